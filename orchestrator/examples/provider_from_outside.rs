//! A provider from outside the crate: `nice`, which runs the workload as a process with a low priority (nice(1)). The program
//! is `matrix` with this provider beside the built-in ones:
//!
//! ```text
//! cargo run -p orchestrator --example provider_from_outside -- run nice.yaml
//! ```
//!
//! ```yaml
//! matrix: {virtualization: [native, nice]}
//! providers: {nice: {level: 10}}
//! ```

use std::{
    path::PathBuf,
    process::{Command, ExitCode},
    sync::Arc,
};

use async_trait::async_trait;
use orchestrator::{
    host::{Deployed, Host, HostError, Listener, Program, RunningProgram},
    main_with,
    matrix_file::SshAddress,
    provider::{
        Availability, Environment, EnvironmentRequest, Leftover, Making, Provider, ProviderError,
        ProviderKind,
        detached::{AgentClient, ClockReading, DetachedEnvironment},
    },
};
use record::{detached::ListedEnvironment, run_directory::Resource, settings::Need};
use serde::Deserialize;
use serde_json::{Map, Value, json};
use tokio::net::UnixStream;

const NAME: &str = "nice";
/// The kind of an environment's folder, with which its process ends.
const DIRECTORY: &str = "directory";

/// The row. What it leaves out is as [`ProviderKind::new`] has it.
static PROVIDERS: [ProviderKind; 1] = [ProviderKind {
    column: true,
    check: |options| Settings::of(options.clone()).map(drop),
    ..ProviderKind::new(NAME, make)
}];

fn main() -> ExitCode {
    main_with(&PROVIDERS)
}

/// What a matrix file can say under `providers: {nice: …}`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Settings {
    /// From 0, an ordinary priority, to 19, the lowest.
    level: u8,
}

impl Default for Settings {
    fn default() -> Self {
        Self { level: 19 }
    }
}

impl Settings {
    fn of(options: Value) -> Result<Self, String> {
        let settings: Self = serde_json::from_value(options).map_err(|error| error.to_string())?;
        match settings.level {
            0..=19 => Ok(settings),
            level => Err(format!("`level` is {level}, and the lowest priority is 19")),
        }
    }
}

fn make(making: &Making<'_>) -> Result<Box<dyn Provider>, ProviderError> {
    let Settings { level } = Settings::of(making.options()).map_err(|reason| ProviderError::Unsupported {
        provider: NAME.to_owned(),
        reason,
        hint: Some("correct `providers.nice` in the matrix file".to_owned()),
    })?;
    let host = LowPriority {
        host: Arc::clone(making.host),
        level,
    };
    Ok(Box::new(Nice {
        agent: Arc::new(AgentClient::new(Arc::new(host))),
        level,
    }))
}

/// A host on which every program is started with a low priority. A process passes it on to those that it starts.
struct LowPriority {
    host: Arc<dyn Host>,
    level: u8,
}

#[async_trait]
impl Host for LowPriority {
    fn name(&self) -> &str {
        self.host.name()
    }

    fn is_this_machine(&self) -> bool {
        self.host.is_this_machine()
    }

    async fn start(&self, program: &Program) -> Result<RunningProgram, HostError> {
        let arguments = [
            "-n".into(),
            self.level.to_string().into(),
            program.file.clone().into_os_string(),
        ];
        let arguments = arguments.into_iter().chain(program.arguments.iter().cloned());
        self.host.start(&Program::new("nice", arguments)).await
    }

    async fn connect(&self, listener: &Listener) -> Result<UnixStream, HostError> {
        self.host.connect(listener).await
    }

    async fn deploy(&self) -> Result<Deployed, HostError> {
        self.host.deploy().await
    }

    fn terminal(&self, program: &Program) -> Command {
        self.host.terminal(program)
    }

    fn machine_behind(&self, name: &str, address: SshAddress, identity: PathBuf) -> Arc<dyn Host> {
        self.host.machine_behind(name, address, identity)
    }
}

/// Processes with a low priority on one host.
struct Nice {
    agent: Arc<AgentClient>,
    level: u8,
}

impl Nice {
    fn resource(&self, environment: &str) -> Resource {
        Resource {
            host: self.agent.host().to_owned(),
            kind: DIRECTORY.to_owned(),
            name: environment.to_owned(),
        }
    }

    async fn environment(
        &self,
        request: &EnvironmentRequest,
        clock: ClockReading,
        running: bool,
    ) -> Result<Box<dyn Environment>, ProviderError> {
        let mut facts = Map::new();
        facts.insert("provider".to_owned(), json!(NAME));
        facts.insert("level".to_owned(), json!(self.level));
        let workload = self.agent.deployed().await?;
        facts.insert("workload_sha256".to_owned(), json!(workload.sha256));
        let agent = Arc::clone(&self.agent);
        Ok(Box::new(DetachedEnvironment::new(
            agent, request, facts, clock, running,
        )))
    }
}

#[async_trait]
impl Provider for Nice {
    fn name(&self) -> &'static str {
        NAME
    }

    async fn survey(&self) -> Availability {
        // The question itself is a program that is started by `nice`.
        match self.agent.platform().await {
            Ok(_) => Availability::Available {
                detail: format!("level {}", self.level),
            },
            Err(error) => Availability::prevented_by(error),
        }
    }

    async fn survey_need(&self, need: &Need) -> Option<Availability> {
        Some(self.agent.survey_need(need).await)
    }

    fn resources(&self, request: &EnvironmentRequest) -> Vec<Resource> {
        vec![self.resource(&request.environment)]
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
        let is_it = |it: &&ListedEnvironment| it.started && it.environment == request.environment;
        let Some(found) = listed.iter().find(is_it) else {
            return Ok(None);
        };
        let (clock, _) = ClockReading::of(&self.agent).await?;
        let environment = self.environment(request, clock, found.running).await?;
        Ok(Some(environment))
    }

    async fn shell(&self, environment: &str) -> Result<Program, ProviderError> {
        let folder = self.agent.deployed().await?.environments.join(environment);
        let script = r#"cd "$1" && exec "${SHELL:-/bin/sh}""#;
        let arguments = ["-c".into(), script.into(), "sh".into(), folder.into_os_string()];
        Ok(Program::new("sh", arguments))
    }

    async fn leftovers(&self) -> Result<Vec<Leftover>, ProviderError> {
        let listed = self.agent.list().await?.environments;
        let leftover = |it: ListedEnvironment| {
            // A folder without an owner is the provider `native`'s to remove.
            let owner = it.owner.filter(|owner| owner.provider == NAME)?;
            Some(Leftover {
                resource: self.resource(&it.environment),
                run: Some(owner.run),
                run_directory: Some(owner.run_directory),
                scenario: Some(owner.scenario),
                running: it.running,
            })
        };
        Ok(listed.into_iter().filter_map(leftover).collect())
    }

    async fn remove(&self, leftover: &Leftover) -> Result<(), ProviderError> {
        self.agent.remove(&leftover.resource.name).await.map(drop)
    }
}
