//! Observers: those who watch a run. Execution says what happens only as events; what a person sees of them, the
//! observers of [`crate::cli`] decide. The main types are [`Observer`] and [`Events`].

use std::sync::{Mutex, MutexGuard, PoisonError};

use record::run_directory::{Event, JournalEntry, RunState, ScenarioState};

use crate::journal::{self, Journal, JournalError};

/// Watches a run.
pub trait Observer: Send {
    /// Something happened. Must not block: a run waits for it.
    fn observe(&mut self, event: &Event);
}

/// The one way by which execution says what happens: the journal first, then those who watch. Hosts that are at work side
/// by side share it.
pub struct Events(Mutex<Sinks>);

/// What was said so far, and who is told.
struct Sinks {
    journal: Journal,
    state: RunState,
    observers: Vec<Box<dyn Observer>>,
}

impl Events {
    /// Goes on from `state`, which the journal's earlier lines gave.
    #[must_use]
    pub fn new(journal: Journal, state: RunState, observers: Vec<Box<dyn Observer>>) -> Self {
        Self(Mutex::new(Sinks {
            journal,
            state,
            observers,
        }))
    }

    fn sinks(&self) -> MutexGuard<'_, Sinks> {
        // An observer that panicked leaves the journal and the state whole.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Where the run stands after all that was said.
    #[must_use]
    pub fn state(&self) -> RunState {
        self.sinks().state.clone()
    }

    /// Where a scenario of it stands.
    #[must_use]
    pub fn scenario(&self, slug: &str) -> ScenarioState {
        self.sinks().state.scenario(slug)
    }

    /// Says that something happens, or is about to. It is on disk when this returns, but for the workload's health,
    /// which comes each second, and its notices, which come as often as strangers wish and are in the windows' records:
    /// the disk is left alone while a window is measured.
    ///
    /// # Errors
    /// When the journal cannot be written; the thing must then not be done.
    pub fn emit(&self, event: Event) -> Result<(), JournalError> {
        let sinks = &mut *self.sinks();
        let is_journaled = match &event {
            Event::Workload { progress, .. } => progress.is_journaled(),
            _ => true,
        };
        let entry = match is_journaled {
            true => sinks.journal.append(event)?,
            false => JournalEntry::new(journal::stamp(), event),
        };
        sinks.state.apply(&entry);
        for observer in &mut sinks.observers {
            observer.observe(&entry.event);
        }
        Ok(())
    }
}
