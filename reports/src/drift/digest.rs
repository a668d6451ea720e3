//! A run's night, kept in its folder: of a year of runs only the newest has to be read whole. The main function is
//! [`night_of`].
//!
//! ```text
//! report/night.json    made_from    SHA-256 of the name, length and time of change of every file of the run
//!                      night        what they came to
//!                      sha256       of that, as JSON without white space
//! pruned.json          format       how the numbers of the night were taken
//!                      at           when what was measured was removed
//!                      files        how many files that was, and their bytes
//!                      night        what they came to
//!                      sha256       of that
//! ```
//!
//! What is kept is believed while no file of the run is another than it was; else the run is read again. It can be removed
//! at any time, and one that cannot be written is no error: it only saves time.
//! Not so the night of a run that was pruned: nothing else has its numbers.

use std::{
    io::{self, Write as _},
    path::Path,
    time::UNIX_EPOCH,
};

use record::run_directory::{Kind, Place, ReadError, RunDirectory, from_json, read_file, values_in};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::Night;
use crate::input::traffic;

/// Raised whenever a night's numbers are taken in another way: what was kept is then read anew.
const FORMAT: u32 = 4;

/// A night of a thousand scenarios of a hundred windows, with all that is compared of it, is two thirds of it.
const LONGEST: u64 = 32 << 20;
/// Such a night has 800,000 values, as [`values_in`] counts them.
const MOST_VALUES: usize = 1 << 20;

/// What is kept.
#[derive(Serialize, Deserialize)]
struct Kept<N> {
    format: u32,
    made_from: String,
    night: N,
    sha256: String,
}

/// What is kept of a run of which what was measured was removed.
#[derive(Serialize, Deserialize)]
pub(super) struct Pruned<N> {
    format: u32,
    at: String,
    files: usize,
    bytes: u64,
    night: N,
    sha256: String,
}

impl<'a> Pruned<&'a Night> {
    /// Of a run whose files, so many and of so many bytes, are to be removed now.
    pub(super) fn of(night: &'a Night, at: &str, (files, bytes): (usize, u64)) -> Self {
        Self {
            format: FORMAT,
            at: at.to_owned(),
            files,
            bytes,
            sha256: sha256_of(night),
            night,
        }
    }
}

/// The night of a run directory that its user named.
///
/// # Errors
/// As [`night_in`].
pub fn night_of(path: &Path) -> Result<Night, ReadError> {
    night_in(&RunDirectory::new(path))
}

/// The night of a run directory, from what was kept of it or from all of it.
///
/// # Errors
/// When nothing that is true was kept and the run cannot be read.
pub fn night_in(directory: &RunDirectory) -> Result<Night, ReadError> {
    if let Some(night) = of_pruned(directory)? {
        return Ok(night);
    }
    // Before it is read: what changes meanwhile is read again the next time.
    let made_from = state_of(directory).ok();
    let kept = made_from
        .as_ref()
        .and_then(|made_from| read(&file_of(directory), made_from));
    if let Some(night) = kept {
        return Ok(night);
    }
    let run = crate::load_from(directory, None)?;
    let night = Night::of(&run, &traffic::read(&run));
    if let Some(made_from) = made_from {
        // See the module's header.
        let _ = write(
            directory,
            &Kept {
                format: FORMAT,
                made_from,
                sha256: sha256_of(&night),
                night: &night,
            },
        );
    }
    Ok(night)
}

/// The night of a run that was pruned; none of any other.
///
/// # Errors
/// When it is there and cannot be believed: nothing else has its numbers.
fn of_pruned(directory: &RunDirectory) -> Result<Option<Night>, ReadError> {
    let place = directory.pruned();
    if !place.exists() {
        return Ok(None);
    }
    let text = read_file(&place, LONGEST)?;
    let damaged = |how: &str| ReadError::Damaged {
        path: place.path(),
        how: how.to_owned(),
    };
    if values_in(&text) > MOST_VALUES {
        return Err(damaged("it has more values than a night can have"));
    }
    let kept: Pruned<Night> = from_json(&text).map_err(|source| ReadError::Json {
        path: place.path(),
        source,
    })?;
    // Numbers that were taken in an earlier way stay what they are: they cannot be taken anew.
    match kept.format {
        format if format > FORMAT => Err(ReadError::FutureFormat {
            path: place.path(),
            found: format.into(),
            known: FORMAT,
        }),
        _ if kept.sha256 != sha256_of(&kept.night) => {
            Err(damaged("its SHA-256 is not the one that it has of its night"))
        }
        _ => Ok(Some(kept.night)),
    }
}

fn file_of(directory: &RunDirectory) -> Place {
    directory.report().join("night.json")
}

fn read(place: &Place, made_from: &str) -> Option<Night> {
    let text = place.read(LONGEST).ok()?;
    if values_in(&text) > MOST_VALUES {
        return None;
    }
    let kept: Kept<Night> = from_json(&text).ok()?;
    drop(text);
    let is_of_now = kept.format == FORMAT && kept.made_from == made_from;
    (is_of_now && kept.sha256 == sha256_of(&kept.night)).then_some(kept.night)
}

