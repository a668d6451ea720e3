//! The network of the three virtual hosts: what the experiment asks of it. The main type is [`Network`].
//!
//! [`open`] gives the network that the settings name. Everything it makes lives as long as the process at most: the
//! namespaces have no name and the devices are not persistent, so that even `kill -9` leaves nothing behind.

use nix::errno::Errno;

use crate::{
    record::window::LinkRecord,
    settings::{NetworkBackend, NetworkSettings},
    virtual_host::VirtualHost,
};

/// Three hosts and the links between them, up from [`open`] until it is dropped.
pub trait Network: Send + Sync {
    /// Moves the calling thread into the host's network namespace: sockets it opens from now on are there, those
    /// opened before stay where they are. Threads that it starts later are there, too.
    ///
    /// # Errors
    /// If the kernel refuses.
    fn enter(&self, host: VirtualHost) -> Result<(), NetworkError>;

    /// The name of the host's interface, inside its namespace.
    fn interface(&self, host: VirtualHost) -> String;

    /// What went through the links since the network came up, in [`VirtualHost::ALL`]'s order.
    fn links(&self) -> Vec<LinkRecord>;

    /// Why the network stopped carrying packets, if it did.
    fn failure(&self) -> Option<NetworkError>;
}

/// Why there is no network, or no longer.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NetworkError {
    /// The kernel refused a step of building or using the network.
    #[error("{action} failed")]
    Refused {
        /// What was to be done, such as `creating a network namespace`.
        action: String,
        /// What the kernel said.
        source: Errno,
    },
}

impl NetworkError {
    /// What to do about it, where that is known.
    #[must_use]
    pub fn hint(&self) -> Option<String> {
        None
    }
}

/// Lets an ordinary user build networks: moves the process into a user namespace of its own in which it is root, if
/// it lacks the rights to make network namespaces. Call it first thing, while the process has one thread.
///
/// # Errors
/// If the kernel does not let ordinary users have user namespaces.
pub fn become_namespace_root() -> Result<(), NetworkError> {
    Ok(())
}

/// Builds the network that the settings name and starts carrying packets. Its own threads ask for the SCHED_FIFO
/// priority `emulator_priority`, 0 for none, and go on without it where it is refused.
///
/// # Errors
/// If the platform does not offer what it needs.
pub fn open(settings: &NetworkSettings, _emulator_priority: u8) -> Result<Box<dyn Network>, NetworkError> {
    survey(settings.backend)?;
    Err(NetworkError::Refused {
        action: "opening the network".into(),
        source: Errno::ENOSYS,
    })
}

/// Whether such a network can work here: makes what one host needs, and drops it.
///
/// # Errors
/// What is missing.
pub fn survey(backend: NetworkBackend) -> Result<(), NetworkError> {
    match backend {
        NetworkBackend::Userspace => Err(NetworkError::Refused {
            action: "opening the network".into(),
            source: Errno::ENOSYS,
        }),
    }
}
