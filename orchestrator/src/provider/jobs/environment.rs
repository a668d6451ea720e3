//! An environment that a job measures, seen from where it was submitted. The main type is [`JobEnvironment`].

use std::{
    path::Path,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use async_trait::async_trait;
use record::{
    connection::Slurm,
    detached::{self, Failure, Looked},
    progress::Progress,
    run_directory::{JobStanding, Standing, fact},
};
use serde_json::{Map, Value};
use tokio::time::{Instant, sleep_until};

use super::{Memory, end};
use crate::{
    batch::{Cluster, Job},
    provider::{
        Ended, Environment, EnvironmentRequest, News, ProviderError,
        backoff::{Backoff, retried},
        data_folder::Allowance,
        detached::{AgentClient, transfer},
        lines::Lines,
    },
};

/// How often a job that was asked to end is looked at. Somebody waits for it.
const ENDING: Duration = Duration::from_secs(1);
/// How long a batch system may take to say what became of a job that has ended.
const OVER_WITHIN: Duration = Duration::from_secs(60);
/// Why a job waits whose node is down, drained or reserved.
const NODE_GONE: &str = "ReqNodeNotAvail";
/// Characters of what a job says of its end.
const MOST_WORDS: usize = 1000;
/// Whoever runs the cluster could fill the journal with changes of a job's state.
const MOST_CHANGES: u32 = 200;

/// What an environment needs of its provider.
pub struct Parts {
    /// What is called on the submit host.
    pub agent: Arc<AgentClient>,
    /// Where the job is.
    pub cluster: Arc<Cluster>,
    /// How the nodes are asked for.
    pub slurm: Slurm,
    /// What the provider has learnt.
    pub(super) memory: Arc<Mutex<Memory>>,
}

/// An environment of a job.
pub struct JobEnvironment {
    parts: Parts,
    environment: String,
    allowance: Allowance,
    facts: Map<String, Value>,
    /// Where its job stood when it was submitted or found.
    job: JobStanding,
    /// When the queue was looked at last.
    seen: Instant,
    /// When the folder was.
    seen_folder: Instant,
    /// The job as the queue had it last.
    latest: Option<Job>,
    told: Option<JobStanding>,
    changes: u32,
    lines: Lines,
    /// How many bytes of its lines have come.
    received: u64,
    looked: Option<Looked>,
    /// Since when its job is over without a word of how its workload ended, and how the job is.
    over: Option<(Instant, Over)>,
    /// Whether these are all the lines there will ever be.
    complete: bool,
    asked_to_stop: bool,
    backoff: Backoff,
    last_line: Option<Progress>,
}

/// How a job is over.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Over {
    how: String,
    lost_its_node: bool,
}

impl JobEnvironment {
    /// That of this request; with what explains it, and where its job stands.
    #[must_use]
    pub fn new(
        parts: Parts,
        request: &EnvironmentRequest,
        facts: Map<String, Value>,
        job: JobStanding,
    ) -> Self {
        Self {
            parts,
            environment: request.environment.clone(),
            allowance: Allowance::of(request),
            facts,
            job,
            seen: Instant::now(),
            seen_folder: Instant::now(),
            latest: None,
            told: None,
            changes: 0,
            lines: Lines::default(),
            received: 0,
            looked: None,
            over: None,
            complete: false,
            asked_to_stop: false,
            backoff: Backoff::default(),
            last_line: None,
        }
    }

    fn remembered(&self) -> MutexGuard<'_, Memory> {
        // It is whole whenever the lock is free, also after a panic.
        self.parts.memory.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// How far apart the cluster is asked.
    fn apart(&self) -> Duration {
        match self.asked_to_stop {
            true => ENDING,
            false => self.parts.slurm.poll.duration(),
        }
    }

    /// Looks at the queue and at the folder once more; where the job stands, if that is new.
    async fn take_in(&mut self) -> Result<Option<JobStanding>, ProviderError> {
        self.backoff.pause().await;
        // What the job writes does not wait for a cluster that does not answer.
        let snapshot = tokio::select! {
            snapshot = self.parts.cluster.queue.after(self.seen, self.apart()) => snapshot,
            () = sleep_until(self.seen_folder + self.apart() * 2) => {
                if self.looked.is_some() {
                    self.look().await?;
                }
                self.seen_folder = Instant::now();
                return Ok(None);
            }
        };
        let job = snapshot.job(&self.environment).cloned();
        if job.is_some() {
            self.latest.clone_from(&job);
        }
        let begun = self.looked.as_ref().is_some_and(|looked| looked.job.is_some());
        let waits = job
            .as_ref()
            .is_some_and(|job| matches!(job.standing, Standing::Waits | Standing::WaitsForEver));
        // The folder of a job that waits says nothing.
        if !waits || begun {
            self.look().await?;
        }
        self.seen = snapshot.asked;
        self.seen_folder = Instant::now();
        if self.complete {
            return Ok(None);
        }
        match (&job, &snapshot.silence) {
            // It says nothing of the job.
            (None, Some(_)) => {}
            (job, _) => self.judge(job.as_ref()).await?,
        }
        Ok(job.and_then(|job| self.news(&job)))
    }

