//! A run directory's own account of its run: written before anything is created, read by `resume` and `status`. The
//! main type is [`RecordedRun`].

use std::{
    collections::{BTreeMap, BTreeSet},
    fs, io,
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use record::{
    connection::Connection,
    run_directory::{
        Event, HostRecord, JobStanding, JournalEntry, Manifest, Place, PlanRecord, PlannedScenario,
        ReadError, RunDirectory, RunRecords, RunState, ScenarioState, Standing,
    },
};
use serde::Serialize;
use tokio::time::Instant;

use super::run_index;
use crate::{
    batch::Clusters,
    escaping,
    experiment_files::ExperimentFiles,
    host::{self, Host, Said},
    journal,
    provider::{Catalogue, Providers},
    state_directory::StateDirectory,
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

/// Why a run cannot be worked with.
#[derive(Debug, thiserror::Error)]
pub enum RecordedRunError {
    /// There is no such folder.
    #[error("cannot open the run directory {}", path.display())]
    Directory {
        /// Where.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// Its records cannot be read.
    #[error(transparent)]
    Records(#[from] ReadError),
    /// Its environments would not be found.
    #[error(
        "run {run} was begun with the state folder {}, and this is {}: its environments would not be found",
        theirs.display(),
        ours.display()
    )]
    OtherState {
        /// The run's name.
        run: String,
        /// The state folder that it was begun with.
        theirs: PathBuf,
        /// The one of this process.
        ours: PathBuf,
        /// The run directory.
        directory: PathBuf,
    },
    /// This user's list of runs does not have it.
    #[error("run {run} has hosts of a cluster, and the list of runs that were begun here does not have it")]
    Anothers {
        /// The run's name.
        run: String,
    },
    /// Names were taken from it.
    #[error("run {run} is a redacted copy")]
    Redacted {
        /// The run's name.
        run: String,
    },
    /// The settings of its providers are as no version up to this one writes them.
    #[error(transparent)]
    OtherVersion(#[from] serde_json::Error),
    /// One of its hosts is reached as no version up to this one reaches hosts.
    #[error("this version of matrix does not know how run {run} reached the host {host}")]
    UnknownConnection {
        /// The run's name.
        run: String,
        /// The host's name.
        host: String,
    },
    /// Its run directory cannot be made.
    #[error("cannot {action} {}", path.display())]
    Create {
        /// `create` or `write`.
        action: &'static str,
        /// The file or folder that could not be made.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
}

impl RecordedRunError {
    /// What to do about it.
    #[must_use]
    pub fn hint(&self) -> String {
        match self {
            Self::Directory { .. } => {
                "give the folder that `matrix run` made, such as `runs/20260101-120000`".to_owned()
            }
            Self::Records(error) => error.hint(),
            Self::OtherState {
                theirs, directory, ..
            } => format!(
                "`MATRIX_STATE_DIR={} matrix resume {}` goes on with it",
                escaping::pasted(theirs),
                escaping::pasted(directory)
            ),
            Self::Anothers { .. } => {
                "`matrix clean` may have taken its jobs back, which `matrix resume` submits again; or ask where it was begun, with the same \
                 `MATRIX_STATE_DIR`"
                    .to_owned()
            }
            Self::Redacted { .. } => {
                "it says of no host how it is reached: go on with the run that it was made of".to_owned()
            }
            Self::OtherVersion(_) | Self::UnknownConnection { .. } => {
                "manifest.json is of another version of matrix".to_owned()
            }
            Self::Create { .. } => "give another folder with `--out`".to_owned(),
        }
    }
}

impl From<RunRecords> for RecordedRun {
    fn from(records: RunRecords) -> Self {
        Self {
            manifest: records.manifest,
            plan: records.plan,
            state: records.state,
        }
    }
}

impl RecordedRun {
    /// The run directory at `path`, absolute, so that leftovers can say where they belong.
    ///
    /// # Errors
    /// When there is none.
    pub fn directory(path: &Path) -> Result<RunDirectory, RecordedRunError> {
        path.canonicalize()
            .map(RunDirectory::new)
            .map_err(|source| RecordedRunError::Directory {
                path: path.to_owned(),
                source,
            })
    }

    /// Reads it.
    ///
    /// # Errors
    /// When it is missing, half-written or of a future format.
    pub fn read(directory: &RunDirectory) -> Result<Self, RecordedRunError> {
        Ok(RunRecords::read(directory)?.into())
    }

    /// Reads it, to go on with it.
    ///
    /// # Errors
    /// As [`Self::read`], and when it was pruned: its windows would be taken for lost, and be measured again.
    pub fn read_unpruned(directory: &RunDirectory) -> Result<Self, RecordedRunError> {
        Ok(RunRecords::read_unpruned(directory)?.into())
    }

    /// Where it stands, with the windows that the journal has and the directory has not left out: as `matrix resume` will find
    /// it. What is in the windows is not read.
    #[must_use]
    pub fn state_in(&self, directory: &RunDirectory) -> RunState {
        let mut state = self.state.clone();
        for (slug, scenario) in &mut state.scenarios {
            let collected: Vec<u32> = scenario.collected.keys().copied().collect();
            for window in collected {
                if !directory.window(slug, window).is_folder() {
                    scenario.lose(window);
                }
            }
        }
        state
    }

    /// Refuses to go on where its environments would not be found, and would measure on beside new ones.
    ///
    /// # Errors
    /// When it was begun with another state folder, and one of its environments may be there.
    pub fn is_here(&self, directory: &RunDirectory, state: &StateDirectory) -> Result<(), RecordedRunError> {
        let may_be_there = |theirs: &&PathBuf| theirs.as_path() != state.path() && theirs.exists();
        let Some(theirs) = self.manifest.state_directory.as_ref().filter(may_be_there) else {
            return Ok(());
        };
        if self
            .state
            .scenarios
            .values()
            .all(|scenario| scenario.open().next().is_none())
        {
            return Ok(());
        }
        Err(RecordedRunError::OtherState {
            run: self.manifest.run.clone(),
            theirs: theirs.clone(),
            ours: state.path().to_owned(),
            directory: directory.path().to_owned(),
        })
    }

    /// The providers that it was begun with, out of these.
    ///
    /// # Errors
    /// When their settings cannot be understood, or the run is a redacted copy.
    pub fn providers(&self, catalogue: Catalogue) -> Result<Providers, RecordedRunError> {
        if self.manifest.redacted {
            return Err(RecordedRunError::Redacted {
                run: self.manifest.run.clone(),
            });
        }
        let settings = catalogue.settings_of(self.manifest.providers.clone())?;
        Ok(Providers::new(catalogue, settings, self.hosts()?))
    }

    /// Brings what the journal says of jobs that are not collected up to what their clusters say now. What a cluster does not know,
    /// or one that does not answer, stays as the journal has it; why one did not is returned, by its host.
    ///
    /// Its hosts are those of this user's own list of runs: a run directory is not believed which programs to call.
    ///
    /// # Errors
    /// When this user has not begun it.
    pub async fn ask_clusters(
        &mut self,
        state: &StateDirectory,
    ) -> Result<BTreeMap<String, String>, RecordedRunError> {
        let clusters = Clusters::default();
        let mut silent = BTreeMap::new();
        let entries = run_index::entries(state);
        let known = entries.iter().find(|entry| entry.run == self.manifest.run);
        let hosts = match known {
            Some(entry) => entry
                .hosts
                .iter()
                .filter_map(|recorded| of_record(recorded, state)),
            // One that was on this machine alone is in no list, and has no cluster to ask.
            None if !self.has_clusters() => return Ok(silent),
            None => {
                return Err(RecordedRunError::Anothers {
                    run: self.manifest.run.clone(),
                });
            }
        };
        for host in hosts {
            let Some(nodes) = host.nodes() else { continue };
            let asked = Instant::now();
            let seen = clusters
                .of(&nodes.slurm, &host)
                .queue
                .after(asked, Duration::ZERO)
                .await;
            if let Some(silence) = &seen.silence {
                silent.insert(host.name().to_owned(), silence.clone());
            }
            for (scenario, environment, job) in self.open_jobs(host.name()) {
                let standing = match seen.job(&environment) {
                    Some(job) => job.standing(),
                    // A batch system forgets a job some minutes after its end.
                    None if seen.silence.is_none() => JobStanding {
                        standing: Standing::Ended,
                        state: "not in the queue any more".to_owned(),
                        reason: None,
                        start: None,
                        ..job
                    },
                    None => continue,
                };
                self.state.apply(&JournalEntry::new(
                    journal::stamp(),
                    Event::JobChanged {
                        scenario,
                        environment,
                        standing,
                    },
                ));
            }
        }
        Ok(silent)
    }

    /// The jobs of a host that were submitted and not collected, with scenario and environment.
    fn open_jobs(&self, host: &str) -> Vec<(String, String, JobStanding)> {
        let is_of_host = |planned: &&PlannedScenario| planned.hosts().any(|it| it == host);
        let of_host = self.plan.scenarios.iter().filter(is_of_host);
        of_host
            .flat_map(|planned| {
                let open = self
                    .state
                    .scenarios
                    .get(&planned.slug)
                    .into_iter()
                    .flat_map(ScenarioState::open);
                open.filter_map(|it| Some((planned.slug.clone(), it.environment.clone(), it.job.clone()?)))
                    .collect::<Vec<_>>()
            })
            .collect()
    }

    fn has_clusters(&self) -> bool {
        let is_cluster = |host: &HostRecord| matches!(host.connect.known(), Some(Connection::Slurm(_)));
        self.manifest.hosts.iter().any(is_cluster)
    }

    /// The hosts that its scenarios were planned on.
    fn hosts(&self) -> Result<Vec<Arc<dyn Host>>, RecordedRunError> {
        let state = StateDirectory::of_this_user();
        let names: BTreeSet<_> = self.plan.scenarios.iter().flat_map(|it| it.hosts()).collect();
        let said = names.into_iter().map(|name| {
            let recorded = self.manifest.hosts.iter().find(|it| it.name == name);
            let connection = match recorded {
                Some(recorded) => recorded.connect.known(),
                // Earlier versions knew one machine.
                None => Some(&Connection::Local),
            };
            let connection = connection.ok_or_else(|| RecordedRunError::UnknownConnection {
                run: self.manifest.run.clone(),
                host: name.to_owned(),
            })?;
            Ok(Said {
                name,
                connection,
                hardware: recorded.map(|it| it.hardware.as_str()).unwrap_or_default(),
                os: recorded.map(|it| it.os.as_str()).unwrap_or_default(),
            })
        });
        let said: Result<Vec<_>, RecordedRunError> = said.collect();
        Ok(host::all(said?, &state))
    }

    /// Makes a new run directory with manifest, plan and the experiment's files on disk. Fails if there is anything at that place.
    ///
    /// # Errors
    /// When it exists already or cannot be written.
    pub fn create(
        path: &Path,
        manifest: &Manifest,
        plan: &PlanRecord,
        files: Option<&ExperimentFiles>,
    ) -> Result<RunDirectory, RecordedRunError> {
        let failed = |action, path: &Path| {
            let path = path.to_owned();
            move |source| RecordedRunError::Create { action, path, source }
        };
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent).map_err(failed("create", parent))?;
        }
        fs::create_dir(path).map_err(failed("create", path))?;
        let directory = Self::directory(path)?;
        // The manifest comes last: a folder without one is half-written, and nothing was created for it.
        directory.journal().create().map_err(failed("write", path))?;
        if let Some(files) = files {
            let written = directory.experiment().write(files.stream());
            written.map_err(failed("write", path))?;
        }
        write(&directory.plan(), plan).map_err(failed("write", path))?;
        write(&directory.manifest(), manifest).map_err(failed("write", path))?;
        Ok(directory)
    }
}

/// A host as it was recorded, if this version knows how it is reached.
pub(crate) fn of_record(recorded: &HostRecord, state: &StateDirectory) -> Option<Arc<dyn Host>> {
    let said = Said {
        name: &recorded.name,
        connection: recorded.connect.known()?,
        hardware: &recorded.hardware,
        os: &recorded.os,
    };
    Some(host::of(said, state))
}

/// The folders of runs; their names begin with their time.
pub(crate) fn newest_first(runs: &Path) -> Vec<PathBuf> {
    let mut found: Vec<PathBuf> = fs::read_dir(runs)
        .into_iter()
        .flatten()
        .filter_map(|entry| Some(entry.ok()?.path()))
        .collect();
    found.sort();
    found.reverse();
    found
}

fn write(place: &Place, record: &impl Serialize) -> io::Result<()> {
    let mut text = serde_json::to_vec_pretty(record)?;
    text.push(b'\n');
    place.write(&text)
}
