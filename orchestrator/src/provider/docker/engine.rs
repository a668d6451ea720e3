//! The connection to a Docker Engine. The main type is [`Engine`]; the only module besides its siblings that knows
//! bollard, whose errors become ours here.

use std::{
    borrow::Cow,
    env, fmt,
    future::Future,
    io,
    path::{Path, PathBuf},
    sync::{Arc, OnceLock},
    time::Duration,
};

use bollard::{
    Docker as Api,
    errors::Error,
    models::{SystemInfo, SystemVersion},
};
use record::run_directory::EngineParts;

use super::transport::{self, Allowance, Exceeded, TooLong};
use crate::{
    host::{Forward, Host, Listener, Program, output},
    provider::{
        Availability, ProviderError,
        backoff::{self, Backoff},
    },
    workload_binary::{self, machine::Machine},
};

/// The oldest API that this was tried with: Engine 20.10.
const OLDEST_API: (u32, u32) = (1, 41);
const TUN: &str = "/dev/net/tun";
/// Where an engine listens unless it is told otherwise.
pub const SOCKET: &str = "/var/run/docker.sock";
/// The first socket that is there, of those where engines of a user's own listen: rootless ones and Docker Desktop's on
/// Linux; Docker Desktop's, Colima's, OrbStack's and Rancher Desktop's on macOS.
const FIND_SOCKET: &str = r#"
for socket in /var/run/docker.sock "/run/user/$(id -u)/docker.sock" \
    "$HOME/.docker/run/docker.sock" "$HOME/.docker/desktop/docker.sock" \
    "$HOME/.colima/default/docker.sock" "$HOME/.orbstack/run/docker.sock" "$HOME/.rd/docker.sock"
do
    if [ -S "$socket" ]; then printf %s "$socket"; exit; fi
done
"#;
/// For an engine to say what it is.
const FIRST_ANSWER: Duration = Duration::from_secs(15);
/// To look whether some files are there.
const LOOKING: Duration = Duration::from_secs(60);

/// How an engine is reached.
pub enum Way {
    /// At an address such as `unix:///var/run/docker.sock`.
    Address(String),
    /// By the first of the usual sockets that is there, on another machine.
    Forwarded(Arc<dyn Host>),
}

/// An engine that answers.
#[derive(Clone)]
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
    /// The machine of its kernel, as `uname -m` says it.
    pub kernel_machine: String,
    /// The memory of its machine, in bytes, where it says so and can limit a container's.
    pub memory: Option<u64>,
    /// What it makes containers with.
    pub parts: EngineParts,
    /// Where it is reached: here, or by what leads there.
    address: String,
    /// What of its answers was too long.
    exceeded: Exceeded,
    /// Whether it is on this machine, whose devices are then its own.
    pub is_here: bool,
    /// The socket here that leads there, as long as anybody needs it.
    forward: Option<Arc<Forward>>,
    /// Looked for when it is needed first.
    workload: Arc<OnceLock<Workload>>,
}

fn parts(version: &SystemVersion, info: &SystemInfo) -> EngineParts {
    let said =
        |text: Option<&dyn fmt::Display>| text.map(ToString::to_string).filter(|text| !text.is_empty());
    let component = |name: &str| {
        let mut components = version.components.iter().flatten();
        let named = components.find(|component| component.name == name);
        said(named.map(|component| &component.version as &dyn fmt::Display))
    };
    EngineParts {
        storage_driver: said(info.driver.as_ref().map(|it| it as _)),
        default_runtime: said(info.default_runtime.as_ref().map(|it| it as _)),
        runc_version: component("runc"),
        containerd_version: component("containerd"),
        cgroup_version: said(info.cgroup_version.as_ref().map(|it| it as _)),
        cgroup_driver: said(info.cgroup_driver.as_ref().map(|it| it as _)),
        security_options: info.security_options.clone().unwrap_or_default(),
    }
}

/// The workload for an engine's machine.
pub struct Workload {
    /// The program.
    pub binary: Cow<'static, [u8]>,
    /// Its SHA-256, in hexadecimal.
    pub sha256: String,
}

impl Workload {
    /// This one.
    #[must_use]
    pub fn new(binary: Cow<'static, [u8]>) -> Self {
        let sha256 = workload_binary::hash_of(&binary);
        Self { binary, sha256 }
    }
}

