//! The `simulated` provider: the workload as an ordinary process of its host that computes its windows in virtual time. The main type is
//! [`Simulated`].
//!
//! It needs no right and no network, and what the machine does meanwhile does not reach the result. docs/twin.md says what is computed.

use std::{path::PathBuf, sync::Arc};

use async_trait::async_trait;
use record::{axis::SIMULATED, run_directory::Resource};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Map;

use super::{
    Availability, Environment, EnvironmentRequest, Leftover, Provider, ProviderError, ShellRequest,
    detached::HostProcesses,
};
use crate::host::{Host, Program};

/// What a matrix file says of simulated scenarios: `providers.simulated`.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SimulatedSettings {
    /// A folder with the platform of each simulated scenario, `SLUG.yaml`, beside the matrix file. Left out, all are on that of
    /// `workload.simulation.platform`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub platforms: Option<PathBuf>,
}

impl SimulatedSettings {
    pub(super) const fn is_empty(&self) -> bool {
        self.platforms.is_none()
    }
}

/// A host that computes.
pub struct Simulated {
    processes: HostProcesses,
}

impl Simulated {
    /// On that host.
    #[must_use]
    pub fn new(host: Arc<dyn Host>) -> Self {
        Self {
            processes: HostProcesses::new(SIMULATED, host, Map::new()),
        }
    }
}

#[async_trait]
impl Provider for Simulated {
    fn name(&self) -> &'static str {
        SIMULATED
    }

    async fn survey(&self) -> Availability {
        match self.processes.agent.platform().await {
            Ok(_) => Availability::Available {
                detail: "in virtual time, nothing is measured".to_owned(),
            },
            Err(error) => Availability::prevented_by(error),
        }
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
        request.in_no_network(self.name())?;
        self.processes.shell(request).await
    }

    async fn leftovers(&self) -> Result<Vec<Leftover>, ProviderError> {
        let listed = self.processes.agent.list().await?;
        Ok(self.processes.leftovers(listed.environments).collect())
    }

    async fn remove(&self, leftover: &Leftover) -> Result<(), ProviderError> {
        self.processes
            .agent
            .remove(&leftover.resource.name)
            .await
            .map(drop)
    }
}
