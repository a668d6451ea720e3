//! `workload detached` as providers call it, on whichever host: each verb is a program that is started there and answers
//! (docs/hosts.md). The main type is [`AgentClient`].
//!
//! ```text
//! provider ── AgentClient ── Host ──> workload detached start, list, …      short calls
//!               └── DetachedEnvironment ──> follow, collect                 streams, taken up again after a cut
//! ```

mod clock;
mod environment;
pub(crate) mod transfer;

use std::{sync::Arc, time::Duration};

use record::{
    check::CheckRecord,
    detached::{self, Ending, Failure, Listed, Removed, Start, Started, Stopping},
    settings::Need,
};
use serde::{Serialize, de::DeserializeOwned};
use tokio::sync::OnceCell;

pub use self::{clock::ClockReading, environment::DetachedEnvironment};
use super::{Availability, EnvironmentRequest, ProviderError, trial};
use crate::host::{Deployed, Exit, Host, HostError, Program, RunningProgram, output};

/// A call takes milliseconds. Ending a workload that does not want to takes half a minute.
const CALL: Duration = Duration::from_secs(120);
/// How long a workload may take to end in order before it is ended by force.
const TO_END_IN_ORDER: &str = "10s";

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
        let start = Start {
            owner: request.owner(provider),
            settings: request.settings.clone(),
        };
        self.ask(
            "starting the workload",
            Verb::of("start", &request.environment),
            &json(&start),
        )
        .await
    }

    /// Whether an environment's workload runs, how it ended, what it said last.
    ///
    /// # Errors
    /// When there is no such environment, or the host cannot be asked.
    pub async fn ending(&self, environment: &str) -> Result<Ending, ProviderError> {
        self.ask(
            "asking how the workload ended",
            Verb::of("ended", environment),
            b"",
        )
        .await
    }

    /// Asks an environment's workload to end in order.
    ///
    /// # Errors
    /// When there is no such environment, or the host cannot be asked.
    pub async fn stop(&self, environment: &str) -> Result<Stopping, ProviderError> {
        self.ask("asking the workload to end", Verb::of("stop", environment), b"")
            .await
    }

    /// Ends an environment's workload and removes all of it. What is gone already is fine.
    ///
    /// # Errors
    /// When the host cannot be asked or refuses.
    pub async fn remove(&self, environment: &str) -> Result<Removed, ProviderError> {
        let verb = Verb::of("remove", environment).with("--patience", TO_END_IN_ORDER);
        self.ask("removing the environment", verb, b"").await
    }

    /// All that is on the host, whichever provider made it.
    ///
    /// # Errors
    /// When the host cannot be asked or refuses.
    pub async fn list(&self) -> Result<Listed, ProviderError> {
        self.ask("listing what is there", Verb::of_host("list"), b"")
            .await
    }

    /// Removes a bridge that [`Self::list`] named. One that is gone already is fine.
    ///
    /// # Errors
    /// When the host cannot be asked or refuses.
    pub async fn remove_bridge(&self, name: &str) -> Result<Removed, ProviderError> {
        let verb = Verb::of_machine("remove-bridge", name);
        self.ask("removing a bridge from Open vSwitch", verb, b"").await
    }

    /// What the host is.
    ///
    /// # Errors
    /// When it cannot be asked.
    pub async fn platform(&self) -> Result<detached::Host, ProviderError> {
        self.ask("asking what the host is", Verb::of_host("platform"), b"")
            .await
    }

    /// Whether the host as it is meets a need, asked of the very binary that would run there.
    ///
    /// # Errors
    /// When the binary cannot be put there or started, or does not answer in time and as agreed.
    pub async fn check(&self, need: &Need) -> Result<CheckRecord, ProviderError> {
        let file = &self.deployed().await?.program;
        let program = Program::new(file, trial::arguments(need));
        let (_, printed) = self.output(trial::ACTION, &program, b"", trial::PATIENCE).await?;
        trial::answer(&printed)
    }

    /// What [`Self::check`] means for a scenario with that need: an answer to
    /// [`survey_need`](super::Provider::survey_need).
    pub async fn survey_need(&self, need: &Need) -> Availability {
        match self.check(need).await {
            Ok(record) => trial::availability(&record),
            Err(error) => Availability::prevented_by(error),
        }
    }

    /// Passes an environment's lines on from that byte as they come.
    async fn follow(&self, environment: &str, from: u64) -> Result<RunningProgram, ProviderError> {
        let verb = Verb::of("follow", environment).with("--from", &from.to_string());
        self.begin(verb).await
    }

    /// Sends an environment's data once it has been told what is there.
    async fn collect(&self, environment: &str) -> Result<RunningProgram, ProviderError> {
        self.begin(Verb::of("collect", environment)).await
    }

    async fn begin(&self, verb: Verb) -> Result<RunningProgram, ProviderError> {
        Ok(self.host.start(&verb.program(self.deployed().await?)).await?)
    }

    /// Calls a verb and reads its answer.
    async fn ask<A: DeserializeOwned>(
        &self,
        action: &'static str,
        verb: Verb,
        input: &[u8],
    ) -> Result<A, ProviderError> {
        let program = verb.program(self.deployed().await?);
        let (exit, answer) = self.output(action, &program, input, CALL).await?;
        if !exit.success() {
            return Err(self.refusal(action, &exit));
        }
        serde_json::from_slice(&answer).map_err(|error| ProviderError::Data {
            what: format!("the answer of `workload detached {}`", verb.name),
            reason: error.to_string(),
        })
    }

    async fn output(
        &self,
        action: &'static str,
        program: &Program,
        input: &[u8],
        patience: Duration,
    ) -> Result<(Exit, Vec<u8>), ProviderError> {
        output(self.host.as_ref(), program, input, patience)
            .await
            .map_err(|error| match error {
                HostError::TimedOut { after, .. } => ProviderError::TimedOut {
                    action: format!("{action} on host `{}`", self.host()),
                    after,
                },
                error => error.into(),
            })
    }

    /// What a verb that did not end with 0 means.
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

/// A verb with its options.
struct Verb {
    name: &'static str,
    /// Whether it is about the folder of environments.
    rooted: bool,
    arguments: Vec<String>,
}

impl Verb {
    /// Of an environment.
    fn of(name: &'static str, environment: &str) -> Self {
        Self::of_host(name).with("--environment", environment)
    }

    /// Of all that is in the folder of environments.
    fn of_host(name: &'static str) -> Self {
        Self {
            name,
            rooted: true,
            arguments: Vec::new(),
        }
    }

    /// Of what is the machine's.
    fn of_machine(name: &'static str, which: &str) -> Self {
        Self {
            name,
            rooted: false,
            arguments: vec![which.to_owned()],
        }
    }

    fn with(mut self, option: &str, value: &str) -> Self {
        self.arguments.extend([option.to_owned(), value.to_owned()]);
        self
    }

    fn program(&self, deployed: &Deployed) -> Program {
        let root = ["--root".into(), deployed.environments.clone().into_os_string()];
        let arguments = ["detached".into(), self.name.into()]
            .into_iter()
            .chain(root.into_iter().filter(|_| self.rooted))
            .chain(self.arguments.iter().map(Into::into));
        Program::new(&deployed.program, arguments)
    }
}

/// Plain data can always be written as JSON.
fn json(record: &impl Serialize) -> Vec<u8> {
    serde_json::to_vec(record).unwrap_or_default()
}
