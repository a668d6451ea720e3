//! The network of the virtual hosts. The trait is [`Network`]; [`open`] gives the network that the settings name.
//!
//! Everything it makes lives as long as the process at most: the
//! namespaces have no name and the devices are not persistent, so that even `kill -9` leaves nothing behind. Only
//! [`mininet`] has others hold something for it, and sees to that itself.

mod backend;
mod device;
mod emulator;
mod error;
pub mod fabric;
mod ipv6;
mod kernel;
pub mod mininet;
mod namespace;
pub mod release_lateness;
mod seed;
pub mod switch;
mod userspace;

use std::{io, thread::JoinHandle};

use record::{
    settings::{NetworkBackend, NetworkSettings},
    virtual_host::VirtualHost,
};

pub(crate) use self::namespace::errno;
pub use self::{
    backend::Network,
    error::NetworkError,
    namespace::{Namespaces, Work, become_namespace_root},
};
use self::{kernel::Kernel, mininet::Mininet, userspace::Userspace};

/// Builds the network that the settings name and starts carrying packets, unimpaired yet. Its own threads ask for the SCHED_FIFO
/// priority `emulator_priority`, 0 for none, and go on without it where it is refused. Without a seed in the settings
/// every network draws its own losses and delays, and [`Network::seed`] tells from what.
///
/// # Errors
/// If the platform does not offer what it needs.
pub fn open(settings: &NetworkSettings, emulator_priority: u8) -> Result<Box<dyn Network>, NetworkError> {
    (Way::to(settings.backend).open)(settings, emulator_priority)
}

/// Starts a thread in a host's network namespace.
///
/// # Errors
/// If it cannot be started.
pub fn spawn<T: Send + 'static>(
    network: &dyn Network,
    host: VirtualHost,
    name: String,
    work: impl FnOnce() -> T + Send + 'static,
) -> io::Result<JoinHandle<T>> {
    namespace::spawn_by(|starting| network.give(host, starting), name, work)
}

/// Whether such a network can work here: makes what one host needs, and drops it. An ordinary user calls
/// [`become_namespace_root`] first.
///
/// # Errors
/// What is missing.
pub fn survey(settings: &NetworkSettings) -> Result<(), NetworkError> {
    (Way::to(settings.backend).survey)(settings)
}

type Opened = Result<Box<dyn Network>, NetworkError>;

/// How a network is had.
struct Way {
    /// [`open`], with the priority of the network's own threads.
    open: fn(&NetworkSettings, u8) -> Opened,
    /// [`survey`].
    survey: fn(&NetworkSettings) -> Result<(), NetworkError>,
}

impl Way {
    /// The one to each backend. What else there is to know of a backend is in [`NetworkBackend::facts`].
    fn to(backend: NetworkBackend) -> Self {
        match backend {
            NetworkBackend::Userspace => Self {
                open: |settings, emulator_priority| {
                    let seed = settings.seed.unwrap_or_else(seed::random_seed);
                    Ok(Box::new(Userspace::open(settings, seed, emulator_priority)?))
                },
                survey: userspace::survey,
            },
            NetworkBackend::Kernel => Self {
                open: |settings, _| Ok(Box::new(Kernel::open(settings)?)),
                survey: kernel::survey,
            },
            NetworkBackend::Mininet => Self {
                open: |settings, _| Ok(Box::new(Mininet::open(settings)?)),
                survey: |_| mininet::survey(),
            },
        }
    }
}
