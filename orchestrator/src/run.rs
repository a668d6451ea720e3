//! Execution: a plan's scenarios one after another on this machine, each journaled before it touches anything. The
//! main type is [`Run`].
//!
//! ```text
//! lease the host -> for each scenario: create, follow, collect, discard -> run directory
//! ```
//!
//! A run and a resumed run are the same thing: [`Run::execute`] looks at what the journal says of each scenario and
//! does what is left to do.

pub mod collection;
mod compression;
pub mod record;
pub mod register;
pub mod scenario;
pub mod session;
pub mod state;
pub mod stop;

use std::sync::Arc;

use reports::run_directory::{Event, Outcome, PlanRecord, RunDirectory};

use crate::{
    journal::JournalError,
    lease::{self, Asked, Holder, Lease, LeaseError},
    observer::Events,
    provider::{Provider, ProviderError},
};
use stop::Stop;

/// A run that cannot go on. What happened to single scenarios is in the journal, not here.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The journal cannot be written.
    #[error(transparent)]
    Journal(#[from] JournalError),
    /// The host's lease cannot be asked for.
    #[error(transparent)]
    Lease(#[from] LeaseError),
}

impl RunError {
    /// What to do about it.
    #[must_use]
    pub fn hint(&self) -> Option<String> {
        match self {
            Self::Journal(error) => Some(error.hint()),
            Self::Lease(_) => Some("set MATRIX_LEASE to a file that you may write to".to_owned()),
        }
    }
}

/// Gives each scenario its provider: the production one, or a test's.
pub type Choose<'a> =
    &'a (dyn Fn(&reports::run_directory::PlannedScenario) -> Result<Arc<dyn Provider>, ProviderError> + Sync);

/// One plan being carried out.
pub struct Run<'a> {
    /// The run's name.
    pub name: String,
    /// Where everything goes; absolute.
    pub directory: RunDirectory,
    /// What is to be done.
    pub plan: &'a PlanRecord,
    /// Who is told.
    pub events: Events,
    /// Which provider a scenario gets.
    pub choose: Choose<'a>,
    /// The wish to stop.
    pub stop: Stop,
}

impl Run<'_> {
    /// Does what is left to do. Says how each scenario ended in the journal.
    ///
    /// # Errors
    /// When the run cannot go on at all.
    pub async fn execute(&mut self, resumed: bool) -> Result<(), RunError> {
        self.events.emit(Event::RunStarted {
            pid: std::process::id(),
            resumed,
        })?;
        let Some(_lease) = self.lease_host().await? else {
            return Ok(self.events.emit(Event::RunInterrupted)?);
        };
        let plan = self.plan;
        let ordered = plan
            .order
            .iter()
            .filter_map(|id| plan.scenarios.iter().find(|planned| planned.id == *id));
        for planned in ordered.filter(|planned| planned.runs()) {
            if self.events.state().scenario(&planned.slug).is_settled() {
                continue;
            }
            if self.stop.is_requested() {
                break;
            }
            self.scenario(planned).await?;
        }
        let interrupted = self.stop.is_requested()
            || self
                .events
                .state()
                .scenarios
                .values()
                .any(|s| s.outcome == Some(Outcome::Interrupted));
        Ok(self.events.emit(if interrupted {
            Event::RunInterrupted
        } else {
            Event::RunFinished
        })?)
    }

    /// Waits for this machine; `None` when asked to stop meanwhile.
    async fn lease_host(&mut self) -> Result<Option<Lease>, RunError> {
        let holder = Holder::this_process(self.directory.path());
        let (told, queue) = match lease::ask(&lease::of_this_machine(), &holder)? {
            Asked::Granted(lease) => return Ok(Some(lease)),
            Asked::Held { holder, queue } => (holder, queue),
        };
        let holder_words = told.map_or_else(|| "another process".to_owned(), |told| told.to_string());
        self.events.emit(Event::HostBusy {
            host: "this machine".to_owned(),
            holder: holder_words,
        })?;
        let waiting = tokio::task::spawn_blocking(move || queue.wait(&holder));
        tokio::select! {
            granted = waiting => match granted {
                Ok(lease) => Ok(Some(lease?)),
                // The waiting thread can only end so if the runtime is being torn down.
                Err(_) => Ok(None),
            },
            () = self.stop.requested() => Ok(None),
        }
    }
}
