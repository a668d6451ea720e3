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
    provider::{
        Availability, Environment, EnvironmentRequest, Leftover, Making, Provider, ProviderError,
        ProviderKind, ShellRequest, detached::HostProcesses,
    },
};
use record::{connection::SshAddress, run_directory::Resource, settings::Need};
use serde::Deserialize;
use serde_json::{Map, Value, json};
use tokio::net::UnixStream;

const NAME: &str = "nice";

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
    let facts = Map::from_iter([("level".to_owned(), json!(level))]);
    Ok(Box::new(Nice {
        processes: HostProcesses::new(NAME, Arc::new(host), facts),
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
    processes: HostProcesses,
    level: u8,
}

#[async_trait]
impl Provider for Nice {
    fn name(&self) -> &'static str {
        NAME
    }

    async fn survey(&self) -> Availability {
        // The question itself is a program that is started by `nice`.
        match self.processes.agent.platform().await {
            Ok(_) => Availability::Available {
                detail: format!("level {}", self.level),
            },
            Err(error) => Availability::prevented_by(error),
        }
    }

    async fn survey_need(&self, need: &Need) -> Option<Availability> {
        Some(self.processes.agent.survey_need(need).await)
    }

    fn resources(&self, request: &EnvironmentRequest) -> Vec<Resource> {
        vec![self.processes.directory(&request.environment)]
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
        let listed = self.processes.agent.list().await?.environments;
        Ok(self.processes.leftovers(listed).collect())
    }

    async fn remove(&self, leftover: &Leftover) -> Result<(), ProviderError> {
        self.processes
            .agent
            .remove(&leftover.resource.name)
            .await
            .map(drop)
    }
}
