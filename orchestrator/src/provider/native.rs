//! The `native` provider: the workload as a process of its host, with no platform between. The main type is [`Native`].
//!
//! The process has a session of its own and writes to files, so that it goes on when `matrix` ends or the connection to
//! its host does; its environment is a folder there. All of that is the agent's: [`AgentClient`].

use std::sync::Arc;

use async_trait::async_trait;
use record::{detached::ListedEnvironment, run_directory::Resource, settings::Need};
use serde_json::{Map, Value, json};

use super::{
    Availability, Environment, EnvironmentRequest, Leftover, Provider, ProviderError,
    detached::{AgentClient, ClockReading, DetachedEnvironment},
};
use crate::host::{Host, Program};

const NAME: &str = "native";
/// An environment's folder, with which its process is ended.
const DIRECTORY: &str = "directory";
const PROCESS: &str = "process";
/// What a killed workload may leave beside its folder: a bridge of Open vSwitch, which is the machine's.
const BRIDGE: &str = "bridge";

/// A host as it is.
pub struct Native {
    agent: Arc<AgentClient>,
}

impl Native {
    /// On that host.
    #[must_use]
    pub fn new(host: Arc<dyn Host>) -> Self {
        Self {
            agent: Arc::new(AgentClient::new(host)),
        }
    }

    fn resource(&self, kind: &str, name: &str) -> Resource {
        Resource {
            host: self.agent.host().to_owned(),
            kind: kind.to_owned(),
            name: name.to_owned(),
        }
    }

    fn leftover(&self, listed: ListedEnvironment) -> Leftover {
        let (run, run_directory, scenario) = match listed.owner {
            Some(owner) => (Some(owner.run), Some(owner.run_directory), Some(owner.scenario)),
            None => (None, None, None),
        };
        Leftover {
            resource: self.resource(DIRECTORY, &listed.environment),
            run,
            run_directory,
            scenario,
            running: listed.running,
        }
    }

    /// A bridge as something that was left behind. Which run had it is not known.
    fn bridge(&self, name: &str) -> Leftover {
        Leftover {
            resource: self.resource(BRIDGE, name),
            run: None,
            run_directory: None,
            scenario: None,
            running: false,
        }
    }

    async fn environment(
        &self,
        request: &EnvironmentRequest,
        clock: ClockReading,
        running: bool,
    ) -> Result<Box<dyn Environment>, ProviderError> {
        let mut facts = Map::<String, Value>::new();
        facts.insert("provider".to_owned(), json!(NAME));
        facts.insert(
            "workload_sha256".to_owned(),
            json!(self.agent.deployed().await?.sha256),
        );
        Ok(Box::new(DetachedEnvironment::new(
            Arc::clone(&self.agent),
            request,
            facts,
            clock,
            running,
        )))
    }
}

#[async_trait]
impl Provider for Native {
    fn name(&self) -> &'static str {
        NAME
    }

    /// Wherever the workload can be put it can be started; what it needs is another question.
    async fn survey(&self) -> Availability {
        match self.agent.platform().await {
            Ok(host) => Availability::Available {
                detail: format!("Linux {}", host.platform.kernel),
            },
            Err(error) => Availability::prevented_by(error),
        }
    }

    async fn survey_need(&self, need: &Need) -> Option<Availability> {
        Some(self.agent.survey_need(need).await)
    }

    fn resources(&self, request: &EnvironmentRequest) -> Vec<Resource> {
        [DIRECTORY, PROCESS]
            .map(|kind| self.resource(kind, &request.environment))
            .into()
    }

    async fn create(&self, request: &EnvironmentRequest) -> Result<Box<dyn Environment>, ProviderError> {
        let (clock, _) = ClockReading::of(&self.agent).await?;
        self.agent.start(NAME, request).await?;
        self.environment(request, clock, true).await
    }

    async fn find(
        &self,
        request: &EnvironmentRequest,
    ) -> Result<Option<Box<dyn Environment>>, ProviderError> {
        let listed = self.agent.list().await?.environments;
        match listed.iter().find(|it| it.environment == request.environment) {
            Some(found) if found.started => {
                let (clock, _) = ClockReading::of(&self.agent).await?;
                let environment = self.environment(request, clock, found.running);
                Ok(Some(environment.await?))
            }
            _ => Ok(None),
        }
    }

    async fn shell(&self, environment: &str) -> Result<Program, ProviderError> {
        let folder = self.agent.deployed().await?.environments.join(environment);
        let script = r#"cd "$1" && exec "${SHELL:-/bin/sh}""#;
        let arguments = ["-c".into(), script.into(), "sh".into(), folder.into_os_string()];
        Ok(Program::new("sh", arguments))
    }

    async fn leftovers(&self) -> Result<Vec<Leftover>, ProviderError> {
        let listed = self.agent.list().await?;
        // A folder whose owner was never written belongs to nobody else.
        let is_ours = |it: &ListedEnvironment| it.owner.as_ref().is_none_or(|owner| owner.provider == NAME);
        let folders = listed.environments.into_iter().filter(is_ours);
        let bridges = listed.bridges.iter().map(|name| self.bridge(name));
        Ok(folders.map(|it| self.leftover(it)).chain(bridges).collect())
    }

    async fn remove(&self, leftover: &Leftover) -> Result<(), ProviderError> {
        let name = &leftover.resource.name;
        match leftover.resource.kind.as_str() {
            BRIDGE => self.agent.remove_bridge(name).await.map(drop),
            _ => self.agent.remove(name).await.map(drop),
        }
    }
}
