//! Observers: those who watch a run. Execution says what happens only as events; what a person sees of them is decided
//! here. The main types are [`Observer`] and [`Events`].

pub mod plain_log;
pub mod progress_bars;

use reports::run_directory::Event;
use workload::record::progress::Progress;

use crate::{
    journal::{Journal, JournalError},
    run::state::RunState,
};

/// Watches a run.
pub trait Observer: Send {
    /// Something happened. Must not block: a run waits for it.
    fn observe(&mut self, event: &Event);
}

/// The one way by which execution says what happens: the journal first, then those who watch.
pub struct Events {
    journal: Journal,
    state: RunState,
    observers: Vec<Box<dyn Observer>>,
}

impl Events {
    /// Goes on from `state`, which the journal's earlier lines gave.
    #[must_use]
    pub fn new(journal: Journal, state: RunState, observers: Vec<Box<dyn Observer>>) -> Self {
        Self {
            journal,
            state,
            observers,
        }
    }

    /// Where the run stands after all that was said.
    #[must_use]
    pub fn state(&self) -> &RunState {
        &self.state
    }

    /// Says that something happens, or is about to. It is on disk when this returns, but for the workload's health,
    /// which comes each second, and its notices, which come as often as strangers wish and are in the windows' records:
    /// the disk is left alone while a window is measured.
    ///
    /// # Errors
    /// When the journal cannot be written; the thing must then not be done.
    pub fn emit(&mut self, event: Event) -> Result<(), JournalError> {
        if !matches!(
            event,
            Event::Workload {
                progress: Progress::Health { .. } | Progress::Notice { .. },
                ..
            }
        ) {
            self.journal.append(event.clone())?;
        }
        self.state.apply(&event);
        for observer in &mut self.observers {
            observer.observe(&event);
        }
        Ok(())
    }
}
