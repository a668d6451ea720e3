//! Reading the files of a run directory, with errors that say which file, where in it, and what to do. The main type
//! is [`ReadError`].

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use serde::{Deserialize, de::DeserializeOwned};

use super::log::LogError;

/// Why a run directory cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// Nothing is there.
    #[error("there is no run directory at {}", path.display())]
    NotFound {
        /// Where.
        path: PathBuf,
    },
    /// It is something else: a file, or a folder without a manifest.
    #[error("{} is not a run directory: {why}", path.display())]
    NotARunDirectory {
        /// Where.
        path: PathBuf,
        /// How it can be told.
        why: &'static str,
    },
    /// One of the files that are written before the first measurement is missing.
    #[error("the run directory is half-written: {} is missing", path.display())]
    HalfWritten {
        /// The file.
        path: PathBuf,
    },
    /// Written by a newer version.
    #[error("{} has format {found}, and this version of matrix knows formats up to {known}", path.display())]
    FutureFormat {
        /// The file.
        path: PathBuf,
        /// Its format.
        found: u64,
        /// The newest one that is known.
        known: u32,
    },
    /// Not the JSON that belongs there.
    #[error("{} cannot be understood", path.display())]
    Json {
        /// The file.
        path: PathBuf,
        /// What and where.
        source: serde_json::Error,
    },
    /// A line in the midst of the journal that is no event.
    #[error("line {line} of {} is not an event", path.display())]
    Journal {
        /// The journal.
        path: PathBuf,
        /// Which line, from 1.
        line: usize,
        /// What is wrong with it.
        source: serde_json::Error,
    },
    /// The log of a window that counts.
    #[error("{} cannot be used", path.display())]
    Log {
        /// The log.
        path: PathBuf,
        /// What is wrong, and where.
        source: LogError,
    },
    /// A window without the log that the error is asked of.
    #[error("there is no {}, so the true error is not known", path.display())]
    NoTruth {
        /// The log that is not there.
        path: PathBuf,
    },
    /// The operating system refused.
    #[error("{} cannot be read", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
}

impl ReadError {
    /// What to do about it.
    #[must_use]
    pub fn hint(&self) -> String {
        match self {
            Self::NotFound { .. } => {
                "give the folder that `matrix run` printed, such as `runs/2026-11-21T04-00-00Z`".into()
            }
            Self::NotARunDirectory { .. } => {
                "give the folder that has manifest.json, plan.json and events.jsonl in it".into()
            }
            Self::HalfWritten { .. } => {
                "nothing had been measured when it was left: start again with `matrix run`, and delete it"
                    .into()
            }
            Self::FutureFormat { .. } => "use the version of matrix that wrote it, or a later one".into(),
            Self::Json { .. } => {
                "matrix writes this file whole: restore it from a copy, or measure again with `matrix run`"
                    .into()
            }
            Self::Journal { line, .. } => format!(
                "only a line that a crash cut may be unreadable, and this is none: restore line {line} from a copy"
            ),
            Self::Log { source, .. } => source.hint(),
            Self::NoTruth { .. } => {
                "report the error that the controller saw, with `--error received`: this run was measured before the plant kept a log"
                    .into()
            }
            Self::Io { .. } => "see that the file is there and that you may read it".into(),
        }
    }
}

/// Reads one of the files that every run directory has.
pub(crate) fn read_file(path: &Path) -> Result<Vec<u8>, ReadError> {
    fs::read(path).map_err(|source| match source.kind() {
        io::ErrorKind::NotFound => ReadError::HalfWritten {
            path: path.to_owned(),
        },
        _ => ReadError::Io {
            path: path.to_owned(),
            source,
        },
    })
}

/// Reads one of the files that carry a `format`.
///
/// # Errors
/// When it cannot be read, is not what it should be, or is of a later format than the `known` one.
pub fn read_record<T: DeserializeOwned>(path: &Path, known: u32) -> Result<T, ReadError> {
    #[derive(Deserialize)]
    struct Versioned {
        format: Option<u64>,
    }
    let text = read_file(path)?;
    // The format first: what else a later version changed must not be reported as damage.
    let json = |source| ReadError::Json {
        path: path.to_owned(),
        source,
    };
    let Versioned { format } = serde_json::from_slice(&text).map_err(json)?;
    match format {
        Some(found) if found > u64::from(known) => Err(ReadError::FutureFormat {
            path: path.to_owned(),
            found,
            known,
        }),
        _ => serde_json::from_slice(&text).map_err(json),
    }
}
