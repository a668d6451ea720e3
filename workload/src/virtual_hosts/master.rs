//! The ROS master on a virtual host, whichever program it is. The main type is [`RunningMaster`].

use std::net::{Ipv4Addr, TcpListener};

use record::{settings::RosMaster, virtual_host::VirtualHost};

use crate::experiment::ExperimentError;
use crate::ros::{Master, Notices, RosError, Rosmaster, rosmaster};

/// The ROS master's usual port.
const PORT: u16 = 11311;

/// Where the master of that address is, whichever it is.
#[must_use]
pub fn uri(address: Ipv4Addr) -> String {
    format!("http://{address}:{PORT}/")
}

/// A master that answers, until it is dropped or stopped.
pub trait RunningMaster: Send {
    /// Ends it and waits until it has ended.
    ///
    /// # Errors
    /// If it had ended before, and did not come back.
    fn stop(self: Box<Self>) -> Result<(), ExperimentError>;
}

/// Starts the master that the settings name. Called from a thread inside the host, which has that address.
///
/// # Errors
/// If it is not installed, its port is taken, or it does not answer.
pub fn start(
    which: RosMaster,
    (host, address): (VirtualHost, Ipv4Addr),
    notices: Notices,
) -> Result<Box<dyn RunningMaster>, ExperimentError> {
    Ok(match which {
        RosMaster::Embedded => {
            let listener = TcpListener::bind((address, PORT))
                .map_err(|source| ExperimentError::MasterPort { host, source })?;
            Box::new(Master::start(listener, notices)?)
        }
        RosMaster::Rosmaster => Box::new(Rosmaster::start(address, PORT, notices)?),
    })
}

/// Whether that master can run here.
///
/// # Errors
/// What is missing.
pub fn survey(which: RosMaster) -> Result<(), RosError> {
    match which {
        RosMaster::Embedded => Ok(()),
        RosMaster::Rosmaster => rosmaster::survey(),
    }
}

/// The version of that master, where it is known; of the embedded one it is the workload's.
#[must_use]
pub fn version(which: RosMaster) -> Option<String> {
    match which {
        RosMaster::Embedded => Some(env!("CARGO_PKG_VERSION").to_owned()),
        RosMaster::Rosmaster => rosmaster::version(),
    }
}

impl RunningMaster for Master {
    fn stop(self: Box<Self>) -> Result<(), ExperimentError> {
        Self::stop(*self);
        Ok(())
    }
}

impl RunningMaster for Rosmaster {
    fn stop(self: Box<Self>) -> Result<(), ExperimentError> {
        Self::stop(*self);
        Ok(())
    }
}
