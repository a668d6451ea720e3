//! What can end the experiment early. The main type is [`ExperimentError`].

use std::{borrow::Cow, io, path::PathBuf};

use record::{
    limits::{self, LimitError},
    virtual_host::VirtualHost,
};

use crate::{capture::CaptureError, command_error::CommandError, network::NetworkError, ros::RosError};

/// Why the experiment could not go on.
#[derive(Debug, thiserror::Error)]
pub enum ExperimentError {
    /// Too few files may be open.
    #[error(transparent)]
    Limits(#[from] LimitError),
    /// There is no network, or no longer.
    #[error("the virtual hosts' network failed")]
    Network(#[from] NetworkError),
    /// A capture could not be had.
    #[error("the capture failed")]
    Capture(#[from] CaptureError),
    /// The user's command could not be run.
    #[error(transparent)]
    Command(#[from] CommandError),
    /// The nodes could not be connected.
    #[error("the ROS nodes could not be connected")]
    Ros(#[from] RosError),
    /// The master's port could not be had.
    #[error("the ROS master cannot listen on {host}")]
    MasterPort {
        /// Where.
        host: VirtualHost,
        /// What the system said.
        source: io::Error,
    },
    /// A thread could not be started.
    #[error("the thread `{name}` could not be started")]
    Thread {
        /// The thread's name.
        name: Cow<'static, str>,
        /// What the system said.
        source: io::Error,
    },
    /// A thread ended before it was told to.
    #[error("the thread `{name}` ended early")]
    ThreadEnded {
        /// The thread's name.
        name: Cow<'static, str>,
    },
    /// A process could not be started.
    #[error("the process of the {name} could not be started")]
    Process {
        /// Which node's.
        name: &'static str,
        /// What the system said.
        source: io::Error,
    },
    /// A node in a process of its own could not go on.
    #[error("the {name} failed: {reason}")]
    Node {
        /// The node's name.
        name: &'static str,
        /// Why, with the causes.
        reason: String,
        /// What to do about it, where that is known.
        hint: Option<String>,
        /// Whether the platform did not offer what is needed.
        platform: bool,
    },
    /// A file could not be written.
    #[error("{} could not be written", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// There is something where a window is to be written.
    #[error("{} is there already", path.display())]
    Taken {
        /// The window's folder.
        path: PathBuf,
    },
}

impl ExperimentError {
    /// What to do about it, where that is known.
    #[must_use]
    pub fn hint(&self) -> Option<String> {
        match self {
            Self::Limits(error) => Some(error.hint()),
            Self::Network(error) => error.hint(),
            Self::Capture(error) => error.hint(),
            Self::Command(error) => error.hint(),
            Self::Ros(error) => error.hint().map(str::to_owned),
            Self::Node { hint, .. } => hint.clone(),
            Self::Thread { .. } | Self::Process { .. } => {
                Some("raise the limit of processes (`ulimit -u`, or the container's `pids` limit)".into())
            }
            Self::Write { source, .. } => match source.kind() {
                io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem => {
                    Some("choose a data folder that you may write to".into())
                }
                _ => limits::room_hint(source).map(str::to_owned),
            },
            Self::Taken { .. } => {
                Some("choose a data folder without windows: none is ever overwritten".into())
            }
            Self::MasterPort { .. } | Self::ThreadEnded { .. } => None,
        }
    }

    /// Whether the platform did not offer what is needed, rather than the experiment itself having gone wrong.
    #[must_use]
    pub fn is_of_platform(&self) -> bool {
        match self {
            Self::Limits(_)
            | Self::Network(_)
            | Self::Capture(_)
            | Self::MasterPort { .. }
            | Self::Thread { .. }
            | Self::Process { .. }
            | Self::Write { .. } => true,
            Self::Command(error) => error.is_of_platform(),
            Self::Ros(error) => matches!(
                error,
                RosError::System { .. } | RosError::NoRosmaster { .. } | RosError::RosmasterEnded { .. }
            ),
            Self::Node { platform, .. } => *platform,
            Self::ThreadEnded { .. } | Self::Taken { .. } => false,
        }
    }
}
