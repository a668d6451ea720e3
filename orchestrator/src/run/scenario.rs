//! One scenario: take up what an earlier process left, measure what is still wanted, collect it, discard the
//! environment, say how it ended.
//!
//! A machine that fails is not an experiment that fails: what a provider says ends as *errored*, what the workload says
//! of the experiment as *failed*. Data is never discarded before it was collected: when collecting fails, the
//! environment stays for `matrix resume`.

use std::{
    collections::BTreeSet,
    fs, io,
    path::{Path, PathBuf},
    sync::Arc,
};

use reports::run_directory::{EnvironmentRecord, Event, Outcome, PlannedScenario};
use serde::de::DeserializeOwned;
use tokio::{sync::RwLockWriteGuard, task::spawn_blocking};
use workload::{causes::with_causes, record::progress::Progress};

use super::{
    Run, RunError,
    collection::{self, CollectionError, Sorted},
    room,
};
use crate::{
    host::lease::HostLease,
    journal::JournalError,
    matrix_file::{HARDWARE, OS},
    plan::placement::{Claim, Contradiction},
    provider::detached::Keeper,
    provider::{Ended, Environment, EnvironmentRequest, Provider, ProviderError, facts},
};

/// Why the infrastructure could not do what a scenario needs.
#[derive(Debug, thiserror::Error)]
pub(super) enum Trouble {
    #[error(transparent)]
    Journal(#[from] JournalError),
    #[error(transparent)]
    Provider(#[from] ProviderError),
    #[error(transparent)]
    Collection(#[from] CollectionError),
    #[error("cannot write into the run directory")]
    RunDirectory(#[from] io::Error),
    /// The first of two failures is the one to mend: the second may well be its consequence.
    #[error(
        "{}; what there was of the environment could not be removed: {}",
        with_causes(first),
        with_causes(second)
    )]
    NotRemoved {
        first: ProviderError,
        second: Box<Trouble>,
    },
    #[error(
        "the disk of {place} has {} free, and {windows} windows take about {}",
        room::in_words(*free),
        room::in_words(*wanted)
    )]
    NoRoom {
        place: String,
        windows: usize,
        wanted: u64,
        free: u64,
    },
    /// It was out of reach when the run was planned, or has become another since.
    #[error("{}", .0.reason)]
    AnotherHost(Contradiction),
    #[error("`{environment}` of {} still measures on this host", run_directory.display())]
    StillMeasuring {
        environment: String,
        run_directory: PathBuf,
    },
}

/// How one environment ended.
struct Ending {
    outcome: Outcome,
    reason: Option<String>,
    hint: Option<String>,
}

impl Ending {
    fn of(outcome: Outcome, reason: Option<String>, hint: Option<String>) -> Self {
        Self {
            outcome,
            reason,
            hint,
        }
    }

    fn errored(trouble: &Trouble) -> Self {
        let hint = match trouble {
            Trouble::Provider(error) => error.hint(),
            Trouble::Journal(error) => Some(error.hint()),
            Trouble::Collection(_) | Trouble::RunDirectory(_) | Trouble::NoRoom { .. } => {
                Some("make room on the disk and `matrix resume`".to_owned())
            }
            Trouble::AnotherHost(contradiction) => Some(contradiction.fix.clone()),
            Trouble::StillMeasuring { run_directory, .. } => Some(format!(
                "`matrix resume {}` goes on with it, `matrix clean` removes it",
                run_directory.display()
            )),
            Trouble::NotRemoved { first, .. } => {
                let clean = "`matrix clean` removes what is left".to_owned();
                Some(match first.hint() {
                    Some(hint) => format!("{hint}; {clean}"),
                    None => clean,
                })
            }
        };
        Self::of(Outcome::Errored, Some(with_causes(trouble)), hint)
    }
}

/// What a file of JSON says, if it is there and says it: facts that are missing must not cost any windows.
fn read_json<T: DeserializeOwned>(path: &Path) -> Option<T> {
    serde_json::from_slice(&fs::read(path).ok()?).ok()
}

