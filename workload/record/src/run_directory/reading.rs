//! Reading the files of a run directory, with errors that say which file, where in it, and what to do. The main type
//! is [`ReadError`].

use std::{io, path::PathBuf};

use serde::{Deserialize, de::DeserializeOwned};
use sha2::{Digest, Sha256};

use super::{EnvironmentRecord, FORMAT, Place, log::LogError};
use crate::{
    layout,
    window::{Impossible, WindowRecord},
};

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
    /// Not as it was written.
    #[error("{} is damaged: {how}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// By what it is known.
        how: String,
    },
    /// JSON with a number that nothing has.
    #[error("{} cannot be what matrix wrote", path.display())]
    Impossible {
        /// The file.
        path: PathBuf,
        /// What no run of `matrix` has.
        source: Impossible,
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
        /// The system's error.
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
            Self::Damaged { .. } => {
                "it was changed after matrix wrote it, by a person or by the disk: restore it from a copy".into()
            }
            Self::Impossible { .. } => {
                "a host wrote it so, or it was changed since: restore it from a copy; of a window, move its folder away, and the report counts it as missing"
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

/// The plan of a thousand scenarios, which is the longest of the records, is a third of it.
pub const LONGEST_RECORD: u64 = 16 << 20;

/// Reads one of the files that every run directory has, of at most so many bytes.
///
/// # Errors
/// When it is not there, is longer, or cannot be read.
pub fn read_file(place: &Place, most_bytes: u64) -> Result<Vec<u8>, ReadError> {
    place.read(most_bytes).map_err(|source| match source.kind() {
        io::ErrorKind::NotFound => ReadError::HalfWritten { path: place.path() },
        _ => ReadError::Io {
            path: place.path(),
            source,
        },
    })
}

/// Reads one of the files that carry a `format`.
///
/// # Errors
/// When it cannot be read, is not what it should be, or is of a later format than the `known` one.
pub fn read_record<T: DeserializeOwned>(place: &Place, known: u32) -> Result<T, ReadError> {
    read_checked(place, known, None)
}

/// Reads one of the files that carry a `format`, and that has this SHA-256 where it is known.
///
/// # Errors
/// As [`read_record`], and when it is another.
pub(crate) fn read_checked<T: DeserializeOwned>(
    place: &Place,
    known: u32,
    sha256: Option<&str>,
) -> Result<T, ReadError> {
    read_record_of(place, known, LONGEST_RECORD, sha256.into_iter())
}

/// What a scenario's platform was. The file has one of these SHA-256, if there are any.
///
/// # Errors
/// As [`read_record`], and when it is another.
pub fn read_environment<'a>(
    place: &Place,
    sha256: impl Iterator<Item = &'a str> + Clone,
) -> Result<EnvironmentRecord, ReadError> {
    // Values of any kind take fifty times the memory of their text, and there is one of these a scenario.
    read_record_of(place, FORMAT, 256 << 10, sha256)
}

fn read_record_of<'a, T: DeserializeOwned>(
    place: &Place,
    known: u32,
    most_bytes: u64,
    mut sha256: impl Iterator<Item = &'a str> + Clone,
) -> Result<T, ReadError> {
    #[derive(Deserialize)]
    struct Versioned {
        format: Option<u64>,
    }
    let text = read_file(place, most_bytes)?;
    if sha256.clone().next().is_some() {
        let found = format!("{:x}", Sha256::digest(&text));
        if !sha256.any(|sha256| sha256 == found) {
            return Err(ReadError::Damaged {
                path: place.path(),
                how: "its SHA-256 is not the one that events.jsonl has of it".to_owned(),
            });
        }
    }
    // The format first: what else a later version changed must not be reported as damage.
    let json = |source| ReadError::Json {
        path: place.path(),
        source,
    };
    let Versioned { format } = serde_json::from_slice(&text).map_err(json)?;
    match format {
        Some(found) if found > u64::from(known) => Err(ReadError::FutureFormat {
            path: place.path(),
            found,
            known,
        }),
        _ => serde_json::from_slice(&text).map_err(json),
    }
}

/// Reads the `window.json` of a window's folder, which has this SHA-256 where it is known.
///
/// # Errors
/// As [`read_record`], when it is another, and when it says what no window can be.
pub fn read_window(folder: &Place, sha256: Option<&str>) -> Result<WindowRecord, ReadError> {
    let place = folder.join(layout::WINDOW);
    let sums = sha256.into_iter();
    let record: WindowRecord = read_record_of(&place, crate::FORMAT, WindowRecord::MOST_BYTES, sums)?;
    match record.check() {
        Ok(()) => Ok(record),
        Err(source) => Err(ReadError::Impossible {
            path: place.path(),
            source,
        }),
    }
}
