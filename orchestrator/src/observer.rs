//! Observers: those who watch a run. Execution says what happens only as events; what a person sees of them, the
//! observers of [`crate::cli`] decide. The main types are [`Observer`] and [`Events`].

use std::sync::{Mutex, MutexGuard, PoisonError};

use record::{progress::Progress, run_directory::Event};

use crate::{
    journal::{Journal, JournalError},
    run::state::{RunState, ScenarioState},
};

/// Watches a run.
pub trait Observer: Send {
    /// Something happened. Must not block: a run waits for it.
    fn observe(&mut self, event: &Event);
}

/// The one way by which execution says what happens: the journal first, then those who watch. Hosts that are at work side
/// by side share it.
pub struct Events(Mutex<Told>);

/// What was said so far, and who is to be told.
struct Told {
    journal: Journal,
    state: RunState,
    observers: Vec<Box<dyn Observer>>,
}

impl Events {
    /// Goes on from `state`, which the journal's earlier lines gave.
    #[must_use]
    pub fn new(journal: Journal, state: RunState, observers: Vec<Box<dyn Observer>>) -> Self {
        Self(Mutex::new(Told {
            journal,
            state,
            observers,
        }))
    }

    fn told(&self) -> MutexGuard<'_, Told> {
        // An observer that panicked leaves the journal and the state whole.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Where the run stands after all that was said.
    #[must_use]
    pub fn state(&self) -> RunState {
        self.told().state.clone()
    }

    /// Where a scenario of it stands.
    #[must_use]
    pub fn scenario(&self, slug: &str) -> ScenarioState {
        self.told().state.scenario(slug)
    }

    /// Says that something happens, or is about to. It is on disk when this returns, but for the workload's health,
    /// which comes each second, and its notices, which come as often as strangers wish and are in the windows' records:
    /// the disk is left alone while a window is measured.
    ///
    /// # Errors
    /// When the journal cannot be written; the thing must then not be done.
    pub fn emit(&self, event: Event) -> Result<(), JournalError> {
        let told = &mut *self.told();
        if !matches!(
            event,
            Event::Workload {
                progress: Progress::Health { .. } | Progress::Notice { .. },
                ..
            }
        ) {
            told.journal.append(event.clone())?;
        }
        told.state.apply(&event);
        for observer in &mut told.observers {
            observer.observe(&event);
        }
        Ok(())
    }
}
