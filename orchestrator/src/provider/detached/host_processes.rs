//! What every provider does whose workload is a process of its host. The main type is [`HostProcesses`].

use std::sync::Arc;

use record::{
    call::Shell,
    detached::ListedEnvironment,
    run_directory::{Resource, fact},
    settings::{NetworkSettings, Settings},
    virtual_host::VirtualHost,
};
use serde_json::{Map, Value, json};

use super::{AgentClient, ClockReading, DetachedEnvironment};
use crate::{
    host::{Host, Program},
    provider::{Environment, EnvironmentRequest, Leftover, ProviderError, ShellRequest},
};

/// The kind of an environment's folder, with which its process ends.
pub(crate) const DIRECTORY: &str = "directory";
const PROCESS: &str = "process";

/// The environments of one provider on one host: a folder each, and a process that the agent keeps.
pub struct HostProcesses {
    provider: &'static str,
    /// What is called on the host.
    pub agent: Arc<AgentClient>,
    facts: Map<String, Value>,
}

impl HostProcesses {
    /// Of the provider with that name, with what explains its environments beside its name and the workload's SHA-256.
    #[must_use]
    pub fn new(provider: &'static str, host: Arc<dyn Host>, facts: Map<String, Value>) -> Self {
        Self {
            provider,
            agent: Arc::new(AgentClient::new(host)),
            facts,
        }
    }

    /// Something of that kind and name on the host.
    #[must_use]
    pub fn resource(&self, kind: &str, name: &str) -> Resource {
        Resource {
            host: self.agent.host().to_owned(),
            kind: kind.to_owned(),
            name: name.to_owned(),
        }
    }

    /// What an environment is, before it is made: its folder and its process.
    #[must_use]
    pub fn resources(&self, environment: &str) -> Vec<Resource> {
        [DIRECTORY, PROCESS]
            .map(|kind| self.resource(kind, environment))
            .into()
    }

    /// The environment's folder.
    #[must_use]
    pub fn directory(&self, environment: &str) -> Resource {
        self.resource(DIRECTORY, environment)
    }

    /// For [`Provider::create`](crate::provider::Provider::create).
    ///
    /// # Errors
    /// When there is an environment of that name already, or the host refuses.
    pub async fn create(&self, request: &EnvironmentRequest) -> Result<Box<dyn Environment>, ProviderError> {
        let (clock, _) = ClockReading::of(&self.agent).await?;
        self.agent.start(self.provider, request).await?;
        self.environment(request, clock, true).await
    }

    /// For [`Provider::find`](crate::provider::Provider::find).
    ///
    /// # Errors
    /// When the host cannot be asked.
    pub async fn find(
        &self,
        request: &EnvironmentRequest,
    ) -> Result<Option<Box<dyn Environment>>, ProviderError> {
        let listed = self.agent.list().await?.environments;
        let is_it = |it: &&ListedEnvironment| it.started && it.environment == request.environment;
        let Some(found) = listed.iter().find(is_it) else {
            return Ok(None);
        };
        let (clock, _) = ClockReading::of(&self.agent).await?;
        self.environment(request, clock, found.running).await.map(Some)
    }

    async fn environment(
        &self,
        request: &EnvironmentRequest,
        clock: ClockReading,
        running: bool,
    ) -> Result<Box<dyn Environment>, ProviderError> {
        let sha256 = &self.agent.deployed().await?.sha256;
        let mut facts = Map::from_iter([
            (fact::PROVIDER.to_owned(), json!(self.provider)),
            (fact::WORKLOAD_SHA256.to_owned(), json!(sha256)),
        ]);
        facts.extend(self.facts.clone());
        let agent = Arc::clone(&self.agent);
        Ok(Box::new(DetachedEnvironment::new(
            agent, request, facts, clock, running,
        )))
    }

    /// A shell in the environment's folder, and in a virtual host if one is asked for.
    ///
    /// # Errors
    /// When the host cannot be asked, or the experiment has no such virtual host.
    pub async fn shell(&self, request: &ShellRequest<'_>) -> Result<Program, ProviderError> {
        request.of_no_image(self.provider)?;
        let deployed = self.agent.deployed().await?;
        let folder = deployed.environments.join(request.environment);
        let inside = match request.virtual_host {
            None => Vec::new(),
            Some(host) => {
                ensure_it_has(host, request.settings)?;
                let call = Shell::of(host, request.settings).arguments();
                [deployed.program.clone().into_os_string()]
                    .into_iter()
                    .chain(call)
                    .collect()
            }
        };
        let script = r#"cd "$1" && shift && exec "$@" "${SHELL:-/bin/sh}""#;
        let arguments = ["-c".into(), script.into(), "sh".into(), folder.into_os_string()];
        Ok(Program::new("sh", arguments.into_iter().chain(inside)))
    }

    /// Those of the listed environments that this provider made. A folder whose owner was never written has none: it is
    /// `native`'s to remove.
    pub fn leftovers(&self, listed: Vec<ListedEnvironment>) -> impl Iterator<Item = Leftover> {
        listed.into_iter().filter_map(|it| {
            let owner = it.owner.filter(|owner| owner.provider == self.provider)?;
            Some(Leftover {
                run: Some(owner.run),
                run_directory: Some(owner.run_directory),
                scenario: Some(owner.scenario),
                ..self.leftover(DIRECTORY, &it.environment, it.running)
            })
        })
    }

    /// Something that was left behind; which run had it is not known.
    #[must_use]
    pub fn leftover(&self, kind: &str, name: &str, running: bool) -> Leftover {
        Leftover {
            resource: self.resource(kind, name),
            run: None,
            run_directory: None,
            scenario: None,
            running,
            job: None,
        }
    }
}

/// Whether an experiment's network has that host.
fn ensure_it_has(host: VirtualHost, settings: &Settings) -> Result<(), ProviderError> {
    let topology = settings.network_in_use().map(NetworkSettings::topology);
    let hosts = topology.map(|topology| topology.hosts).unwrap_or_default();
    if hosts.iter().any(|it| it.name == host) {
        return Ok(());
    }
    let names: Vec<&str> = hosts.iter().map(|it| it.name.name()).collect();
    Err(ProviderError::Unsupported {
        provider: "the experiment".to_owned(),
        reason: match names.as_slice() {
            [] => "it has no network, and so no virtual host".to_owned(),
            _ => format!("it has no virtual host `{host}`"),
        },
        hint: Some(match names.as_slice() {
            [] => "leave `--virtual-host` out".to_owned(),
            names => format!("name one of {}", names.join(", ")),
        }),
    })
}
