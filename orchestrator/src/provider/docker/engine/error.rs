//! What errors of bollard's mean to us, and what to do about them.

use std::{io, time::Duration};

use bollard::errors::Error;

use super::super::transport::{self, TooLong};
use crate::provider::ProviderError;

pub(super) fn unreachable(address: &str, error: Error) -> ProviderError {
    ProviderError::Unreachable {
        platform: format!("a Docker Engine at {address}"),
        hint: Some(how_to_reach(address, &error)),
        // The operating system's words say more than those of the layers above it.
        source: match io_error(&error) {
            // Words of ours.
            Some(io::ErrorKind::Other) | None => error.into(),
            Some(kind) => io::Error::from(kind).into(),
        },
    }
}

/// An engine took a connection and said nothing.
#[derive(Debug, thiserror::Error)]
#[error("it did not answer within {0:?}")]
pub(super) struct Silent(pub(super) Duration);

pub(super) fn how_to_reach(address: &str, error: &Error) -> String {
    if !address.starts_with("unix://") {
        return "check DOCKER_HOST: `unix:///path` and `tcp://host:port` can be reached".to_owned();
    }
    match io_error(error) {
        Some(io::ErrorKind::PermissionDenied) => {
            "run `sudo usermod -aG docker $USER` and log in again, or run matrix as root".to_owned()
        }
        Some(io::ErrorKind::ConnectionRefused) => {
            "the engine has ended: start it, for instance with `sudo systemctl start docker`".to_owned()
        }
        Some(io::ErrorKind::NotFound) => INSTALL.to_owned(),
        _ if matches!(error, Error::SocketNotFoundError(_)) => INSTALL.to_owned(),
        // Something listens there.
        _ => "the engine is there and does not answer as it should: see what keeps it busy, or restart it, for instance \
              with `sudo systemctl restart docker`"
            .to_owned(),
    }
}

const INSTALL: &str = "install Docker Engine (on Debian and Ubuntu `sudo apt-get install docker.io`) and start it, for \
                       instance with `sudo systemctl start docker`";

/// What the operating system said, if it said something.
pub(super) fn io_error(error: &Error) -> Option<io::ErrorKind> {
    transport::io_error(error).map(io::Error::kind)
}

/// What an error of bollard's means to us; `action` as in `creating the container x`.
pub fn translate(action: &str, error: Error) -> ProviderError {
    if let Some(too_long) = TooLong::behind(&error) {
        return endless(too_long, action);
    }
    match error {
        Error::DockerResponseServerError {
            status_code: 404,
            ref message,
        } => ProviderError::Refused {
            platform: PLATFORM.to_owned(),
            action: action.to_owned(),
            hint: message.contains("No such container").then(|| {
                "somebody else removed it; `matrix resume` measures again what is missing".to_owned()
            }),
            source: error.into(),
        },
        Error::DockerResponseServerError { ref message, .. } => ProviderError::Refused {
            platform: PLATFORM.to_owned(),
            action: action.to_owned(),
            hint: hint(message),
            source: error.into(),
        },
        Error::DockerStreamError { error: ref message } => ProviderError::Refused {
            platform: PLATFORM.to_owned(),
            action: action.to_owned(),
            hint: hint(message),
            source: error.into(),
        },
        other => ProviderError::Disconnected {
            platform: PLATFORM.to_owned(),
            action: action.to_owned(),
            source: other.into(),
        },
    }
}

pub(super) fn endless(too_long: TooLong, action: &str) -> ProviderError {
    ProviderError::Unsupported {
        provider: PLATFORM.to_owned(),
        reason: format!("{too_long}, {action}"),
        hint: Some("see what it is that listens there, and restart it".to_owned()),
    }
}

const PLATFORM: &str = "the Docker Engine";

/// What to do about a refusal, by the engine's words.
fn hint(message: &str) -> Option<String> {
    let message = message.to_lowercase();
    let hints = [
        (
            "/dev/net/tun",
            "load the kernel's TUN driver on the engine's host: `sudo modprobe tun`",
        ),
        (
            "no space left",
            "make room on the engine's disk, for instance with `docker system prune`",
        ),
        (
            "rt_runtime",
            "start the engine with `--cpu-rt-runtime=950000`, or leave `realtime_runtime` out",
        ),
        (
            "real-time",
            "leave `providers.docker.realtime_runtime` out on this engine",
        ),
        (
            "cpuset",
            "name processors that this machine has in `providers.docker.cpuset`",
        ),
        (
            "range of cpus",
            "ask for no more `providers.docker.cpus` than this machine has",
        ),
        (
            "minimum memory",
            "ask for at least `6MiB` in `providers.docker.memory`",
        ),
    ];
    hints
        .into_iter()
        .find(|(sign, _)| message.contains(sign))
        .map(|(_, hint)| hint.to_owned())
}

/// Whether the engine says that there is no such thing.
pub fn is_missing(error: &Error) -> bool {
    matches!(error, Error::DockerResponseServerError { status_code: 404, .. })
}

/// None where the engine says that there is no such thing.
///
/// # Errors
/// What else it says.
pub fn if_there<T>(action: &str, answer: Result<T, Error>) -> Result<Option<T>, ProviderError> {
    match answer {
        Ok(found) => Ok(Some(found)),
        Err(error) if is_missing(&error) => Ok(None),
        Err(error) => Err(translate(action, error)),
    }
}
