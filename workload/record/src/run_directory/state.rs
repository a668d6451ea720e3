//! Where a run stands, from its journal alone. The main type is [`RunState`]: the one fold of the journal. What a command, a report or
//! a resumed run knows of a run beside its plan and its files, it knows from here.

use std::{
    collections::{BTreeMap, BTreeSet},
    ops::RangeInclusive,
};

use super::{Event, JobStanding, JournalEntry, Outcome, PlanRecord};
use crate::{progress::Progress, window::Verdict};

/// Where a run stands.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RunState {
    /// By slug; a scenario that was never started is not in it.
    pub scenarios: BTreeMap<String, ScenarioState>,
    /// Whether all scenarios have an outcome.
    pub finished: bool,
    /// SHA-256 of `manifest.json`, in hexadecimal; none in runs of earlier versions.
    pub manifest_sha256: Option<String>,
    /// That of `plan.json`.
    pub plan_sha256: Option<String>,
    /// Windows that broke and are kept, of all scenarios.
    broken_kept: usize,
}

/// Windows that broke and are kept with their reasons. Whoever reads the report of a run reads no more of them; a journal may have a
/// million, each with as many words as it likes.
const MOST_BROKEN: usize = 10_000;

/// Where a scenario stands.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ScenarioState {
    /// By their number; one that was never started is not in it.
    pub rounds: BTreeMap<u32, RoundState>,
    /// Windows that are whole in the run directory.
    pub collected: BTreeMap<u32, Collected>,
    /// Windows that the workload has completed, collected or not.
    pub completed: BTreeSet<u32>,
    /// When its environment last began to measure a window, RFC 3339; none while none is measured.
    pub measuring_since: Option<String>,
    /// For how long nothing was heard of its workload when that was told last, in seconds.
    pub silent_for_s: Option<u64>,
    /// The environments that were kept, as it was wished, and are not known to be gone.
    pub kept: BTreeSet<String>,
    /// How many environments were begun.
    pub attempts: u32,
    /// The providers of its environments.
    pub providers: BTreeSet<String>,
    /// Each environment that was made, in the order in which they were.
    pub made: Vec<MadeEnvironment>,
    /// Windows that broke, whether or not they were measured again: the first of them, where a run has very many.
    pub broken: Vec<BrokenWindow>,
    /// How many more broke.
    pub broken_beside: usize,
    /// SHA-256 of each environment's `environment.json`, as often as it was written, in hexadecimal: a crash may have left either.
    environments_recorded: BTreeMap<String, BTreeSet<String>>,
}

/// Where a scenario stands in one round, which has one environment of it, or several if the first was lost.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RoundState {
    /// Whether work on it ever began.
    pub started: bool,
    /// How it ended, last time; none while it is worked on, and where a window of it is to be measured again.
    pub outcome: Option<Outcome>,
    /// Why, if not completed.
    pub reason: Option<String>,
    /// What to do about it.
    pub hint: Option<String>,
    /// The environment that was created, or was about to be, and is not known to be gone.
    pub open: Option<OpenEnvironment>,
    /// The windows that were wanted of it.
    windows: BTreeSet<u32>,
}

/// A window that is whole in the run directory.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Collected {
    /// The environment that measured it.
    pub environment: String,
    /// Whether it counts.
    pub verdict: Verdict,
    /// SHA-256 of its `window.json`, if it is known.
    pub sha256: Option<String>,
}

/// An environment that was made, and when, RFC 3339.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MadeEnvironment {
    /// The environment's name.
    pub environment: String,
    /// When that began; none where the journal does not have it.
    pub begun: Option<String>,
    /// When it existed.
    pub done: String,
}

/// A window that broke, kept aside.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BrokenWindow {
    /// Its number.
    pub window: u32,
    /// The environment that measured it.
    pub environment: String,
    /// The reason, as `matrix status` prints it.
    pub reason: String,
}

/// An environment that may exist.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OpenEnvironment {
    /// The environment's name.
    pub environment: String,
    /// When its creation was announced, RFC 3339.
    pub begun: String,
    /// The windows it is to measure.
    pub windows: Vec<u32>,
    /// Whether its data had been collected and its removal had begun: there is nothing more in it to go on with.
    pub discarding: bool,
    /// Where its job stood when that was told last; none of one that is no job.
    pub job: Option<JobStanding>,
}

