//! Why there is no Mininet, or no longer. The main type is [`MininetError`].

use std::time::Duration;

/// What is missing or went wrong.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MininetError {
    /// It would change the machine's Open vSwitch.
    #[error("Mininet needs to be root of this machine")]
    NotRoot,
    /// Something is not installed.
    #[error("Mininet cannot work here: {what} is not installed")]
    Missing {
        /// What, such as `mnexec`.
        what: String,
    },
    /// A host's namespaces cannot be made.
    #[error("Mininet cannot make a host here: {said}")]
    Refused {
        /// What `mnexec` said.
        said: String,
    },
    /// Open vSwitch's daemons do not answer.
    #[error("Open vSwitch does not answer: {said}")]
    Service {
        /// What its tool said.
        said: String,
    },
    /// Mininet failed.
    #[error("Mininet failed: {said}")]
    Failed {
        /// What it said.
        said: String,
    },
    /// Mininet takes too long.
    #[error("Mininet did not answer within {after:?}")]
    Silent {
        /// The timeout that it had.
        after: Duration,
    },
    /// The program that holds the network has ended.
    #[error("the program that holds Mininet's network has ended")]
    Ended,
    /// The program that holds the network says what nobody expects.
    #[error("the program that holds Mininet's network answered {answer:?}")]
    Puzzling {
        /// The line.
        answer: String,
    },
}

impl MininetError {
    /// What to do about it, where that is known.
    #[must_use]
    pub fn hint(&self) -> Option<&'static str> {
        match self {
            Self::NotRoot => Some("run as root, or use `backend: userspace`"),
            Self::Missing { .. } => Some(
                "use `backend: userspace`, or install it: `apt-get install mininet openvswitch-switch \
                 openvswitch-testcontroller ethtool`; in Docker, name the image of `dockerfiles/mininet/build`",
            ),
            Self::Refused { .. } => Some(
                "use `backend: userspace`, or let the workload mount file systems: in Docker with `system_calls: \
                 [mount]` under `providers.docker`, and where the engine's host has AppArmor with `apparmor: unconfined`",
            ),
            Self::Service { .. } => Some(
                "start it: `systemctl start openvswitch-switch`, where there is no systemd \
                 `/usr/share/openvswitch/scripts/ovs-ctl start --system-id=random`, in Docker `entrypoint: \
                 [with-openvswitch]` under `providers.docker`; or use `backend: userspace`",
            ),
            Self::Failed { .. } | Self::Silent { .. } | Self::Ended | Self::Puzzling { .. } => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[rstest::rstest]
    #[case(MininetError::NotRoot, "run as root")]
    #[case(MininetError::Missing { what: "mnexec".into() }, "apt-get install mininet")]
    #[case(MininetError::Refused { said: "mount: Permission denied".into() }, "system_calls: [mount]")]
    #[case(MininetError::Service { said: "no such file".into() }, "systemctl start openvswitch-switch")]
    fn what_a_user_can_mend_comes_with_its_fix(#[case] error: MininetError, #[case] fix: &str) {
        let hint = error.hint().unwrap();
        assert!(
            hint.contains(fix) && hint.contains("backend: userspace"),
            "{hint}"
        );
    }
}
