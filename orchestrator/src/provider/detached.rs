//! `workload detached` as providers call it, on whichever host: each command is a program that is started there and answers
//! (docs/hosts.md). The main type is [`AgentClient`].
//!
//! ```text
//! provider ── AgentClient ── Host ──> workload detached start, list, …      short calls
//!               └── DetachedEnvironment ──> follow, collect                 streams, taken up again after a cut
//! ```

mod clock;
mod environment;
mod host_processes;
pub(crate) mod transfer;

use std::{sync::Arc, time::Duration};

use record::{
    call::{Detached, Follow, Remove, Root, Which},
    check::CheckRecord,
    detached::{self, Ending, Failure, JobContainer, Listed, Looked, Removed, Start, Started, Stopping},
    quantity::TimeSpan,
    settings::Need,
};
use serde::{Serialize, de::DeserializeOwned};
use tokio::sync::OnceCell;

pub(crate) use self::host_processes::DIRECTORY;
pub use self::{clock::ClockReading, environment::DetachedEnvironment, host_processes::HostProcesses};
use super::{Availability, EnvironmentRequest, ProviderError, capability_probe};
use crate::host::{Deployed, Exit, Host, HostError, Program, RunningProgram, output};

/// A call takes milliseconds. Ending a workload that does not want to takes half a minute.
const CALL: Duration = Duration::from_secs(120);
/// How long a workload may take to end in order before it is ended by force.
const GRACE: TimeSpan = TimeSpan::from_secs(10);

/// The workload's agent on a host.
pub struct AgentClient {
    host: Arc<dyn Host>,
    /// Put there when it is needed first.
    deployed: OnceCell<Deployed>,
}

impl AgentClient {
    /// On that host.
    #[must_use]
    pub fn new(host: Arc<dyn Host>) -> Self {
        Self {
            host,
            deployed: OnceCell::new(),
        }
    }

    /// The host's name in the matrix file.
    #[must_use]
    pub fn host(&self) -> &str {
        self.host.name()
    }

    /// The workload as it is on the host, put there if it is not yet.
    ///
    /// # Errors
    /// When the host cannot be reached or refuses.
    pub async fn deployed(&self) -> Result<&Deployed, ProviderError> {
        Ok(self.deployed.get_or_try_init(|| self.host.deploy()).await?)
    }

    /// Makes an environment for a provider and starts its workload, which then needs nobody.
    ///
    /// # Errors
    /// When there is one of that name already, or the host refuses.
    pub async fn start(
        &self,
        provider: &str,
        request: &EnvironmentRequest,
    ) -> Result<Started, ProviderError> {
        let environment = &request.environment;
        let call = |root| Detached::Start(which(root, environment));
        self.ask("starting the workload", call, &asked_for(provider, request, None))
            .await
    }

    /// Makes an environment for a provider whose workload a job is to start, in a container if there is one.
    ///
    /// # Errors
    /// When there is one of that name already, or the host refuses.
    pub async fn prepare(
        &self,
        provider: &str,
        request: &EnvironmentRequest,
        container: Option<JobContainer>,
    ) -> Result<(), ProviderError> {
        let environment = &request.environment;
        let call = |root| Detached::Prepare(which(root, environment));
        let input = asked_for(provider, request, container);
        self.answered("preparing the environment", call, &input)
            .await
            .map(drop)
    }

    /// What there is by now of an environment that a job measures, with the lines from that byte on, or the first of them.
    ///
    /// # Errors
    /// When there is no such environment, or the host cannot be asked.
    pub async fn look(&self, environment: &str, from: u64) -> Result<(Looked, Vec<u8>), ProviderError> {
        let call = |root| {
            Detached::Look(Follow {
                which: which(root, environment),
                from,
            })
        };
        let (name, mut answer) = self
            .answered("looking at what the job has written", call, b"")
            .await?;
        let end = answer
            .iter()
            .position(|byte| *byte == b'\n')
            .map_or(answer.len(), |at| at + 1);
        let lines = answer.split_off(end);
        let looked: Looked = read_answer(name, &answer)?;
        match looked.bytes == lines.len() as u64 && looked.bytes <= Looked::MOST {
            true => Ok((looked, lines)),
            false => Err(ProviderError::Disconnected {
                platform: format!("host `{}`", self.host()),
                action: "reading what the job has written".to_owned(),
                source: format!("{} of {} bytes came", lines.len(), looked.bytes).into(),
            }),
        }
    }