impl RunState {
    /// Replays a journal.
    #[must_use]
    pub fn replay<'a>(entries: impl IntoIterator<Item = &'a JournalEntry>) -> Self {
        let mut state = Self::default();
        for entry in entries {
            state.apply(entry);
        }
        state
    }

    /// Whether a scenario of the plan has a round without an outcome, or one that was asked to stop.
    #[must_use]
    pub fn is_interrupted(&self, plan: &PlanRecord) -> bool {
        let mut outcomes = self.outcomes(plan).into_iter();
        outcomes.any(|outcome| matches!(outcome, None | Some(Outcome::Interrupted)))
    }

    /// How the scenarios of the plan that run ended in each of their rounds.
    #[must_use]
    pub fn outcomes(&self, plan: &PlanRecord) -> Vec<Option<Outcome>> {
        let running = plan.scenarios.iter().filter(|planned| planned.runs());
        let outcomes = running.flat_map(|planned| {
            let state = self.scenario(&planned.slug);
            planned.rounds().map(move |round| state.round(round).outcome)
        });
        outcomes.collect()
    }

    /// What the journal says of a scenario.
    #[must_use]
    pub fn scenario(&self, slug: &str) -> ScenarioState {
        self.scenarios.get(slug).cloned().unwrap_or_default()
    }

    /// Takes one more event into account.
    pub fn apply(&mut self, JournalEntry { at, event }: &JournalEntry) {
        match event {
            Event::RunStarted {
                manifest_sha256,
                plan_sha256,
                ..
            } => {
                self.finished = false;
                self.manifest_sha256.clone_from(manifest_sha256);
                self.plan_sha256.clone_from(plan_sha256);
            }
            Event::RunFinished => self.finished = true,
            Event::RunLeft
            | Event::RunInterrupted
            | Event::HostBusy { .. }
            | Event::EnvironmentFound { .. } => {}
            Event::EnvironmentCreated {
                scenario,
                environment,
                ..
            } => self.entry(scenario).made(environment, at),
            Event::JobChanged {
                scenario,
                environment,
                standing,
            } => {
                let rounds = self.entry(scenario).rounds.values_mut();
                let open = rounds.filter_map(|round| round.open.as_mut());
                for open in open.filter(|open| open.environment == *environment) {
                    open.job = Some(standing.clone());
                }
            }
            Event::EnvironmentRecorded {
                scenario,
                environment,
                sha256,
            } => {
                let recorded = &mut self.entry(scenario).environments_recorded;
                let sha256s = recorded.entry(environment.clone()).or_default();
                sha256s.insert(sha256.clone());
            }
            Event::WorkloadSilent { scenario, for_s } => self.entry(scenario).silent_for_s = Some(*for_s),
            Event::WorkloadHeard { scenario, .. } => self.entry(scenario).silent_for_s = None,
            Event::WindowBroken {
                scenario,
                environment,
                window,
                reason,
            } => {
                let is_kept = self.broken_kept < MOST_BROKEN;
                self.broken_kept += usize::from(is_kept);
                let state = self.entry(scenario);
                state.lose(*window);
                if is_kept {
                    state.broken.push(BrokenWindow {
                        window: *window,
                        environment: environment.clone(),
                        reason: reason.clone(),
                    });
                } else {
                    state.broken_beside += 1;
                }
            }
            Event::EnvironmentDiscarding {
                scenario,
                environment,
            } => {
                let rounds = self.entry(scenario).rounds.values_mut();
                for open in rounds.filter_map(|round| round.open.as_mut()) {
                    open.discarding |= open.environment == *environment;
                }
            }
            Event::ScenarioStarted {
                scenario,
                windows,
                round,
            } => {
                let state = self.entry(scenario);
                state.silent_for_s = None;
                let round = state.entry(*round);
                round.started = true;
                round.outcome = None;
                round.reason = None;
                round.hint = None;
                round.windows.extend(windows);
            }
            Event::EnvironmentCreating {
                scenario,
                environment,
                provider,
                windows,
                round,
                ..
            } => {
                let state = self.entry(scenario);
                state.attempts = state.attempts.saturating_add(1);
                state.providers.insert(provider.clone());
                let round = state.entry(*round);
                round.windows.extend(windows);
                round.open = Some(OpenEnvironment {
                    environment: environment.clone(),
                    begun: at.clone(),
                    windows: windows.clone(),
                    discarding: false,
                    job: None,
                });
            }
            Event::Workload { scenario, progress } => {
                let state = self.entry(scenario);
                match progress {
                    Progress::Measuring { .. } => state.measuring_since = Some(at.clone()),
                    // The next window begins with it.
                    Progress::WindowComplete { window, .. } => {
                        state.completed.insert(*window);
                        state.measuring_since = Some(at.clone());
                    }
                    Progress::Stopped { .. } | Progress::Finished | Progress::Failed { .. } => {
                        state.measuring_since = None;
                    }
                    _ => {}
                }
            }
            Event::WindowCollected {
                scenario,
                environment,
                window,
                verdict,
                sha256,
            } => {
                let state = self.entry(scenario);
                // Where the journal does not have its creation: a name is never given twice.
                state.attempts = state.attempts.max(attempt(environment));
                let collected = Collected {
                    environment: environment.clone(),
                    verdict: *verdict,
                    sha256: sha256.clone(),
                };
                state.collected.insert(*window, collected);
            }
            Event::EnvironmentDiscarded {
                scenario,
                environment,
            } => self.entry(scenario).close(environment),
            Event::EnvironmentKept {
                scenario,
                environment,
            } => {
                let state = self.entry(scenario);
                state.close(environment);
                state.kept.insert(environment.clone());
            }
            Event::ScenarioFinished {
                scenario,
                outcome,
                reason,
                hint,
                round,
            } => {
                let state = self.entry(scenario);
                state.measuring_since = None;
                let round = state.entry(*round);
                round.outcome = Some(*outcome);
                round.reason.clone_from(reason);
                round.hint.clone_from(hint);
            }
        }
    }

    fn entry(&mut self, slug: &str) -> &mut ScenarioState {
        self.scenarios.entry(slug.to_owned()).or_default()
    }
}