impl fmt::Debug for Engine {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter
            .debug_struct("Engine")
            .field("api", &self.api)
            .field("version", &self.version)
            .finish_non_exhaustive()
    }
}

impl Engine {
    /// Connects to the engine that is there.
    ///
    /// # Errors
    /// When none answers.
    pub async fn connect(way: &Way) -> Result<Self, ProviderError> {
        match way {
            Way::Address(address) => Self::at(address).await,
            Way::Forwarded(host) => Self::on(host).await,
        }
    }

    async fn at(address: &str) -> Result<Self, ProviderError> {
        Self::answering_within(FIRST_ANSWER, address).await
    }

    async fn answering_within(timeout: Duration, address: &str) -> Result<Self, ProviderError> {
        let unreachable = |error| unreachable(address, error);
        let exceeded = Exceeded::default();
        let api = transport::connect(address, &exceeded).map_err(unreachable)?;
        // An engine takes some milliseconds to say what it is, since it asks its parts.
        let asked = async { tokio::join!(api.version(), api.info(), api.clone().negotiate_version()) };
        let answered = tokio::time::timeout(timeout, asked).await;
        let (version, info, api) =
            answered.map_err(|_| unreachable(Error::from(io::Error::other(Silent(timeout)))))?;
        let version = version.map_err(unreachable)?;
        let info = info.map_err(unreachable)?;
        let api = api.map_err(unreachable)?;
        let parts = parts(&version, &info);
        let memory = info.mem_total.filter(|_| info.memory_limit != Some(false));
        Ok(Self {
            api,
            version: version.version.unwrap_or_default(),
            api_version: version.api_version.unwrap_or_default(),
            os: version.os.unwrap_or_default(),
            architecture: version.arch.unwrap_or_default(),
            kernel: version.kernel_version.unwrap_or_default(),
            kernel_machine: info.architecture.unwrap_or_default(),
            memory: memory
                .and_then(|bytes| u64::try_from(bytes).ok())
                .filter(|bytes| *bytes > 0),
            parts,
            address: address.to_owned(),
            exceeded,
            is_here: address.starts_with("unix://"),
            forward: None,
            workload: Arc::default(),
        })
    }

    async fn on(host: &Arc<dyn Host>) -> Result<Self, ProviderError> {
        let find = Program::new("sh", ["-c", FIND_SOCKET]);
        let (_, found) = output(host.as_ref(), &find, b"", LOOKING).await?;
        let socket = match String::from_utf8_lossy(&found).trim() {
            // That nobody listens there is said with its name.
            "" => SOCKET.to_owned(),
            found => found.to_owned(),
        };
        let listener = Listener::Unix(socket.into());
        let forward = Forward::open(Arc::clone(host), listener)
            .map_err(|source| ProviderError::of_this_machine("making a socket", source))?;
        match Self::at(&format!("unix://{}", forward.socket().display())).await {
            Ok(engine) => Ok(Self {
                is_here: false,
                forward: Some(Arc::new(forward)),
                ..engine
            }),
            // Who connects to a socket of ours sees only that it was closed.
            Err(error) => Err(forward.take_failure().map_or(error, Into::into)),
        }
    }

    /// A handle to follow one log with, and what is to be renewed with each of its frames.
    ///
    /// # Errors
    /// When its address is none, which it was.
    pub fn to_follow(&self) -> Result<(Api, Arc<Allowance>), Error> {
        transport::connect_to_follow(&self.address, &self.api.client_version(), &self.exceeded)
    }

    /// Calls again what a lost connection cut, which must be as good as calling it once.
    ///
    /// # Errors
    /// What the last call ended with.
    pub async fn retried<T, F>(&self, call: impl Fn() -> F) -> Result<T, ProviderError>
    where
        F: Future<Output = Result<T, ProviderError>>,
    {
        let call = || async { call().await.map_err(|error| self.unless_too_long(error)) };
        backoff::retried(call)
            .await
            .map_err(|error| self.explained(error))
    }

    /// Takes notice of an error that a lost connection may have brought.
    ///
    /// # Errors
    /// The same, when trying again does not help or was tried for long enough.
    pub fn after(&self, backoff: &mut Backoff, error: ProviderError) -> Result<(), ProviderError> {
        let error = self.unless_too_long(error);
        backoff.after(error).map_err(|error| self.explained(error))
    }