    /// Whether an environment's workload runs, how it ended, what it said last.
    ///
    /// # Errors
    /// When there is no such environment, or the host cannot be asked.
    pub async fn ending(&self, environment: &str) -> Result<Ending, ProviderError> {
        let call = |root| Detached::Ended(which(root, environment));
        self.ask("asking how the workload ended", call, b"").await
    }

    /// Asks an environment's workload to end in order.
    ///
    /// # Errors
    /// When there is no such environment, or the host cannot be asked.
    pub async fn stop(&self, environment: &str) -> Result<Stopping, ProviderError> {
        let call = |root| Detached::Stop(which(root, environment));
        self.ask("asking the workload to end", call, b"").await
    }

    /// Ends an environment's workload and removes all of it. What is gone already is fine.
    ///
    /// # Errors
    /// When the host cannot be asked or refuses.
    pub async fn remove(&self, environment: &str) -> Result<Removed, ProviderError> {
        let call = |root| {
            Detached::Remove(Remove {
                which: which(root, environment),
                grace: GRACE,
            })
        };
        self.ask("removing the environment", call, b"").await
    }

    /// All that is on the host, whichever provider made it.
    ///
    /// # Errors
    /// When the host cannot be asked or refuses.
    pub async fn list(&self) -> Result<Listed, ProviderError> {
        self.ask("listing what is there", Detached::List, b"").await
    }

    /// Removes a bridge that [`Self::list`] named. One that is gone already is fine.
    ///
    /// # Errors
    /// When the host cannot be asked or refuses.
    pub async fn remove_bridge(&self, name: &str) -> Result<Removed, ProviderError> {
        let call = |_| Detached::RemoveBridge {
            name: name.to_owned(),
        };
        self.ask("removing a bridge from Open vSwitch", call, b"").await
    }

    /// What the host is.
    ///
    /// # Errors
    /// When it cannot be asked.
    pub async fn platform(&self) -> Result<detached::Host, ProviderError> {
        self.ask("asking what the host is", Detached::Platform, b"").await
    }

    /// Whether the host as it is meets a need, asked of the very binary that would run there.
    ///
    /// # Errors
    /// When the binary cannot be put there or started, or does not answer in time and as agreed.
    pub async fn check(&self, need: &Need) -> Result<CheckRecord, ProviderError> {
        let file = &self.deployed().await?.program;
        let program = Program::new(file, capability_probe::call(need).arguments());
        let (_, printed) = self
            .output(capability_probe::ACTION, &program, b"", capability_probe::TIMEOUT)
            .await?;
        capability_probe::answer(&printed)
    }

    /// What [`Self::check`] means for a scenario with that need: an answer to
    /// [`survey_need`](super::Provider::survey_need).
    pub async fn survey_need(&self, need: &Need) -> Availability {
        match self.check(need).await {
            Ok(record) => capability_probe::availability(&record),
            Err(error) => Availability::prevented_by(error),
        }
    }

    /// Passes an environment's lines on from that byte as they come.
    async fn follow(&self, environment: &str, from: u64) -> Result<RunningProgram, ProviderError> {
        let call = |root| {
            Detached::Follow(Follow {
                which: which(root, environment),
                from,
            })
        };
        self.begin(call).await
    }

    /// Sends an environment's data once it has been told what is there.
    async fn collect(&self, environment: &str) -> Result<RunningProgram, ProviderError> {
        self.begin(|root| Detached::Collect(which(root, environment)))
            .await
    }

