//! A run brought down to its night, so that a year of nights fits a disk. The main type is [`Measurements`].
//!
//! The night is on the disk before the first file goes: whatever ends a process in between, `matrix drift` has the night, and the
//! next pruning removes the rest. Only files that a window's record names are removed, and the archive of a user's experiment.

use std::io;

use record::layout;
use record::run_directory::{Place, ReadError, RunDirectory, RunRecords, read_window};

use super::{Night, digest::Pruned};

/// What was measured in a run and is there: all that pruning removes.
#[derive(Debug)]
pub struct Measurements {
    directory: RunDirectory,
    files: Vec<Place>,
    bytes: u64,
}

impl Measurements {
    /// Those of a run directory.
    ///
    /// # Errors
    /// When its records cannot be read: what else is in it is not known then.
    pub fn of(directory: RunDirectory) -> Result<Self, ReadError> {
        let records = RunRecords::read(&directory)?;
        let mut files = vec![directory.experiment()];
        for planned in &records.plan.scenarios {
            let known = records.state.scenario(&planned.slug);
            for number in 1..=planned.settings.all_windows() {
                let folder = directory.window(&planned.slug, number);
                // What nobody can read is no window that counts, and stays.
                if let Ok(record) = read_window(&folder, known.window_sha256(number)) {
                    let measured = record.files.iter().filter(|file| file.name != layout::WINDOW);
                    files.extend(measured.map(|file| folder.join(&file.name)));
                }
            }
        }
        let bytes = |file: &Place| file.bytes().ok();
        files.retain(|file| bytes(file).is_some());
        Ok(Self {
            bytes: files.iter().filter_map(bytes).sum(),
            files,
            directory,
        })
    }

    /// How many files they are.
    #[must_use]
    pub const fn files(&self) -> usize {
        self.files.len()
    }

    /// Their bytes.
    #[must_use]
    pub const fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Keeps the night that they came to, and removes them. `at` is now, RFC 3339.
    ///
    /// # Errors
    /// When the night cannot be written, and nothing is removed; or when a file cannot be removed.
    pub fn remove(self, night: &Night, at: &str) -> io::Result<()> {
        let place = self.directory.pruned();
        if !place.exists() {
            let kept = Pruned::of(night, at, (self.files.len(), self.bytes));
            place.write(&serde_json::to_vec(&kept)?)?;
        }
        self.files.iter().try_for_each(Place::remove_file)
    }
}