    /// Reads what the job has written by now.
    async fn look(&mut self) -> Result<(), ProviderError> {
        loop {
            let (looked, lines) = self.parts.agent.look(&self.environment, self.received).await?;
            self.received += lines.len() as u64;
            self.lines.push(&lines);
            if let Some(job) = &looked.job {
                self.facts
                    .insert(fact::NODE.to_owned(), Value::String(job.node.clone()));
            }
            if let Some(engine) = &looked.engine {
                let known = [
                    (fact::ENGINE_VERSION, &engine.version),
                    (fact::IMAGE_ID, &engine.image_id),
                ];
                let known = known.map(|(name, value)| (name.to_owned(), Value::String(value.clone())));
                self.facts.extend(known);
            }
            let there_is_more = !lines.is_empty();
            let has_ended = looked.ended.is_some();
            self.looked = Some(looked);
            // Those that have come are passed on first.
            if !there_is_more || !has_ended {
                self.complete = has_ended;
                return Ok(());
            }
        }
    }

    /// Why the job ended without a workload, in its own words: its node is another than the file says, or lacks what it needs.
    fn refusal(&self) -> Option<Failure> {
        let looked = self.looked.as_ref().filter(|looked| looked.ended.is_none())?;
        let last = looked
            .last_words
            .lines()
            .rev()
            .find(|line| !line.trim().is_empty())?;
        serde_json::from_str(last).ok()
    }

    /// What the state of the job means for the environment.
    async fn judge(&mut self, job: Option<&Job>) -> Result<(), ProviderError> {
        let over = match job.map(|job| (job, job.standing)) {
            Some((job, Standing::Waits)) => match self.waits_for_a_lost_node(job) {
                Some(node) => {
                    self.parts.cluster.system.cancel(&job.id).await?;
                    Some(Over {
                        how: format!(
                            "job {} waited for node {node}, which is not there any more",
                            job.id
                        ),
                        lost_its_node: true,
                    })
                }
                None => None,
            },
            Some((job, Standing::Runs)) => {
                if self.asked_to_stop && self.looked.is_none() {
                    // It began while it was taken back.
                    self.parts.cluster.system.stop(&job.id).await?;
                }
                None
            }
            Some((job, Standing::WaitsForEver)) => {
                self.parts.cluster.system.cancel(&job.id).await?;
                let reason = job.reason.as_deref().unwrap_or("it is not said why");
                Some(Over {
                    how: format!("job {} would never run: {reason}", job.id),
                    lost_its_node: false,
                })
            }
            Some((job, standing)) => {
                let lost_its_node = standing == Standing::LostItsNode;
                if let (true, Some(node)) = (lost_its_node, &job.node) {
                    self.remembered().lost.insert(node.clone());
                }
                let reason = job.reason.as_ref().map(|reason| format!(" ({reason})"));
                let node = job.node.as_ref().map(|node| format!(" on {node}"));
                Some(Over {
                    how: format!(
                        "job {}{} ended as {}{}",
                        job.id,
                        node.unwrap_or_default(),
                        job.state,
                        reason.unwrap_or_default()
                    ),
                    lost_its_node,
                })
            }
            None => Some(Over {
                how: format!(
                    "the batch system does not know the job {} any more, and it left no word of its end",
                    self.job.job
                ),
                lost_its_node: false,
            }),
        };
        match (over, &self.over) {
            (None, _) => self.over = None,
            (Some(over), None) => self.over = Some((Instant::now(), over)),
            (Some(_), Some(_)) => {}
        }
        let never_began = self.looked.as_ref().is_none_or(|looked| looked.job.is_none());
        let has_said_why = self.refusal().is_some();
        let visible_within = match has_said_why || (self.asked_to_stop && never_began) {
            true => Duration::ZERO,
            false => self.parts.slurm.visible_within.duration(),
        };
        // What the node wrote last may not be seen here yet.
        if self
            .over
            .as_ref()
            .is_some_and(|(since, _)| since.elapsed() >= visible_within)
        {
            self.look().await?;
            self.complete = true;
        }
        Ok(())
    }

    /// The node that was chosen for a job and will not come, whether or not it was seen to fail. One that the user named is waited
    /// for.
    fn waits_for_a_lost_node(&self, job: &Job) -> Option<String> {
        let node = job.wanted_node.clone()?;
        if self.parts.slurm.nodelist.is_some() {
            return None;
        }
        let is_gone = job
            .reason
            .as_ref()
            .is_some_and(|reason| reason.starts_with(NODE_GONE));
        let mut memory = self.remembered();
        if is_gone {
            memory.lost.insert(node.clone());
        }
        memory.lost.contains(&node).then_some(node)
    }

