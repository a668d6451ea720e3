//! Execution: a plan's scenarios, one after another on a host and the hosts side by side, each journaled before it touches
//! anything. Where all of a host's are only computed, as many as the machine has processors are computed side by side. The main
//! type is [`Run`].
//!
//! ```text
//! each host:  lease -> for each round, for each of its scenarios: create, follow, collect, discard -> run directory
//! ```
//!
//! A run and a resumed run are the same thing: [`Run::execute`] looks at what the journal says of each scenario in each round and
//! does what is left to do.

pub mod collection;
mod compression;
pub mod inspection;
pub mod keep;
pub mod recorded;
pub mod run_index;
pub mod scenario;
pub mod session;
pub mod silence;
pub mod stop;
pub mod unit;

use std::{collections::BTreeSet, io, num::NonZero, ops::RangeInclusive, thread};

use collection::CollectionError;
use futures_util::{TryStreamExt as _, future::try_join_all, stream};
use keep::Keep;
use record::run_directory::{Event, PlanRecord, RunDirectory};
use stop::Stop;
use tokio::{
    sync::{Mutex, RwLock, RwLockWriteGuard},
    task::spawn_blocking,
};
use unit::Unit;

use crate::{
    disk_space,
    experiment_files::ExperimentFiles,
    host::lease::{Answer, HostLease},
    journal::JournalError,
    lease::Holder,
    observer::Events,
    provider::{Fleet, ProviderError},
};

/// A run that cannot go on. What happened to single scenarios is in the journal, not here.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The journal cannot be written.
    #[error(transparent)]
    Journal(#[from] JournalError),
    /// A window that is not whole cannot be put aside.
    #[error(transparent)]
    Collection(#[from] CollectionError),
    /// The run directory cannot be read.
    #[error("the run directory cannot be looked at")]
    RunDirectory(#[from] io::Error),
}

impl RunError {
    /// What to do about it.
    #[must_use]
    pub fn hint(&self) -> Option<String> {
        match self {
            Self::Journal(error) => Some(error.hint()),
            Self::Collection(error) => Some(error.hint()),
            Self::RunDirectory(error) => Some(disk_space::hint(error)),
        }
    }
}

/// Whether a run waits for its jobs.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Patience {
    /// It goes on until there is nothing more to do.
    #[default]
    WaitsForJobs,
    /// It collects what has ended, submits what is missing, and leaves. What is measured on other hosts is left, too.
    LeavesJobs,
}

/// How the units of a host come one after another.
pub(crate) enum Turn {
    /// On the host itself, which is leased while they do.
    Host(Mutex<Option<HostLease>>),
    /// In the queue of a batch system, to which they are submitted one after another.
    Queue(Mutex<()>),
}

impl Turn {
    /// On a host that nobody has leased yet.
    pub(crate) fn on_host() -> Self {
        Self::Host(Mutex::new(None))
    }

    /// Gives back what was leased.
    pub(crate) async fn end(self) {
        if let Self::Host(lease) = self
            && let Some(lease) = lease.into_inner()
        {
            lease.give_back().await;
        }
    }
}

/// One plan being carried out.
pub struct Run<'a> {
    /// The run's name.
    pub name: String,
    /// Where everything goes; absolute.
    pub directory: RunDirectory,
    /// What is to be done.
    pub plan: &'a PlanRecord,
    /// The files of a user's experiment, if it has any.
    pub files: Option<ExperimentFiles>,
    /// Who is told.
    pub events: Events,
    /// Where it is done.
    pub fleet: &'a dyn Fleet,
    /// The wish to stop.
    pub stop: Stop,
    /// Which environments stay.
    pub keep: Keep,
    /// Whether jobs are waited for.
    pub patience: Patience,
    /// Whether something is measured on this machine (written) or collected to it (read), never both: a transfer from
    /// another host would disturb what is measured here.
    pub this_machine: RwLock<()>,
}

