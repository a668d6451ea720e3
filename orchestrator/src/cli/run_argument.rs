//! A run directory on the command line: a folder, or `latest`. The function is [`run_argument`].

use std::{
    ffi::{OsStr, OsString},
    path::{Path, PathBuf},
};

use clap::builder::{OsStringValueParser, TypedValueParser};
use record::run_directory::RunDirectory;

use crate::run::recorded::newest_first;

/// The folder in which `matrix run` makes run directories.
pub const RUNS: &str = "runs";
/// The newest of them.
const LATEST: &str = "latest";

/// There is no newest run.
#[derive(Debug, thiserror::Error)]
#[error("there is no run in `{}`: name a run directory, or run `matrix` where the folder of your runs is", folder.display())]
struct NoRun {
    folder: PathBuf,
}

/// Reads a run directory's path, or `latest` for the newest run in `runs/`.
#[must_use]
pub fn run_argument() -> impl TypedValueParser<Value = PathBuf> {
    OsStringValueParser::new().try_map(|text: OsString| resolve(&text, Path::new(RUNS)))
}

/// The newest run in `runs/`.
#[must_use]
pub fn newest_run() -> Option<PathBuf> {
    newest(Path::new(RUNS))
}

/// A run directory by its path or by `latest`; none if there is no newest.
#[must_use]
pub fn run_named(text: &OsStr) -> Option<PathBuf> {
    resolve(text, Path::new(RUNS)).ok()
}

fn newest(runs: &Path) -> Option<PathBuf> {
    newest_first(runs).into_iter().find(|run| is_run(run))
}

/// Whether a folder is a run directory.
#[must_use]
pub fn is_run(folder: &Path) -> bool {
    RunDirectory::new(folder).manifest().exists()
}

fn resolve(text: &OsStr, runs: &Path) -> Result<PathBuf, NoRun> {
    let path = Path::new(text);
    // A folder that is called so is meant by its name.
    if text != LATEST || path.exists() {
        return Ok(path.to_owned());
    }
    newest(runs).ok_or_else(|| NoRun {
        folder: runs.to_owned(),
    })
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn the_latest_is_the_newest_folder_that_is_a_run() {
        let folder = tempfile::tempdir().unwrap();
        let error = resolve(OsStr::new(LATEST), folder.path())
            .unwrap_err()
            .to_string();
        assert!(error.starts_with("there is no run in"), "{error}");
        for (name, is_run) in [
            ("20260101-000000", true),
            ("20260102-000000", true),
            ("zzz", false),
        ] {
            fs::create_dir(folder.path().join(name)).unwrap();
            if is_run {
                fs::write(folder.path().join(name).join("manifest.json"), "{}").unwrap();
            }
        }
        let found = resolve(OsStr::new(LATEST), folder.path()).unwrap();
        assert_eq!(found, folder.path().join("20260102-000000"));
        assert_eq!(resolve(OsStr::new("x"), folder.path()).unwrap(), Path::new("x"));
    }
}
