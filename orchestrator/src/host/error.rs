//! What can go wrong between us and a host. The main type is [`HostError`].

use std::time::Duration;

use crate::failure::Cause;

/// What went wrong. Callers tell these apart by what they can do: repair the way, try again, or repair the host.
#[derive(Debug, thiserror::Error)]
pub enum HostError {
    /// It was never reached: nothing listens, its key is not known, it does not let us in.
    #[error("cannot reach host `{host}`")]
    Unreachable {
        /// The host's name in the matrix file.
        host: String,
        /// What would make it answer.
        hint: Option<String>,
        /// The cause.
        source: Cause,
    },
    /// It was reached, then the connection ended. What runs there detached goes on: it can be asked for again.
    #[error("lost the connection to host `{host}` while {action}")]
    Disconnected {
        /// The host's name in the matrix file.
        host: String,
        /// What was being done, as in `following the workload's lines`.
        action: String,
        /// The cause.
        source: Cause,
    },
    /// It answered no.
    #[error("host `{host}` refused {action}")]
    Refused {
        /// The host's name in the matrix file.
        host: String,
        /// What was being done, as in `starting /usr/bin/vagrant`.
        action: String,
        /// What would make it possible.
        hint: Option<String>,
        /// The cause.
        source: Cause,
    },
    /// There is no workload that it could run.
    #[error("host `{host}` cannot run the workload")]
    NoWorkload {
        /// The host's name in the matrix file.
        host: String,
        /// What would make it possible.
        hint: Option<String>,
        /// The cause.
        source: Cause,
    },
    /// It did not get done in time.
    #[error("host `{host}` was not done with {action} after {} s", .after.as_secs())]
    TimedOut {
        /// The host's name in the matrix file.
        host: String,
        /// What was being done, as in `running /usr/bin/vagrant`.
        action: String,
        /// How long it was waited for.
        after: Duration,
    },
}

impl HostError {
    /// What to do about it, where that is known.
    #[must_use]
    pub fn hint(&self) -> Option<String> {
        match self {
            Self::Unreachable { hint, .. } | Self::Refused { hint, .. } | Self::NoWorkload { hint, .. } => {
                hint.clone()
            }
            Self::Disconnected { .. } => {
                Some("what runs there may go on without us: `matrix resume` finds it".to_owned())
            }
            Self::TimedOut { .. } => Some("see what keeps it busy, or whether its disk answers".to_owned()),
        }
    }

    /// Whether trying again soon may help, with nothing repaired by anybody.
    #[must_use]
    pub fn is_passing(&self) -> bool {
        matches!(self, Self::Disconnected { .. })
    }
}
