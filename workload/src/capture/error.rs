//! Why there is no capture, and what to do about it. The type is [`CaptureError`].

use std::{io, path::PathBuf, sync::Arc};

use nix::errno::Errno;
use record::{limits, virtual_host::VirtualHost};

/// Why there is no capture.
#[derive(Debug, Clone, thiserror::Error)]
pub enum CaptureError {
    /// The packet socket could not be opened, or no longer be read.
    #[error("the capture on {host} failed: {action}")]
    Socket {
        /// Whose.
        host: VirtualHost,
        /// What failed, such as `opening a packet socket`.
        action: &'static str,
        /// What the kernel said.
        source: Errno,
    },
    /// The reading thread could not be started.
    #[error("the reading thread of the capture on {host} could not be started")]
    Thread {
        /// Whose.
        host: VirtualHost,
        /// The system's error.
        source: Arc<io::Error>,
    },
    /// The reading thread has ended; its last window says why.
    #[error("the capture on {host} has ended")]
    Ended {
        /// Whose.
        host: VirtualHost,
    },
    /// tcpdump could not be started.
    #[error("tcpdump could not be started")]
    Tool {
        /// The system's error.
        source: Arc<io::Error>,
    },
    /// tcpdump would end at once.
    #[error("tcpdump may not set its groups here, which it does as it starts")]
    ToolRights,
    /// tcpdump has ended, or does not answer.
    #[error("tcpdump on {host} no longer captures: {said}")]
    ToolEnded {
        /// Where.
        host: VirtualHost,
        /// Its last words.
        said: String,
    },
    /// The filter is none.
    #[error("tcpdump refused the filter `{expression}`: {said}")]
    Filter {
        /// As it was written.
        expression: String,
        /// tcpdump's words.
        said: String,
    },
    /// A file could not be written.
    #[error("cannot write the capture {}", file.display())]
    Write {
        /// The capture's path.
        file: PathBuf,
        /// The system's error.
        source: Arc<io::Error>,
    },
}

impl CaptureError {
    /// What to do about it, where that is known.
    #[must_use]
    pub fn hint(&self) -> Option<String> {
        match self {
            Self::Socket {
                source: Errno::EPERM, ..
            } => Some("in a container, add the capability NET_RAW".to_owned()),
            Self::Thread { .. } => {
                Some("raise the limit of processes (`ulimit -u`, or the container's `pids` limit)".to_owned())
            }
            Self::Write { source, .. } => match source.kind() {
                io::ErrorKind::StorageFull => {
                    Some("make room on the disk, or lower `capture.snaplen`".to_owned())
                }
                io::ErrorKind::PermissionDenied => Some("choose a folder that you may write to".to_owned()),
                _ => limits::room_hint(source).map(str::to_owned),
            },
            Self::Tool { .. } => Some(
                "install it where the workload runs (`apt-get install tcpdump`; in Docker, name an `image:` that has \
                 it), or do without: `capture: {tool: builtin}` and no `capture.filter`"
                    .to_owned(),
            ),
            Self::ToolRights => Some(
                "run as root, in Docker with `providers: {docker: {capabilities: [SETGID]}}`, or write `capture: {tool: \
                 builtin}`"
                    .to_owned(),
            ),
            Self::Filter { .. } => {
                Some("write `capture.filter` as pcap-filter(7) says, such as `tcp and not port 11311`".to_owned())
            }
            Self::Socket { .. } | Self::Ended { .. } | Self::ToolEnded { .. } => None,
        }
    }
}
