//! What can go wrong between us and a platform. The main type is [`ProviderError`].
//!
//! All of these say something of the infrastructure, none of the experiment: a scenario that ends with one is
//! `errored`. They are told apart by what a caller can do: repair the host, ask again, or give up on the data.

use std::{io, path::PathBuf};

use record::causes::with_causes;

use super::time_limit::WindowTooLong;
use crate::{
    failure::{Cause, file_hint},
    host::HostError,
    workload_binary::InstallError,
};

/// What went wrong.
#[derive(Debug, thiserror::Error)]
pub enum ProviderError {
    /// There is no provider of that name.
    #[error("there is no virtualization `{name}`")]
    Unknown {
        /// As it was asked for.
        name: String,
        /// Those that there are.
        known: Vec<&'static str>,
    },
    /// There is no host of that name.
    #[error("there is no host `{name}`")]
    UnknownHost {
        /// As it was asked for.
        name: String,
    },
    /// This version knows the provider but cannot drive it.
    #[error("{provider}: {reason}")]
    Unsupported {
        /// The provider's name on the axis `virtualization`.
        provider: String,
        /// The reason, as the plan and the report print it.
        reason: String,
        /// What to do instead.
        hint: Option<String>,
    },
    /// A node of a cluster is asked by a job, and none was to be submitted.
    #[error("host `{host}`: what its nodes have is known in a job")]
    KnownInAJob {
        /// The host's name in the matrix file.
        host: String,
    },
    /// Not even one window fits into the time that an environment may take.
    #[error(transparent)]
    WindowTooLong(#[from] WindowTooLong),
    /// The platform does not answer at all.
    #[error("cannot reach {platform}")]
    Unreachable {
        /// What does not answer.
        platform: String,
        /// What would make it answer.
        hint: Option<String>,
        /// The cause.
        source: Cause,
    },
    /// The platform answered, then the connection ended. The environment may well go on: it can be found again.
    #[error("lost the connection to {platform} while {action}")]
    Disconnected {
        /// What stopped answering.
        platform: String,
        /// What was being done, as in `following the workload's lines`.
        action: String,
        /// The cause.
        source: Cause,
    },
    /// The platform said no.
    #[error("{platform} refused {action}")]
    Refused {
        /// What refused.
        platform: String,
        /// What was being done, as in `creating the container matrix-r1-a`.
        action: String,
        /// What would make it possible.
        hint: Option<String>,
        /// The cause.
        source: Cause,
    },
    /// Something that should be there is not.
    #[error("{what} does not exist any more")]
    NotFound {
        /// What, by kind and name.
        what: String,
    },
    /// The platform did not get done in time.
    #[error("{action} was not done after {} s", .after.as_secs())]
    TimedOut {
        /// What was being done.
        action: String,
        /// How long it was waited for.
        after: std::time::Duration,
    },
    /// A file on this machine could not be read or written.
    #[error("cannot {action} {}", .path.display())]
    File {
        /// What was being done, as in `write`.
        action: &'static str,
        /// Which file or directory.
        path: PathBuf,
        /// The cause.
        source: io::Error,
    },
    /// What came from the environment is not what a workload leaves behind. Nothing of it was trusted.
    #[error("{what}: {reason}")]
    Data {
        /// Which part.
        what: String,
        /// What is wrong with it.
        reason: String,
    },
    /// Something was called when it must not be.
    #[error("{reason}")]
    OutOfOrder {
        /// What was called when it must not be.
        reason: &'static str,
    },
    /// A fault that the matrix file asked the fake platform to play.
    #[error("the fake platform was told to fail at {at}")]
    Played {
        /// Where.
        at: &'static str,
    },
}

impl From<HostError> for ProviderError {
    fn from(error: HostError) -> Self {
        let platform = |host| format!("host `{host}`");
        match error {
            HostError::Unreachable { host, hint, source } => Self::Unreachable {
                platform: platform(host),
                hint,
                source,
            },
            HostError::Disconnected { host, action, source } => Self::Disconnected {
                platform: platform(host),
                action,
                source,
            },
            HostError::Refused {
                host,
                action,
                hint,
                source,
            } => Self::Refused {
                platform: platform(host),
                action,
                hint,
                source,
            },
            HostError::TimedOut { action, after, .. } => Self::TimedOut { action, after },
            HostError::NoWorkload { host, hint, source } => Self::Unsupported {
                provider: platform(host),
                reason: with_causes(source.as_ref()),
                hint,
            },
        }
    }
}

impl From<InstallError> for ProviderError {
    fn from(error: InstallError) -> Self {
        Self::File {
            action: "write",
            path: error.path,
            source: error.source,
        }
    }
}

impl ProviderError {
    /// What the system of this machine refused, while that was being done.
    #[must_use]
    pub fn of_this_machine(action: &str, source: io::Error) -> Self {
        Self::Refused {
            platform: "this machine".to_owned(),
            action: action.to_owned(),
            hint: None,
            source: source.into(),
        }
    }

    /// Whether trying again soon may help, with nothing repaired by anybody, where the platform was reached before.
    #[must_use]
    pub fn is_passing(&self) -> bool {
        matches!(self, Self::Disconnected { .. } | Self::Unreachable { .. })
    }

    /// What to do about it, where that is known.
    #[must_use]
    pub fn hint(&self) -> Option<String> {
        match self {
            Self::Unknown { known, .. } => Some(format!("write one of {}", known.join(", "))),
            Self::KnownInAJob { .. } => {
                Some("`matrix doctor FILE --probe` submits one of a minute".to_owned())
            }
            Self::WindowTooLong(_) => Some(WindowTooLong::HINT.to_owned()),
            Self::UnknownHost { .. } => Some("write it under `hosts:` in the matrix file".to_owned()),
            Self::Unsupported { hint, .. } | Self::Unreachable { hint, .. } | Self::Refused { hint, .. } => {
                hint.clone()
            }
            Self::Disconnected { .. } => {
                Some("the environment may go on without us: `matrix resume` finds it".to_owned())
            }
            Self::NotFound { .. } => {
                Some("somebody else removed it; `matrix resume` measures again what is missing".to_owned())
            }
            Self::TimedOut { .. } => Some("`matrix clean` shows and removes what is left".to_owned()),
            Self::File { source, .. } => file_hint(source),
            Self::Data { .. } => Some("what arrived is kept under `broken/` and never counted".to_owned()),
            Self::OutOfOrder { .. } => {
                Some("this is a mistake in matrix itself: please report it".to_owned())
            }
            Self::Played { .. } => Some("take `fail` out of `providers.fake` in the matrix file".to_owned()),
        }
    }
}
