//! Why there is no network, or no longer, and what to do about it. The type is [`NetworkError`].

use nix::errno::Errno;

use super::mininet::error::MininetError;

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
        /// The interface's name.
        interface: String,
        /// What was to be done with it, such as `setting its address`.
        action: &'static str,
        /// What the kernel said.
        source: Errno,
    },
    /// A program that sets networks up is not there.
    #[error("{program} is not installed")]
    Tool {
        /// The tool's name.
        program: &'static str,
    },
    /// A program that sets networks up could not be started.
    #[error("{program} could not be started")]
    Start {
        /// The tool's name.
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
    /// The network has no host of that name.
    #[error("the network has no host {host}")]
    NoHost {
        /// Its name.
        host: String,
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
            Self::Interface { .. } | Self::Command { .. } | Self::Carrying { .. } | Self::NoHost { .. } => {
                return None;
            }
        };
        Some(hint.to_owned())
    }
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
}