    /// What only looks like a lost connection is none.
    fn unless_too_long(&self, error: ProviderError) -> ProviderError {
        match (error, self.exceeded.take()) {
            (ProviderError::Disconnected { action, .. }, Some(too_long)) => endless(too_long, &action),
            (error, _) => error,
        }
    }

    /// Why the way to it is closed, where we know more than that it is.
    fn explained(&self, error: ProviderError) -> ProviderError {
        match &self.forward {
            Some(forward) if error.is_passing() => forward.take_failure().map_or(error, Into::into),
            _ => error,
        }
    }

    /// Whether it can run our workload.
    ///
    /// # Errors
    /// Why there is none for it.
    pub fn judge(&self) -> Result<Availability, ProviderError> {
        let unavailable = |reason, fix: &str| {
            Ok(Availability::Unavailable {
                reason,
                fix: Some(fix.to_owned()),
            })
        };
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
        } else {
            self.workload()?;
            Ok(Availability::Available {
                detail: format!("Docker Engine {} (API {})", self.version, self.api_version),
            })
        }
    }

    /// The workload for its machine.
    ///
    /// # Errors
    /// When there is none.
    pub fn workload(&self) -> Result<&Workload, ProviderError> {
        if let Some(workload) = self.workload.get() {
            return Ok(workload);
        }
        let binary = self
            .machine()?
            .workload()
            .map_err(|none| self.unsupported(&none.to_string(), Some(none.hint())))?;
        // Another task may have been faster, with the same.
        Ok(self.workload.get_or_init(|| Workload::new(binary)))
    }

    /// The machine that it runs programs of. An engine of another than its kernel's would run them as that of its own, which
    /// is none that the results could be told to be of.
    fn machine(&self) -> Result<Machine, ProviderError> {
        let machine: Machine = self
            .architecture
            .parse()
            .map_err(|unknown| self.unsupported(&format!("{unknown}"), None))?;
        if self.kernel_machine.parse() == Ok(machine) {
            return Ok(machine);
        }
        Err(self.unsupported(
            &format!(
                "it is a program for {machine} on a kernel for {}",
                self.kernel_machine
            ),
            Some(format!("install Docker Engine for {} there", self.kernel_machine)),
        ))
    }

    fn unsupported(&self, why: &str, hint: Option<String>) -> ProviderError {
        ProviderError::Unsupported {
            provider: format!("Docker Engine {}", self.version),
            reason: why.to_owned(),
            hint,
        }
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
            // Words of ours.
            Some(io::ErrorKind::Other) | None => error.into(),
            Some(kind) => io::Error::from(kind).into(),
        },
    }
}

