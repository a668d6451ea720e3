//! Batch systems: they give a node of a cluster to a job when its turn comes. The trait is [`BatchSystem`].
//!
//! ```text
//! provider::jobs ── JobRequest ──> BatchSystem ── sbatch, squeue, scancel, sinfo ──> a program on the submit host
//!                <── Job ───────── Queue: one question for all jobs
//! ```
//!
//! `matrix` has no scheduler of its own. What it needs of one is small, so that another can stand in for Slurm: give a job to it, ask
//! for all jobs of this user, ask one to end, take one back, and say which nodes there are.

mod cluster;
pub mod queue;
pub mod slurm;
use std::{collections::BTreeSet, ffi::OsString, path::PathBuf};

use async_trait::async_trait;
use record::{
    connection::Slurm,
    run_directory::{JobStanding, Standing},
};

pub use self::cluster::{Cluster, Clusters};
use crate::{host::Program, provider::ProviderError};

/// A scheduler of a cluster, as the submit host's user sees it.
#[async_trait]
pub trait BatchSystem: Send + Sync {
    /// Its name and version.
    ///
    /// # Errors
    /// When it is not there.
    async fn version(&self) -> Result<String, ProviderError>;

    /// When and where a job would run if it were submitted now. Submits nothing.
    ///
    /// # Errors
    /// When it could never run, with what stands in the way.
    async fn forecast(&self, job: &JobRequest) -> Result<Forecast, ProviderError>;

    /// The nodes on which this job could run some day: those that others use just now are among them.
    ///
    /// # Errors
    /// When the cluster cannot be asked, or would refuse the job on whichever node.
    async fn nodes(&self, job: &JobRequest) -> Result<FittingNodes, ProviderError>;

    /// The longest time that a job with these wishes may ask for, in minutes; none where there is no limit.
    ///
    /// # Errors
    /// When the cluster cannot be asked.
    async fn longest_minutes(&self, wishes: &Slurm) -> Result<Option<u32>, ProviderError>;

    /// Submits a job; its number. A job of the same name that is there already is that job.
    ///
    /// # Errors
    /// When it is refused; nothing of it is left in the queue then.
    async fn submit(&self, job: &JobRequest) -> Result<String, ProviderError>;

    /// All jobs of this user that the system remembers, those that ended lately too.
    ///
    /// # Errors
    /// When the cluster cannot be asked, which says nothing of the jobs.
    async fn jobs(&self) -> Result<Vec<Job>, ProviderError>;

    /// Asks a job to end in order, and takes it back if it has not begun. One that is gone is fine.
    ///
    /// # Errors
    /// When the cluster cannot be asked.
    async fn stop(&self, job: &str) -> Result<(), ProviderError>;

    /// Takes a job back, or ends it. One that is gone is fine.
    ///
    /// # Errors
    /// When the cluster cannot be asked.
    async fn cancel(&self, job: &str) -> Result<(), ProviderError>;

    /// A shell on the node of a job that runs, for a person: a program of the submit host's that wants a terminal.
    fn shell(&self, job: &str) -> Program;
}

/// A job to be submitted: one environment's workload on a whole node, once.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct JobRequest {
    /// Its name, unique for ever: that of the environment.
    pub name: String,
    /// To whom it belongs.
    pub owner: JobOwner,
    /// What is wanted of the cluster.
    pub wishes: Slurm,
    /// The program, a script on the submit host's file system.
    pub script: PathBuf,
    /// Its arguments.
    pub arguments: Vec<OsString>,
    /// Where what it writes goes; the folder is there.
    pub output: PathBuf,
    /// How long it may take, in minutes.
    pub minutes: u32,
    /// The job whose end it waits for.
    pub after: Option<String>,
    /// The node that it is to run on; any that fits where there is none.
    pub node: Option<String>,
    /// Nodes that it must not run on.
    pub not_on: BTreeSet<String>,
}

/// To whom a job belongs, as its comment in the queue has it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct JobOwner {
    /// The run's name.
    pub run: String,
    /// The host's name in the matrix file.
    pub host: String,
    /// The scenario's slug.
    pub scenario: String,
}

impl JobOwner {
    /// As a comment: names are words without spaces.
    #[must_use]
    pub fn comment(&self) -> String {
        let Self { run, host, scenario } = self;
        format!("matrix run={run} host={host} scenario={scenario}")
    }

    /// Out of a comment; none of one that we have not written.
    #[must_use]
    pub fn of_comment(comment: &str) -> Option<Self> {
        let words: Vec<&str> = comment.split(' ').collect();
        let [matrix, run, host, scenario] = words.as_slice() else {
            return None;
        };
        Some(Self {
            run: Some(*matrix)
                .filter(|it| *it == "matrix")
                .and(run.strip_prefix("run="))?
                .to_owned(),
            host: host.strip_prefix("host=")?.to_owned(),
            scenario: scenario.strip_prefix("scenario=")?.to_owned(),
        })
    }
}

/// The nodes that a job asks for.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct FittingNodes {
    /// The names of those that fit.
    pub fit: Vec<String>,
    /// Those that are out of service, of which the system does not say whether they fit: name and state.
    pub out_of_service: Vec<(String, String)>,
}

/// When and where a job would run.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Forecast {
    /// When, in the cluster's own words and time zone.
    pub start: Option<String>,
    /// On which node.
    pub node: Option<String>,
}

/// A job as the batch system has it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Job {
    /// Its number.
    pub id: String,
    /// Its name.
    pub name: String,
    /// Whose it is; none of one that is not ours.
    pub owner: Option<JobOwner>,
    /// Where it stands.
    pub standing: Standing,
    /// The system's own word for that.
    pub state: String,
    /// Why it waits or has ended, in the system's own words.
    pub reason: Option<String>,
    /// The node that it runs or ran on.
    pub node: Option<String>,
    /// The node that it asked for.
    pub wanted_node: Option<String>,
    /// When it began or may begin, in the cluster's own words and time zone.
    pub start: Option<String>,
}

impl Job {
    /// Where it stands, for the journal.
    #[must_use]
    pub fn standing(&self) -> JobStanding {
        JobStanding {
            job: self.id.clone(),
            standing: self.standing,
            state: self.state.clone(),
            reason: self.reason.clone(),
            node: self.node.clone(),
            start: self.start.clone(),
        }
    }
}