impl Run<'_> {
    /// Does what is left to do. Says how each scenario ended in the journal.
    ///
    /// # Errors
    /// When the run cannot go on at all.
    pub async fn execute(&self, resumed: bool) -> Result<(), RunError> {
        self.events.emit(Event::RunStarted {
            pid: std::process::id(),
            resumed,
            manifest_sha256: Some(self.directory.manifest().digest()?.sha256),
            plan_sha256: Some(self.directory.plan().digest()?.sha256),
        })?;
        let settled = self.settled();
        self.on_all_hosts(|_| true).await?;
        // Only now: to read all that was measured would disturb a workload that was left and may still measure here.
        if resumed && !self.stop.is_requested() {
            let mut differing = BTreeSet::new();
            for unit in settled {
                let _nothing_is_measured_here = self.this_machine.read().await;
                if self.inspect(&unit.planned.slug, unit.windows()).await? {
                    differing.insert((&unit.planned.slug, unit.round));
                }
            }
            self.on_all_hosts(|unit| differing.contains(&(&unit.planned.slug, unit.round)))
                .await?;
        }
        // The wish to stop may come when all is measured.
        Ok(self
            .events
            .emit(match self.events.state().is_interrupted(self.plan) {
                true if self.patience == Patience::LeavesJobs && !self.stop.is_requested() => Event::RunLeft,
                true => Event::RunInterrupted,
                false => Event::RunFinished,
            })?)
    }

    /// The units that there is nothing to do for, as far as the journal knows.
    fn settled(&self) -> Vec<Unit<'_>> {
        let units = Unit::all(self.plan).into_iter();
        units.filter(|unit| self.is_settled(*unit)).collect()
    }

    fn is_settled(&self, unit: Unit<'_>) -> bool {
        let state = self.events.scenario(&unit.planned.slug);
        state.round(unit.round).is_settled()
    }

    /// Does what is left to do of some units, the hosts side by side.
    async fn on_all_hosts(&self, which: impl Fn(Unit<'_>) -> bool) -> Result<(), RunError> {
        let hosts = self.units_by_host(which);
        let at_work = hosts.iter().map(|(host, units)| self.on_host(host, units));
        try_join_all(at_work).await.map(drop)
    }

    /// Brings the journal up to those of some windows that a scenario has in the run directory; whether it was not.
    async fn inspect(&self, slug: &str, windows: RangeInclusive<u32>) -> Result<bool, RunError> {
        let (directory, run, scenario) = (self.directory.clone(), self.name.clone(), slug.to_owned());
        let state = self.events.scenario(slug);
        let inspecting = move || inspection::inspect(&directory, &run, &scenario, windows, &state);
        // All that was measured is read: others are not to wait for that.
        let events = spawn_blocking(inspecting).await.map_err(io::Error::other)??;
        let differs = !events.is_empty();
        events.into_iter().try_for_each(|event| self.events.emit(event))?;
        Ok(differs)
    }

    /// Those that run, round by round, in the order that the plan has for each; the hosts by the first of theirs.
    fn units_by_host(&self, which: impl Fn(Unit<'_>) -> bool) -> Vec<(&str, Vec<Unit<'_>>)> {
        let mut hosts: Vec<(&str, Vec<Unit<'_>>)> = Vec::new();
        for unit in Unit::all(self.plan).into_iter().filter(|unit| which(*unit)) {
            let host = unit.host();
            match hosts.iter_mut().find(|(known, _)| *known == host) {
                Some((_, units)) => units.push(unit),
                None => hosts.push((host, vec![unit])),
            }
        }
        hosts
    }

    /// Does what is left to do on a host, round by round.
    async fn on_host(&self, host: &str, units: &[Unit<'_>]) -> Result<(), RunError> {
        if self.is_cluster(host) {
            return self.on_cluster(units).await;
        }
        if self.patience == Patience::LeavesJobs {
            return Ok(());
        }
        let turn = Turn::on_host();
        let side_by_side = self.side_by_side(host, units);
        for round in units.chunk_by(|unit, next| unit.round == next.round) {
            self.units(round, side_by_side, &turn).await?;
        }
        turn.end().await;
        Ok(())
    }

    /// Submits what is left to do on a cluster, in the order of the plan, and waits for all of it at once: the cluster keeps the
    /// order.
    async fn on_cluster(&self, units: &[Unit<'_>]) -> Result<(), RunError> {
        self.units(units, units.len(), &Turn::Queue(Mutex::new(()))).await
    }

    async fn units(&self, units: &[Unit<'_>], side_by_side: usize, turn: &Turn) -> Result<(), RunError> {
        stream::iter(units.iter().copied().map(Ok))
            .try_for_each_concurrent(side_by_side, async |unit| {
                match self.is_settled(unit) || self.stop.is_requested() {
                    true => Ok(()),
                    false => self.unit(unit, turn).await,
                }
            })
            .await
    }

    /// Whether a host stands for the nodes of a cluster.
    fn is_cluster(&self, host: &str) -> bool {
        self.fleet.host(host).is_ok_and(|host| host.nodes().is_some())
    }

    /// How many units a host may do at a time. What is measured there must not be disturbed; what is computed cannot be.
    fn side_by_side(&self, host: &str, units: &[Unit<'_>]) -> usize {
        let is_here = self.fleet.host(host).is_ok_and(|host| host.is_this_machine());
        match is_here && units.iter().all(|unit| unit.is_computed()) {
            true => thread::available_parallelism().map_or(1, NonZero::get),
            false => 1,
        }
    }

    /// Waits until the host is ours; whether it is, and not rather asked to stop meanwhile.
    async fn has_lease(
        &self,
        unit: Unit<'_>,
        lease: &Mutex<Option<HostLease>>,
    ) -> Result<bool, scenario::ScenarioError> {
        let name = unit.host();
        // Who comes meanwhile waits for the same answer.
        let mut lease = lease.lock().await;
        loop {
            let asked = match lease.as_mut() {
                Some(asked) => asked,
                None => {
                    let holder = Holder::this_process(self.directory.path());
                    // The run directory is locked: nobody else asks with this. Two names of one machine are not to take the lease
                    // from each other.
                    let token = format!(
                        "{} on {} for {name}",
                        self.directory.path().display(),
                        holder.machine
                    );
                    lease.insert(HostLease::ask(self.fleet.host(name)?, &token, &holder))
                }
            };
            let answer = tokio::select! {
                answer = asked.answer() => answer,
                () = self.stop.requested() => return Ok(false),
            };
            match answer {
                Ok(Answer::Granted) => return Ok(true),
                Ok(Answer::HeldBy(holder)) => self.events.emit(Event::HostBusy {
                    host: name.to_owned(),
                    holder,
                })?,
                Err(error) => {
                    // The next scenario asks anew: the host may be back by then.
                    *lease = None;
                    return Err(ProviderError::from(error).into());
                }
            }
        }
    }

    /// Nothing is collected to this machine while this lives, if it is this machine that measures.
    async fn quiet(&self, unit: Unit<'_>) -> Result<Option<RwLockWriteGuard<'_, ()>>, ProviderError> {
        let is_here = self.fleet.host(unit.host())?.is_this_machine();
        Ok(match is_here && !unit.is_computed() {
            true => Some(self.this_machine.write().await),
            false => None,
        })
    }
}
