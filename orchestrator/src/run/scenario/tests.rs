use std::{
    collections::VecDeque,
    path::{Path, PathBuf},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

use async_trait::async_trait;
use record::{
    run_directory::{FORMAT, PlanRecord, Resource, RunDirectory, RunState},
    settings::Settings,
    window::Verdict,
};
use serde_json::{Map, Value};
use tokio::sync::RwLock;

use super::*;
use crate::{
    host::{Here, Host, Program},
    journal::Journal,
    observer::{Events, Observer},
    provider::{Availability, Fleet, Leftover, ProviderError, ShellRequest},
    run::{keep::Keep, stop::stop_switch},
    state_directory::StateDirectory,
};

type Made = Result<Box<dyn Environment>, ProviderError>;

/// A platform that does as the test says when it is asked for an environment, for the one that there was, and for leftovers.
struct Scripted {
    create: Box<dyn Fn() -> Made + Send + Sync>,
    find: fn() -> Option<Box<dyn Environment>>,
    leftovers: Box<dyn Fn() -> Result<Vec<Leftover>, ProviderError> + Send + Sync>,
}

/// One that refuses to create anything, and may be gone from then on.
fn refusing(vanishes: bool) -> Scripted {
    let gone = Arc::new(AtomicBool::new(false));
    let is_gone = Arc::clone(&gone);
    Scripted {
        create: Box::new(move || {
            gone.store(vanishes, Ordering::Relaxed);
            Err(refusal("creating", "no space left"))
        }),
        find: || None,
        leftovers: Box::new(move || match is_gone.load(Ordering::Relaxed) {
            true => Err(refusal("listing", "connection reset")),
            false => Ok(Vec::new()),
        }),
    }
}

/// One whose environments complete a window and give nothing out at first, as a container that somebody removes.
fn emptied(found: fn() -> Option<Box<dyn Environment>>) -> Scripted {
    Scripted {
        create: Box::new(|| Ok(AfterOneWindow::that_is_empty(true))),
        find: found,
        leftovers: Box::new(|| Ok(Vec::new())),
    }
}

fn refusal(action: &str, cause: &str) -> ProviderError {
    ProviderError::Refused {
        platform: "the engine".to_owned(),
        action: action.to_owned(),
        hint: Some(format!("mend {action}")),
        source: cause.into(),
    }
}

#[async_trait]
impl Provider for Scripted {
    fn name(&self) -> &'static str {
        "scripted"
    }

    async fn survey(&self) -> Availability {
        Availability::Available {
            detail: String::new(),
        }
    }

    fn resources(&self, _: &EnvironmentRequest) -> Vec<Resource> {
        Vec::new()
    }

    async fn create(&self, _: &EnvironmentRequest) -> Made {
        (self.create)()
    }

    async fn find(&self, _: &EnvironmentRequest) -> Result<Option<Box<dyn Environment>>, ProviderError> {
        Ok((self.find)())
    }

    async fn shell(&self, _: &ShellRequest<'_>) -> Result<Program, ProviderError> {
        Err(refusal("entering", "there is nothing"))
    }

    async fn leftovers(&self) -> Result<Vec<Leftover>, ProviderError> {
        (self.leftovers)()
    }

    async fn remove(&self, _: &Leftover) -> Result<(), ProviderError> {
        Ok(())
    }
}

/// An environment whose workload completed a window and was killed.
struct AfterOneWindow {
    lines: VecDeque<Progress>,
    /// Whether it gives nothing out.
    is_empty: bool,
}

impl AfterOneWindow {
    fn that_is_empty(is_empty: bool) -> Box<dyn Environment> {
        let verdict = Verdict::Valid;
        Box::new(Self {
            lines: VecDeque::from([Progress::WindowComplete {
                window: 1,
                verdict,
                reason: None,
            }]),
            is_empty,
        })
    }
}

#[async_trait]
impl Environment for AfterOneWindow {
    fn facts(&self) -> Map<String, Value> {
        Map::new()
    }

    fn running(&self) -> bool {
        false
    }

    async fn next_progress(&mut self) -> Result<Option<Progress>, ProviderError> {
        Ok(self.lines.pop_front())
    }

    async fn stop(&mut self) -> Result<(), ProviderError> {
        Ok(())
    }

    async fn ended(&mut self) -> Result<Ended, ProviderError> {
        Ok(Ended::failed("killed by signal 9"))
    }

    async fn collect(&mut self, into: &Path) -> Result<(), ProviderError> {
        if !self.is_empty {
            // That it is no whole window is found out where windows are sorted.
            std::fs::create_dir(into.join("window-1")).unwrap();
        }
        Ok(())
    }

    async fn discard(self: Box<Self>) -> Result<(), ProviderError> {
        Ok(())
    }
}

