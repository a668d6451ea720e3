//! Whether a window is whole: its `window.json` is the one that was collected and says so, and every file beside it has the
//! length and the checksum that it names. The main function is [`see_that_window_is_whole`].

use std::io;

use super::{Place, ReadError, read_window};
use crate::{
    causes::with_causes,
    layout,
    window::{FileRecord, WindowRecord},
};

/// Why a window does not count.
#[derive(Debug)]
pub enum NotWhole {
    /// It is cut or damaged; the reason, for a person.
    Broken(String),
    /// Nobody knows: it cannot be read now, or not by this version.
    Unreadable(io::Error),
}

impl From<ReadError> for NotWhole {
    fn from(error: ReadError) -> Self {
        match error {
            ReadError::HalfWritten { .. } => {
                Self::Broken("it was cut: there is no window.json, which is written last".to_owned())
            }
            ReadError::Io { source, .. } => Self::of_file(layout::WINDOW, source),
            ReadError::Damaged { how, .. } => Self::Broken(format!("window.json is damaged: {how}")),
            error @ ReadError::FutureFormat { .. } => Self::Unreadable(io::Error::other(with_causes(&error))),
            error => Self::Broken(with_causes(&error)),
        }
    }
}

impl NotWhole {
    /// The reason, for a person.
    #[must_use]
    pub fn reason(self) -> String {
        match self {
            Self::Broken(reason) => reason,
            Self::Unreadable(error) => format!("it cannot be read: {error}"),
        }
    }

    fn of_file(name: &str, error: io::Error) -> Self {
        match error.kind() {
            // It is not there, is something else, or longer than any.
            io::ErrorKind::NotFound
            | io::ErrorKind::InvalidInput
            | io::ErrorKind::NotADirectory
            | io::ErrorKind::FileTooLarge => Self::Broken(format!("{name} cannot be read: {error}")),
            _ => Self::Unreadable(error),
        }
    }
}

/// What a window that is whole says of itself. Its `window.json` has this SHA-256, where that is known.
///
/// # Errors
/// Why it is not whole, or is not known to be.
pub fn see_that_window_is_whole(folder: &Place, sha256: Option<&str>) -> Result<WindowRecord, NotWhole> {
    let record = read_window(folder, sha256)?;
    let broken = |reason: String| Err(NotWhole::Broken(reason));
    if !record.complete {
        return broken(format!(
            "it was cut after {} of {} steps",
            record.steps_done, record.steps_expected
        ));
    }
    for file in &record.files {
        see_that_file_is_whole(folder, file)?;
    }
    Ok(record)
}

/// Reads a file beside a window's record, which names it.
///
/// # Errors
/// Why it is another, or is not known to be the one.
pub fn see_that_file_is_whole(folder: &Place, file: &FileRecord) -> Result<(), NotWhole> {
    let name = &file.name;
    let broken = |reason: String| Err(NotWhole::Broken(reason));
    let found = folder.join(name).digest();
    let found = found.map_err(|error| NotWhole::of_file(name, error))?;
    if found.bytes != file.bytes {
        return broken(format!(
            "{name} has {} bytes instead of {}",
            found.bytes, file.bytes
        ));
    }
    if found.sha256 != file.sha256 {
        return broken(format!("the checksum of {name} does not match window.json"));
    }
    Ok(())
}
