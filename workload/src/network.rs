//! The network of the three virtual hosts: what the experiment asks of it. The main type is [`Network`].
//!
//! [`open`] gives the network that the settings name. Everything it makes lives as long as the process at most: the
//! namespaces have no name and the devices are not persistent, so that even `kill -9` leaves nothing behind. Only
//! [`mininet`] has others hold something for it, and sees to that itself.

mod device;
mod emulator;
mod ipv6;
mod kernel;
pub mod link;
pub mod mininet;
mod namespace;
pub mod release_lateness;
pub mod star;
pub mod switch;
mod userspace;

use std::{
    hash::{BuildHasher, Hasher, RandomState},
    io,
    thread::JoinHandle,
};

use nix::errno::Errno;

pub use self::namespace::Work;
pub use self::namespace::become_namespace_root;
pub(crate) use self::namespace::errno;
use self::{
    kernel::Kernel,
    mininet::{Mininet, MininetError},
    release_lateness::ReleaseCounts,
    userspace::Userspace,
};
use crate::{
    record::window::LinkRecord,
    settings::{NetworkBackend, NetworkSettings},
    virtual_host::VirtualHost,
};

/// Three hosts and the links between them, up from [`open`] until it is dropped.
pub trait Network: Send + Sync {
    /// Moves the calling thread into the host's network namespace: sockets it opens from now on are there, those
    /// opened before stay where they are. Threads that it starts later are there, too. The thread must have
    /// CAP_SYS_ADMIN; the experiment, which has not, uses [`spawn`].
    ///
    /// # Errors
    /// If the kernel refuses.
    fn enter(&self, host: VirtualHost) -> Result<(), NetworkError>;

    /// Has a thread that is in the host's namespace do something short, sometime. [`spawn`] is what it is for.
    ///
    /// # Errors
    /// If there is no such thread.
    fn give(&self, host: VirtualHost, work: Work) -> io::Result<()>;

    /// The name of the host's interface, inside its namespace.
    fn interface(&self, host: VirtualHost) -> String;

    /// From now on every link delays, loses and limits as the settings say. A network that was opened carries without
    /// delay or loss until then; [`ImpairedFrom`](crate::settings::ImpairedFrom) says why. Once is enough.
    ///
    /// # Errors
    /// If the platform refuses.
    fn impair(&self) -> Result<(), NetworkError>;

    /// What went through the links since the network came up, in [`VirtualHost::ALL`]'s order.
    fn links(&self) -> Vec<LinkRecord>;

    /// What losses and delays are drawn from, given or drawn itself; none if they cannot be drawn again.
    fn seed(&self) -> Option<u64>;

    /// How late packets were let go since the network came up; nothing where that is the kernel's doing.
    fn release_lateness(&self) -> Option<ReleaseCounts> {
        None
    }

    /// What was done to the platform to have the network and what the platform says of it now, for a person to read:
    /// `network.txt`. None where nothing outside this process was asked for anything.
    fn transcript(&self) -> Option<String> {
        None
    }

    /// Why the network stopped carrying packets, if it did.
    fn failure(&self) -> Option<NetworkError>;
}

/// Why there is no network, or no longer.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NetworkError {
    /// An ordinary user could not become root of a user namespace.
    #[error("this user may not have a user namespace")]
    UserNamespace {
        /// What the kernel said.
        source: Errno,
    },
    /// No network namespace.
    #[error("a network namespace could not be made")]
    Namespace {
        /// What the kernel said.
        source: Errno,
    },
    /// No way into a host's namespace.
    #[error("a network namespace could not be entered")]
    Enter {
        /// What the kernel said.
        source: Errno,
    },
    /// No TUN/TAP.
    #[error("/dev/net/tun could not be opened")]
    TunDevice {
        /// What the kernel said.
        source: Errno,
    },
    /// A host's interface could not be set up.
    #[error("interface {interface}: {action} failed")]
    Interface {
        /// Its name.
        interface: String,
        /// What was to be done with it, such as `setting its address`.
        action: &'static str,
        /// What the kernel said.
        source: Errno,
    },
    /// A program that sets networks up is not there.
    #[error("{program} is not installed")]
    Tool {
        /// Its name.
        program: &'static str,
    },
    /// A program that sets networks up could not be started.
    #[error("{program} could not be started")]
    Start {
        /// Its name.
        program: &'static str,
        /// What the kernel said.
        source: Errno,
    },
    /// The kernel has not got a part of the network.
    #[error("{part} is not in this kernel")]
    KernelLacks {
        /// What it lacks, such as `netem`.
        part: &'static str,
        /// The module that would have it.
        module: &'static str,
    },
    /// A program that sets networks up failed.
    #[error("`{command}` failed: {said}")]
    Command {
        /// The program and its arguments.
        command: String,
        /// What it printed.
        said: String,
    },
    /// There is no Mininet.
    #[error(transparent)]
    Mininet(#[from] MininetError),
    /// A thread of the network could not be started.
    #[error("a thread of the network could not be started")]
    Thread {
        /// What the kernel said.
        source: Errno,
    },
    /// The network was up and no longer carries packets.
    #[error("the network stopped: {action} failed")]
    Carrying {
        /// What was to be done, such as `waiting for packets`.
        action: &'static str,
        /// What the kernel said.
        source: Errno,
    },
}