impl ScenarioState {
    /// That of a round, by the number that the journal has; runs of one round have none there.
    fn entry(&mut self, round: Option<u32>) -> &mut RoundState {
        self.rounds.entry(round.unwrap_or(1)).or_default()
    }

    fn made(&mut self, environment: &str, at: &str) {
        let open = self.open().find(|open| open.environment == environment);
        let begun = open.map(|open| open.begun.clone());
        self.made.push(MadeEnvironment {
            environment: environment.to_owned(),
            begun,
            done: at.to_owned(),
        });
    }

    /// Takes a window out that is not in its place any more.
    pub fn lose(&mut self, window: u32) {
        self.completed.remove(&window);
        // It had its place, and is to be measured again.
        if self.collected.remove(&window).is_some() {
            self.reopen(window);
        }
    }

    /// A window is gone: the round that it was wanted of is not completed any more. Where the journal does not know which that is,
    /// none is taken for completed.
    fn reopen(&mut self, window: u32) {
        let known = self.rounds.values().any(|round| round.windows.contains(&window));
        for round in self.rounds.values_mut() {
            let is_it = !known || round.windows.contains(&window);
            if is_it && round.outcome == Some(Outcome::Completed) {
                round.outcome = None;
            }
        }
    }

    /// Windows that were collected and do not count.
    #[must_use]
    pub fn windows_invalid(&self) -> usize {
        let collected = self.collected.values();
        collected
            .filter(|window| window.verdict == Verdict::Invalid)
            .count()
    }

    /// SHA-256 of a collected window's `window.json`, in hexadecimal, if it is known.
    #[must_use]
    pub fn window_sha256(&self, window: u32) -> Option<&str> {
        self.collected.get(&window)?.sha256.as_deref()
    }

    /// Those that an `environment.json` may have; none if that is not known.
    pub fn environment_sha256s(&self) -> impl Iterator<Item = &str> + Clone {
        self.environments_recorded.values().flatten().map(String::as_str)
    }

    /// The environments of which an `environment.json` was written.
    pub fn environments_recorded(&self) -> impl Iterator<Item = &str> {
        self.environments_recorded.keys().map(String::as_str)
    }

    /// Whether a window of that environment was collected.
    #[must_use]
    pub fn has_windows_of(&self, environment: &str) -> bool {
        self.collected
            .values()
            .any(|window| window.environment == environment)
    }

    fn close(&mut self, environment: &str) {
        for round in self.rounds.values_mut() {
            round.open.take_if(|open| open.environment == environment);
        }
    }

    /// What the journal says of a round.
    #[must_use]
    pub fn round(&self, round: u32) -> RoundState {
        self.rounds.get(&round).cloned().unwrap_or_default()
    }

    /// The environments of all rounds that may exist.
    pub fn open(&self) -> impl Iterator<Item = &OpenEnvironment> {
        self.rounds.values().filter_map(|round| round.open.as_ref())
    }

    /// Whether there is nothing more to do in any of so many rounds.
    #[must_use]
    pub fn is_settled(&self, mut rounds: impl Iterator<Item = u32>) -> bool {
        rounds.all(|round| self.round(round).is_settled())
    }

    /// The windows that the workload has completed, collected or not.
    #[must_use]
    pub fn complete(&self) -> BTreeSet<u32> {
        self.completed
            .iter()
            .chain(self.collected.keys())
            .copied()
            .collect()
    }

    /// The window that an environment of it measures, and since when; none where the journal does not know of one.
    #[must_use]
    pub fn under_way(&self) -> Option<(u32, &str)> {
        let since = self.measuring_since.as_deref()?;
        let complete = self.complete();
        let mut windows = self.open().flat_map(|open| &open.windows);
        let window = windows.find(|window| !complete.contains(window))?;
        Some((*window, since))
    }

    /// Those of these windows that are not in the run directory.
    #[must_use]
    pub fn wanted(&self, windows: RangeInclusive<u32>) -> Vec<u32> {
        windows
            .filter(|window| !self.collected.contains_key(window))
            .collect()
    }
}

impl RoundState {
    /// Whether there is nothing more to do: completed, or failed by the experiment's own word.
    #[must_use]
    pub const fn is_settled(&self) -> bool {
        matches!(self.outcome, Some(Outcome::Completed | Outcome::Failed)) && self.open.is_none()
    }
}

/// The number at the end of an environment's name.
fn attempt(environment: &str) -> u32 {
    let number = environment.rsplit('-').next();
    number.and_then(|number| number.parse().ok()).unwrap_or(0)
}

#[cfg(test)]
mod tests;
