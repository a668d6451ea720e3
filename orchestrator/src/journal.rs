//! The journal's writing end: an event is on disk before the thing it announces is done. The main type is [`Journal`].
//!
//! Reading is `reports::run_directory`'s, since a report reads the same lines.

use std::{
    fs::{File, OpenOptions},
    io::{Read, Seek, SeekFrom, Write},
    path::{Path, PathBuf},
    time::SystemTime,
};

use reports::run_directory::{Event, JournalEntry};

/// The journal could not be written. Nothing may be created then.
#[derive(Debug, thiserror::Error)]
#[error("the journal {} cannot be written", path.display())]
pub struct JournalError {
    path: PathBuf,
    source: std::io::Error,
}

impl JournalError {
    /// What to do about it.
    #[must_use]
    pub fn hint(&self) -> String {
        "make room on the disk, or give `--out` a folder that you may write to, then `matrix resume`"
            .to_owned()
    }
}

/// Appends to a run's `events.jsonl`.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    file: File,
}

impl Journal {
    /// Opens the journal, which may exist already. A last line that a crash cut is closed by a line feed, so that it
    /// stays visible as what it is and the next line is whole.
    ///
    /// # Errors
    /// When the file cannot be opened or written.
    pub fn open(path: &Path) -> Result<Self, JournalError> {
        let fail = |source| JournalError {
            path: path.to_owned(),
            source,
        };
        let mut file = OpenOptions::new()
            .read(true)
            .append(true)
            .create(true)
            .open(path)
            .map_err(fail)?;
        if file.metadata().map_err(fail)?.len() > 0 {
            let mut last = [0];
            file.seek(SeekFrom::End(-1)).map_err(fail)?;
            file.read_exact(&mut last).map_err(fail)?;
            if last != *b"\n" {
                file.write_all(b"\n").map_err(fail)?;
            }
        }
        Ok(Self {
            path: path.to_owned(),
            file,
        })
    }

    /// Appends one event and waits until it is on disk.
    ///
    /// # Errors
    /// When it could not be written.
    pub fn append(&mut self, event: Event) -> Result<JournalEntry, JournalError> {
        let entry = JournalEntry { at: now(), event };
        let fail = |source| JournalError {
            path: self.path.clone(),
            source,
        };
        let mut line = serde_json::to_vec(&entry).map_err(|error| fail(error.into()))?;
        line.push(b'\n');
        self.file
            .write_all(&line)
            .and_then(|()| self.file.sync_data())
            .map_err(fail)?;
        Ok(entry)
    }
}

/// The time now, as journal and manifest write it.
#[must_use]
pub fn now() -> String {
    humantime::format_rfc3339_millis(SystemTime::now()).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_that_a_crash_cut_does_not_swallow_the_next_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("events.jsonl");
        std::fs::write(&path, r#"{"at":"2026-01-01T00:00:00.000Z","event":"run-fin"#).unwrap();
        Journal::open(&path)
            .unwrap()
            .append(Event::RunInterrupted)
            .unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        assert_eq!(text.lines().count(), 2);
        let last: JournalEntry = serde_json::from_str(text.lines().last().unwrap()).unwrap();
        assert_eq!(last.event, Event::RunInterrupted);
    }
}