impl NetworkError {
    /// What to do about it, where that is known.
    #[must_use]
    pub fn hint(&self) -> Option<String> {
        let hint = match self {
            Self::UserNamespace {
                source: Errno::EINVAL,
            } => {
                "this is a mistake in the program: it has started threads before asking for a user namespace"
            }
            Self::UserNamespace { .. } => {
                "run as root, or allow user namespaces to ordinary users: as root `sysctl -w \
                 user.max_user_namespaces=15000`, on Debian also `kernel.unprivileged_userns_clone=1`, on Ubuntu also \
                 `kernel.apparmor_restrict_unprivileged_userns=0`; in a container, add the capabilities NET_ADMIN and \
                 SYS_ADMIN"
            }
            Self::Namespace {
                source: Errno::ENOSPC,
            } => "the limit is reached: as root `sysctl -w user.max_net_namespaces=15000`",
            Self::Namespace { .. } | Self::Enter { .. } => {
                "run as root, or on Ubuntu, as root, `sysctl -w kernel.apparmor_restrict_unprivileged_userns=0`; in a \
                 container, add the capabilities NET_ADMIN and SYS_ADMIN"
            }
            Self::TunDevice {
                source: Errno::EACCES | Errno::EPERM,
            } => {
                "as root `chmod 0666 /dev/net/tun`, which is its usual mode; in a container, pass the device \
                 `/dev/net/tun`"
            }
            Self::TunDevice { .. } => {
                "load the module: `modprobe tun`; in a container, pass the device `/dev/net/tun`"
            }
            Self::Interface {
                source: Errno::EPERM, ..
            } => "in a container, add the capability NET_ADMIN",
            Self::Tool { program } => {
                let package = match *program {
                    "ethtool" => "ethtool",
                    "ovs-vsctl" | "ovs-appctl" | "ovs-dpctl" => "openvswitch-switch",
                    _ => "iproute2",
                };
                return Some(format!(
                    "use `backend: userspace`, or install it (`apt-get install {package}`); in a container, name an \
                     `image:` that has it"
                ));
            }
            Self::KernelLacks { module, .. } => {
                return Some(format!(
                    "use `backend: userspace`, or load {module}: as root `modprobe {module}`"
                ));
            }
            Self::Mininet(error) => return error.hint().map(str::to_owned),
            Self::Command { said, .. } if said.contains("not permitted") => {
                "run as root; in a container, add the capability NET_ADMIN"
            }
            Self::Thread { .. } | Self::Start { .. } => {
                "raise the limit of processes (`ulimit -u`, or the container's `pids` limit)"
            }
            Self::Interface { .. } | Self::Command { .. } | Self::Carrying { .. } => return None,
        };
        Some(hint.to_owned())
    }
}

/// Builds the network that the settings name and starts carrying packets, unimpaired yet. Its own threads ask for the SCHED_FIFO
/// priority `emulator_priority`, 0 for none, and go on without it where it is refused. Without a seed in the settings
/// every network draws its own losses and delays, and [`Network::seed`] tells from what.
///
/// # Errors
/// If the platform does not offer what it needs.
pub fn open(settings: &NetworkSettings, emulator_priority: u8) -> Result<Box<dyn Network>, NetworkError> {
    match settings.backend {
        NetworkBackend::Userspace => {
            let seed = settings.seed.unwrap_or_else(random_seed);
            Ok(Box::new(Userspace::open(settings, seed, emulator_priority)?))
        }
        NetworkBackend::Kernel => Ok(Box::new(Kernel::open(settings)?)),
        NetworkBackend::Mininet => Ok(Box::new(Mininet::open(settings)?)),
    }
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
    match settings.backend {
        NetworkBackend::Userspace => userspace::survey(),
        NetworkBackend::Kernel => kernel::survey(settings),
        NetworkBackend::Mininet => mininet::survey(),
    }
}

/// The standard library's only source of randomness: the keys of a new hash map are drawn by the operating system. 53
/// bits of it, which every reader of JSON keeps exactly, so that a recorded seed can be used again.
fn random_seed() -> u64 {
    RandomState::new().build_hasher().finish() >> 11
}

#[cfg(test)]
mod tests {
    use super::*;

    #[rstest::rstest]
    #[case(NetworkError::UserNamespace { source: Errno::EPERM }, "user namespaces")]
    #[case(NetworkError::Namespace { source: Errno::EPERM }, "SYS_ADMIN")]
    #[case(NetworkError::TunDevice { source: Errno::EACCES }, "chmod 0666 /dev/net/tun")]
    #[case(NetworkError::TunDevice { source: Errno::ENOENT }, "modprobe tun")]
    #[case(
        NetworkError::Interface { interface: "h1-eth0".into(), action: "making it", source: Errno::EPERM },
        "NET_ADMIN"
    )]
    #[case(NetworkError::Command { command: "tc".into(), said: "Operation not permitted".into() }, "NET_ADMIN")]
    #[case(NetworkError::Tool { program: "tc" }, "apt-get install iproute2")]
    #[case(NetworkError::KernelLacks { part: "netem", module: "sch_netem" }, "modprobe sch_netem")]
    #[case(NetworkError::KernelLacks { part: "netem", module: "sch_netem" }, "backend: userspace")]
    fn what_a_user_can_mend_comes_with_its_fix(#[case] error: NetworkError, #[case] fix: &str) {
        assert!(
            error.hint().unwrap().contains(fix),
            "{error:?}: {:?}",
            error.hint()
        );
    }

    #[test]
    fn networks_without_a_seed_differ() {
        assert_ne!(random_seed(), random_seed());
    }

    #[test]
    fn a_drawn_seed_is_exact_as_a_number_of_javascript() {
        let most = (0..1000).map(|_| random_seed()).max().unwrap();
        assert!((1 << 50..1 << 53).contains(&most), "{most}");
    }
}
