//! The connection to a Docker Engine. The main type is [`Engine`]; the only module besides its siblings that knows
//! bollard, whose errors become ours here.

mod error;

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

use self::error::{Silent, endless, unreachable};
pub use self::error::{if_there, is_missing, translate};
use super::transport::{self, Allowance, Exceeded};
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

#[cfg(test)]
mod tests;