impl Run<'_> {
    /// Does what is left to do of one scenario.
    ///
    /// # Errors
    /// Only when the journal cannot be written; everything else is an outcome.
    pub(super) async fn scenario(
        &self,
        planned: &PlannedScenario,
        lease: &mut Option<HostLease>,
    ) -> Result<(), RunError> {
        let wanted = self.wanted(planned);
        self.events.emit(Event::ScenarioStarted {
            scenario: planned.slug.clone(),
            windows: wanted,
        })?;
        let ending = match self.leased_attempts(planned, lease).await {
            Ok(ending) => ending,
            Err(Trouble::Journal(error)) => return Err(error.into()),
            Err(trouble) => Ending::errored(&trouble),
        };
        Ok(self.events.emit(Event::ScenarioFinished {
            scenario: planned.slug.clone(),
            outcome: ending.outcome,
            reason: ending.reason,
            hint: ending.hint,
        })?)
    }

    fn wanted(&self, planned: &PlannedScenario) -> Vec<u32> {
        self.events
            .scenario(&planned.slug)
            .wanted(planned.settings.windows)
    }

    async fn leased_attempts(
        &self,
        planned: &PlannedScenario,
        lease: &mut Option<HostLease>,
    ) -> Result<Ending, Trouble> {
        match self.has_lease(planned, lease).await? {
            true => self.attempts(planned).await,
            false => Ok(Ending::of(Outcome::Interrupted, None, None)),
        }
    }

    /// The environment that is still there, if any, then a new one for what is still wanted.
    async fn attempts(&self, planned: &PlannedScenario) -> Result<Ending, Trouble> {
        self.refuse_beside_another(planned).await?;
        let provider = self.fleet.provider(planned)?;
        if let Some(open) = self.events.scenario(&planned.slug).open {
            let request = self.request(planned, open.environment, open.windows);
            if open.discarding {
                self.remove_remains(provider.as_ref(), &request).await?;
            } else if let Some(ending) = self.take_up(provider.as_ref(), &request).await?
                && (ending.outcome == Outcome::Failed || self.stop.is_requested())
            {
                return Ok(ending);
            }
        }
        let windows = self.wanted(planned);
        if windows.is_empty() {
            return Ok(Ending::of(Outcome::Completed, None, None));
        }
        if self.stop.is_requested() {
            return Ok(Ending::of(Outcome::Interrupted, None, None));
        }
        self.check_host(planned, windows.len()).await?;
        let attempt = self.events.scenario(&planned.slug).attempts + 1;
        let name = format!("matrix-{}-{}-{attempt}", self.name, planned.slug);
        let request = self.request(planned, name, windows);
        self.events.emit(Event::EnvironmentCreating {
            scenario: planned.slug.clone(),
            environment: request.environment.clone(),
            provider: provider.name().to_owned(),
            windows: request.windows.clone(),
            resources: provider.resources(&request),
        })?;
        let quiet = self.quiet(&request.host).await?;
        match provider.create(&request).await {
            Ok(environment) => {
                self.events.emit(Event::EnvironmentCreated {
                    scenario: planned.slug.clone(),
                    environment: request.environment.clone(),
                    facts: facts::of(environment.as_ref()),
                })?;
                self.measure(provider.as_ref(), environment, &request, quiet)
                    .await
            }
            Err(first) if self.keep.keeps(Outcome::Errored) => {
                self.keep_environment(&request)?;
                Err(first.into())
            }
            Err(first) => match self.remove_remains(provider.as_ref(), &request).await {
                Ok(()) => Err(first.into()),
                Err(Trouble::Journal(error)) => Err(error.into()),
                Err(second) => Err(Trouble::NotRemoved {
                    first,
                    second: Box::new(second),
                }),
            },
        }
    }

    /// The lease says that no other `matrix` works here; a workload whose `matrix` was killed may still measure, and
    /// two windows on one host disturb each other.
    async fn refuse_beside_another(&self, planned: &PlannedScenario) -> Result<(), Trouble> {
        let state = self.events.state();
        let own = state.scenario(&planned.slug).open.map(|open| open.environment);
        // Nothing is measured in a machine that was kept.
        let kept: BTreeSet<_> = state.scenarios.values().flat_map(|it| &it.kept).collect();
        let mut asked = Vec::new();
        let beside = |other: &&PlannedScenario| other.runs() && other.host == planned.host;
        for other in self.plan.scenarios.iter().filter(beside) {
            let provider = self.fleet.provider(other)?;
            if asked.contains(&provider.name()) {
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
                return Err(Trouble::StillMeasuring {
                    environment: running.resource.name,
                    run_directory: running.run_directory.unwrap_or_default(),
                });
            }
        }
        Ok(())
    }

    /// Refuses to begin on another machine than the scenario says, and what would fill a disk: that of the host, or this
    /// machine's with the run directory. Others may fill it yet.
    async fn check_host(&self, planned: &PlannedScenario, windows: usize) -> Result<(), Trouble> {
        let wanted = room::windows_take(&planned.settings, windows);
        let host = self.fleet.host(planned.host.as_deref().unwrap_or_default())?;
        let place = format!("host `{}`", host.name());
        let is_here = host.is_this_machine();
        let said = Keeper::new(Arc::clone(&host)).platform().await?;
        let (hardware, os) = (planned.axis(HARDWARE), planned.axis(OS));
        let claim = Claim {
            host: host.name(),
            hardware: hardware.as_deref(),
            os: os.as_deref(),
        };
        // What this machine is was known when the run was planned.
        if let Some(contradiction) = claim
            .contradiction(&said.platform.machine, &said.platform.os)
            .filter(|_| !is_here)
        {
            return Err(Trouble::AnotherHost(contradiction));
        }
        let there = said.free_bytes;
        let disk = rustix::fs::statvfs(self.directory.path()).map_err(io::Error::from)?;
        let here = disk.f_bavail.saturating_mul(disk.f_frsize);
        let run_directory = self.directory.path().display().to_string();
        for (place, free) in [(place, there), (run_directory, here)] {
            if free < wanted {
                return Err(Trouble::NoRoom {
                    place,
                    windows,
                    wanted,
                    free,
                });
            }
        }
        Ok(())
    }

    fn request(
        &self,
        planned: &PlannedScenario,
        environment: String,
        windows: Vec<u32>,
    ) -> EnvironmentRequest {
        EnvironmentRequest {
            environment,
            run: self.name.clone(),
            run_directory: self.directory.path().to_owned(),
            scenario: planned.slug.clone(),
            host: planned.host.clone().unwrap_or_default(),
            settings: planned.settings.clone(),
            windows,
        }
    }

    /// Goes on with an environment that an earlier process left; `None` when there was nothing to go on with.
    async fn take_up(
        &self,
        provider: &dyn Provider,
        request: &EnvironmentRequest,
    ) -> Result<Option<Ending>, Trouble> {
        let quiet = self.quiet(&request.host).await?;
        let Some(environment) = provider.find(request).await? else {
            self.remove_remains(provider, request).await?;
            return Ok(None);
        };
        self.events.emit(Event::EnvironmentFound {
            scenario: request.scenario.clone(),
            environment: request.environment.clone(),
            running: environment.running(),
        })?;
        self.measure(provider, environment, request, quiet)
            .await
            .map(Some)
    }

    /// Follows a workload to its end, collects what it measured and discards its environment.
    async fn measure(
        &self,
        provider: &dyn Provider,
        environment: Box<dyn Environment>,
        request: &EnvironmentRequest,
        quiet: Option<RwLockWriteGuard<'_, ()>>,
    ) -> Result<Ending, Trouble> {
        let mut environment = environment;
        let last = self.follow(provider, &mut environment, request).await?;
        let ended = environment.ended().await?;
        drop(quiet);
        self.collect(provider, environment.as_mut(), request).await?;
        let ending = self.ending(last, &ended, request);
        match self.keep.keeps(ending.outcome) {
            true => self.keep_environment(request)?,
            false => self.discard(environment, request).await?,
        }
        Ok(ending)
    }

    /// How an environment ended whose data was collected.
    fn ending(&self, last: Option<Progress>, ended: &Ended, request: &EnvironmentRequest) -> Ending {
        let state = self.events.scenario(&request.scenario);
        if state.wanted(request.settings.windows).is_empty() {
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

    fn keep_environment(&self, request: &EnvironmentRequest) -> Result<(), Trouble> {
        Ok(self.events.emit(Event::EnvironmentKept {
            scenario: request.scenario.clone(),
            environment: request.environment.clone(),
        })?)
    }

    /// Passes on what the workload says until it ends; its last conclusive line.
    async fn follow(
        &self,
        provider: &dyn Provider,
        environment: &mut Box<dyn Environment>,
        request: &EnvironmentRequest,
    ) -> Result<Option<Progress>, Trouble> {
        let mut last = None;
        let mut asked_to_stop = false;
        let mut reconnected = false;
        let mut told = Vec::new();
        loop {
            let progress = tokio::select! {
                progress = environment.next_progress() => progress,
                () = self.stop.requested(), if !asked_to_stop => {
                    asked_to_stop = true;
                    environment.stop().await?;
                    continue;
                }
            };
            match progress {
                // One that was found again says everything again.
                Ok(Some(progress)) if told.contains(&progress) => {}
                Ok(Some(progress)) => {
                    if !matches!(progress, Progress::Health { .. } | Progress::Notice { .. }) {
                        told.push(progress.clone());
                    }
                    self.events.emit(Event::Workload {
                        scenario: request.scenario.clone(),
                        progress: progress.clone(),
                    })?;
                    if matches!(
                        progress,
                        Progress::Finished | Progress::Stopped { .. } | Progress::Failed { .. }
                    ) {
                        last = Some(progress);
                    }
                }
                Ok(None) => return Ok(last),
                // An engine that was restarted forgets its listeners, not its containers: look once more.
                Err(error) if !reconnected => match provider.find(request).await {
                    Ok(Some(found)) => {
                        reconnected = true;
                        *environment = found;
                    }
                    Ok(None) | Err(_) => return Err(error.into()),
                },
                Err(error) => return Err(error.into()),
            }
        }
    }

    /// Copies the data into the run directory's own file system, then gives each window its place.
    async fn collect(
        &self,
        provider: &dyn Provider,
        environment: &mut dyn Environment,
        request: &EnvironmentRequest,
    ) -> Result<(), Trouble> {
        let _nothing_is_measured_here = self.this_machine.read().await;
        let folder = self
            .directory
            .scenario(&request.scenario)
            .join(format!("collecting-{}", request.environment));
        // What an interrupted collection left is only a copy: the originals are still in the environment.
        match fs::remove_dir_all(&folder) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error.into()),
            _ => {}
        }
        fs::create_dir_all(&folder)?;
        environment.collect(&folder).await?;
        self.keep_platform(provider, environment, request, &folder)?;
        let state = self.events.scenario(&request.scenario);
        let windows: Vec<u32> = request
            .windows
            .iter()
            .copied()
            .filter(|window| !state.collected.contains(window))
            .collect();
        let (scenario, environment) = (&request.scenario, &request.environment);
        let sorting = {
            let (directory, folder) = (self.directory.clone(), folder.clone());
            let (scenario, environment) = (scenario.clone(), environment.clone());
            move || collection::sort_windows(&directory, &scenario, &environment, &windows, &folder)
        };
        // Captures are compressed: other hosts are not to wait for that.
        let sorted = spawn_blocking(sorting).await.map_err(io::Error::other)??;
        for sorted in sorted {
            let (scenario, environment) = (scenario.clone(), environment.clone());
            self.events.emit(match sorted {
                Sorted::Whole { window, verdict } => Event::WindowCollected {
                    scenario,
                    environment,
                    window,
                    verdict,
                },
                Sorted::Broken { window, reason } => Event::WindowBroken {
                    scenario,
                    environment,
                    window,
                    reason,
                },
            })?;
        }
        fs::remove_dir_all(&folder)?;
        Ok(())
    }

    /// Writes the scenario's `environment.json`: what the provider knows and what the workload saw from inside, and
    /// puts the workload's `network.txt` beside it. That of
    /// an earlier environment, whose windows may count, stays under its own name.
    fn keep_platform(
        &self,
        provider: &dyn Provider,
        environment: &dyn Environment,
        request: &EnvironmentRequest,
        folder: &Path,
    ) -> Result<(), Trouble> {
        let record = EnvironmentRecord {
            environment: request.environment.clone(),
            provider: provider.name().to_owned(),
            host: request.host.clone(),
            facts: facts::of(environment),
            platform: read_json(&folder.join("environment.json")),
        };
        let path = self.directory.environment(&request.scenario);
        if let Some(EnvironmentRecord {
            environment: earlier, ..
        }) = read_json(&path)
            && earlier != request.environment
        {
            fs::rename(&path, path.with_file_name(format!("environment-{earlier}.json")))?;
            let network = path.with_file_name("network.txt");
            if network.exists() {
                fs::rename(&network, path.with_file_name(format!("network-{earlier}.txt")))?;
            }
        }
        let network = folder.join("network.txt");
        if network.exists() {
            fs::copy(&network, path.with_file_name("network.txt"))?;
        }
        let mut text = serde_json::to_vec_pretty(&record).map_err(io::Error::from)?;
        text.push(b'\n');
        Ok(fs::write(&path, text)?)
    }

    async fn discard(
        &self,
        environment: Box<dyn Environment>,
        request: &EnvironmentRequest,
    ) -> Result<(), Trouble> {
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
    ) -> Result<(), Trouble> {
        let ours = provider.resources(request);
        for leftover in provider.leftovers().await? {
            let of_this_run = leftover.run.as_deref() == Some(request.run.as_str());
            if of_this_run && ours.contains(&leftover.resource) {
                provider.remove(&leftover).await?;
            }
        }
        Ok(self.events.emit(Event::EnvironmentDiscarded {
            scenario: request.scenario.clone(),
            environment: request.environment.clone(),
        })?)
    }
}

#[cfg(test)]
mod tests;
