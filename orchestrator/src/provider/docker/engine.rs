//! The connection to a Docker Engine. The main type is [`Engine`]; the only module besides its siblings that knows
//! bollard, whose errors become ours here.

use std::{
    env, io,
    path::{Path, PathBuf},
};

use bollard::{Docker as Api, errors::Error};

use crate::{
    provider::{Availability, ProviderError},
    workload_binary,
};

/// The oldest API that this was tried with: Engine 20.10.
const OLDEST_API: (u32, u32) = (1, 41);
const TUN: &str = "/dev/net/tun";
/// Where an engine listens unless it is told otherwise.
pub const SOCKET: &str = "/var/run/docker.sock";

/// An engine that answers.
#[derive(Debug, Clone)]
pub struct Engine {
    /// bollard's handle, with the version of the API negotiated.
    pub api: Api,
    /// Its version, such as `20.10.24`.
    pub version: String,
    /// The version of its API.
    pub api_version: String,
    /// Its operating system's kind, such as `linux`.
    pub os: String,
    /// Its architecture in Go's words, such as `amd64`.
    pub architecture: String,
    /// Its kernel.
    pub kernel: String,
    /// Whether it is on this machine, whose devices are then its own.
    pub is_here: bool,
}

impl Engine {
    /// Connects to the engine at an address such as `unix:///var/run/docker.sock`.
    ///
    /// # Errors
    /// When none answers.
    pub async fn connect(address: &str) -> Result<Self, ProviderError> {
        let unreachable = |error| unreachable(address, error);
        let api = Api::connect_with_host(address).map_err(unreachable)?;
        // An engine takes some milliseconds to say its version, since it asks its parts for theirs.
        let (version, api) = tokio::join!(api.version(), api.clone().negotiate_version());
        let (version, api) = (version.map_err(unreachable)?, api.map_err(unreachable)?);
        Ok(Self {
            api,
            version: version.version.unwrap_or_default(),
            api_version: version.api_version.unwrap_or_default(),
            os: version.os.unwrap_or_default(),
            architecture: version.arch.unwrap_or_default(),
            kernel: version.kernel_version.unwrap_or_default(),
            is_here: address.starts_with("unix://"),
        })
    }

    /// The same, on another machine, whatever its address looks like.
    #[must_use]
    pub fn elsewhere(self) -> Self {
        Self {
            is_here: false,
            ..self
        }
    }

    /// Whether it can run our workload.
    #[must_use]
    pub fn judge(&self) -> Availability {
        let unavailable = |reason, fix: &str| Availability::Unavailable {
            reason,
            fix: Some(fix.to_owned()),
        };
        let wanted = machine_in_go(workload_binary::MACHINE);
        if parse_api(&self.api_version).is_none_or(|version| version < OLDEST_API) {
            unavailable(
                format!(
                    "Docker Engine {} is too old (API {})",
                    self.version, self.api_version
                ),
                "install Docker Engine 20.10 or later",
            )
        } else if self.os != "linux" {
            unavailable(
                format!("Docker Engine {} runs {} containers", self.version, self.os),
                "switch it to Linux containers",
            )
        } else if self.is_here && !Path::new(TUN).exists() {
            unavailable(
                format!("the kernel of Docker Engine {} has no {TUN}", self.version),
                "load its TUN driver: `sudo modprobe tun`",
            )
        } else if self.architecture != wanted {
            unavailable(
                format!(
                    "Docker Engine {} is of {}, the workload of {wanted}",
                    self.version, self.architecture
                ),
                "use an engine of this machine's architecture",
            )
        } else {
            Availability::Available {
                detail: format!("Docker Engine {} (API {})", self.version, self.api_version),
            }
        }
    }
}

/// The word that Go, and so Docker, has for a machine.
fn machine_in_go(machine: &str) -> &str {
    match machine {
        "x86_64" => "amd64",
        "aarch64" => "arm64",
        "i686" => "386",
        other => other,
    }
}

fn parse_api(version: &str) -> Option<(u32, u32)> {
    let (major, minor) = version.split_once('.')?;
    Some((major.parse().ok()?, minor.parse().ok()?))
}

