//! Where a run stands, from its journal alone. The main type is [`RunState`].

use std::collections::{BTreeMap, BTreeSet};

use record::{
    progress::Progress,
    run_directory::{Event, JournalEntry, Outcome, PlanRecord},
};

/// Where a run stands.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RunState {
    /// By slug; a scenario that was never started is not in it.
    pub scenarios: BTreeMap<String, ScenarioState>,
    /// Whether all scenarios have an outcome.
    pub finished: bool,
}

/// Where a scenario stands.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ScenarioState {
    /// How it ended, last time.
    pub outcome: Option<Outcome>,
    /// Why.
    pub reason: Option<String>,
    /// Windows that are whole in the run directory.
    pub collected: BTreeMap<u32, Collected>,
    /// Windows that the workload has completed, collected or not.
    pub completed: BTreeSet<u32>,
    /// The environment that was created, or was about to be, and is not known to be gone.
    pub open: Option<OpenEnvironment>,
    /// For how long nothing was heard of its workload when that was told last, in seconds.
    pub silent_for_s: Option<u64>,
    /// The environments that were kept, as it was wished, and are not known to be gone.
    pub kept: BTreeSet<String>,
    /// How many environments were begun.
    pub attempts: u32,
}

/// A window that is whole in the run directory.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Collected {
    /// The environment that measured it.
    pub environment: String,
    /// SHA-256 of its `window.json`, if it is known.
    pub sha256: Option<String>,
}

/// An environment that may exist.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OpenEnvironment {
    /// Its name.
    pub environment: String,
    /// The windows it is to measure.
    pub windows: Vec<u32>,
    /// Whether its data had been collected and its removal had begun: there is nothing more in it to go on with.
    pub discarding: bool,
}

impl RunState {
    /// Replays a journal.
    #[must_use]
    pub fn replay<'a>(entries: impl IntoIterator<Item = &'a JournalEntry>) -> Self {
        let mut state = Self::default();
        for entry in entries {
            state.apply(&entry.event);
        }
        state
    }

    /// Whether a scenario of the plan has no outcome, or was asked to stop.
    #[must_use]
    pub fn is_interrupted(&self, plan: &PlanRecord) -> bool {
        let running = plan.scenarios.iter().filter(|planned| planned.runs());
        let mut outcomes = running.map(|planned| self.scenario(&planned.slug).outcome);
        outcomes.any(|outcome| matches!(outcome, None | Some(Outcome::Interrupted)))
    }

    /// What the journal says of a scenario.
    #[must_use]
    pub fn scenario(&self, slug: &str) -> ScenarioState {
        self.scenarios.get(slug).cloned().unwrap_or_default()
    }

    /// Takes one more event into account.
    pub fn apply(&mut self, event: &Event) {
        match event {
            Event::RunStarted { .. } => self.finished = false,
            Event::RunFinished => self.finished = true,
            Event::RunInterrupted | Event::HostBusy { .. } | Event::EnvironmentCreated { .. } => {}
            Event::EnvironmentFound { .. } | Event::EnvironmentRecorded { .. } => {}
            Event::WorkloadSilent { scenario, for_s } => self.entry(scenario).silent_for_s = Some(*for_s),
            Event::WorkloadHeard { scenario, .. } => self.entry(scenario).silent_for_s = None,
            Event::WindowBroken { scenario, window, .. } => {
                let state = self.entry(scenario);
                state.completed.remove(window);
                // It had its place, and is to be measured again.
                if state.collected.remove(window).is_some() && state.outcome == Some(Outcome::Completed) {
                    state.outcome = None;
                }
            }
            Event::EnvironmentDiscarding {
                scenario,
                environment,
            } => {
                if let Some(open) = &mut self.entry(scenario).open {
                    open.discarding |= open.environment == *environment;
                }
            }
            Event::ScenarioStarted { scenario, .. } => {
                let state = self.entry(scenario);
                state.outcome = None;
                state.reason = None;
                state.silent_for_s = None;
            }
            Event::EnvironmentCreating {
                scenario,
                environment,
                windows,
                ..
            } => {
                let state = self.entry(scenario);
                state.attempts = state.attempts.saturating_add(1);
                state.open = Some(OpenEnvironment {
                    environment: environment.clone(),
                    windows: windows.clone(),
                    discarding: false,
                });
            }
            Event::Workload { scenario, progress } => {
                if let Progress::WindowComplete { window, .. } = progress {
                    self.entry(scenario).completed.insert(*window);
                }
            }
            Event::WindowCollected {
                scenario,
                environment,
                window,
                sha256,
                ..
            } => {
                let state = self.entry(scenario);
                // Where the journal does not have its creation: a name is never given twice.
                state.attempts = state.attempts.max(attempt(environment));
                let collected = Collected {
                    environment: environment.clone(),
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
                ..
            } => {
                let state = self.entry(scenario);
                state.outcome = Some(*outcome);
                state.reason.clone_from(reason);
            }
        }
    }

    fn entry(&mut self, slug: &str) -> &mut ScenarioState {
        self.scenarios.entry(slug.to_owned()).or_default()
    }
}

