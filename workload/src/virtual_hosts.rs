//! What experiments have on the hosts of an emulated network, whatever they measure: a thread or a program on a host, ways in for
//! tools, the ROS master, captures, and `network.txt`.

mod master;
mod namespace_entries;
mod namespace_thread;
mod notices;

use std::path::Path;

use record::{layout, settings::CaptureSettings, virtual_host::VirtualHost};

pub use self::{
    master::{
        RunningMaster, start as start_master, survey as survey_master, uri, version as version_of_master,
    },
    namespace_entries::NamespaceEntries,
    namespace_thread::{begin_on_host, on_host, outcome_of},
    notices::{News, NoticeQueue},
};
use crate::{capture::Capture, experiment::ExperimentError, network::Network};

/// A capture on each host of the network, if captures are wanted.
///
/// # Errors
/// If one cannot be opened.
pub fn start_captures(
    settings: &CaptureSettings,
    network: &dyn Network,
) -> Result<Vec<(VirtualHost, Capture)>, ExperimentError> {
    let hosts = network.topology().names().filter(|_| settings.enabled);
    hosts
        .map(|host| Ok((host, Capture::start(network, host, settings)?)))
        .collect()
}

/// Writes how the network was made and what went through its links, if there is something to tell.
///
/// # Errors
/// If it cannot be written.
pub fn keep_transcript(data: &Path, network: &dyn Network) -> Result<(), ExperimentError> {
    let Some(transcript) = network.transcript() else {
        return Ok(());
    };
    let path = data.join(layout::NETWORK);
    std::fs::write(&path, transcript).map_err(|source| ExperimentError::Write { path, source })
}
