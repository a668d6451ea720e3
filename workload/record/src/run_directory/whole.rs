//! Whether a window is whole: its `window.json` is the one that was collected, is of this window and says that all its steps were
//! done, and every file beside it has the length and the checksum that it names. The main functions are [`read_whole_record`], which
//! looks at `window.json` alone, and [`ensure_window_is_whole`].

use std::io;

use super::{FileDigest, Place, ReadError, read_window};
use crate::{
    causes::with_causes,
    reason,
    window::{FileRecord, WindowRecord},
};

/// Why a window does not count.
#[derive(Debug)]
pub enum NotWhole {
    /// It is cut, damaged or another; the reason, for a person.
    Broken(String),
    /// In the place of one of its files is something that no window has: a link, a device, a file longer than any.
    Replaced(ReadError),
    /// Nobody knows: it cannot be read now, or not by this version.
    Unreadable(ReadError),
}

/// As for its `window.json`.
impl From<ReadError> for NotWhole {
    fn from(error: ReadError) -> Self {
        let is_replaced = matches!(&error, ReadError::Io { source, .. } if is_of_what_stands_there(source));
        match error {
            error if is_replaced => Self::Replaced(error),
            ReadError::HalfWritten { .. } => {
                Self::Broken("window.json is missing, so it was never finished".to_owned())
            }
            ReadError::Damaged { how, .. } => Self::Broken(format!("window.json is damaged: {how}")),
            // Both name what they found, which may be as long as the file.
            ReadError::Impossible { source, .. } => Self::Broken(reason::shortened(&format!(
                "window.json cannot be what was measured: {source}"
            ))),
            ReadError::Json { source, .. } => Self::Broken(reason::shortened(&format!(
                "window.json cannot be understood: {source}"
            ))),
            error => Self::Unreadable(error),
        }
    }
}

impl NotWhole {
    /// The reason, for a person.
    #[must_use]
    pub fn reason(self) -> String {
        match self {
            Self::Broken(reason) => reason,
            Self::Replaced(ReadError::Io { path, source }) => {
                let name = path.file_name().unwrap_or_default().display();
                format!("{name} cannot be read: {source}")
            }
            Self::Replaced(error) | Self::Unreadable(error) => {
                format!("it cannot be read: {}", with_causes(&error))
            }
        }
    }

    /// The reason, for a person, where it is known that this is no whole window.
    ///
    /// # Errors
    /// Why that is not known.
    pub fn known_reason(self) -> Result<String, io::Error> {
        match self {
            Self::Unreadable(ReadError::Io { source, .. }) => Err(source),
            Self::Unreadable(error) => Err(io::Error::other(with_causes(&error))),
            known => Ok(known.reason()),
        }
    }
}

/// Whether it stays so however often it is tried.
fn is_of_what_stands_there(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::NotFound
            | io::ErrorKind::InvalidInput
            | io::ErrorKind::NotADirectory
            | io::ErrorKind::FileTooLarge
    )
}

/// What a window of this number says of itself when all its steps were done. Its `window.json` has this SHA-256, where that is known;
/// the files beside it are not looked at.
///
/// # Errors
/// Why it is not whole, or is not known to be.
pub fn read_whole_record(
    folder: &Place,
    window: u32,
    sha256: Option<&str>,
) -> Result<WindowRecord, NotWhole> {
    let mut record = read_window(folder, sha256)?;
    // A report has the records of all windows in memory.
    record.shorten_reasons();
    let broken = |reason: String| Err(NotWhole::Broken(reason));
    if record.window != window {
        return broken(format!("window.json is that of window {}", record.window));
    }
    if !record.complete {
        return broken(match record.loops() {
            Some(loops) => format!("{} of {} steps were done", loops.steps_done, loops.steps_expected),
            None => "the command was interrupted".to_owned(),
        });
    }
    Ok(record)
}

/// The same, and every file that the window's record names is as it was measured.
///
/// # Errors
/// Why it is not whole, or is not known to be.
pub fn ensure_window_is_whole(
    folder: &Place,
    window: u32,
    sha256: Option<&str>,
) -> Result<WindowRecord, NotWhole> {
    let record = read_whole_record(folder, window, sha256)?;
    for file in &record.files {
        ensure_file_is_whole(folder, file)?;
    }
    Ok(record)
}

/// Reads a file beside a window's record, which names it.
///
/// # Errors
/// Why it is another, or is not known to be the one.
pub fn ensure_file_is_whole(folder: &Place, file: &FileRecord) -> Result<(), NotWhole> {
    let name = &file.name;
    let broken = |reason: String| Err(NotWhole::Broken(reason));
    let place = folder.join(name);
    let found = place
        .open_within(file.bytes)
        .and_then(FileDigest::of)
        .map_err(|source| {
            let is_of_what_stands_there = is_of_what_stands_there(&source);
            let error = ReadError::Io {
                path: place.path(),
                source,
            };
            match is_of_what_stands_there {
                true => NotWhole::Replaced(error),
                false => NotWhole::Unreadable(error),
            }
        })?;
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