/// An engine took a connection and said nothing.
#[derive(Debug, thiserror::Error)]
#[error("it did not answer within {0:?}")]
struct Silent(Duration);

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
fn io_error(error: &Error) -> Option<io::ErrorKind> {
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

fn endless(too_long: TooLong, action: &str) -> ProviderError {
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

#[cfg(test)]
mod tests {
    use bollard::query_parameters::LogsOptionsBuilder;
    use futures_util::StreamExt as _;

    use super::{transport::tests::Hostile, *};

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
        let error = transport::connect(&address, &Exceeded::default())
            .unwrap()
            .version()
            .await
            .unwrap_err();
        assert!(how_to_reach(&address, &error).starts_with("install Docker Engine"));

        // One that listens and does not answer is installed.
        let silent = how_to_reach(&address, &Error::RequestTimeoutError);
        assert!(silent.contains("does not answer"), "{silent}");

        // A socket nobody listens on, as an engine leaves it that was killed.
        drop(std::os::unix::net::UnixListener::bind(nowhere.path().join("docker.sock")).unwrap());
        let api = transport::connect(&address, &Exceeded::default()).unwrap();
        let error = api.negotiate_version().await.unwrap_err();
        assert!(
            how_to_reach(&address, &error).starts_with("the engine has ended"),
            "{error:?}"
        );
    }

    #[tokio::test]
    async fn an_engine_that_says_what_it_is_without_end_is_unreachable_and_that_is_why() {
        let hostile = Hostile::saying("HTTP/1.1 200 OK\r\n\r\n{\"Version\": \"", &[b'1'; 65536]);
        let error = Engine::at(&hostile.address()).await.unwrap_err();
        let why = record::causes::with_causes(&error);
        assert!(why.contains("longer than 8 MiB"), "{why}");
    }

    #[tokio::test]
    async fn an_engine_that_takes_a_connection_and_says_nothing_is_given_up_when_its_time_is_over() {
        let hostile = Hostile::saying("", b"");
        let timeout = Duration::from_millis(200);
        let error = Engine::answering_within(timeout, &hostile.address())
            .await
            .unwrap_err();
        let why = record::causes::with_causes(&error);
        assert!(why.contains("did not answer within 200ms"), "{why}");
        assert!(error.hint().unwrap().contains("does not answer"), "{error:?}");
        assert_eq!(
            FIRST_ANSWER,
            Duration::from_secs(15),
            "what docs/security.md promises"
        );
    }

    #[tokio::test]
    async fn a_log_whose_frame_has_no_end_is_no_lost_connection() {
        let hostile = Hostile::saying("HTTP/1.1 200 OK\r\n\r\n", b"\x01\0\0\0\x7f\xff\xff\xff0123456789");
        let (go, kernel) = OURS;
        let engine = Engine {
            address: hostile.address(),
            ..engine("1.41", "linux", go, kernel)
        };
        let (api, _) = engine.to_follow().unwrap();
        let options = LogsOptionsBuilder::default().follow(true).stdout(true).build();
        let frame = api.logs("x", Some(options)).next().await.unwrap();
        let error = translate("following the workload's lines", frame.unwrap_err());
        assert!(error.is_passing(), "as bollard tells it: {error:?}");
        let error = engine.after(&mut Backoff::default(), error).unwrap_err();
        assert!(error.to_string().contains("longer than 4 MiB"), "{error}");
    }

    #[test]
    fn an_answer_without_end_is_not_asked_for_again() {
        let too_long = Error::from(io::Error::other(transport::tests::too_long()));
        let error = translate("listing what is ours", too_long);
        assert!(!error.is_passing(), "{error:?}");
        assert!(
            error
                .to_string()
                .contains("longer than 8 MiB, listing what is ours"),
            "{error}"
        );
    }

    fn engine(api: &str, os: &str, architecture: &str, kernel_machine: &str) -> Engine {
        Engine {
            api: transport::connect("http://127.0.0.1:1", &Exceeded::default()).unwrap(),
            address: "http://127.0.0.1:1".to_owned(),
            exceeded: Exceeded::default(),
            version: "20.10.24".to_owned(),
            api_version: api.to_owned(),
            os: os.to_owned(),
            architecture: architecture.to_owned(),
            kernel: String::new(),
            kernel_machine: kernel_machine.to_owned(),
            memory: None,
            parts: EngineParts::default(),
            is_here: false,
            forward: None,
            workload: Arc::default(),
        }
    }

    /// In Go's words, and the kernel's.
    const OURS: (&str, &str) = if cfg!(target_arch = "x86_64") {
        ("amd64", "x86_64")
    } else {
        ("arm64", "aarch64")
    };

    #[test]
    fn an_engine_that_cannot_run_the_workload_is_unavailable() {
        let (go, kernel) = OURS;
        let able = engine("1.41", "linux", go, kernel);
        assert!(matches!(able.judge(), Ok(Availability::Available { .. })));
        assert_eq!(able.workload().unwrap().sha256, workload_binary::sha256());
        for (engine, why, has_fix) in [
            (engine("1.40", "linux", go, kernel), "too old", true),
            (engine("1.41", "windows", go, kernel), "windows containers", true),
            (engine("1.41", "linux", "s390x", "s390x"), "s390x", false),
            (
                engine("1.41", "linux", "386", kernel),
                "a program for i686 on a kernel for",
                true,
            ),
            (
                engine("1.41", "linux", go, "riscv64"),
                "on a kernel for riscv64",
                true,
            ),
        ] {
            let Availability::Unavailable { reason, fix } =
                engine.judge().unwrap_or_else(Availability::prevented_by)
            else {
                panic!("available: {why}");
            };
            assert!(reason.contains(why), "{reason}");
            assert_eq!(fix.is_some(), has_fix, "{reason}");
        }
    }

    #[test]
    fn an_engine_of_another_machine_needs_the_workload_that_was_built_for_it() {
        // The builder makes it beside the programs of a user, not beside tests.
        let error = engine("1.41", "linux", "386", "i686")
            .workload()
            .map(drop)
            .unwrap_err();
        assert!(error.to_string().contains("no workload for i686"), "{error}");
        assert!(error.hint().unwrap().contains("workload/builder/build i686"));
    }
}
