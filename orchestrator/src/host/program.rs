//! Programs on a host, and what is left of them when they have ended. The main types are [`Program`], which is plain data,
//! and [`RunningProgram`], which is live.

use std::{ffi::OsString, path::PathBuf};

use async_trait::async_trait;
use tokio::net::UnixStream;

use super::HostError;

/// A program to start. It gets nothing of the surroundings in which `matrix` was started but `PATH` and `HOME`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Program {
    /// Its file there, or a name to be found in `PATH`.
    pub file: PathBuf,
    /// Its arguments. Over SSH each is quoted for a POSIX shell, and none is ever read by one.
    pub arguments: Vec<OsString>,
}

impl Program {
    /// With these arguments.
    pub fn new<A: Into<OsString>>(file: impl Into<PathBuf>, arguments: impl IntoIterator<Item = A>) -> Self {
        Self {
            file: file.into(),
            arguments: arguments.into_iter().map(Into::into).collect(),
        }
    }
}

/// A program that was started.
pub struct RunningProgram {
    /// Its standard input and output: shutting down the writing half is the end of its input. Dropping it ends the
    /// program's input and output, upon which a well-behaved one ends.
    pub stream: UnixStream,
    /// Its end.
    pub end: Box<dyn ProgramEnd>,
}

/// The end of a program, to be waited for after or beside its stream.
#[async_trait]
pub trait ProgramEnd: Send {
    /// Waits until it has ended. To be called once.
    ///
    /// # Errors
    /// When the host could not say how: the connection was lost first.
    async fn wait(self: Box<Self>) -> Result<Exit, HostError>;
}

/// How a program ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Exit {
    /// Its exit code; none when a signal ended it.
    pub code: Option<i32>,
    /// The end of its standard error, at most 64 KiB. What is not UTF-8 is replaced.
    pub last_words: String,
}

impl Exit {
    /// Whether it ended by itself with code 0.
    #[must_use]
    pub fn success(&self) -> bool {
        self.code == Some(0)
    }
}
