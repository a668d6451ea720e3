//! Virtual machines through Vagrant: `libvirt`, `virtualbox` and the other providers that Vagrant knows. The main type is
//! [`Vagrant`].
//!
//! ```text
//! host ── vagrant up ──> machine        a folder of the environment's own on the host
//!   └──── SSH ─────────> machine        a host like any other: the workload's agent is at work in it
//! ```
//!
//! The machine is the environment: it is made for one and removed with it.

mod inside;
pub(crate) mod kind;
mod machine;
pub mod options;
pub(crate) mod output;
mod requirements;
mod settings;
pub(crate) mod ssh_config;

use std::sync::Arc;

use async_trait::async_trait;
use record::run_directory::{Resource, fact};
use serde_json::{Map, Value, json};
use tokio::sync::OnceCell;

pub use self::settings::VagrantSettings;
use self::{
    inside::Inside,
    kind::VagrantKind,
    machine::{Machine, MachineFolders},
};
use super::{
    Availability, Ended, Environment, EnvironmentRequest, Leftover, Provider, ProviderError, ShellRequest,
    detached::{AgentClient, ClockReading, DetachedEnvironment},
};
use crate::host::{Host, Program};

/// A machine's folder on its host, with which the machine goes.
const MACHINE: &str = "machine";
/// What Vagrant calls a machine that can be entered.
const RUNNING: &str = "running";
/// What it calls one of which there is nothing yet.
const NOT_CREATED: &str = "not_created";

/// Virtual machines of one of Vagrant's providers on a host.
pub struct Vagrant {
    provider: &'static str,
    kind: &'static VagrantKind,
    host: Arc<dyn Host>,
    settings: VagrantSettings,
    folders: OnceCell<MachineFolders>,
}

impl Vagrant {
    /// Of the provider that Vagrant knows by this name.
    #[must_use]
    pub fn new(
        provider: &'static str,
        kind: &'static VagrantKind,
        host: Arc<dyn Host>,
        settings: VagrantSettings,
    ) -> Self {
        Self {
            provider,
            kind,
            host,
            settings,
            folders: OnceCell::new(),
        }
    }

    async fn folders(&self) -> Result<&MachineFolders, ProviderError> {
        let folders = async {
            let deployed = self.host.deploy().await?;
            Ok::<_, ProviderError>(MachineFolders::beside(
                Arc::clone(&self.host),
                &deployed.environments,
            ))
        };
        self.folders.get_or_try_init(|| folders).await
    }

    async fn machine(&self, environment: &str) -> Result<Machine, ProviderError> {
        Ok(self.folders().await?.machine(environment, self.provider))
    }

    fn resource(&self, environment: &str) -> Resource {
        Resource {
            host: self.host.name().to_owned(),
            kind: MACHINE.to_owned(),
            name: environment.to_owned(),
        }
    }

    /// Whether a run that somebody else has made may set what it sets: a matrix file was looked at when it was read.
    fn check_settings(&self) -> Result<(), ProviderError> {
        let refusals = self.settings.refusals(self.provider, self.kind.options);
        match refusals.into_iter().next() {
            None => Ok(()),
            Some((_, refusal)) => Err(ProviderError::Unsupported {
                provider: self.provider.to_owned(),
                reason: refusal.reason,
                hint: Some(refusal.instead),
            }),
        }
    }

    /// Goes into a machine that runs.
    async fn enter(&self, machine: Machine, environment: &str) -> Result<Entered, ProviderError> {
        let inside = Inside::of(&self.host, machine.clone(), environment).await?;
        Ok(Entered {
            agent: Arc::new(AgentClient::new(Arc::new(inside))),
            machine,
        })
    }

    async fn environment(
        &self,
        entered: Entered,
        request: &EnvironmentRequest,
        clock: ClockReading,
        running: bool,
    ) -> Result<Box<dyn Environment>, ProviderError> {
        let mut facts = Map::<String, Value>::new();
        facts.insert(fact::PROVIDER.to_owned(), json!(self.provider));
        facts.insert(
            "vagrant".to_owned(),
            json!(requirements::version(self.host.as_ref()).await),
        );
        facts.extend(requirements::versions(self.host.as_ref(), &self.kind.requirement).await);
        facts.insert("machine".to_owned(), json!(self.settings));
        facts.insert(fact::BOX.to_owned(), json!(entered.machine.made_of().await));
        facts.insert(
            fact::WORKLOAD_SHA256.to_owned(),
            json!(entered.agent.deployed().await?.sha256),
        );
        let workload = DetachedEnvironment::new(Arc::clone(&entered.agent), request, facts, clock, running);
        Ok(Box::new(VagrantEnvironment {
            workload,
            machine: entered.machine,
        }))
    }
}

