//! The folder of an environment that has no platform to keep its things: of fake ones. The main type is
//! [`EnvironmentDirectory`].
//!
//! ```text
//! environments/<name>/
//!   owner.json    what it belongs to: Owner
//!   lines.jsonl   the workload's standard output
//!   data/         its data folder
//! ```

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use record::{
    detached::{Owner, UNFINISHED},
    layout,
    run_directory::Resource,
};

use super::{Leftover, ProviderError};
use crate::state_directory::StateDirectory;

/// The folder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EnvironmentDirectory(PathBuf);

impl EnvironmentDirectory {
    /// The folder that an environment of this name has or would have.
    #[must_use]
    pub fn of(state: &StateDirectory, environment: &str) -> Self {
        Self(state.environments().join(environment))
    }

    /// Every environment's folder and its owner; the owner is none where a crash came before it was written.
    ///
    /// # Errors
    /// When the state directory is there but cannot be read.
    pub fn all(state: &StateDirectory) -> Result<Vec<(Self, Option<Owner>)>, ProviderError> {
        let root = state.environments();
        let failed = |source| ProviderError::File {
            action: "read",
            path: root.clone(),
            source,
        };
        let entries = match fs::read_dir(&root) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
            entries => entries.map_err(failed)?,
        };
        let mut all = Vec::new();
        for entry in entries {
            let entry = entry.map_err(failed)?;
            if entry.file_type().map_err(failed)?.is_dir() {
                let directory = Self(entry.path());
                let owner = directory.owner();
                all.push((directory, owner));
            }
        }
        all.sort_by(|(a, _), (b, _)| a.0.cmp(&b.0));
        Ok(all)
    }

    /// Makes the folder, with its owner in it.
    ///
    /// # Errors
    /// When there is one of that name already, or it cannot be made.
    pub fn create(&self, owner: &Owner) -> Result<(), ProviderError> {
        if let Some(parent) = self.0.parent() {
            fs::create_dir_all(parent).map_err(self.failed("create", parent))?;
        }
        // Made beside its place and moved there, so that a folder without its owner is never seen by others.
        let unfinished = Self(
            self.0
                .with_file_name(format!("{}{UNFINISHED}", self.environment())),
        );
        let made = unfinished.fill(owner).and_then(|()| {
            // A folder that is not empty is not replaced.
            fs::rename(&unfinished.0, &self.0).map_err(self.failed("create", &self.0))
        });
        if made.is_err() {
            unfinished.remove()?;
        }
        made
    }

    fn fill(&self, owner: &Owner) -> Result<(), ProviderError> {
        fs::create_dir(&self.0).map_err(self.failed("create", &self.0))?;
        let path = self.0.join(layout::OWNER);
        let text = serde_json::to_vec_pretty(owner).map_err(io::Error::from);
        text.and_then(|text| fs::write(&path, text))
            .map_err(self.failed("write", &path))?;
        fs::create_dir(self.data()).map_err(self.failed("create", &self.data()))
    }

    /// The folder itself.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// The environment's name.
    #[must_use]
    pub fn environment(&self) -> String {
        self.0
            .file_name()
            .map(|name| name.to_string_lossy().into_owned())
            .unwrap_or_default()
    }

    /// What it belongs to, if that is known.
    #[must_use]
    pub fn owner(&self) -> Option<Owner> {
        let text = fs::read(self.0.join(layout::OWNER)).ok()?;
        serde_json::from_slice(&text).ok()
    }

    /// Where the workload's lines are.
    #[must_use]
    pub fn lines(&self) -> PathBuf {
        self.0.join(layout::LINES)
    }

    /// Where its data is.
    #[must_use]
    pub fn data(&self) -> PathBuf {
        self.0.join("data")
    }

    /// The folder as the journal and `matrix clean` name it: by its environment, whose process, if one runs, is ended
    /// with it.
    #[must_use]
    pub fn resource(&self, host: &str) -> Resource {
        Resource {
            host: host.to_owned(),
            kind: "directory".to_owned(),
            name: self.environment(),
        }
    }

    /// The folder as something that was left behind.
    #[must_use]
    pub fn leftover(&self, host: &str, owner: Option<Owner>, running: bool) -> Leftover {
        let (run, run_directory, scenario) = match owner {
            Some(owner) => (Some(owner.run), Some(owner.run_directory), Some(owner.scenario)),
            None => (None, None, None),
        };
        Leftover {
            resource: self.resource(host),
            run,
            run_directory,
            scenario,
            running,
            job: None,
        }
    }

    /// Removes the folder with all that is in it; it may be gone already.
    ///
    /// # Errors
    /// When it cannot be removed.
    pub fn remove(&self) -> Result<(), ProviderError> {
        match fs::remove_dir_all(&self.0) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                Err(self.failed("remove", &self.0)(error))
            }
            _ => Ok(()),
        }
    }

    fn failed(&self, action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> ProviderError + use<> {
        let path = path.to_owned();
        move |source| ProviderError::File { action, path, source }
    }
}
