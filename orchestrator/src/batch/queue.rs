//! What was last seen of a cluster's queue, for all who wait for a job of it. The main type is [`Queue`].
//!
//! A cluster is asked once for all jobs, and not more often than its users are used to: sites block those who ask all the time.

use std::{sync::Arc, time::Duration};

use record::causes::with_causes;
use tokio::{
    sync::{Mutex, watch},
    time::{Instant, sleep_until},
};

use super::{BatchSystem, Job};
use crate::provider::ProviderError;

/// How much longer than an answer took is waited until the next question.
const TIMES_THE_ANSWER: u32 = 5;
/// A cluster that does not answer is asked again after pauses that grow up to this.
const LONGEST_PAUSE: Duration = Duration::from_secs(300);

/// All jobs of this user, as they were at some time.
#[derive(Debug, Clone)]
pub struct Snapshot {
    /// When the question was asked.
    pub asked: Instant,
    /// The jobs; of the last answer, where there was none.
    pub jobs: Vec<Job>,
    /// Why there was no answer, if there was none. That says nothing of the jobs.
    pub silence: Option<String>,
}

impl Snapshot {
    /// The job of that name: the last one submitted, of several.
    #[must_use]
    pub fn job(&self, name: &str) -> Option<&Job> {
        self.jobs.iter().rev().find(|job| job.name == name)
    }
}

/// Asks for all jobs, for all who want to know.
pub struct Queue {
    system: Arc<dyn BatchSystem>,
    last: Arc<watch::Sender<Option<Last>>>,
    /// Held by the one who asks.
    asking: Arc<Mutex<()>>,
    /// What was asked before is no longer so.
    outdated: watch::Sender<Option<Instant>>,
}

#[derive(Clone)]
struct Last {
    snapshot: Arc<Snapshot>,
    /// How long the answer took.
    took: Duration,
    /// How many questions in a row were not answered.
    unanswered: u32,
}

impl Last {
    fn of(asked: Instant, answer: Result<Vec<Job>, ProviderError>, before: Option<Self>) -> Self {
        let (unanswered, jobs) =
            before.map_or((0, Vec::new()), |it| (it.unanswered, it.snapshot.jobs.clone()));
        let (unanswered, jobs, silence) = match answer {
            Ok(jobs) => (0, jobs, None),
            Err(error) => (unanswered.saturating_add(1), jobs, Some(with_causes(&error))),
        };
        Self {
            snapshot: Arc::new(Snapshot { asked, jobs, silence }),
            took: asked.elapsed(),
            unanswered,
        }
    }

    /// When the next question may be asked.
    fn next(&self, apart: Duration) -> Instant {
        let apart = match self.unanswered {
            0 => apart.max(self.took * TIMES_THE_ANSWER),
            times => apart
                .saturating_mul(1 << times.min(10))
                .min(LONGEST_PAUSE.max(apart)),
        };
        self.snapshot.asked + apart
    }
}

impl Queue {
    /// Of which nothing has been seen.
    #[must_use]
    pub fn new(system: Arc<dyn BatchSystem>) -> Self {
        Self {
            system,
            last: Arc::new(watch::Sender::new(None)),
            asking: Arc::default(),
            outdated: watch::Sender::new(None),
        }
    }

    /// What the queue was after `since`. The cluster is asked only if nobody has asked since then, and `apart` from the question
    /// before; who is in more of a hurry asks earlier, for all. Cancel-safe: the question goes on, and its answer is for who asks next.
    pub async fn after(&self, since: Instant, apart: Duration) -> Arc<Snapshot> {
        let mut last = self.last.subscribe();
        let since = self
            .outdated
            .borrow()
            .map_or(since, |outdated| since.max(outdated));
        loop {
            let due = match last.borrow_and_update().as_ref() {
                Some(seen) if seen.snapshot.asked > since => return Arc::clone(&seen.snapshot),
                Some(seen) => seen.next(apart),
                None => Instant::now(),
            };
            tokio::select! {
                () = sleep_until(due) => {}
                // Its sender lives as long as this.
                _ = last.changed() => continue,
            }
            let turn = Arc::clone(&self.asking).lock_owned().await;
            if last.has_changed().unwrap_or(false) {
                continue;
            }
            let (system, sender) = (Arc::clone(&self.system), Arc::clone(&self.last));
            let asking = tokio::spawn(async move {
                let _turn = turn;
                let asked = Instant::now();
                let answer = system.jobs().await;
                let before = sender.borrow().clone();
                sender.send_replace(Some(Last::of(asked, answer, before)));
            });
            // It ends before its answer only with the whole program.
            let _ = asking.await;
        }
    }

    /// A job was taken back, or has ended and its folder is gone: who asks from now on is not told that it is there.
    pub fn outdate(&self) {
        self.outdated.send_replace(Some(Instant::now()));
    }

    /// What the queue is now, for what cannot wait: whether a job is there before it is submitted once more, or after it was taken
    /// back.
    ///
    /// # Errors
    /// When the cluster does not answer.
    pub async fn now(&self) -> Result<Vec<Job>, ProviderError> {
        self.system.jobs().await
    }
}
