//! Work inside a virtual host: on a thread of its own there, so that whatever threads and sockets it makes stay there.
//! The main function is [`on_host`].

use std::thread::JoinHandle;

use record::virtual_host::VirtualHost;

use crate::experiment::ExperimentError;
use crate::network::{self, Network};

/// Runs `make` inside the host and waits for it.
///
/// # Errors
/// If there is no thread for it, or what the work says.
pub fn on_host<T: Send + 'static>(
    network: &dyn Network,
    host: VirtualHost,
    make: impl FnOnce() -> Result<T, ExperimentError> + Send + 'static,
) -> Result<T, ExperimentError> {
    outcome_of(begin_on_host(network, host, make)?, host)
}

/// Work that is under way inside a host.
pub type Making<T> = JoinHandle<Result<T, ExperimentError>>;

/// Begins to run `make` inside the host.
///
/// # Errors
/// If there is no thread for it.
pub fn begin_on_host<T: Send + 'static>(
    network: &dyn Network,
    host: VirtualHost,
    make: impl FnOnce() -> Result<T, ExperimentError> + Send + 'static,
) -> Result<Making<T>, ExperimentError> {
    network::spawn(network, host, host.to_string(), make).map_err(|source| ExperimentError::Thread {
        name: host.to_string().into(),
        source,
    })
}

/// Waits for it.
///
/// # Errors
/// What the work says, or that it ended in a panic.
pub fn outcome_of<T>(making: Making<T>, host: VirtualHost) -> Result<T, ExperimentError> {
    making.join().unwrap_or(Err(ExperimentError::ThreadEnded {
        name: host.to_string().into(),
    }))
}