/// A machine with the workload's agent in it.
struct Entered {
    machine: Machine,
    agent: Arc<AgentClient>,
}

#[async_trait]
impl Provider for Vagrant {
    fn name(&self) -> &'static str {
        self.provider
    }

    async fn survey(&self) -> Availability {
        requirements::survey(
            self.host.as_ref(),
            self.provider,
            &self.kind.requirement,
            &self.settings,
        )
        .await
    }

    fn resources(&self, request: &EnvironmentRequest) -> Vec<Resource> {
        vec![self.resource(&request.environment)]
    }

    async fn create(&self, request: &EnvironmentRequest) -> Result<Box<dyn Environment>, ProviderError> {
        self.check_settings()?;
        let machine = self.machine(&request.environment).await?;
        machine
            .prepare(&request.owner(self.provider), &self.settings)
            .await?;
        machine.up(self.settings.boot_timeout.duration()).await?;
        machine.digest_box().await;
        let entered = self.enter(machine, &request.environment).await?;
        let (clock, _) = ClockReading::of(&entered.agent).await?;
        entered.agent.start(self.provider, request).await?;
        self.environment(entered, request, clock, true).await
    }

    async fn find(
        &self,
        request: &EnvironmentRequest,
    ) -> Result<Option<Box<dyn Environment>>, ProviderError> {
        let folders = self.folders().await?;
        let name = &request.environment;
        let is_there = folders.list().await?.iter().any(|(there, _)| there == name);
        let machine = folders.machine(name, self.provider);
        if !is_there {
            return Ok(None);
        }
        match machine.state().await?.as_str() {
            RUNNING => {}
            NOT_CREATED => return Ok(None),
            // It has its data, and nobody to hand it out. To measure anew would be to throw away what was measured.
            state => return Err(machine.stands_still(state)),
        }
        let entered = self.enter(machine, name).await?;
        let listed = entered.agent.list().await?.environments;
        match listed.iter().find(|it| it.environment == *name) {
            Some(found) if found.started => {
                let (clock, _) = ClockReading::of(&entered.agent).await?;
                let environment = self.environment(entered, request, clock, found.running);
                Ok(Some(environment.await?))
            }
            _ => Ok(None),
        }
    }

    async fn shell(&self, request: &ShellRequest<'_>) -> Result<Program, ProviderError> {
        request.in_no_network(self.provider)?;
        request.of_no_image(self.provider)?;
        Ok(self.machine(request.environment).await?.shell())
    }

    async fn leftovers(&self) -> Result<Vec<Leftover>, ProviderError> {
        let folders = self.folders().await?;
        let mut leftovers = Vec::new();
        for (name, owner) in folders.list().await? {
            let Some(owner) = owner.filter(|owner| owner.provider == self.provider) else {
                continue;
            };
            // Where Vagrant does not say so, it is a leftover all the same.
            let state = folders.machine(&name, self.provider).state().await;
            let running = state.is_ok_and(|state| state == RUNNING);
            leftovers.push(Leftover {
                resource: self.resource(&name),
                run: Some(owner.run),
                run_directory: Some(owner.run_directory),
                scenario: Some(owner.scenario),
                running,
                job: None,
            });
        }
        Ok(leftovers)
    }

    async fn remove(&self, leftover: &Leftover) -> Result<(), ProviderError> {
        self.machine(&leftover.resource.name).await?.remove().await
    }
}

/// A workload in a machine of its own.
struct VagrantEnvironment {
    workload: DetachedEnvironment,
    machine: Machine,
}

#[async_trait]
impl Environment for VagrantEnvironment {
    fn facts(&self) -> Map<String, Value> {
        self.workload.facts()
    }

    fn running(&self) -> bool {
        self.workload.running()
    }

    async fn next_progress(&mut self) -> Result<Option<record::progress::Progress>, ProviderError> {
        self.workload.next_progress().await
    }

    async fn stop(&mut self) -> Result<(), ProviderError> {
        self.workload.stop().await
    }

    async fn ended(&mut self) -> Result<Ended, ProviderError> {
        self.workload.ended().await
    }

    async fn collect(&mut self, into: &std::path::Path) -> Result<(), ProviderError> {
        self.workload.collect(into).await
    }

    /// The workload goes with its machine.
    async fn discard(self: Box<Self>) -> Result<(), ProviderError> {
        self.machine.remove().await
    }
}
