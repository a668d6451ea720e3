//! From an environment's data folder into the run directory: whole windows are verified, compressed and take their
//! place, broken ones are kept aside. The main function is [`sort_windows`].
//!
//! A window is whole when its `window.json` says so and every file beside it has the length and the checksum that it
//! names. Nothing is ever joined, mended or overwritten.

use std::{io, path::PathBuf};

use record::{
    layout,
    run_directory::{Place, RunDirectory, ensure_window_is_whole, read_window},
    window::{FileRecord, Verdict},
};

use super::compression::compress_captures;
use crate::disk_space;

/// A folder could not be read or moved.
#[derive(Debug, thiserror::Error)]
#[error("{doing} {}", path.display())]
pub struct CollectionError {
    doing: &'static str,
    path: PathBuf,
    source: io::Error,
}

impl CollectionError {
    /// What to do about it.
    #[must_use]
    pub fn hint(&self) -> String {
        disk_space::hint(&self.source)
    }
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
        /// SHA-256 of its `window.json`.
        sha256: String,
    },
    /// It is kept aside.
    Broken {
        /// Its number.
        window: u32,
        /// What is wrong with the window's files.
        reason: String,
    },
}

impl Sorted {
    /// The window's number.
    #[must_use]
    pub const fn window(&self) -> u32 {
        match self {
            Self::Whole { window, .. } | Self::Broken { window, .. } => *window,
        }
    }
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
    from: &Place,
) -> Result<Vec<Sorted>, CollectionError> {
    let mut sorted = Vec::new();
    for &window in windows {
        let folder = from.join(layout::window_folder(window));
        if !folder.is_folder() {
            continue;
        }
        let place = run.window(slug, window);
        // A crash between the move and its line in the journal: the window has its place, this is a second copy.
        if same_window(&folder, &place)
            && let Ok(record) = ensure_window_is_whole(&place, window, None)
        {
            keep(&place)?;
            let (verdict, sha256) = (record.verdict, record_sha256(&place)?);
            sorted.push(Sorted::Whole {
                window,
                verdict,
                sha256,
            });
            continue;
        }
        let verified = match ensure_window_is_whole(&folder, window, None) {
            Ok(_) if place.exists() => Err("the run directory has another window of this number".to_owned()),
            Ok(record) => Ok(record.verdict),
            // Where that is not known, its original stays where it is.
            Err(not_whole) => Err(not_whole.known_reason().map_err(failed("cannot read", &folder))?),
        };
        match verified {
            Ok(verdict) => {
                compress_captures(&folder).map_err(failed("cannot compress the captures in", &folder))?;
                sync(&folder).map_err(failed("cannot wait until the disk has", &folder))?;
                let sha256 = record_sha256(&folder)?;
                move_folder(&folder, &place)?;
                sorted.push(Sorted::Whole {
                    window,
                    verdict,
                    sha256,
                });
            }
            Err(reason) => {
                put_aside(run, slug, environment, window, &folder)?;
                sorted.push(Sorted::Broken { window, reason });
            }
        }
    }
    Ok(sorted)
}

/// Whether two folders hold one and the same window: its record has the checksums of all that is beside it.
fn same_window(one: &Place, other: &Place) -> bool {
    let as_measured = |folder: &Place| {
        let mut record = read_window(folder, None).ok()?;
        record.files = record.files.iter().map(FileRecord::as_measured).collect();
        Some(record)
    };
    matches!((as_measured(one), as_measured(other)), (Some(one), Some(other)) if one == other)
}

/// By what a window's record is known again.
///
/// # Errors
/// When it cannot be read.
pub(super) fn record_sha256(window: &Place) -> Result<String, CollectionError> {
    let record = window.join(layout::WINDOW);
    Ok(record.digest().map_err(failed("cannot read", &record))?.sha256)
}

/// Waits until all of a window is on the disk. Its original goes once the journal says that it was collected.
fn sync(folder: &Place) -> io::Result<()> {
    for (place, _) in folder.entries()? {
        place.sync()?;
    }
    folder.sync()
}

