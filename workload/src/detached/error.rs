//! What can go wrong beside a detached workload. The main type is [`DetachedError`].

use std::{
    io,
    path::{Path, PathBuf},
    time::Duration,
};

use record::{detached::Failure, identity::IdentityMismatch, transfer::SendError};
use rustix::io::Errno;

use crate::{command_error::CommandError, network::NetworkError};

/// Why a verb failed.
#[derive(Debug, thiserror::Error)]
pub enum DetachedError {
    /// What a user's command left behind cannot be ended.
    #[error(transparent)]
    Command(CommandError),
    /// Of a name that is no safe name of a folder.
    #[error("an environment cannot be called {name:?}")]
    Name {
        /// As it was given.
        name: String,
    },
    /// Of a root that means something else in another working directory.
    #[error("the root {} is not absolute", root.display())]
    Root {
        /// As it was given.
        root: PathBuf,
    },
    /// What came on standard input is not what the verb reads.
    #[error("standard input cannot be read as {what}")]
    Input {
        /// What it was to be.
        what: &'static str,
        /// Where it is not.
        source: serde_json::Error,
    },
    /// What came on standard input is longer than it ever has to be.
    #[error("standard input is longer than {most} bytes")]
    TooLong {
        /// The bound.
        most: u64,
    },
    /// A second environment of the same name.
    #[error("there is already an environment {name} in {}", root.display())]
    Exists {
        /// The environment's name.
        name: String,
        /// Where.
        root: PathBuf,
    },
    /// None of that name.
    #[error("there is no environment {name} in {}", root.display())]
    Missing {
        /// The environment's name.
        name: String,
        /// Where.
        root: PathBuf,
    },
    /// Its folder was made for a workload that is started at once, or its settings are gone.
    #[error("the environment {name} was not prepared for a job")]
    Unprepared {
        /// The environment's name.
        name: String,
    },
    /// A job has begun to write there before.
    #[error("the environment {environment} is that of job {job} on {node}")]
    Claimed {
        /// The environment's name.
        environment: String,
        /// That job's number.
        job: String,
        /// Its node.
        node: String,
    },
    /// The node is another machine than was said.
    #[error("{}", .0.reason)]
    AnotherHost(IdentityMismatch),
    /// The node's engine does not do what a container needs.
    #[error("cannot {action}: {words}")]
    Engine {
        /// What, as an infinitive.
        action: &'static str,
        /// Its words, or its client's.
        words: String,
    },
    /// More was said to be there already than there is.
    #[error("{} has {length} bytes, and {there} are said to be there already", path.display())]
    Beyond {
        /// The file.
        path: PathBuf,
        /// Its length.
        length: u64,
        /// What is said to be there.
        there: u64,
    },
    /// The data folder was not sent.
    #[error(transparent)]
    Send(#[from] SendError),
    /// A file or folder refused.
    #[error("cannot {action} {}", path.display())]
    File {
        /// A verb.
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The system's words.
        source: io::Error,
    },
    /// The system refused something else.
    #[error("cannot {action}")]
    System {
        /// What, as an infinitive.
        action: &'static str,
        /// Its words.
        source: io::Error,
    },
    /// A process that even SIGKILL does not end.
    #[error("process {pid} has not ended {after:?} after SIGKILL")]
    Stubborn {
        /// Its number.
        pid: i32,
        /// How long it was waited for.
        after: Duration,
    },
    /// Nothing was heard of who holds a lease.
    #[error("nothing came on standard input for {after:?}")]
    Silent {
        /// How long it was waited for.
        after: Duration,
    },
    /// The supervisor did not start the workload.
    #[error("{}", .0.error)]
    Supervisor(Failure),
    /// Open vSwitch refused.
    #[error("cannot {action}")]
    Bridge {
        /// What, as an infinitive.
        action: &'static str,
        /// The error of the network.
        source: NetworkError,
    },
}

impl DetachedError {
    /// Of a file, with the system's words to come.
    pub(super) fn file<E: Into<io::Error>>(
        action: &'static str,
        path: &Path,
    ) -> impl FnOnce(E) -> Self + use<E> {
        let path = path.to_owned();
        move |source| Self::File {
            action,
            path,
            source: source.into(),
        }
    }

    /// Of the system, with its words to come.
    pub(super) fn system<E: Into<io::Error>>(action: &'static str) -> impl Fn(E) -> Self {
        move |source| Self::System {
            action,
            source: source.into(),
        }
    }

    /// Whether the call itself was wrong, so that the same call always fails.
    #[must_use]
    pub const fn is_of_call(&self) -> bool {
        matches!(
            self,
            Self::Name { .. } | Self::Root { .. } | Self::Input { .. } | Self::TooLong { .. }
        )
    }

    /// What another process of ours has said, to be said again as it is.
    #[must_use]
    pub fn relayed(&self) -> Option<Failure> {
        match self {
            Self::Supervisor(failure) => Some(failure.clone()),
            _ => None,
        }
    }

    /// What to do about it.
    #[must_use]
    pub fn hint(&self) -> Option<String> {
        let hint = match self {
            Self::Name { .. } => {
                "use letters, digits, `.`, `_` and `-`, at most 200 of them, with a letter or digit first"
            }
            Self::Command(error) => return error.hint(),
            Self::Root { .. } => "write the whole path, from `/` on",
            Self::Exists { .. } => "remove it first, or choose another name",
            Self::Missing { .. } => "`workload detached list` says which there are",
            Self::Unprepared { .. } => "prepare it with `workload detached prepare`",
            Self::Claimed { .. } => {
                "an environment is measured once: `matrix` makes another one for the windows that are missing"
            }
            Self::AnotherHost(mismatch) => return Some(mismatch.fix.clone()),
            Self::Engine { words, .. } => hint_of_engine(words),
            Self::Beyond { .. } | Self::Send(SendError::Beyond { .. }) => {
                "the file has been written anew: ask for it from its beginning"
            }
            Self::Stubborn { .. } => {
                "the kernel keeps it, usually for a disk that does not answer: try again later, or restart the host"
            }
            Self::Silent { .. } => "send an empty line now and then, more often than `--beat` says",
            Self::Bridge { source, .. } => return source.hint(),
            Self::Supervisor(failure) => return failure.hint.clone(),
            Self::File { source, .. }
            | Self::System { source, .. }
            | Self::Send(SendError::Read { source, .. } | SendError::Stream(source)) => {
                return hint_of_system(source);
            }
            Self::Input { .. } | Self::TooLong { .. } => return None,
        };
        Some(hint.to_owned())
    }
}

fn hint_of_engine(words: &str) -> &'static str {
    let said = |part: &str| words.contains(part);
    if said("No such image") || said("no such image") {
        "bring the image to the engine of each node: `matrix` itself pulls nothing"
    } else if said("permission denied") {
        "have the administrator let your user use the engine of the nodes, or measure `native` there"
    } else {
        "ask for nodes that have a Docker Engine (`connect.slurm.constraint` or `nodelist`), or measure `native` there"
    }
}

fn hint_of_system(error: &io::Error) -> Option<String> {
    let hint = match Errno::from_io_error(error)? {
        Errno::NOSPC => "make room on the host's disk",
        Errno::NOSYS => "Linux 5.3 or newer is needed",
        Errno::MFILE => "raise fs.inotify.max_user_instances or the limit on open files",
        _ => return None,
    };
    Some(hint.to_owned())
}