/// The engine that `DOCKER_HOST` names, else this machine's, else this user's own: as `docker` finds its engine, and a
/// rootless engine besides, which `docker` finds by its context.
#[must_use]
pub fn usual_address() -> String {
    if let Some(host) = env::var("DOCKER_HOST").ok().filter(|host| !host.is_empty()) {
        return host;
    }
    let rootless =
        env::var_os("XDG_RUNTIME_DIR").map(|directory| PathBuf::from(directory).join("docker.sock"));
    match rootless {
        Some(socket) if socket.exists() && !PathBuf::from(SOCKET).exists() => {
            format!("unix://{}", socket.display())
        }
        _ => format!("unix://{SOCKET}"),
    }
}

fn unreachable(address: &str, error: Error) -> ProviderError {
    ProviderError::Unreachable {
        platform: format!("a Docker Engine at {address}"),
        hint: Some(how_to_reach(address, &error)),
        // The operating system's words say more than those of the layers above it.
        source: match io_error(&error) {
            Some(kind) => io::Error::from(kind).into(),
            None => error.into(),
        },
    }
}

fn how_to_reach(address: &str, error: &Error) -> String {
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
        _ => {
            "install Docker Engine (on Debian and Ubuntu `sudo apt-get install docker.io`) and start it, for \
              instance with `sudo systemctl start docker`"
                .to_owned()
        }
    }
}

/// The operating system's error among the causes.
fn io_error(error: &Error) -> Option<io::ErrorKind> {
    let mut cause: Option<&(dyn std::error::Error + 'static)> = Some(error);
    while let Some(error) = cause {
        if let Some(io) = error.downcast_ref::<io::Error>() {
            return Some(io.kind());
        }
        cause = error.source();
    }
    None
}

/// What an error of bollard's means to us; `action` as in `creating the container x`.
pub fn translate(action: &str, error: Error) -> ProviderError {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[rstest::rstest]
    #[case("1.41", Some((1, 41)))]
    #[case("1.9", Some((1, 9)))]
    #[case("", None)]
    fn versions_are_compared_as_numbers(#[case] text: &str, #[case] version: Option<(u32, u32)>) {
        assert_eq!(parse_api(text), version);
    }

    #[tokio::test]
    async fn an_engine_that_is_not_there_is_unreachable_with_a_fix() {
        let nowhere = tempfile::tempdir().unwrap();
        let address = format!("unix://{}/docker.sock", nowhere.path().display());
        let error = Api::connect_with_host(&address).unwrap_err();
        assert!(how_to_reach(&address, &error).starts_with("install Docker Engine"));

        // A socket nobody listens on, as an engine leaves it that was killed.
        drop(std::os::unix::net::UnixListener::bind(nowhere.path().join("docker.sock")).unwrap());
        let api = Api::connect_with_host(&address).unwrap();
        let error = api.negotiate_version().await.unwrap_err();
        assert!(
            how_to_reach(&address, &error).starts_with("the engine has ended"),
            "{error:?}"
        );
    }

    fn engine(api: &str, os: &str, architecture: &str) -> Engine {
        Engine {
            api: Api::connect_with_http("http://127.0.0.1:1", 1, bollard::API_DEFAULT_VERSION).unwrap(),
            version: "20.10.24".to_owned(),
            api_version: api.to_owned(),
            os: os.to_owned(),
            architecture: architecture.to_owned(),
            kernel: String::new(),
            is_here: false,
        }
    }

    #[test]
    fn an_engine_that_cannot_run_the_workload_is_unavailable() {
        let here = machine_in_go(workload_binary::MACHINE);
        assert!(matches!(
            engine("1.41", "linux", here).judge(),
            Availability::Available { .. }
        ));
        for (engine, why) in [
            (engine("1.40", "linux", here), "too old"),
            (engine("1.41", "windows", here), "windows containers"),
            (engine("1.41", "linux", "s390x"), "s390x"),
        ] {
            let Availability::Unavailable { reason, fix } = engine.judge() else {
                panic!("available: {why}");
            };
            assert!(reason.contains(why) && fix.is_some(), "{reason}");
        }
    }
}