/// This machine with that platform; its lease is the test's own.
struct Alone {
    platform: Arc<dyn Provider>,
    folder: PathBuf,
}

impl Fleet for Alone {
    fn host(&self, name: &str) -> Result<Arc<dyn Host>, ProviderError> {
        let state = StateDirectory::new(&self.folder);
        Ok(Arc::new(Here::leased_at(name, state, self.folder.join("lease"))))
    }

    fn provider(&self, _: &PlannedScenario, _: &str) -> Result<Arc<dyn Provider>, ProviderError> {
        Ok(Arc::clone(&self.platform))
    }
}

/// Keeps what happened for the test.
struct Kept(std::sync::mpsc::Sender<Event>);

impl Observer for Kept {
    fn observe(&mut self, event: &Event) {
        self.0.send(event.clone()).unwrap();
    }
}

fn scenario() -> PlannedScenario {
    PlannedScenario {
        id: "a".into(),
        slug: "a-scripted".into(),
        axes: Map::new(),
        host: Some("here".into()),
        pool: Vec::new(),
        feasible: true,
        reason: None,
        fix: None,
        not_selected: None,
        simulated: false,
        settings: Settings::default(),
    }
}

/// All events of a scenario on that platform.
async fn events(platform: impl Provider + 'static) -> Vec<Event> {
    let folder = tempfile::tempdir().unwrap();
    let directory = RunDirectory::new(folder.path());
    let plan = PlanRecord {
        format: FORMAT,
        scenarios: vec![scenario()],
        order: vec!["a".into()],
        later_rounds: Vec::new(),
        measuring_s: 1.0,
    };
    let journal = Journal::open(&directory.journal()).unwrap();
    let (keep, kept) = std::sync::mpsc::channel();
    let (_switch, stop) = stop_switch();
    let fleet = Alone {
        platform: Arc::new(platform),
        folder: folder.path().to_owned(),
    };
    let run = Run {
        name: "r".into(),
        directory,
        plan: &plan,
        files: None,
        events: Events::new(journal, RunState::default(), vec![Box::new(Kept(keep))]),
        fleet: &fleet,
        stop,
        keep: Keep::Never,
        patience: Patience::default(),
        this_machine: RwLock::default(),
    };
    let turn = Turn::on_host();
    let unit = Unit {
        planned: &plan.scenarios[0],
        round: 1,
    };
    run.unit(unit, &turn).await.unwrap();
    turn.end().await;
    drop(run);
    kept.iter().collect()
}

fn ending(events: &[Event]) -> (String, String) {
    match events.last().unwrap() {
        Event::ScenarioFinished {
            outcome: Outcome::Errored,
            reason: Some(reason),
            hint: Some(hint),
            ..
        } => (reason.clone(), hint.clone()),
        other => panic!("{other:?}"),
    }
}

fn discarded(events: &[Event]) -> bool {
    let discarded = |event: &Event| matches!(event, Event::EnvironmentDiscarded { .. });
    events.iter().any(discarded)
}

#[tokio::test]
async fn an_environment_that_could_not_be_created_is_removed() {
    let events = events(refusing(false)).await;
    assert!(discarded(&events), "{events:#?}");
    let (reason, hint) = ending(&events);
    assert_eq!(reason, "the engine refused creating: no space left");
    assert_eq!(hint, "mend creating");
}

#[tokio::test]
async fn when_removing_fails_too_the_first_failure_is_told_first() {
    let events = events(refusing(true)).await;
    assert!(
        !discarded(&events),
        "what is left must be found by a resume: {events:#?}"
    );
    let (reason, hint) = ending(&events);
    assert_eq!(
        reason,
        "the engine refused creating: no space left; what there was of the environment could not be removed: the \
         engine refused listing: connection reset"
    );
    assert_eq!(hint, "mend creating; `matrix clean` removes what is left");
}

#[tokio::test]
async fn an_environment_that_does_not_give_out_a_window_it_measured_is_not_removed() {
    let events = events(emptied(|| Some(AfterOneWindow::that_is_empty(true)))).await;
    assert!(!discarded(&events), "the window may be in it: {events:#?}");
    let (reason, hint) = ending(&events);
    assert_eq!(
        reason,
        "the environment did not give out every measured window; missing: 1"
    );
    assert!(
        hint.contains("`matrix resume`") && hint.contains("`matrix clean`"),
        "{hint}"
    );
}

#[tokio::test]
async fn what_is_found_of_an_environment_afterwards_is_asked_for_the_window_once_more() {
    let events = events(emptied(|| Some(AfterOneWindow::that_is_empty(false)))).await;
    let broken = |event: &Event| matches!(event, Event::WindowBroken { window: 1, .. });
    assert!(events.iter().any(broken), "{events:#?}");
    assert!(discarded(&events), "{events:#?}");
}
