//! Work inside a virtual host: on a thread of its own there, so that whatever threads and sockets it makes stay there.
//! The main function is [`on_host`].

use std::thread::{self, Scope, ScopedJoinHandle};

use super::error::ExperimentError;
use crate::{network::Network, virtual_host::VirtualHost};

/// Runs `make` inside the host and waits for it.
///
/// # Errors
/// If the host cannot be entered, or what the work says.
pub fn on_host<T: Send>(
    network: &dyn Network,
    host: VirtualHost,
    make: impl FnOnce() -> Result<T, ExperimentError> + Send,
) -> Result<T, ExperimentError> {
    thread::scope(|scope| outcome_of(begin_on_host(scope, network, host, make)?, host))
}

/// Work that is under way inside a host.
pub type Making<'scope, T> = ScopedJoinHandle<'scope, Result<T, ExperimentError>>;

/// Begins to run `make` inside the host.
///
/// # Errors
/// If there is no thread for it.
pub fn begin_on_host<'scope, 'env, T: Send + 'scope>(
    scope: &'scope Scope<'scope, 'env>,
    network: &'scope dyn Network,
    host: VirtualHost,
    make: impl FnOnce() -> Result<T, ExperimentError> + Send + 'scope,
) -> Result<Making<'scope, T>, ExperimentError> {
    let name = host.name();
    let inside = thread::Builder::new()
        .name(name.to_owned())
        .spawn_scoped(scope, move || {
            network.enter(host)?;
            make()
        });
    inside.map_err(|source| ExperimentError::Thread { name, source })
}

/// Waits for it.
///
/// # Errors
/// What the work says, or that it ended in a panic.
pub fn outcome_of<T>(making: Making<'_, T>, host: VirtualHost) -> Result<T, ExperimentError> {
    making
        .join()
        .unwrap_or(Err(ExperimentError::ThreadEnded { name: host.name() }))
}
