//! A run's night, kept in its folder: of a year of runs only the newest has to be read whole. The main function is
//! [`night_of`].
//!
//! ```text
//! report/night.json    made_from    SHA-256 of the name, length and time of change of every file of the run
//!                      night        what they came to
//! ```
//!
//! What is kept is believed while no file of the run is another than it was; else the run is read again. It can be removed
//! at any time, and one that cannot be written is no error: it only saves time.

use std::{
    fs,
    io::{self, BufWriter},
    path::{Path, PathBuf},
    time::UNIX_EPOCH,
};

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::Night;
use crate::{
    run_directory::{ReadError, RunDirectory},
    traffic,
};

/// Raised whenever a night's numbers are taken in another way: what was kept is then read anew.
const FORMAT: u32 = 2;

/// What is kept.
#[derive(Serialize, Deserialize)]
struct Kept<N> {
    format: u32,
    made_from: String,
    night: N,
}

/// The night of a run directory, from what was kept of it or from all of it.
///
/// # Errors
/// When nothing that is true was kept and the run cannot be read.
pub fn night_of(path: &Path) -> Result<Night, ReadError> {
    let directory = RunDirectory::new(path);
    // Before it is read: what changes meanwhile is read again the next time.
    let made_from = state_of(&directory).ok();
    let kept = made_from
        .as_ref()
        .and_then(|made_from| read(&file_of(&directory), made_from));
    if let Some(night) = kept {
        return Ok(night);
    }
    let run = crate::load(path)?;
    let night = Night::of(&run, &traffic::read(&run))?;
    if let Some(made_from) = made_from {
        // See the module's header.
        let _ = write(
            &directory,
            &Kept {
                format: FORMAT,
                made_from,
                night: &night,
            },
        );
    }
    Ok(night)
}

fn file_of(directory: &RunDirectory) -> PathBuf {
    directory.report().join("night.json")
}

fn read(path: &Path, made_from: &str) -> Option<Night> {
    let kept: Kept<Night> = serde_json::from_slice(&fs::read(path).ok()?).ok()?;
    (kept.format == FORMAT && kept.made_from == made_from).then_some(kept.night)
}

/// A reader sees the old one or the new one, never a part.
fn write(directory: &RunDirectory, kept: &Kept<&Night>) -> io::Result<()> {
    fs::create_dir_all(directory.report())?;
    let path = file_of(directory);
    let beside = path.with_extension("json.new");
    serde_json::to_writer(BufWriter::new(fs::File::create(&beside)?), kept)?;
    fs::rename(beside, path)
}

/// By what it is known whether a run is as it was. Reports are made of it and say nothing new.
fn state_of(directory: &RunDirectory) -> io::Result<String> {
    let mut files = Vec::new();
    let mut folders = vec![directory.path().to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder)? {
            let path = entry?.path();
            let about = path.metadata()?;
            if about.is_dir() && path != directory.report() {
                folders.push(path);
            } else if about.is_file() {
                let changed = about.modified()?.duration_since(UNIX_EPOCH).unwrap_or_default();
                files.push((path, about.len(), changed.as_nanos()));
            }
        }
    }
    files.sort();
    let mut hasher = Sha256::new();
    for (path, bytes, changed_ns) in files {
        let name = path.strip_prefix(directory.path()).unwrap_or(&path);
        hasher.update(name.as_os_str().as_encoded_bytes());
        hasher.update(format!("\0{bytes}\0{changed_ns}\0"));
    }
    Ok(format!("{:x}", hasher.finalize()))
}
