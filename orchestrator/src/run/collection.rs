//! From an environment's data folder into the run directory: whole windows are verified, compressed and take their
//! place, broken ones are kept aside. The main function is [`sort_windows`].
//!
//! A window is whole when its `window.json` says so and every file beside it has the length and the checksum that it
//! names. Nothing is ever joined, mended or overwritten.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use reports::run_directory::RunDirectory;
use workload::record::window::{FileRecord, Verdict, WindowRecord};

use super::compression::compress_captures;

/// A folder could not be read or moved.
#[derive(Debug, thiserror::Error)]
#[error("{doing} {}", path.display())]
pub struct CollectionError {
    doing: &'static str,
    path: PathBuf,
    source: io::Error,
}

/// What became of one window.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Sorted {
    /// It is in the run directory.
    Whole {
        /// Its number.
        window: u32,
        /// What it is worth.
        verdict: Verdict,
    },
    /// It is kept aside.
    Broken {
        /// Its number.
        window: u32,
        /// Why.
        reason: String,
    },
}

/// Moves the windows that were collected into `from` to their places. Windows of which nothing is there are not
/// mentioned.
///
/// # Errors
/// When the run directory cannot be written. What was moved by then stays moved.
pub fn sort_windows(
    run: &RunDirectory,
    slug: &str,
    environment: &str,
    windows: &[u32],
    from: &Path,
) -> Result<Vec<Sorted>, CollectionError> {
    let mut sorted = Vec::new();
    for &window in windows {
        let folder = from.join(format!("window-{window}"));
        if !folder.is_dir() {
            continue;
        }
        let place = run.window(slug, window);
        // A crash between the move and its line in the journal: the window has its place, this is a second copy.
        if same_window(&folder, &place)
            && let Ok(verdict) = verify(&place)
        {
            sorted.push(Sorted::Whole { window, verdict });
            continue;
        }
        let verified = verify(&folder).and_then(|verdict| match place.exists() {
            true => Err("the run directory has another window of this number".to_owned()),
            false => Ok(verdict),
        });
        match verified {
            Ok(verdict) => {
                compress_captures(&folder).map_err(|source| CollectionError {
                    doing: "cannot compress the captures in",
                    path: folder.clone(),
                    source,
                })?;
                move_folder(&folder, &place)?;
                sorted.push(Sorted::Whole { window, verdict });
            }
            Err(reason) => {
                let aside = run.broken(slug, environment).join(format!("window-{window}"));
                // What an earlier try put aside is a copy of the same.
                if !aside.exists() {
                    move_folder(&folder, &aside)?;
                }
                sorted.push(Sorted::Broken { window, reason });
            }
        }
    }
    Ok(sorted)
}

/// Whether two folders hold one and the same window: its record has the checksums of all that is beside it.
fn same_window(one: &Path, other: &Path) -> bool {
    let record = |folder: &Path| {
        let text = fs::read(folder.join("window.json")).ok()?;
        let mut record: WindowRecord = serde_json::from_slice(&text).ok()?;
        record.files = record.files.iter().map(FileRecord::as_measured).collect();
        Some(record)
    };
    matches!((record(one), record(other)), (Some(one), Some(other)) if one == other)
}

/// What a window's folder is worth, or why it is broken.
///
/// # Errors
/// The reason, for a person.
pub fn verify(folder: &Path) -> Result<Verdict, String> {
    let path = folder.join("window.json");
    let text = fs::read_to_string(&path).map_err(|error| match error.kind() {
        io::ErrorKind::NotFound => "it was cut: there is no window.json, which is written last".to_owned(),
        _ => format!("window.json cannot be read: {error}"),
    })?;
    let record: WindowRecord = serde_json::from_str(&text)
        .map_err(|error| format!("window.json is not a window's record: {error}"))?;
    if !record.complete {
        return Err(format!(
            "it was cut after {} of {} steps",
            record.steps_done, record.steps_expected
        ));
    }
    for file in &record.files {
        let name = Path::new(&file.name);
        if name.components().count() != 1 || name.file_name().is_none() {
            return Err(format!(
                "window.json names a file outside its folder: {}",
                file.name
            ));
        }
        let (bytes, sha256) =
            digest(&folder.join(name)).map_err(|error| format!("{} cannot be read: {error}", file.name))?;
        if bytes != file.bytes {
            return Err(format!(
                "{} has {bytes} bytes instead of {}",
                file.name, file.bytes
            ));
        }
        if sha256 != file.sha256 {
            return Err(format!(
                "the checksum of {} does not match window.json",
                file.name
            ));
        }
    }
    Ok(record.verdict)
}

/// Length and SHA-256 in hexadecimal.
fn digest(path: &Path) -> io::Result<(u64, String)> {
    use sha2::{Digest, Sha256};
    let mut hasher = Sha256::new();
    let bytes = io::copy(&mut fs::File::open(path)?, &mut hasher)?;
    Ok((bytes, format!("{:x}", hasher.finalize())))
}

/// Both folders are in the run directory, and so on one file system: a rename is atomic.
fn move_folder(from: &Path, to: &Path) -> Result<(), CollectionError> {
    let fail = |doing, path: &Path, source| CollectionError {
        doing,
        path: path.to_owned(),
        source,
    };
    if let Some(parent) = to.parent() {
        fs::create_dir_all(parent).map_err(|error| fail("cannot create", parent, error))?;
    }
    fs::rename(from, to).map_err(|error| fail("cannot move a window to", to, error))?;
    if let Some(parent) = to.parent() {
        fs::File::open(parent)
            .and_then(|folder| folder.sync_all())
            .map_err(|error| fail("cannot sync", parent, error))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A folder with a window that cannot be read, and the run directory that it is to go to.
    fn cut_window() -> (tempfile::TempDir, RunDirectory, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let run = RunDirectory::new(folder.path().join("run"));
        let from = folder.path().join("from");
        fs::create_dir_all(from.join("window-1")).unwrap();
        fs::write(from.join("window-1/control.csv"), "step\n").unwrap();
        (folder, run, from)
    }

    #[test]
    fn a_window_without_its_record_is_kept_aside_and_its_place_stays_free() {
        let (_folder, run, from) = cut_window();
        let sorted = sort_windows(&run, "s", "e-1", &[1, 2], &from).unwrap();
        assert!(matches!(&sorted[..], [Sorted::Broken { window: 1, reason }] if reason.contains("cut")));
        assert!(!run.window("s", 1).exists());
        assert!(run.broken("s", "e-1").join("window-1/control.csv").exists());
    }

    #[test]
    fn what_was_put_aside_already_is_not_moved_again() {
        let (_folder, run, from) = cut_window();
        fs::create_dir_all(run.broken("s", "e-1").join("window-1")).unwrap();
        assert_eq!(sort_windows(&run, "s", "e-1", &[1], &from).unwrap().len(), 1);
    }
}
