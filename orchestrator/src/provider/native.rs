//! The `native` provider: the workload as a process of its host, with no platform between. The main type is [`Native`].
//!
//! The process has a session of its own and writes to files, so that it goes on when `matrix` ends or the connection to
//! its host does; its environment is a folder there. All of that is the agent's: [`AgentClient`](super::detached::AgentClient).

use std::sync::Arc;

use async_trait::async_trait;
use record::{run_directory::Resource, settings::Need};
use serde_json::Map;

use super::{
    Availability, Environment, EnvironmentRequest, Leftover, Provider, ProviderError, ShellRequest,
    detached::{DIRECTORY, HostProcesses},
};
use crate::host::{Host, Program};

const NAME: &str = "native";
/// What a killed workload may leave beside its folder: a bridge of Open vSwitch, which is the machine's.
const BRIDGE: &str = "bridge";

/// A host as it is.
pub struct Native {
    processes: HostProcesses,
}

impl Native {
    /// On that host.
    #[must_use]
    pub fn new(host: Arc<dyn Host>) -> Self {
        Self {
            processes: HostProcesses::new(NAME, host, Map::new()),
        }
    }
}

#[async_trait]
impl Provider for Native {
    fn name(&self) -> &'static str {
        NAME
    }

    /// Wherever the workload can be put it can be started; what it needs is another question.
    async fn survey(&self) -> Availability {
        match self.processes.agent.platform().await {
            Ok(host) => Availability::Available {
                detail: format!("Linux {}", host.platform.kernel),
            },
            Err(error) => Availability::prevented_by(error),
        }
    }

    async fn survey_need(&self, need: &Need) -> Option<Availability> {
        Some(self.processes.agent.survey_need(need).await)
    }

    fn resources(&self, request: &EnvironmentRequest) -> Vec<Resource> {
        self.processes.resources(&request.environment)
    }

    async fn create(&self, request: &EnvironmentRequest) -> Result<Box<dyn Environment>, ProviderError> {
        self.processes.create(request).await
    }

    async fn find(
        &self,
        request: &EnvironmentRequest,
    ) -> Result<Option<Box<dyn Environment>>, ProviderError> {
        self.processes.find(request).await
    }

    async fn shell(&self, request: &ShellRequest<'_>) -> Result<Program, ProviderError> {
        self.processes.shell(request).await
    }

    async fn leftovers(&self) -> Result<Vec<Leftover>, ProviderError> {
        let listed = self.processes.agent.list().await?;
        // A folder whose owner was never written belongs to nobody else.
        let (owned, nobodys): (Vec<_>, Vec<_>) =
            listed.environments.into_iter().partition(|it| it.owner.is_some());
        let leftover = |kind, name: &str, running| self.processes.leftover(kind, name, running);
        let nobodys = nobodys
            .iter()
            .map(|it| leftover(DIRECTORY, &it.environment, it.running));
        let bridges = listed.bridges.iter().map(|name| leftover(BRIDGE, name, false));
        Ok(self
            .processes
            .leftovers(owned)
            .chain(nobodys)
            .chain(bridges)
            .collect())
    }

    async fn remove(&self, leftover: &Leftover) -> Result<(), ProviderError> {
        let (agent, name) = (&self.processes.agent, &leftover.resource.name);
        match leftover.resource.kind.as_str() {
            BRIDGE => agent.remove_bridge(name).await.map(drop),
            _ => agent.remove(name).await.map(drop),
        }
    }
}
