//! The journal's writing end: an event is on disk before the thing it announces is done. The main type is [`Journal`].
//!
//! Reading is `record::run_directory`'s, since a report reads the same lines.

use std::{
    fs::File,
    io::{self, Read, Seek, SeekFrom, Write},
    path::PathBuf,
    time::SystemTime,
};

use record::run_directory::{self, Chain, Event, JournalEntry, OpenOptions, Place};

/// The journal could not be written. Nothing may be created then.
#[derive(Debug, thiserror::Error)]
#[error("the journal {} cannot be written", path.display())]
pub struct JournalError {
    path: PathBuf,
    source: io::Error,
}

impl JournalError {
    /// What to do about it.
    #[must_use]
    pub fn hint(&self) -> String {
        "make room on its disk, or let it be written again, then `matrix resume`: what was begun may measure on meanwhile"
            .to_owned()
    }
}

/// Appends to a run's `events.jsonl`.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    file: File,
    /// The checksums of the lines that are there.
    chain: Chain,
}

impl Journal {
    /// Opens the journal, which may exist already. A last line that a crash cut is closed by a line feed, so that it
    /// stays visible as what it is and the next line is whole.
    ///
    /// # Errors
    /// When the file cannot be read, opened or written.
    pub fn open(place: &Place) -> Result<Self, JournalError> {
        let fail = |source| JournalError {
            path: place.path(),
            source,
        };
        let mut options = OpenOptions::new();
        options.read(true).append(true);
        let mut file = match place.open_to_write(&options) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => place.create().map_err(fail)?,
            opened => opened.map_err(fail)?,
        };
        let journal = run_directory::Journal::read(place).map_err(|error| fail(io::Error::other(error)))?;
        if file.metadata().map_err(fail)?.len() > 0 {
            let mut last = [0];
            file.seek(SeekFrom::End(-1)).map_err(fail)?;
            file.read_exact(&mut last).map_err(fail)?;
            if last != *b"\n" {
                file.write_all(b"\n").map_err(fail)?;
            }
        }
        Ok(Self {
            path: place.path(),
            file,
            chain: journal.chain,
        })
    }

    /// Appends one event and waits until it is on disk.
    ///
    /// # Errors
    /// When it could not be written.
    pub fn append(&mut self, event: Event) -> Result<JournalEntry, JournalError> {
        let entry = JournalEntry::new(stamp(), event);
        let fail = |source| JournalError {
            path: self.path.clone(),
            source,
        };
        // One that could not be written is none that the next follows on.
        let mut chain = self.chain.clone();
        let line = chain.line(&entry).map_err(|error| fail(error.into()))?;
        self.file
            .write_all(&line)
            .and_then(|()| self.file.sync_data())
            .map_err(fail)?;
        self.chain = chain;
        Ok(entry)
    }
}

/// The time now, as the manifest writes it.
#[must_use]
pub fn now() -> String {
    humantime::format_rfc3339_millis(SystemTime::now()).to_string()
}

/// The time now, as the journal writes it. A native environment is made in a millisecond: in whole ones seven nights would have the same
/// time, and nothing would be known of how much nights differ.
#[must_use]
pub fn stamp() -> String {
    humantime::format_rfc3339_micros(SystemTime::now()).to_string()
}

#[cfg(test)]
mod tests {
    use record::progress::Progress;

    use super::*;

    #[test]
    fn a_line_that_a_crash_cut_does_not_swallow_the_next_one() {
        let folder = tempfile::tempdir().unwrap();
        let place = Place::root(folder.path()).join("events.jsonl");
        std::fs::write(
            place.path(),
            r#"{"at":"2026-01-01T00:00:00.000Z","event":"run-fin"#,
        )
        .unwrap();
        Journal::open(&place)
            .unwrap()
            .append(Event::RunInterrupted)
            .unwrap();
        let text = std::fs::read_to_string(place.path()).unwrap();
        assert_eq!(text.lines().count(), 2);
        let last: JournalEntry = serde_json::from_str(text.lines().last().unwrap()).unwrap();
        assert_eq!(last.event, Event::RunInterrupted);
    }

    #[test]
    fn a_line_is_of_a_microsecond_and_of_a_workloads_words_it_has_the_beginning() {
        let folder = tempfile::tempdir().unwrap();
        let place = Place::root(folder.path()).join("events.jsonl");
        let failed = Event::Workload {
            scenario: "a".to_owned(),
            progress: Progress::Failed {
                reason: "r".repeat(64 << 10),
                hint: Some("h".repeat(64 << 10)),
                platform: true,
            },
        };
        let entry = Journal::open(&place).unwrap().append(failed).unwrap();
        assert_eq!(entry.at.len(), "2026-01-01T00:00:00.000000Z".len());
        let line = std::fs::read_to_string(place.path()).unwrap();
        assert!(
            line.len() < 2500 && line.contains("r…") && line.contains("h…"),
            "{} bytes",
            line.len()
        );
        let read = run_directory::Journal::read(&place).unwrap();
        assert_eq!(read.entries, [entry]);
    }

    #[test]
    fn lines_of_two_processes_with_a_cut_one_between_follow_on_each_other() {
        let folder = tempfile::tempdir().unwrap();
        let place = Place::root(folder.path()).join("events.jsonl");
        let start = |pid| Event::RunStarted {
            pid,
            resumed: pid > 1,
            manifest_sha256: None,
            plan_sha256: None,
        };
        for pid in 1..=3 {
            let mut journal = Journal::open(&place).unwrap();
            journal.append(start(pid)).unwrap();
            journal.append(Event::RunInterrupted).unwrap();
            let mut text = std::fs::read(place.path()).unwrap();
            text.extend_from_slice(br#"{"at":"2026-01-01T00:00:00.000Z","event":"run-fin"#);
            std::fs::write(place.path(), text).unwrap();
        }
        let read = run_directory::Journal::read(&place).unwrap();
        assert_eq!((read.entries.len(), read.cut_lines), (6, vec![3, 6, 9]));
        assert!(read.chain.is_checked());
    }
}
