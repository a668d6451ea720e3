//! One scenario in one round: take up what an earlier process left, measure what is still wanted, collect it, discard the
//! environment, say how it ended.
//!
//! A machine that fails is not an experiment that fails: what a provider says ends as *errored*, what the workload says
//! of the experiment as *failed*. Data is never discarded before it was collected: when collecting fails, the
//! environment stays for `matrix resume`.

mod collecting;
mod ending;
mod following;

use std::{collections::BTreeSet, io, sync::Arc};

use record::{
    axis::{HARDWARE, OS, SIMULATED},
    detached::UNFINISHED,
    identity::HostIdentity,
    progress::Progress,
    run_directory::{Event, JobStanding, Outcome, PlannedScenario, Resource},
};
use tokio::sync::{MutexGuard, RwLockWriteGuard};

pub(super) use self::ending::ScenarioError;
use self::{
    ending::{Ending, Work},
    following::Heard,
};
use super::{Patience, Run, RunError, Turn, unit::Unit};
use crate::{
    disk_space,
    journal::JournalError,
    provider::{
        Ended, Environment, EnvironmentRequest, Provider, ProviderError, detached::AgentClient, facts,
    },
};

impl Run<'_> {
    /// Does what is left to do of one scenario in one round.
    ///
    /// # Errors
    /// Only when the journal cannot be written; everything else is an outcome.
    pub(super) async fn unit(&self, unit: Unit<'_>, turn: &Turn) -> Result<(), RunError> {
        if self.leaves(unit) && self.is_under_way(unit).await? {
            return Ok(());
        }
        let experiment = unit.planned.settings.experiment.as_ref();
        let mut retries = experiment.map_or(0, |experiment| experiment.retries);
        let host = self.fleet.host(unit.host());
        let nodes = host.as_ref().ok().and_then(|host| host.nodes());
        let mut other_nodes = nodes.map_or(0, |nodes| nodes.slurm.attempts.saturating_sub(1));
        loop {
            let Work::Ended(ending) = self.once(unit, turn).await? else {
                break;
            };
            // What failed is a result, and is not tried until it succeeds. Where all windows are there, another environment would
            // measure none: what went wrong came after them.
            if ending.outcome != Outcome::Errored || self.wanted(unit).is_empty() || self.stop.is_requested()
            {
                break;
            }
            let left = match ending.lost_its_node {
                true => &mut other_nodes,
                false => &mut retries,
            };
            match left.checked_sub(1) {
                Some(one_less) => *left = one_less,
                None => break,
            }
        }
        Ok(())
    }

    /// Whether the job of a unit waits or measures, so that there is nothing to do but to say so if that is new.
    async fn is_under_way(&self, unit: Unit<'_>) -> Result<bool, RunError> {
        let state = self.events.scenario(&unit.planned.slug);
        let Some(open) = state.round(unit.round).open.filter(|open| !open.discarding) else {
            return Ok(false);
        };
        let request = self.request(unit, open.environment, open.windows);
        // Whoever works on it will see what is wrong.
        let Ok(provider) = self.fleet.provider(unit.planned, unit.host()) else {
            return Ok(false);
        };
        let found = provider.find(&request).await.ok().flatten();
        let Some(job) = found.as_ref().and_then(|found| found.job()) else {
            return Ok(false);
        };
        if open.job.is_none_or(|before| before.has_changed(job)) {
            self.job_changed(&request, job)?;
        }
        Ok(job.standing.is_alive())
    }

    fn job_changed(&self, request: &EnvironmentRequest, job: &JobStanding) -> Result<(), JournalError> {
        self.events.emit(Event::JobChanged {
            scenario: request.scenario.clone(),
            environment: request.environment.clone(),
            standing: job.clone(),
        })
    }

    async fn once(&self, unit: Unit<'_>, turn: &Turn) -> Result<Work, RunError> {
        let Unit { planned, round } = unit;
        let wanted = self.wanted(unit);
        self.events.emit(Event::ScenarioStarted {
            scenario: planned.slug.clone(),
            windows: wanted,
            round: planned.round(round),
        })?;
        let attempted = match self.failed_fast(unit) {
            Some(ending) => Ok(Work::Ended(ending)),
            None => self.in_turn(unit, turn).await,
        };
        let ending = match attempted {
            Ok(Work::Ended(ending)) => ending,
            Ok(Work::Left) => return Ok(Work::Left),
            Err(ScenarioError::Journal(error)) => return Err(error.into()),
            Err(trouble @ ScenarioError::StandsStill { .. }) if self.stop.is_requested() => Ending {
                outcome: Outcome::Interrupted,
                ..Ending::errored(&trouble)
            },
            Err(trouble) => Ending::errored(&trouble),
        };
        self.events.emit(Event::ScenarioFinished {
            scenario: planned.slug.clone(),
            outcome: ending.outcome,
            reason: ending.reason.clone(),
            hint: ending.hint.clone(),
            round: planned.round(round),
        })?;
        Ok(Work::Ended(ending))
    }

    /// That the scenario has ended with an earlier environment, if its experiment wants that.
    fn failed_fast(&self, unit: Unit<'_>) -> Option<Ending> {
        unit.planned
            .settings
            .experiment
            .as_ref()
            .filter(|it| it.fail_fast)?;
        let state = self.events.scenario(&unit.planned.slug);
        let mut others = unit.planned.rounds().filter(|round| *round != unit.round);
        let failed = others.find(|round| state.round(*round).outcome == Some(Outcome::Failed))?;
        let reason =
            format!("the environment of round {failed} failed, and `fail_fast` ends the scenario with it");
        Some(Ending::of(Outcome::Failed, Some(reason), None))
    }

    fn wanted(&self, unit: Unit<'_>) -> Vec<u32> {
        self.events.scenario(&unit.planned.slug).wanted(unit.windows())
    }

    /// Works on a scenario when its turn on its host comes.
    async fn in_turn(&self, unit: Unit<'_>, turn: &Turn) -> Result<Work, ScenarioError> {
        match turn {
            Turn::Host(lease) => match self.has_lease(unit, lease).await? {
                true => self.attempts(unit, None).await,
                false => Ok(Work::Ended(Ending::of(Outcome::Interrupted, None, None))),
            },
            // First come, first served: the scenarios come in the order of the plan.
            Turn::Queue(queue) => self.attempts(unit, Some(queue.lock().await)).await,
        }
    }

    /// The environment that is still there, if any, then a new one for what is still wanted.
    async fn attempts(
        &self,
        unit: Unit<'_>,
        mut submitting: Option<MutexGuard<'_, ()>>,
    ) -> Result<Work, ScenarioError> {
        let Unit { planned, round } = unit;
        self.refuse_beside_another(unit).await?;
        let provider = self.fleet.provider(planned, unit.host())?;
        let mut taken_up = false;
        if let Some(open) = self.events.scenario(&planned.slug).round(round).open {
            let request = self.request(unit, open.environment, open.windows);
            if open.discarding {
                self.remove_remains(provider.as_ref(), &request).await?;
            } else {
                match self
                    .take_up(provider.as_ref(), &request, unit, &mut submitting)
                    .await?
                {
                    Some(Work::Ended(ending))
                        if ending.outcome != Outcome::Failed && !self.stop.is_requested() =>
                    {
                        taken_up = true;
                    }
                    Some(work) => return Ok(work),
                    None => {}
                }
            }
        }
        // Of one that was taken up all that is there was read when it was collected.
        if !taken_up {
            let _nothing_is_measured_here = self.this_machine.read().await;
            self.inspect(&planned.slug, unit.windows()).await?;
        }
        loop {
            let mut windows = self.wanted(unit);
            if windows.is_empty() {
                return Ok(Work::Ended(Ending::of(Outcome::Completed, None, None)));
            }
            if self.stop.is_requested() {
                return Ok(Work::Ended(Ending::of(Outcome::Interrupted, None, None)));
            }
            let all = windows.len();
            if let Some(limit) = provider.time_limit().await? {
                windows.truncate(
                    limit
                        .most_windows(&planned.settings)
                        .map_err(ProviderError::from)?,
                );
            }
            let is_last = windows.len() == all;
            match self
                .attempt(unit, provider.as_ref(), windows, &mut submitting)
                .await?
            {
                // Those that did not fit into one environment are measured in another.
                Work::Ended(ending) if ending.outcome == Outcome::Completed && !is_last => {}
                work => return Ok(work),
            }
        }
    }

    /// A new environment for these windows.
    async fn attempt(
        &self,
        unit: Unit<'_>,
        provider: &dyn Provider,
        windows: Vec<u32>,
        submitting: &mut Option<MutexGuard<'_, ()>>,
    ) -> Result<Work, ScenarioError> {
        let Unit { planned, round } = unit;
        self.check_host(unit, windows.len()).await?;
        let attempt = self.events.scenario(&planned.slug).attempts.saturating_add(1);
        let name = format!("matrix-{}-{}-{attempt}", self.name, planned.slug);
        let request = self.request(unit, name, windows);
        self.events.emit(Event::EnvironmentCreating {
            scenario: planned.slug.clone(),
            environment: request.environment.clone(),
            provider: provider.name().to_owned(),
            windows: request.windows.clone(),
            resources: provider.resources(&request),
            round: planned.round(round),
        })?;
        let quiet = self.quiet(unit).await?;
        let created = provider.create(&request).await;
        drop(submitting.take());
        match created {
            Ok(environment) => {
                self.events.emit(Event::EnvironmentCreated {
                    scenario: planned.slug.clone(),
                    environment: request.environment.clone(),
                    facts: facts::of(environment.as_ref()),
                })?;
                if let Some(job) = environment.job() {
                    self.job_changed(&request, job)?;
                }
                if self.leaves(unit) {
                    return Ok(Work::Left);
                }
                self.measure(provider, environment, &request, quiet)
                    .await
                    .map(Work::Ended)
            }
            Err(first) if self.keep.keeps(Outcome::Errored) => {
                self.keep_environment(&request)?;
                Err(first.into())
            }
            Err(first) => match self.remove_remains(provider, &request).await {
                Ok(()) => Err(first.into()),
                Err(ScenarioError::Journal(error)) => Err(error.into()),
                Err(second) => Err(ScenarioError::NotRemoved {
                    first,
                    second: Box::new(second),
                }),
            },
        }
    }

    /// The lease says that no other `matrix` works here; a workload whose `matrix` was killed may still measure, and
    /// two windows on one host disturb each other.
    async fn refuse_beside_another(&self, unit: Unit<'_>) -> Result<(), ScenarioError> {
        let planned = unit.planned;
        // A job has its node for itself, and takes the node's lease.
        if self.is_cluster(unit.host()) {
            return Ok(());
        }
        let state = self.events.state();
        let open = state.scenario(&planned.slug).round(unit.round).open;
        let own = open.map(|open| open.environment);
        // Nothing is measured in a machine that was kept.
        let kept: BTreeSet<_> = state.scenarios.values().flat_map(|it| &it.kept).collect();
        let mut asked = Vec::new();
        let host = unit.host();
        let beside = |other: &&PlannedScenario| other.runs() && other.hosts().any(|it| it == host);
        for other in self.plan.scenarios.iter().filter(beside) {
            let provider = self.fleet.provider(other, host)?;
            // What is computed does not disturb what is computed.
            let is_harmless = unit.is_computed() && provider.name() == SIMULATED;
            if is_harmless || asked.contains(&provider.name()) {
                continue;
            }
            asked.push(provider.name());
            let leftovers = match provider.leftovers().await {
                Ok(leftovers) => leftovers,
                // Another scenario's platform that does not answer runs nothing that could disturb this one.
                Err(_) if other.slug != planned.slug => continue,
                Err(error) => return Err(error.into()),
            };
            if let Some(running) = leftovers
                .into_iter()
                .filter(|leftover| leftover.running && !kept.contains(&leftover.resource.name))
                .find(|leftover| Some(&leftover.resource.name) != own.as_ref())
            {
                return Err(ScenarioError::StillMeasuring {
                    environment: running.resource.name,
                    run_directory: running.run_directory.unwrap_or_default(),
                });
            }
        }
        Ok(())
    }

    /// Refuses to begin on another machine than the scenario says, and what would fill a disk: that of the host, or this
    /// machine's with the run directory. Others may fill it yet.
    async fn check_host(&self, unit: Unit<'_>, windows: usize) -> Result<(), ScenarioError> {
        let planned = unit.planned;
        let wanted = disk_space::windows_take(&planned.settings, windows);
        let host = self.fleet.host(unit.host())?;
        let place = format!("host `{}`", host.name());
        let is_here = host.is_this_machine();
        let said = AgentClient::new(Arc::clone(&host)).platform().await?;
        let (hardware, os) = (planned.axis(HARDWARE), planned.axis(OS));
        let claim = HostIdentity {
            host: host.name(),
            hardware: hardware.as_deref(),
            os: os.as_deref(),
        };
        // What this machine is was known when the run was planned. What a node is the job looks at.
        if let Some(contradiction) = claim
            .contradiction(&said.platform.machine, &said.platform.os)
            .filter(|_| !is_here && host.nodes().is_none())
        {
            return Err(ScenarioError::AnotherHost(contradiction));
        }
        let there = said.free_bytes;
        let disk = rustix::fs::statvfs(self.directory.path()).map_err(io::Error::from)?;
        let here = disk.f_bavail.saturating_mul(disk.f_frsize);
        let run_directory = self.directory.path().display().to_string();
        for (place, free) in [(place, there), (run_directory, here)] {
            if free < wanted {
                return Err(ScenarioError::NoRoom {
                    place,
                    windows,
                    wanted,
                    free,
                });
            }
        }
        Ok(())
    }

    /// Whether this process leaves the environment of a unit as soon as it is submitted.
    fn leaves(&self, unit: Unit<'_>) -> bool {
        self.patience == Patience::LeavesJobs && self.is_cluster(unit.host())
    }

    fn request(&self, unit: Unit<'_>, environment: String, windows: Vec<u32>) -> EnvironmentRequest {
        EnvironmentRequest {
            environment,
            run: self.name.clone(),
            run_directory: self.directory.path().to_owned(),
            scenario: unit.planned.slug.clone(),
            host: unit.host().to_owned(),
            settings: unit.planned.settings.clone(),
            windows,
            files: self.files.clone(),
        }
    }

    /// Goes on with an environment that an earlier process left; `None` when there was nothing to go on with.
    async fn take_up(
        &self,
        provider: &dyn Provider,
        request: &EnvironmentRequest,
        unit: Unit<'_>,
        submitting: &mut Option<MutexGuard<'_, ()>>,
    ) -> Result<Option<Work>, ScenarioError> {
        let quiet = self.quiet(unit).await?;
        let Some(environment) = provider.find(request).await? else {
            self.remove_remains(provider, request).await?;
            return Ok(None);
        };
        self.events.emit(Event::EnvironmentFound {
            scenario: request.scenario.clone(),
            environment: request.environment.clone(),
            running: environment.running(),
        })?;
        if environment.running() && self.leaves(unit) {
            return Ok(Some(Work::Left));
        }
        // Others submit theirs while this one is waited for; what it leaves to measure is submitted after them.
        drop(submitting.take());
        let ending = self.measure(provider, environment, request, quiet).await?;
        Ok(Some(Work::Ended(ending)))
    }

    /// Follows a workload to its end, collects what it measured and discards its environment.
    async fn measure(
        &self,
        provider: &dyn Provider,
        environment: Box<dyn Environment>,
        request: &EnvironmentRequest,
        quiet: Option<RwLockWriteGuard<'_, ()>>,
    ) -> Result<Ending, ScenarioError> {
        let mut environment = environment;
        let heard = self.follow(provider, &mut environment, request).await?;
        let ended = match self
            .end(provider, environment.as_mut(), request, &heard, quiet)
            .await
        {
            // Somebody may be removing it just now: what is left of it is looked for once more.
            Err(error @ (ScenarioError::Provider(_) | ScenarioError::NotGivenOut { .. })) => {
                match provider.find(request).await {
                    Ok(Some(found)) => {
                        environment = found;
                        self.end(provider, environment.as_mut(), request, &heard, None)
                            .await?
                    }
                    Ok(None) | Err(_) => return Err(error),
                }
            }
            ended => ended?,
        };
        let mut ending = self.ending(heard.last, &ended, request);
        ending.lost_its_node = ended.lost_its_node;
        match self.keep.keeps(ending.outcome) {
            true => self.keep_environment(request)?,
            false => self.discard(environment, request).await?,
        }
        Ok(ending)
    }

    /// Waits for the end of a workload and collects what it measured.
    async fn end(
        &self,
        provider: &dyn Provider,
        environment: &mut dyn Environment,
        request: &EnvironmentRequest,
        heard: &Heard,
        quiet: Option<RwLockWriteGuard<'_, ()>>,
    ) -> Result<Ended, ScenarioError> {
        let ended = environment.ended().await?;
        drop(quiet);
        self.collect(provider, environment, request, heard).await?;
        Ok(ended)
    }

    /// How an environment ended whose data was collected.
    fn ending(&self, last: Option<Progress>, ended: &Ended, request: &EnvironmentRequest) -> Ending {
        let state = self.events.scenario(&request.scenario);
        // A command that failed after the last window, `restore`, may have left the host as no later scenario expects it.
        let went_wrong =
            request.settings.experiment.is_some() && matches!(last, Some(Progress::Failed { .. }));
        let is_there = |window: &u32| state.collected.contains_key(window);
        if request.windows.iter().all(is_there) && !went_wrong {
            return Ending::of(Outcome::Completed, None, None);
        }
        match last {
            Some(Progress::Failed {
                reason,
                hint,
                platform: false,
            }) => Ending::of(Outcome::Failed, Some(reason), hint),
            Some(Progress::Failed {
                reason,
                hint,
                platform: true,
            }) => Ending::of(Outcome::Errored, Some(reason), hint),
            _ if self.stop.is_requested() => Ending::of(Outcome::Interrupted, None, None),
            _ => Ending::of(
                Outcome::Errored,
                Some(format!(
                    "the workload ended before its last window: {}",
                    ended.how
                )),
                Some("`matrix resume` measures the windows that are missing".to_owned()),
            ),
        }
    }

    fn keep_environment(&self, request: &EnvironmentRequest) -> Result<(), ScenarioError> {
        Ok(self.events.emit(Event::EnvironmentKept {
            scenario: request.scenario.clone(),
            environment: request.environment.clone(),
        })?)
    }

    async fn discard(
        &self,
        environment: Box<dyn Environment>,
        request: &EnvironmentRequest,
    ) -> Result<(), ScenarioError> {
        let (scenario, name) = (&request.scenario, &request.environment);
        self.events.emit(Event::EnvironmentDiscarding {
            scenario: scenario.clone(),
            environment: name.clone(),
        })?;
        environment.discard().await?;
        Ok(self.events.emit(Event::EnvironmentDiscarded {
            scenario: scenario.clone(),
            environment: name.clone(),
        })?)
    }

    /// Removes what there is of an environment that never came to measure.
    async fn remove_remains(
        &self,
        provider: &dyn Provider,
        request: &EnvironmentRequest,
    ) -> Result<(), ScenarioError> {
        let ours = provider.resources(request);
        for leftover in provider.leftovers().await? {
            // A removal that was cut short may have left a folder of that name without its owner.
            let of_this_run = leftover.run.as_ref().is_none_or(|run| *run == request.run);
            if of_this_run && ours.iter().any(|ours| is_of(&leftover.resource, ours)) {
                provider.remove(&leftover).await?;
            }
        }
        Ok(self.events.emit(Event::EnvironmentDiscarded {
            scenario: request.scenario.clone(),
            environment: request.environment.clone(),
        })?)
    }
}

/// Whether something is a resource, or what a crash has left of one that was being made.
fn is_of(found: &Resource, resource: &Resource) -> bool {
    let rest = found.name.strip_prefix(&resource.name);
    (&found.host, &found.kind) == (&resource.host, &resource.kind)
        && rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('.') && rest.ends_with(UNFINISHED))
}

#[cfg(test)]
mod tests;
