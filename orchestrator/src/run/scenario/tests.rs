use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering},
};

use async_trait::async_trait;
use reports::run_directory::{FORMAT, PlanRecord, Resource, RunDirectory};
use tokio::sync::RwLock;
use workload::settings::Settings;

use super::*;
use crate::{
    host::{Here, Host, Program},
    journal::Journal,
    observer::{Events, Observer},
    provider::{Availability, Leftover},
    run::{Fleet, keep::Keep, state::RunState, stop::stop_switch},
    state_directory::StateDirectory,
};

/// A platform that refuses to create anything, and may be gone from then on.
#[derive(Clone)]
struct Refusing {
    vanishes: bool,
    gone: Arc<AtomicBool>,
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
impl Provider for Refusing {
    fn name(&self) -> &'static str {
        "refusing"
    }

    async fn survey(&self) -> Availability {
        Availability::Available {
            detail: String::new(),
        }
    }

    fn resources(&self, _: &EnvironmentRequest) -> Vec<Resource> {
        Vec::new()
    }

    async fn create(&self, _: &EnvironmentRequest) -> Result<Box<dyn Environment>, ProviderError> {
        self.gone.store(self.vanishes, Ordering::Relaxed);
        Err(refusal("creating", "no space left"))
    }

    async fn find(&self, _: &EnvironmentRequest) -> Result<Option<Box<dyn Environment>>, ProviderError> {
        Ok(None)
    }

    async fn shell(&self, _: &str) -> Result<Program, ProviderError> {
        Err(refusal("entering", "there is nothing"))
    }

    async fn leftovers(&self) -> Result<Vec<Leftover>, ProviderError> {
        match self.gone.load(Ordering::Relaxed) {
            true => Err(refusal("listing", "connection reset")),
            false => Ok(Vec::new()),
        }
    }

    async fn remove(&self, _: &Leftover) -> Result<(), ProviderError> {
        Ok(())
    }
}

/// This machine with that platform; its lease is the test's own.
struct Alone {
    platform: Refusing,
    folder: PathBuf,
}

impl Fleet for Alone {
    fn host(&self, name: &str) -> Result<Arc<dyn Host>, ProviderError> {
        let state = StateDirectory::new(&self.folder);
        Ok(Arc::new(Here::leased_at(name, state, self.folder.join("lease"))))
    }

    fn provider(&self, _: &PlannedScenario) -> Result<Arc<dyn Provider>, ProviderError> {
        Ok(Arc::new(self.platform.clone()))
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
        slug: "a-refusing".into(),
        axes: serde_json::Map::new(),
        host: Some("here".into()),
        feasible: true,
        reason: None,
        fix: None,
        not_selected: None,
        settings: Settings::default(),
    }
}

/// All events of a scenario on that platform.
async fn events(platform: Refusing) -> Vec<Event> {
    let folder = tempfile::tempdir().unwrap();
    let directory = RunDirectory::new(folder.path());
    let plan = PlanRecord {
        format: FORMAT,
        scenarios: vec![scenario()],
        order: vec!["a".into()],
        measuring_s: 1.0,
    };
    let journal = Journal::open(&directory.journal()).unwrap();
    let (keep, kept) = std::sync::mpsc::channel();
    let (_switch, stop) = stop_switch();
    let fleet = Alone {
        platform,
        folder: folder.path().to_owned(),
    };
    let run = Run {
        name: "r".into(),
        directory,
        plan: &plan,
        events: Events::new(journal, RunState::default(), vec![Box::new(Kept(keep))]),
        fleet: &fleet,
        stop,
        keep: Keep::Never,
        this_machine: RwLock::default(),
    };
    let mut lease = None;
    run.scenario(&plan.scenarios[0], &mut lease).await.unwrap();
    lease.unwrap().give_back().await;
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
    let events = events(Refusing {
        vanishes: false,
        gone: Arc::default(),
    })
    .await;
    assert!(discarded(&events), "{events:#?}");
    let (reason, hint) = ending(&events);
    assert_eq!(reason, "the engine refused creating: no space left");
    assert_eq!(hint, "mend creating");
}

#[tokio::test]
async fn when_removing_fails_too_the_first_failure_is_told_first() {
    let events = events(Refusing {
        vanishes: true,
        gone: Arc::default(),
    })
    .await;
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
