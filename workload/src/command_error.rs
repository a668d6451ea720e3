//! What ends a command's experiment early. The main type is [`CommandError`].

use std::{io, path::PathBuf};

/// Why there are no more windows.
#[derive(Debug, thiserror::Error)]
pub enum CommandError {
    /// Whoever started the workload gave it no folder for the command's files.
    #[error("there is no folder for the command's files")]
    NoWork,
    /// A folder's name cannot be an argument.
    #[error("{} has a name that is not text", path.display())]
    NoText {
        /// The folder.
        path: PathBuf,
    },
    /// The program is not there, or cannot be started.
    #[error("`{program}` cannot be started")]
    Start {
        /// As the matrix file names it.
        program: String,
        /// What the system said.
        source: io::Error,
    },
    /// The command before or after the windows failed.
    #[error("the command `{hook}` {how}{}", printed(.last_words))]
    Hook {
        /// Which, as the matrix file names it.
        hook: &'static str,
        /// How it ended.
        how: String,
        /// What it printed last.
        last_words: String,
    },
    /// The matrix file has it so: nothing more is measured.
    #[error("window {window} does not count, and `fail_fast` ends the scenario with it: {reason}")]
    FailFast {
        /// Which.
        window: u32,
        /// Why it does not count.
        reason: String,
    },
    /// Something killed the command of a window, or one of its nodes.
    #[error("{who} of window {window} was killed by signal {signal}{}", printed(.last_words))]
    Killed {
        /// `the command`, or which node.
        who: String,
        /// Which window's.
        window: u32,
        /// By which signal.
        signal: i32,
        /// What it printed last.
        last_words: String,
    },
    /// Processes that the command started do not end, though they were killed.
    #[error("{count} processes that the command left behind do not end")]
    Stubborn {
        /// How many.
        count: usize,
    },
    /// The system refused something.
    #[error("cannot {action}")]
    System {
        /// What.
        action: &'static str,
        /// What it said.
        source: io::Error,
    },
}

fn printed(last_words: &str) -> String {
    match last_words {
        "" => String::new(),
        words => format!("; it printed last: {words}"),
    }
}

impl CommandError {
    /// Whether the platform is to blame, and not the experiment.
    #[must_use]
    pub const fn is_of_platform(&self) -> bool {
        !matches!(self, Self::FailFast { .. })
    }

    /// Of the system's, with its words to come.
    pub(crate) fn system<E: Into<io::Error>>(action: &'static str) -> impl FnOnce(E) -> Self {
        move |source| Self::System {
            action,
            source: source.into(),
        }
    }

    /// What to do about it, where that is known.
    #[must_use]
    pub fn hint(&self) -> Option<String> {
        match self {
            Self::Start { source, .. } => Some(match source.kind() {
                io::ErrorKind::NotFound => {
                    "install it in the image, the box or on the host, in `prepare:`, or name a file of \
                                            `files:` as `./NAME`"
                        .to_owned()
                }
                io::ErrorKind::PermissionDenied => "make the file executable (`chmod +x`)".to_owned(),
                _ => return None,
            }),
            Self::Hook { hook, .. } => Some(format!(
                "its whole output is in `{hook}-*` files of the scenario's folder in the run directory"
            )),
            Self::Killed { signal: 9, .. } => {
                Some("see whether there was too little memory (`dmesg`, or the container's limit)".to_owned())
            }
            _ => None,
        }
    }
}
