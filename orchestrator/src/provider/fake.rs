//! The `fake` provider: runs the pipeline in a blink, for tests and for trying out a matrix file. The main type is
//! [`Fake`].
//!
//! What it measures is the twin in virtual time with some noise; what it leaves are the files of a real workload. Its
//! environments are folders below the state directory, as the native provider's, and all of their state is there: one
//! that is found again after a crash goes on from where it was. Nothing runs in between: the workload gets on whenever
//! it is asked for its next line. It is strict: what must not be called is an error.

mod environment;
mod settings;
pub(crate) mod window;

use async_trait::async_trait;
use record::{detached::Owner, run_directory::Resource};

use self::environment::FakeEnvironment;
use super::{
    Availability, Environment, EnvironmentRequest, Leftover, Provider, ProviderError, ShellRequest,
    environment_directory::EnvironmentDirectory,
};
use crate::{host::Program, state_directory::StateDirectory};

pub use settings::{FakeScenario, FakeSettings, Fault, FaultPoint};

const NAME: &str = "fake";

/// A platform that is not there.
#[derive(Debug, Clone)]
pub struct Fake {
    host: String,
    settings: FakeSettings,
    state: StateDirectory,
}

impl Fake {
    /// On the host of that name in the matrix file, with its environments in this state directory.
    #[must_use]
    pub fn new(host: &str, settings: FakeSettings, state: StateDirectory) -> Self {
        Self {
            host: host.to_owned(),
            settings,
            state,
        }
    }

    fn ours(&self) -> Result<Vec<(EnvironmentDirectory, Option<Owner>)>, ProviderError> {
        let mut all = EnvironmentDirectory::all(&self.state)?;
        // A crash may have come before its owner was written, or in the midst of its removal.
        all.retain(|(_, owner)| owner.as_ref().is_none_or(|owner| owner.provider == NAME));
        Ok(all)
    }
}

#[async_trait]
impl Provider for Fake {
    fn name(&self) -> &'static str {
        NAME
    }

    async fn survey(&self) -> Availability {
        Availability::Available {
            detail: "in virtual time, nothing is measured".to_owned(),
        }
    }

    fn resources(&self, request: &EnvironmentRequest) -> Vec<Resource> {
        vec![EnvironmentDirectory::of(&self.state, &request.environment).resource(&self.host)]
    }

    async fn create(&self, request: &EnvironmentRequest) -> Result<Box<dyn Environment>, ProviderError> {
        let directory = EnvironmentDirectory::of(&self.state, &request.environment);
        directory.create(&request.owner(NAME))?;
        let fault = self.settings.fault(&request.scenario, &request.environment);
        if fault.is_some_and(|fault| fault.at == FaultPoint::Create) {
            return Err(ProviderError::Played {
                at: FaultPoint::Create.name(),
            });
        }
        Ok(Box::new(FakeEnvironment::create(
            directory,
            request,
            &self.settings,
        )?))
    }

    async fn find(
        &self,
        request: &EnvironmentRequest,
    ) -> Result<Option<Box<dyn Environment>>, ProviderError> {
        let directory = EnvironmentDirectory::of(&self.state, &request.environment);
        // Without its lines the workload was never started.
        if !directory.lines().exists() {
            return Ok(None);
        }
        Ok(Some(Box::new(FakeEnvironment::find(
            directory,
            request,
            &self.settings,
        )?)))
    }

    async fn shell(&self, _: &ShellRequest<'_>) -> Result<Program, ProviderError> {
        Err(ProviderError::Unsupported {
            provider: NAME.to_owned(),
            reason: "there is nothing to enter".to_owned(),
            hint: None,
        })
    }

    async fn leftovers(&self) -> Result<Vec<Leftover>, ProviderError> {
        let leftovers = self.ours()?.into_iter().map(|(directory, owner)| {
            // It runs only while somebody asks it to, and then that is its own run.
            directory.leftover(&self.host, owner, false)
        });
        Ok(leftovers.collect())
    }

    async fn remove(&self, leftover: &Leftover) -> Result<(), ProviderError> {
        let host = &leftover.resource.host;
        match self
            .ours()?
            .into_iter()
            .find(|(directory, _)| directory.resource(host) == leftover.resource)
        {
            Some((directory, _)) => directory.remove(),
            None => Ok(()),
        }
    }
}
