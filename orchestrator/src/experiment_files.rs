//! The files of a user's experiment: listed and packed once, before the run, and kept in its run directory, so that a resumed run
//! measures what it began with. The main type is [`ExperimentFiles`].

use std::{
    collections::BTreeSet,
    fmt, fs, io,
    path::{Component, Path, PathBuf},
    sync::Arc,
};

use ignore::{WalkBuilder, overrides::OverrideBuilder};
use record::{
    run_directory::{Manifest, RunDirectory},
    transfer::files,
};
use sha2::{Digest as _, Sha256};

/// More files no experiment has.
const MOST_FILES: usize = 10_000;

/// All of them, packed.
#[derive(Clone, PartialEq, Eq)]
pub struct ExperimentFiles(Arc<[u8]>);

impl fmt::Debug for ExperimentFiles {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "ExperimentFiles({} bytes)", self.0.len())
    }
}

/// Why they cannot be packed, or are not those that the run began with.
#[derive(Debug, thiserror::Error)]
pub enum ExperimentFilesError {
    /// There is nothing of that name.
    #[error("there is no `{path}` beside the matrix file")]
    Missing {
        /// As the matrix file has it.
        path: String,
    },
    /// It is not below the matrix file's folder, so that there is no place for it below that of the experiment.
    #[error("`{path}` is not below the folder of the matrix file")]
    Outside {
        /// As the matrix file has it.
        path: String,
    },
    /// A pattern is none.
    #[error("`{pattern}` is no pattern")]
    Pattern {
        /// As the matrix file has it.
        pattern: String,
        /// Why.
        source: ignore::Error,
    },
    /// A link, whose meaning is another one elsewhere.
    #[error("{} is a link", path.display())]
    Link {
        /// Where.
        path: PathBuf,
    },
    /// A pipe, a device or a socket, of which there is nothing to take along.
    #[error("{} is neither a file nor a folder", path.display())]
    Special {
        /// Where.
        path: PathBuf,
    },
    /// There are too many.
    #[error("there are more than {MOST_FILES} files")]
    Many,
    /// A folder cannot be read.
    #[error("the experiment's files cannot be listed")]
    List(#[from] ignore::Error),
    /// A file cannot be read.
    #[error("the experiment's files cannot be packed")]
    Pack(#[source] io::Error),
    /// The run directory has them no more.
    #[error("the run directory's copy of the experiment's files cannot be read")]
    Read(#[source] io::Error),
    /// The run directory has others.
    #[error("the experiment's files in the run directory are not those that the run began with")]
    Changed,
}

impl ExperimentFilesError {
    /// Whether it is about this entry of `files:`.
    #[must_use]
    pub fn names(&self, named: &str) -> bool {
        match self {
            Self::Missing { path } | Self::Outside { path } | Self::Pattern { pattern: path, .. } => {
                path == named
            }
            _ => false,
        }
    }

    /// What to do about it.
    #[must_use]
    pub const fn hint(&self) -> Option<&'static str> {
        match self {
            Self::Missing { .. } => {
                Some("paths under `files:` are relative to the folder of the matrix file")
            }
            Self::Pattern { .. } => Some("write patterns as in .gitignore, such as `!**/*.pyc`"),
            Self::Link { .. } => {
                Some("name what it leads to, or leave it out with a pattern such as `!sim/link`")
            }
            Self::Outside { .. } => Some("copy or move it there, and name it by its path from there"),
            Self::Special { .. } => Some("leave it out with a pattern such as `!sim/pipe`"),
            Self::Many => Some("leave some out with patterns such as `!sim/results/**`"),
            Self::Changed | Self::Read(_) => Some("begin the run anew with `matrix run`"),
            Self::List(_) | Self::Pack(_) => None,
        }
    }
}

impl ExperimentFiles {
    /// Packs the files that a matrix file in that folder names: files and folders, and patterns after `!` that are left out.
    ///
    /// # Errors
    /// When one is not there, is a link, or cannot be read.
    pub fn pack(folder: &Path, named: &[String]) -> Result<Self, ExperimentFilesError> {
        let paths = list(folder, named)?;
        let mut stream = Vec::new();
        files::pack(folder, &paths, &mut stream).map_err(ExperimentFilesError::Pack)?;
        Ok(Self(stream.into()))
    }

    /// Those of a run; none of one that has none.
    ///
    /// # Errors
    /// When they are not those that it began with.
    pub fn of_run(
        directory: &RunDirectory,
        manifest: &Manifest,
    ) -> Result<Option<Self>, ExperimentFilesError> {
        let Some(sha256) = &manifest.experiment_sha256 else {
            return Ok(None);
        };
        let bytes = directory
            .experiment()
            .read(files::MOST_BYTES)
            .map_err(ExperimentFilesError::Read)?;
        let files = Self(bytes.into());
        match files.sha256() == *sha256 {
            true => Ok(Some(files)),
            false => Err(ExperimentFilesError::Changed),
        }
    }

    /// The stream, as the workload unpacks it.
    #[must_use]
    pub fn stream(&self) -> &[u8] {
        &self.0
    }

    /// The same as a tar, as an engine unpacks it.
    ///
    /// # Errors
    /// When it is no such stream.
    pub fn as_tar(&self) -> io::Result<Vec<u8>> {
        files::as_tar(&*self.0)
    }

    /// Its SHA-256, in hexadecimal: the same for the same files.
    #[must_use]
    pub fn sha256(&self) -> String {
        format!("{:x}", Sha256::digest(&self.0))
    }
}

/// The regular files, by their paths below the folder, in order.
fn list(folder: &Path, named: &[String]) -> Result<Vec<PathBuf>, ExperimentFilesError> {
    let mut left_out = OverrideBuilder::new(folder);
    for pattern in named.iter().filter(|it| it.starts_with('!')) {
        left_out
            .add(pattern)
            .map_err(|source| ExperimentFilesError::Pattern {
                pattern: pattern.clone(),
                source,
            })?;
    }
    let left_out = left_out.build()?;
    let mut found = BTreeSet::new();
    for path in named.iter().filter(|it| !it.starts_with('!')) {
        let is_below = |part: Component<'_>| matches!(part, Component::Normal(_) | Component::CurDir);
        if !Path::new(path).components().all(is_below) {
            return Err(ExperimentFilesError::Outside { path: path.clone() });
        }
        let place = folder.join(path);
        let Ok(metadata) = fs::symlink_metadata(&place) else {
            return Err(ExperimentFilesError::Missing { path: path.clone() });
        };
        if let Some(path) = link_on_the_way(folder, path) {
            return Err(ExperimentFilesError::Link { path });
        }
        // A walk applies patterns to what is below its root.
        if left_out.matched(&place, metadata.is_dir()).is_ignore() {
            continue;
        }
        let mut walk = WalkBuilder::new(&place);
        walk.standard_filters(false).overrides(left_out.clone());
        for entry in walk.build() {
            let entry = entry?;
            let kind = entry.file_type();
            if entry.path_is_symlink() {
                return Err(ExperimentFilesError::Link {
                    path: entry.into_path(),
                });
            }
            if kind.is_some_and(|kind| !kind.is_file() && !kind.is_dir()) {
                return Err(ExperimentFilesError::Special {
                    path: entry.into_path(),
                });
            }
            if kind.is_some_and(|kind| kind.is_file()) {
                let below = entry.path().strip_prefix(folder).unwrap_or(entry.path());
                // `./sim` and `sim/` are one.
                found.insert(below.components().collect::<PathBuf>());
            }
            if found.len() > MOST_FILES {
                return Err(ExperimentFilesError::Many);
            }
        }
    }
    Ok(found.into_iter().collect())
}

/// A link among the folders that a path goes through: what is behind it may be anywhere.
fn link_on_the_way(folder: &Path, path: &str) -> Option<PathBuf> {
    let parts = Path::new(path).components();
    let places = parts.scan(folder.to_owned(), |place, part| {
        place.push(part);
        Some(place.clone())
    });
    let mut places = places.filter(|place| place.is_symlink());
    places.next()
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;

    fn folder() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for path in [
            "sim/reach.py",
            "sim/__pycache__/reach.pyc",
            "sim/.hidden",
            "setup.sh",
            "other.txt",
        ] {
            let place = folder.path().join(path);
            fs::create_dir_all(place.parent().unwrap()).unwrap();
            fs::write(place, path).unwrap();
        }
        folder
    }

    fn listed(folder: &tempfile::TempDir, named: &[&str]) -> Result<Vec<String>, String> {
        let named: Vec<String> = named.iter().map(|it| (*it).to_owned()).collect();
        let found = list(folder.path(), &named).map_err(|error| error.to_string())?;
        Ok(found.iter().map(|path| path.display().to_string()).collect())
    }

    #[test]
    fn files_and_folders_are_taken_and_patterns_left_out() {
        let folder = folder();
        assert_eq!(
            listed(&folder, &["./sim/", "setup.sh", "sim", "!**/*.pyc"]).unwrap(),
            ["setup.sh", "sim/.hidden", "sim/reach.py"]
        );
        assert_eq!(listed(&folder, &["sim", "!sim/"]).unwrap(), Vec::<String>::new());
    }

    #[test]
    fn what_is_not_there_or_a_link_is_told() {
        let folder = folder();
        assert_eq!(
            listed(&folder, &["sin"]).unwrap_err(),
            "there is no `sin` beside the matrix file"
        );
        symlink("/etc", folder.path().join("sim/etc")).unwrap();
        assert!(
            listed(&folder, &["sim"])
                .unwrap_err()
                .ends_with("sim/etc is a link")
        );
        assert!(listed(&folder, &["sim", "!sim/etc"]).is_ok());
        assert!(
            listed(&folder, &["sim/etc/passwd"])
                .unwrap_err()
                .ends_with("sim/etc is a link")
        );
    }

    #[test]
    fn what_has_no_place_in_an_experiment_is_told_before_anything_is_read() {
        let folder = folder();
        for outside in ["../..", "/etc/passwd", "sim/../../other"] {
            let told = listed(&folder, &[outside]).unwrap_err();
            assert_eq!(
                told,
                format!("`{outside}` is not below the folder of the matrix file")
            );
        }
        let socket = folder.path().join("sim/socket");
        let _listening = std::os::unix::net::UnixListener::bind(socket).unwrap();
        let told = listed(&folder, &["sim"]).unwrap_err();
        assert!(
            told.ends_with("sim/socket is neither a file nor a folder"),
            "{told}"
        );
        assert!(listed(&folder, &["sim", "!sim/socket"]).is_ok());
    }

    #[test]
    fn a_run_has_the_files_that_it_began_with_or_none() {
        let folder = folder();
        let files = ExperimentFiles::pack(folder.path(), &["sim".to_owned()]).unwrap();
        let directory = RunDirectory::new(folder.path());
        directory.experiment().write(files.stream()).unwrap();
        let recorded = include_str!("../../tests/fixtures/recorded/manifest.json");
        let mut manifest: Manifest = serde_json::from_str(recorded).unwrap();
        assert_eq!(ExperimentFiles::of_run(&directory, &manifest).unwrap(), None);
        manifest.experiment_sha256 = Some(files.sha256());
        assert_eq!(
            ExperimentFiles::of_run(&directory, &manifest).unwrap(),
            Some(files)
        );
        directory.experiment().write(b"others").unwrap();
        let changed = ExperimentFiles::of_run(&directory, &manifest).unwrap_err();
        assert!(matches!(changed, ExperimentFilesError::Changed));
    }
}