/// Moves what is no window that counts to where nothing is counted.
///
/// # Errors
/// When it cannot be moved.
pub(super) fn put_aside(
    run: &RunDirectory,
    slug: &str,
    environment: &str,
    window: u32,
    folder: &Place,
) -> Result<(), CollectionError> {
    let broken = run.broken(slug, environment);
    let name = layout::window_folder(window);
    // What was put aside before stays: it may be another.
    let names = std::iter::once(name.clone()).chain((2..).map(|number| format!("{name}-{number}")));
    let aside = names.map(|name| broken.join(name)).find(|place| !place.exists());
    aside.map_or(Ok(()), |aside| move_folder(folder, &aside))
}

/// Both folders are in the run directory, and so on one file system: a rename is atomic.
fn move_folder(from: &Place, to: &Place) -> Result<(), CollectionError> {
    let parent = to.parent();
    parent.make_folder().map_err(failed("cannot create", &parent))?;
    from.rename(to).map_err(failed("cannot move a window to", to))?;
    sync_above(to)
}

/// Waits until a window that is in its place is on the disk there.
///
/// # Errors
/// When the disk fails.
pub(super) fn keep(window: &Place) -> Result<(), CollectionError> {
    sync(window).map_err(failed("cannot wait until the disk has", window))?;
    sync_above(window)
}

/// The folders above a window may be new too.
fn sync_above(window: &Place) -> Result<(), CollectionError> {
    let scenario = window.parent();
    for above in [scenario.clone(), scenario.parent(), scenario.parent().parent()] {
        above.sync().map_err(failed("cannot sync", &above))?;
    }
    Ok(())
}

pub(super) fn failed(
    doing: &'static str,
    place: &Place,
) -> impl FnOnce(io::Error) -> CollectionError + use<> {
    let path = place.path();
    move |source| CollectionError { doing, path, source }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use record::{quantity::TimeSpan, settings::Settings};

    use super::*;
    use crate::provider::fake::window::{FakeWindow, Noise, write};

    /// A run directory, and in it a folder with a window that cannot be read.
    fn cut_window() -> (tempfile::TempDir, RunDirectory, Place) {
        let folder = tempfile::tempdir().unwrap();
        let run = RunDirectory::new(folder.path());
        let from = run.scenario("s").join("collecting-e-1");
        from.join("window-1").make_folder().unwrap();
        fs::write(from.join("window-1/control.csv").path(), "step\n").unwrap();
        (folder, run, from)
    }

    #[test]
    fn a_window_without_its_record_is_kept_aside_and_its_place_stays_free() {
        let (_folder, run, from) = cut_window();
        let sorted = sort_windows(&run, "s", "e-1", &[1, 2], &from).unwrap();
        assert!(
            matches!(&sorted[..], [Sorted::Broken { window: 1, reason }] if reason.contains("never finished"))
        );
        assert!(!run.window("s", 1).exists());
        assert!(run.broken("s", "e-1").join("window-1/control.csv").exists());
    }

    #[test]
    fn a_window_in_the_folder_of_another_is_kept_aside() {
        let (_folder, run, from) = cut_window();
        let settings = Settings {
            window: TimeSpan::from_secs(10),
            period: TimeSpan::from_secs(10),
            ..Settings::default()
        };
        let first = FakeWindow {
            environment: "e-1",
            settings: &settings,
            window: 1,
            before: 0,
            steps: settings.steps_per_window(),
            noise: Noise {
                seed: 1,
                scenario: "s",
                mean_m: 0.0,
                deviation_m: 0.0,
            },
        };
        from.join("window-2").make_folder().unwrap();
        write(&first, &from.join("window-2").path(), true).unwrap();
        let sorted = sort_windows(&run, "s", "e-1", &[2], &from).unwrap();
        assert!(
            matches!(&sorted[..], [Sorted::Broken { window: 2, reason }] if reason.contains("that of window 1"))
        );
        assert!(!run.window("s", 2).exists());
    }

    #[test]
    fn what_was_put_aside_already_is_not_moved_again() {
        let (_folder, run, from) = cut_window();
        run.broken("s", "e-1").join("window-1").make_folder().unwrap();
        assert_eq!(sort_windows(&run, "s", "e-1", &[1], &from).unwrap().len(), 1);
    }
}
