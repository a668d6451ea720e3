//! What is measured in one environment: the trait [`Experiment`], and what all experiments have in common. `crate::experiments` has a
//! row for each.

mod conditions;
mod error;
mod platform_watch;
mod reporter;
pub(crate) mod snapshot;
pub(crate) mod window_folder;

use std::{
    path::PathBuf,
    sync::{Arc, atomic::AtomicBool},
};

use record::settings::Settings;

pub use self::{
    error::ExperimentError,
    platform_watch::{KnownPlatform, PlatformWatch},
    reporter::Reporter,
    window_folder::write_whole,
};

/// What is to be measured.
#[derive(Debug, Clone, PartialEq)]
pub struct Request {
    /// The environment's name.
    pub environment: String,
    /// How; without problems.
    pub settings: Settings,
    /// Where the data go.
    pub data: PathBuf,
    /// Numbers of the windows, one contiguous stretch.
    pub windows: Vec<u32>,
    /// Where a command has its files; none for experiments that need none.
    pub work: Option<PathBuf>,
}

/// An experiment.
pub trait Experiment: Sync {
    /// Does what has to be done first, while the process has one thread.
    ///
    /// # Errors
    /// If the platform does not allow it.
    fn begin(&self, settings: &Settings) -> Result<(), ExperimentError>;

    /// Measures all windows, or until `stop` is set. Everything it made is gone afterwards, except the data.
    ///
    /// # Errors
    /// If the platform lacks something or the experiment goes wrong. Windows that were complete by then are on disk.
    fn run(
        &self,
        request: &Request,
        reporter: &Reporter,
        stop: &Arc<AtomicBool>,
    ) -> Result<Ending, ExperimentError>;
}

/// How a run ended without failing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ending {
    /// All windows are on disk.
    Finished,
    /// It was asked to stop in that window.
    Stopped {
        /// The window that was cut.
        window: u32,
    },
}
