//! What is said to `workload detached` and what it answers, as types: one line of JSON each way. docs/hosts.md says what
//! each verb does. The main types are [`Start`], [`Listed`] and [`Failure`].

use std::{collections::BTreeMap, path::PathBuf};

use serde::{Deserialize, Serialize};

use super::platform::PlatformRecord;
use crate::{
    layout,
    settings::{Settings, asked_for},
};

/// What the name of a folder ends with that has not all in it yet. The environment's name is before it and, of the workload's own
/// folders, the number of the process that makes it.
pub const UNFINISHED: &str = ".unfinished";

/// What an environment belongs to: `owner.json`, in its folder before anything else.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Owner {
    /// The provider that made it.
    pub provider: String,
    /// The run's name.
    pub run: String,
    /// The run directory, as the machine of its user knows it.
    pub run_directory: PathBuf,
    /// The scenario's slug.
    pub scenario: String,
    /// The host's name in the matrix file.
    pub host: String,
    /// The windows it is to measure.
    pub windows: Vec<u32>,
}

/// What `start` reads first. The files of a user's experiment follow it, if it has any ([`crate::transfer::files`]).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Start {
    /// What the environment belongs to, with the windows to measure.
    pub owner: Owner,
    /// What the workload is to do.
    #[serde(deserialize_with = "asked_for")]
    pub settings: Settings,
    /// The container that a job is to run the workload in; none where it is a process.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub container: Option<JobContainer>,
}

/// A container in which a job runs its workload: `container.json`. The job adds what it alone knows, which is its user, its folder,
/// the workload, and the memory of its node.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct JobContainer {
    /// Options of `docker run`.
    pub options: Vec<String>,
    /// What it is made of.
    pub image: JobImage,
    /// A program of the image, with arguments, that becomes the workload; if there is none, the workload is started at once.
    pub entrypoint: Vec<String>,
    /// The system calls that its programs have, as a profile of seccomp in JSON.
    pub seccomp: String,
    /// How much memory it may use, in bytes; three quarters of the node's if that is not said.
    pub memory: Option<u64>,
}

/// What a job's container is made of.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum JobImage {
    /// An image that the node's engine has.
    Named(String),
    /// One without any file, which is made where the engine does not have it.
    Empty {
        /// Its name.
        name: String,
        /// Its labels.
        labels: BTreeMap<String, String>,
    },
}

/// The engine of the node that a job's container ran on: `engine.json`.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct EngineRecord {
    /// Its version.
    pub version: String,
    /// The digest of the container's image.
    pub image_id: String,
}

/// What `start` answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Started {
    /// The workload's process number.
    pub pid: u32,
}

/// How a workload's process ended: `ended.json`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Ended {
    /// By itself, with this exit code.
    Code(i32),
    /// By this signal.
    Signal(i32),
}

/// What `ended` answers.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Ending {
    /// Whether the workload still runs.
    pub running: bool,
    /// How it ended; none while it runs, and where nobody was left to see it end.
    pub ended: Option<Ended>,
    /// The end of its standard error, at most 64 KiB. What is not UTF-8 is replaced.
    pub last_words: String,
}

/// What `stop` answers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stopping {
    /// Whether there was a workload to ask.
    pub asked: bool,
}

/// What `remove` and `remove-bridge` answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Removed {
    /// Whether there was something to remove.
    pub removed: bool,
}

/// The job that an environment's workload runs in: `job.json`, made once, before anything runs. A second job of the same
/// environment finds it and ends.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct JobRecord {
    /// The job's number, as the batch system has it.
    pub job: String,
    /// The node that it runs on, as the batch system calls it.
    pub node: String,
}

/// What `look` answers. The lines follow it, at most [`Looked::MOST`] bytes of them.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Looked {
    /// The job that the workload runs in, or ran in; none where none has begun.
    pub job: Option<JobRecord>,
    /// The engine of the job's container, if it has one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub engine: Option<EngineRecord>,
    /// How the workload ended; none while it runs, and where nobody was left to see it end.
    pub ended: Option<Ended>,
    /// What the job wrote that is no line: the end of the workload's standard error and of the job's own, at most 64 KiB. What is
    /// not UTF-8 is replaced.
    pub last_words: String,
    /// How many bytes of lines follow.
    pub bytes: u64,
}

impl Looked {
    /// So many bytes of lines follow at most; asked again, `look` sends what comes after them.
    pub const MOST: u64 = 1 << 20;
}

/// What `list` answers: everything of ours on the host.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Listed {
    /// The environments below the root, by name.
    pub environments: Vec<ListedEnvironment>,
    /// The bridges that killed workloads left in Open vSwitch. Which run had one is not known.
    pub bridges: Vec<String>,
}

/// One environment of [`Listed`].
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ListedEnvironment {
    /// The environment's name, which is that of its folder.
    pub environment: String,
    /// What it belongs to; none where a crash came before that was written.
    pub owner: Option<Owner>,
    /// Whether its workload was started, and so has lines.
    pub started: bool,
    /// Whether a workload of it runs.
    pub running: bool,
}

/// What `collect` reads: how many bytes of a file are already there, by its path below the data folder. What is not
/// named is sent from its beginning.
pub type AlreadyThere = BTreeMap<String, u64>;

/// Whether a file of that name is small, and rewritten or appended to while one of the same name may be there: such a
/// file is always sent whole.
#[must_use]
pub fn is_sent_whole(name: &str) -> bool {
    [
        layout::ENVIRONMENT,
        layout::NETWORK,
        layout::PROGRESS,
        layout::WINDOW,
    ]
    .contains(&name)
}

/// The first line that `lease` reads.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LeaseRequest {
    /// Who asks. The lease passes from an older connection to a newer one with the same token.
    pub token: String,
    /// What others are told of who holds it: an object, which is handed on as it is.
    pub holder: serde_json::Map<String, serde_json::Value>,
}

/// A line that `lease` answers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum LeaseAnswer {
    /// It is yours as long as this process lives.
    Granted {
        /// Always true.
        granted: bool,
    },
    /// Another has it; [`Self::Granted`] follows when it is free.
    Held {
        /// Who; none where that cannot be read.
        held: Option<serde_json::Map<String, serde_json::Value>>,
    },
}

/// What `platform` answers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Host {
    /// What it is, as a workload would see it.
    #[serde(flatten)]
    pub platform: PlatformRecord,
    /// What an ordinary user may still write to the disk of the root.
    pub free_bytes: u64,
    /// The user who asks: 0 is root.
    pub uid: u32,
    /// The host's clock, in nanoseconds since 1970-01-01.
    pub now_ns: u64,
}

/// What a verb that failed says, on standard error.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Failure {
    /// What failed, with its causes.
    pub error: String,
    /// What to do about it.
    pub hint: Option<String>,
}