impl ScenarioState {
    fn close(&mut self, environment: &str) {
        if self
            .open
            .as_ref()
            .is_some_and(|open| open.environment == environment)
        {
            self.open = None;
        }
    }

    /// Whether there is nothing more to do: completed, or failed by the experiment's own word.
    #[must_use]
    pub fn is_settled(&self) -> bool {
        matches!(self.outcome, Some(Outcome::Completed | Outcome::Failed)) && self.open.is_none()
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

    /// The windows of `1..=windows` that are not in the run directory.
    #[must_use]
    pub fn wanted(&self, windows: u32) -> Vec<u32> {
        (1..=windows)
            .filter(|window| !self.collected.contains_key(window))
            .collect()
    }
}

/// The number at the end of an environment's name.
fn attempt(environment: &str) -> u32 {
    let number = environment.rsplit('-').next();
    number.and_then(|number| number.parse().ok()).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use record::{run_directory::PlannedScenario, window::Verdict};

    use super::*;

    fn journal(events: Vec<Event>) -> Vec<JournalEntry> {
        events
            .into_iter()
            .map(|event| JournalEntry {
                at: String::new(),
                event,
            })
            .collect()
    }

    fn creating(environment: &str, windows: Vec<u32>) -> Event {
        Event::EnvironmentCreating {
            scenario: "s".into(),
            environment: environment.into(),
            provider: "fake".into(),
            windows,
            resources: Vec::new(),
        }
    }

    #[test]
    fn an_environment_that_was_only_intended_is_still_open() {
        let state = RunState::replay(&journal(vec![creating("e-1", vec![1, 2])]));
        let open = state.scenario("s").open.unwrap();
        assert_eq!((open.environment.as_str(), open.windows), ("e-1", vec![1, 2]));
    }

    #[test]
    fn an_environment_whose_removal_began_has_nothing_more_to_go_on_with() {
        let discarding = Event::EnvironmentDiscarding {
            scenario: "s".into(),
            environment: "e-1".into(),
        };
        let state = RunState::replay(&journal(vec![creating("e-1", vec![1]), discarding]));
        assert!(state.scenario("s").open.unwrap().discarding);
    }

    #[test]
    fn collected_windows_are_not_wanted_again_and_a_discarded_environment_is_closed() {
        let state = RunState::replay(&journal(vec![
            creating("e-1", vec![1, 2, 3]),
            Event::WindowCollected {
                scenario: "s".into(),
                environment: "e-1".into(),
                window: 1,
                verdict: Verdict::Valid,
                sha256: None,
            },
            Event::EnvironmentDiscarded {
                scenario: "s".into(),
                environment: "e-1".into(),
            },
        ]));
        let scenario = state.scenario("s");
        assert_eq!(scenario.wanted(3), vec![2, 3]);
        assert_eq!(scenario.open, None);
        assert_eq!(scenario.attempts, 1);
    }

    #[test]
    fn a_run_is_interrupted_while_a_scenario_of_it_has_not_ended() {
        let scenario = |slug: &str| PlannedScenario {
            id: slug.to_owned(),
            slug: slug.to_owned(),
            axes: serde_json::Map::new(),
            host: None,
            feasible: slug != "infeasible",
            reason: None,
            fix: None,
            not_selected: None,
            simulated: false,
            settings: record::settings::Settings::default(),
        };
        let plan = PlanRecord {
            format: 1,
            scenarios: vec![scenario("s"), scenario("t"), scenario("infeasible")],
            order: Vec::new(),
            measuring_s: 1.0,
        };
        let finished = |slug: &str, outcome| Event::ScenarioFinished {
            scenario: slug.to_owned(),
            outcome,
            reason: None,
            hint: None,
        };
        let is_interrupted = |events| RunState::replay(&journal(events)).is_interrupted(&plan);
        assert!(is_interrupted(vec![finished("s", Outcome::Completed)]));
        for (outcome, interrupted) in [
            (Outcome::Interrupted, true),
            (Outcome::Completed, false),
            (Outcome::Errored, false),
        ] {
            let events = vec![finished("s", Outcome::Completed), finished("t", outcome)];
            assert_eq!(is_interrupted(events), interrupted, "{outcome:?}");
        }
    }

    #[test]
    fn a_scenario_with_an_open_environment_is_not_settled_whatever_its_outcome() {
        let finished = Event::ScenarioFinished {
            scenario: "s".into(),
            outcome: Outcome::Completed,
            reason: None,
            hint: None,
        };
        assert!(
            RunState::replay(&journal(vec![finished.clone()]))
                .scenario("s")
                .is_settled()
        );
        let state = RunState::replay(&journal(vec![creating("e-1", vec![1]), finished]));
        assert!(!state.scenario("s").is_settled());
    }
}