    /// How the workload ended that was asked to, though not by us: as far as the queue tells, once the job is over.
    async fn ended_by_another(&self) -> Ended {
        let begun = Instant::now();
        let mut since = self.seen;
        let seen = loop {
            let seen = self.parts.cluster.queue.after(since, ENDING).await;
            let runs = seen
                .job(&self.environment)
                .is_some_and(|job| job.standing == Standing::Runs);
            if !runs || begun.elapsed() > OVER_WITHIN {
                break seen;
            }
            since = seen.asked;
        };
        let job = seen.job(&self.environment).or(self.latest.as_ref());
        let state = job.map(|job| format!("; it is {}", job.state));
        let how = format!(
            "job {} was asked to end, as `scancel` does, and the batch system itself before a job's time is over{}",
            self.job.job,
            state.unwrap_or_default()
        );
        let lost_its_node = job.is_some_and(|job| job.standing == Standing::LostItsNode);
        if let Some(node) = job.and_then(|job| job.node.clone()).filter(|_| lost_its_node) {
            self.remembered().lost.insert(node);
        }
        Ended {
            lost_its_node,
            ..Ended::failed(&how)
        }
    }

    fn news(&mut self, job: &Job) -> Option<JobStanding> {
        let standing = job.standing();
        if !self.told.as_ref().unwrap_or(&self.job).has_changed(&standing) || self.changes >= MOST_CHANGES {
            return None;
        }
        self.changes += 1;
        self.told = Some(standing.clone());
        Some(standing)
    }
}

#[async_trait]
impl Environment for JobEnvironment {
    fn facts(&self) -> Map<String, Value> {
        self.facts.clone()
    }

    fn running(&self) -> bool {
        self.job.standing.is_alive()
    }

    fn job(&self) -> Option<&JobStanding> {
        Some(&self.job)
    }

    async fn next_progress(&mut self) -> Result<Option<Progress>, ProviderError> {
        loop {
            match self.next_news().await? {
                Some(News::Workload(progress)) => return Ok(Some(progress)),
                Some(News::Job(_)) => {}
                None => return Ok(None),
            }
        }
    }

    async fn next_news(&mut self) -> Result<Option<News>, ProviderError> {
        loop {
            if let Some(line) = self.lines.next_line()? {
                self.last_line = Some(line.clone());
                return Ok(Some(News::Workload(line)));
            }
            if self.complete {
                return Ok(None);
            }
            match self.take_in().await {
                Ok(Some(standing)) => return Ok(Some(News::Job(standing))),
                Ok(None) => self.backoff = Backoff::default(),
                Err(error) => self.backoff.after(error)?,
            }
        }
    }

    fn may_be_silent(&self) -> bool {
        !self.asked_to_stop
    }

    async fn stop(&mut self) -> Result<(), ProviderError> {
        retried(|| self.parts.cluster.system.stop(&self.job.job)).await?;
        self.asked_to_stop = true;
        Ok(())
    }

    async fn ended(&mut self) -> Result<Ended, ProviderError> {
        while self.next_progress().await?.is_some() {}
        if matches!(self.last_line, Some(Progress::Stopped { .. })) && !self.asked_to_stop {
            return Ok(self.ended_by_another().await);
        }
        if let Some(Failure { error, hint }) = self.refusal() {
            let to_do = hint.map(|hint| format!(" (to do: {hint})"));
            let why = format!("{error}{}", to_do.unwrap_or_default());
            return Ok(Ended::failed(&why.chars().take(MOST_WORDS).collect::<String>()));
        }
        let looked = self.looked.as_ref();
        let words = looked.map(|looked| looked.last_words.clone()).unwrap_or_default();
        let ended = match (looked.and_then(|looked| looked.ended), &self.over) {
            (Some(detached::Ended::Code(code)), _) => Ended::by_exit_code(code.into()),
            (Some(detached::Ended::Signal(signal)), _) => Ended::by_signal(signal.into()),
            (None, Some((_, over))) => Ended {
                success: false,
                how: over.how.clone(),
                lost_its_node: over.lost_its_node,
            },
            (None, None) => Ended::by_last_line(self.last_line.as_ref()),
        };
        Ok(ended.with_last_words(&words))
    }

    async fn collect(&mut self, into: &Path) -> Result<(), ProviderError> {
        transfer::collect(&self.parts.agent, &self.environment, into, &self.allowance).await
    }

    async fn discard(self: Box<Self>) -> Result<(), ProviderError> {
        // What has ended needs no question.
        let has_ended = self.looked.as_ref().is_some_and(|looked| looked.ended.is_some());
        if !has_ended && self.over.is_none() {
            end(&self.parts.cluster, &self.environment).await?;
        }
        self.parts.cluster.queue.outdate();
        retried(|| self.parts.agent.remove(&self.environment))
            .await
            .map(drop)
    }
}
