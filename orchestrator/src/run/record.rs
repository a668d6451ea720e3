//! A run directory's own account of its run: written before anything is created, read by `resume` and `status`. The
//! main type is [`RecordedRun`].

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use reports::{
    ReadError,
    run_directory::{Event, Manifest, Place, PlanRecord, RunDirectory, RunRecords},
};
use serde::{Deserialize as _, Serialize};

use super::state::RunState;
use crate::{
    exit::Exit,
    host::{self, Host},
    matrix_file::Connection,
    provider::Roster,
    state_directory::StateDirectory,
    terminal::{self, Complaint},
};

/// What was asked, what was planned, what happened.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedRun {
    /// What was asked.
    pub manifest: Manifest,
    /// What was planned.
    pub plan: PlanRecord,
    /// Where it stands.
    pub state: RunState,
}

impl RecordedRun {
    /// The run directory at `path`, absolute, so that leftovers can say where they belong.
    ///
    /// # Errors
    /// When there is none.
    pub fn directory(path: &Path) -> Result<RunDirectory, Complaint> {
        path.canonicalize()
            .map(RunDirectory::new)
            .map_err(|error| Complaint {
                what: format!("cannot open the run directory {}: {error}", path.display()).into(),
                hint: Some(
                    "give the folder that `matrix run` made, such as `runs/20260101-120000`".to_owned(),
                ),
                exit: Exit::Wrong,
            })
    }

    /// Reads it.
    ///
    /// # Errors
    /// When it is missing, half-written or of a future format.
    pub fn read(directory: &RunDirectory) -> Result<Self, Complaint> {
        let wrong = |error: ReadError| Complaint::new(Exit::Wrong, &error, Some(error.hint()));
        let records = RunRecords::read(directory).map_err(wrong)?;
        let state = RunState::replay(&records.journal.entries);
        Ok(Self {
            manifest: records.manifest,
            plan: records.plan,
            state,
        })
    }

    /// Where it stands, with the windows that the journal has and the directory has not left out: as `matrix resume` will find
    /// it. What is in the windows is not read.
    #[must_use]
    pub fn state_in(&self, directory: &RunDirectory) -> RunState {
        let mut state = self.state.clone();
        for (slug, scenario) in &self.state.scenarios {
            for (window, collected) in &scenario.collected {
                if !directory.window(slug, *window).is_folder() {
                    state.apply(&Event::WindowBroken {
                        scenario: slug.clone(),
                        environment: collected.environment.clone(),
                        window: *window,
                        reason: String::new(),
                    });
                }
            }
        }
        state
    }

    /// Refuses to go on where its environments would not be found, and would measure on beside new ones.
    ///
    /// # Errors
    /// When it was begun with another state folder, and one of its environments may be there.
    pub fn is_here(&self, directory: &RunDirectory, state: &StateDirectory) -> Result<(), Complaint> {
        let may_be_there = |theirs: &&PathBuf| theirs.as_path() != state.path() && theirs.exists();
        let Some(theirs) = self.manifest.state_directory.as_ref().filter(may_be_there) else {
            return Ok(());
        };
        if self
            .state
            .scenarios
            .values()
            .all(|scenario| scenario.open.is_none())
        {
            return Ok(());
        }
        Err(Complaint {
            what: format!(
                "run {} was begun with the state folder {}, and this is {}: its environments would not be found",
                self.manifest.run,
                theirs.display(),
                state.path().display()
            )
            .into(),
            hint: Some(format!(
                "`MATRIX_STATE_DIR={} matrix resume {}` goes on with it",
                terminal::pasted(theirs),
                terminal::pasted(directory.path())
            )),
            exit: Exit::Wrong,
        })
    }

    /// The providers that it was begun with.
    ///
    /// # Errors
    /// When their settings cannot be understood, or the run is a redacted copy.
    pub fn roster(&self) -> Result<Roster, Complaint> {
        if self.manifest.redacted {
            return Err(Complaint {
                what: format!("run {} is a redacted copy", self.manifest.run).into(),
                hint: Some(
                    "it says of no host how it is reached: go on with the run that it was made of".to_owned(),
                ),
                exit: Exit::Wrong,
            });
        }
        match serde_json::from_value(self.manifest.providers.clone()) {
            Ok(settings) => Ok(Roster::new(settings, self.hosts()?)),
            Err(error) => Err(of_another_version(&error)),
        }
    }

    /// The hosts that its scenarios were planned on.
    fn hosts(&self) -> Result<Vec<Arc<dyn Host>>, Complaint> {
        let state = StateDirectory::of_this_user();
        let names: BTreeSet<_> = self
            .plan
            .scenarios
            .iter()
            .filter_map(|it| it.host.as_deref())
            .collect();
        let host = |name| {
            let recorded = self.manifest.hosts.iter().find(|it| it.name == name);
            let connection = match recorded {
                Some(recorded) => Connection::deserialize(&recorded.connect)?,
                // Earlier versions knew one machine.
                None => Connection::Local,
            };
            Ok(host::of(name, &connection, &state))
        };
        names
            .into_iter()
            .map(host)
            .collect::<Result<_, serde_json::Error>>()
            .map_err(|error| of_another_version(&error))
    }

    /// Makes a new run directory with manifest and plan on disk. Fails if there is anything at that place.
    ///
    /// # Errors
    /// When it exists already or cannot be written.
    pub fn create(path: &Path, manifest: &Manifest, plan: &PlanRecord) -> Result<RunDirectory, Complaint> {
        let failed = |doing: &str, path: &Path, error: &std::io::Error| Complaint {
            what: format!("cannot {doing} {}: {error}", path.display()).into(),
            hint: Some("give another folder with `--out`".to_owned()),
            exit: Exit::Infrastructure,
        };
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent).map_err(|error| failed("create", parent, &error))?;
        }
        fs::create_dir(path).map_err(|error| failed("create", path, &error))?;
        let directory = Self::directory(path)?;
        // The manifest comes last: a folder without one is half-written, and nothing was created for it.
        directory
            .journal()
            .create()
            .map_err(|error| failed("write", path, &error))?;
        write(&directory.plan(), plan).map_err(|error| failed("write", path, &error))?;
        write(&directory.manifest(), manifest).map_err(|error| failed("write", path, &error))?;
        Ok(directory)
    }
}

fn of_another_version(error: &serde_json::Error) -> Complaint {
    Complaint::new(
        Exit::Wrong,
        error,
        Some("manifest.json is of another version of matrix".to_owned()),
    )
}

fn write(place: &Place, record: &impl Serialize) -> std::io::Result<()> {
    let mut text = serde_json::to_vec_pretty(record)?;
    text.push(b'\n');
    place.write(&text)
}
