//! The `native` provider: the workload as a process of this machine, with no platform between. The main type is
//! [`Native`].
//!
//! The process has a session of its own and writes to files, so that it goes on when `matrix` ends; its environment is a
//! folder below the state directory ([`EnvironmentDirectory`]).

mod check;
mod detached;
mod environment;
mod follow;
mod process;
mod readiness;

use std::{
    fs::File,
    process::{Command, Stdio},
};

use async_trait::async_trait;
use reports::run_directory::Resource;
use workload::{
    network::{NetworkError, mininet},
    settings::NetworkBackend,
};

pub use self::check::check;
use self::{environment::NativeEnvironment, process::WorkloadProcess};
use super::{
    Availability, Environment, EnvironmentRequest, Leftover, Provider, ProviderError,
    environment_directory::{EnvironmentDirectory, Owner},
};
use crate::{state_directory::StateDirectory, workload_binary};

const NAME: &str = "native";

/// What a killed workload may leave beside its folder: a bridge of Open vSwitch, which is the machine's.
const BRIDGE: &str = "bridge";

/// This machine as it is.
#[derive(Debug, Clone)]
pub struct Native {
    host: String,
    state: StateDirectory,
}

impl Native {
    /// On the host of that name in the matrix file, with its environments in this state directory.
    #[must_use]
    pub fn new(host: &str, state: StateDirectory) -> Self {
        Self {
            host: host.to_owned(),
            state,
        }
    }

    /// A bridge as something that was left behind. Which run had it is not known.
    fn bridge(&self, name: String) -> Leftover {
        Leftover {
            resource: Resource {
                host: self.host.clone(),
                kind: BRIDGE.to_owned(),
                name,
            },
            run: None,
            run_directory: None,
            scenario: None,
            running: false,
        }
    }

    fn start(
        &self,
        request: &EnvironmentRequest,
        directory: &EnvironmentDirectory,
    ) -> Result<WorkloadProcess, ProviderError> {
        let binary = workload_binary::installed(&self.state)?;
        let create = |path| {
            File::create_new(&path).map_err(|source| ProviderError::File {
                action: "create",
                path,
                source,
            })
        };
        let mut command = Command::new(binary);
        command
            .args(request.arguments(&directory.data()))
            // Nothing of the surroundings in which `matrix` happened to be started may reach the experiment.
            .env_clear()
            .current_dir("/")
            .stdin(Stdio::null())
            .stdout(create(directory.lines())?)
            .stderr(create(directory.errors())?);
        workload_binary::start(|| detached::spawn(&mut command))
            .and_then(WorkloadProcess::started)
            .map_err(|error| refused("starting the workload", error))
    }
}

fn refused(action: &str, source: std::io::Error) -> ProviderError {
    ProviderError::Refused {
        platform: "this machine".to_owned(),
        action: action.to_owned(),
        hint: None,
        source: source.into(),
    }
}

#[async_trait]
impl Provider for Native {
    fn name(&self) -> &'static str {
        NAME
    }

    async fn survey(&self) -> Availability {
        match check(&self.state, NetworkBackend::Userspace).await {
            Ok(record) => check::availability(&record),
            Err(error) => Availability::prevented_by(error),
        }
    }

    async fn survey_network(&self, backend: NetworkBackend) -> Option<Availability> {
        Some(match check(&self.state, backend).await {
            Ok(record) => check::network(&record),
            Err(error) => Availability::prevented_by(error),
        })
    }

    fn resources(&self, request: &EnvironmentRequest) -> Vec<Resource> {
        let directory = EnvironmentDirectory::of(&self.state, &request.environment);
        let process = Resource {
            host: self.host.clone(),
            kind: "process".to_owned(),
            name: request.environment.clone(),
        };
        vec![directory.resource(&self.host), process]
    }

    async fn create(&self, request: &EnvironmentRequest) -> Result<Box<dyn Environment>, ProviderError> {
        let directory = EnvironmentDirectory::of(&self.state, &request.environment);
        directory.create(&Owner::new(NAME, request))?;
        let process = self.start(request, &directory)?;
        Ok(Box::new(NativeEnvironment::new(directory, Some(process))?))
    }

    async fn find(
        &self,
        request: &EnvironmentRequest,
    ) -> Result<Option<Box<dyn Environment>>, ProviderError> {
        let directory = EnvironmentDirectory::of(&self.state, &request.environment);
        // Without its lines the process was never started.
        if !directory.lines().exists() {
            return Ok(None);
        }
        let process = find_process(&directory)?;
        Ok(Some(Box::new(NativeEnvironment::new(directory, process)?)))
    }

    async fn leftovers(&self) -> Result<Vec<Leftover>, ProviderError> {
        let bridges = bridges()?.into_iter().map(|name| self.bridge(name));
        let directories = EnvironmentDirectory::all(&self.state)?
            .into_iter()
            // A folder whose owner was never written belongs to nobody else.
            .filter(|(_, owner)| owner.as_ref().is_none_or(|owner| owner.provider == NAME))
            .map(|(directory, owner)| {
                let running = find_process(&directory)?.is_some();
                Ok(directory.leftover(&self.host, owner, running))
            });
        directories.chain(bridges.map(Ok)).collect()
    }

    async fn remove(&self, leftover: &Leftover) -> Result<(), ProviderError> {
        let name = &leftover.resource.name;
        if leftover.resource.kind == BRIDGE && bridges()?.contains(name) {
            return mininet::leftovers::remove(name)
                .map_err(|error| network_refused("removing a bridge from Open vSwitch", error));
        }
        let directories = EnvironmentDirectory::all(&self.state)?;
        match directories
            .into_iter()
            .find(|(directory, _)| directory.resource(&leftover.resource.host) == leftover.resource)
        {
            Some((directory, _)) => environment::remove(&directory, find_process(&directory)?).await,
            None => Ok(()),
        }
    }
}

/// Those that no live workload has.
fn bridges() -> Result<Vec<String>, ProviderError> {
    mininet::leftovers::find()
        .map_err(|error| network_refused("looking for bridges of ours in Open vSwitch", error))
}

fn network_refused(action: &str, error: NetworkError) -> ProviderError {
    ProviderError::Refused {
        platform: "this machine".to_owned(),
        action: action.to_owned(),
        hint: error.hint(),
        source: error.into(),
    }
}

fn find_process(directory: &EnvironmentDirectory) -> Result<Option<WorkloadProcess>, ProviderError> {
    WorkloadProcess::find(&directory.environment(), &directory.data())
        .map_err(|error| refused("looking for the workload's process", error))
}