    async fn begin(&self, call: impl FnOnce(Root) -> Detached) -> Result<RunningProgram, ProviderError> {
        let (_, program) = program(self.deployed().await?, call);
        Ok(self.host.start(&program).await?)
    }

    /// Calls the agent and reads its answer.
    async fn ask<A: DeserializeOwned>(
        &self,
        action: &'static str,
        call: impl FnOnce(Root) -> Detached,
        input: &[u8],
    ) -> Result<A, ProviderError> {
        let (name, answer) = self.answered(action, call, input).await?;
        read_answer(name, &answer)
    }

    /// Calls the agent; the command's name, and what it answered.
    async fn answered(
        &self,
        action: &'static str,
        call: impl FnOnce(Root) -> Detached,
        input: &[u8],
    ) -> Result<(&'static str, Vec<u8>), ProviderError> {
        let (name, program) = program(self.deployed().await?, call);
        let (exit, answer) = self.output(action, &program, input, CALL).await?;
        match exit.success() {
            true => Ok((name, answer)),
            false => Err(self.refusal(action, &exit)),
        }
    }

    async fn output(
        &self,
        action: &'static str,
        program: &Program,
        input: &[u8],
        timeout: Duration,
    ) -> Result<(Exit, Vec<u8>), ProviderError> {
        output(self.host.as_ref(), program, input, timeout)
            .await
            .map_err(|error| match error {
                HostError::TimedOut { after, .. } => ProviderError::TimedOut {
                    action: format!("{action} on host `{}`", self.host()),
                    after,
                },
                error => error.into(),
            })
    }

    /// What a command that did not end with 0 means.
    fn refusal(&self, action: &'static str, exit: &Exit) -> ProviderError {
        let platform = format!("host `{}`", self.host());
        let action = action.to_owned();
        let words = exit.last_words.trim();
        let last_line = words.lines().next_back().unwrap_or_default();
        match (exit.code, serde_json::from_str::<Failure>(last_line)) {
            (Some(_), Ok(failure)) => ProviderError::Refused {
                platform,
                action,
                hint: failure.hint,
                source: failure.error.into(),
            },
            (Some(code), Err(_)) => ProviderError::Refused {
                platform,
                action,
                hint: None,
                source: format!("the workload ended with exit code {code}: {words}").into(),
            },
            // Somebody ended it; what it was about goes on without it.
            (None, _) => ProviderError::Disconnected {
                platform,
                action,
                source: "the program that we started there was killed".into(),
            },
        }
    }
}

fn read_answer<A: DeserializeOwned>(name: &str, answer: &[u8]) -> Result<A, ProviderError> {
    serde_json::from_slice(answer).map_err(|error| ProviderError::Data {
        what: format!("the answer of `workload detached {name}`"),
        reason: error.to_string(),
    })
}

/// What the agent reads to make an environment.
fn asked_for(provider: &str, request: &EnvironmentRequest, container: Option<JobContainer>) -> Vec<u8> {
    let mut input = json(&Start {
        owner: request.owner(provider),
        settings: request.settings.clone(),
        container,
    });
    if let Some(files) = &request.files {
        input.push(b'\n');
        input.extend_from_slice(files.stream());
    }
    input
}

/// A call of the agent on a host, with its name.
fn program(deployed: &Deployed, call: impl FnOnce(Root) -> Detached) -> (&'static str, Program) {
    let call = call(Root {
        root: deployed.environments.clone(),
    });
    (call.name(), Program::new(&deployed.program, call.arguments()))
}

fn which(root: Root, environment: &str) -> Which {
    Which {
        root,
        environment: environment.to_owned(),
    }
}

/// Plain data can always be written as JSON.
fn json(record: &impl Serialize) -> Vec<u8> {
    serde_json::to_vec(record).unwrap_or_default()
}