fn sha256_of(night: &Night) -> String {
    let mut hasher = Sha256::new();
    // Plain data can always be written as JSON, and a hasher takes all.
    let _ = serde_json::to_writer(&mut hasher, night);
    format!("{:x}", hasher.finalize())
}

/// A reader sees the old one or the new one, never a part.
fn write(directory: &RunDirectory, kept: &Kept<&Night>) -> io::Result<()> {
    directory.report().make_folder()?;
    let (unfinished, mut out) = file_of(directory).begin()?;
    serde_json::to_writer(&mut out, kept)?;
    out.flush()?;
    unfinished.finish().map(drop)
}

/// By what it is known whether a run is as it was. Reports are made of it and say nothing new.
fn state_of(directory: &RunDirectory) -> io::Result<String> {
    let mut look = Look {
        directory,
        hasher: Sha256::new(),
        entries: 0,
    };
    look.at(directory.root(), 0)?;
    Ok(format!("{:x}", look.hasher.finalize()))
}

/// Folders in each other. Below a run directory are five: `scenarios/<slug>/broken/<environment>/window-1`.
const DEEPEST: usize = 16;
/// Files and folders of a run. Two hundred thousand windows, more than which no plan has, have most of it.
const MOST_ENTRIES: usize = 1 << 21;

/// A look at all files of a run, by name. Nothing is kept but the sum: another may have put any number of files there.
struct Look<'a> {
    directory: &'a RunDirectory,
    hasher: Sha256,
    entries: usize,
}

impl Look<'_> {
    fn at(&mut self, folder: &Place, depth: usize) -> io::Result<()> {
        if depth > DEEPEST {
            return Err(no_run_has("deeper folders"));
        }
        for (place, kind) in folder.entries()? {
            self.entries += 1;
            if self.entries > MOST_ENTRIES {
                return Err(no_run_has("more files"));
            }
            match kind {
                Kind::Folder if place != self.directory.report() => self.at(&place, depth + 1)?,
                // Only its owner may open it, and it says nothing of what was measured.
                Kind::File if place == self.directory.lock() => {}
                Kind::File => self.note(&place)?,
                Kind::Folder | Kind::Other => {}
            }
        }
        Ok(())
    }

    fn note(&mut self, place: &Place) -> io::Result<()> {
        let about = place.open()?.metadata()?;
        let changed = about.modified()?.duration_since(UNIX_EPOCH).unwrap_or_default();
        let path = place.path();
        let name = path.strip_prefix(self.directory.path()).unwrap_or(&path);
        self.hasher.update(name.as_os_str().as_encoded_bytes());
        self.hasher
            .update(format!("\0{}\0{}\0", about.len(), changed.as_nanos()));
        Ok(())
    }
}

fn no_run_has(what: &str) -> io::Error {
    io::Error::other(format!("it has {what} than any run has"))
}

#[cfg(test)]
mod tests {
    use std::{fs, time::Instant};

    use super::*;

    #[test]
    fn a_run_with_folders_deeper_than_any_has_is_looked_at_no_further() {
        let folder = tempfile::tempdir().unwrap();
        let directory = RunDirectory::new(folder.path());
        fs::write(folder.path().join("plan.json"), "{}").unwrap();
        let broken = directory.broken("s", "e-1").join("window-1");
        broken.make_folder().unwrap();
        broken.join("window.json").write(b"{}").unwrap();
        let before = state_of(&directory).unwrap();
        broken.join("window.json").write(b"{ }").unwrap();
        assert_ne!(state_of(&directory).unwrap(), before);
        let mut deep = directory.root().clone();
        for _ in 0..200 {
            deep = deep.join("d");
        }
        deep.make_folder().unwrap();
        let begun = Instant::now();
        assert!(state_of(&directory).is_err());
        assert!(begun.elapsed().as_secs() < 5);
    }

    /// A night of which one scenario was asked for that.
    fn pruned(configuration: &str) -> Result<Option<Night>, ReadError> {
        let folder = tempfile::tempdir().unwrap();
        let directory = RunDirectory::new(folder.path());
        let night = format!(
            r#"{{"run":"r","created":"2026-11-28T00:00:00.000Z","is_simulated":false,"metric":"error","matters_m":null,"scenarios":{{"s":{{"configuration":{configuration},"environment":null,"values":{{}},"lack":null}}}}}}"#
        );
        let sha256 = format!("{:x}", Sha256::digest(&night));
        let text =
            format!(r#"{{"format":4,"at":"x","files":1,"bytes":1,"night":{night},"sha256":"{sha256}"}}"#);
        fs::write(directory.pruned().path(), text).unwrap();
        of_pruned(&directory)
    }

    #[test]
    fn a_night_with_more_settings_than_any_run_has_is_refused() {
        let many = |count| {
            format!(
                r#"{{"settings":{{"zz":[{}]}}}}"#,
                vec![r#"{"":0}"#; count].join(",")
            )
        };
        let error = pruned(&many(330_000)).unwrap_err();
        assert!(
            record::causes::with_causes(&error).contains("values"),
            "{error:?}"
        );
        let night = pruned(&many(1_000)).unwrap().unwrap();
        let settings = night.scenarios["s"].configuration.read();
        assert_eq!(settings["settings"]["zz"].as_array().unwrap().len(), 1_000);
    }
}
