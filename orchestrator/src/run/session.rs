//! What `matrix run` and `matrix resume` have in common: the run's locks, its place in the index of runs, its execution. The main
//! function is [`carry_out`].

use std::{io, path::PathBuf};

use record::run_directory::{Manifest, PlanRecord, RunDirectory, RunState};
use tokio::sync::RwLock;

use super::{
    Patience, Run, RunError,
    keep::Keep,
    run_index::{self, AtWork, Entry},
    stop::Stop,
};
use crate::{
    experiment_files::{ExperimentFiles, ExperimentFilesError},
    journal::Journal,
    lease::{self, Holder, Lease, LeaseError},
    observer::{Events, Observer},
    provider::Providers,
    state_directory::{self, StateDirectory},
};

/// How a run is to be carried out.
pub struct Options {
    /// Whether it goes on with an earlier start.
    pub resumed: bool,
    /// Which environments stay.
    pub keep: Keep,
    /// Whether jobs are waited for.
    pub patience: Patience,
    /// Who watches.
    pub observers: Vec<Box<dyn Observer>>,
    /// The wish to stop.
    pub stop: Stop,
}

/// A run that this process works on: by its directory, and by its name, should the directory be moved meanwhile.
#[derive(Debug)]
pub struct Locked {
    _directory: Lease,
    _name: AtWork,
}

/// Why a run cannot be locked.
#[derive(Debug, thiserror::Error)]
pub enum LockError {
    /// Another process works on it.
    #[error("{} is being worked on by {holder}", directory.display())]
    Held {
        /// The run directory.
        directory: PathBuf,
        /// Who.
        holder: String,
    },
    /// The lock in its directory cannot be taken.
    #[error(transparent)]
    Directory(LeaseError),
    /// The lock in the state folder cannot be taken.
    #[error(transparent)]
    State(LeaseError),
}

impl LockError {
    /// What to do about it.
    #[must_use]
    pub fn hint(&self) -> Option<String> {
        match self {
            Self::Held { .. } => Some("wait for it, or end it with Ctrl-C and `matrix resume`".to_owned()),
            Self::Directory(_) => None,
            Self::State(_) => Some(state_directory::CHOOSE.to_owned()),
        }
    }
}

/// Locks a run for this process.
///
/// # Errors
/// When another process works on it, or it cannot be locked.
pub fn lock(directory: &RunDirectory, run: &str) -> Result<Locked, LockError> {
    let holder = Holder::this_process(directory.path());
    let held = |holder| LockError::Held {
        directory: directory.path().to_owned(),
        holder,
    };
    let by_directory = lease::ask(&directory.lock(), &holder)
        .map_err(LockError::Directory)?
        .granted()
        .map_err(held)?;
    let by_name = run_index::take(&StateDirectory::of_this_user(), &holder, run)
        .map_err(LockError::State)?
        .map_err(held)?;
    Ok(Locked {
        _directory: by_directory,
        _name: by_name,
    })
}

/// Why a run cannot be carried out.
#[derive(Debug, thiserror::Error)]
pub enum SessionError {
    /// It cannot go on.
    #[error(transparent)]
    Run(#[from] RunError),
    /// It cannot be entered in the state folder.
    #[error(transparent)]
    Register(io::Error),
    /// Its experiment's files are not there as they were.
    #[error(transparent)]
    Files(#[from] ExperimentFilesError),
}

impl SessionError {
    /// What to do about it, where that is known.
    #[must_use]
    pub fn hint(&self) -> Option<String> {
        match self {
            Self::Run(error) => error.hint(),
            Self::Register(_) => None,
            Self::Files(error) => error.hint().map(str::to_owned),
        }
    }
}

/// Carries out what is left to do of a plan, from `state` on; where the run stands then.
///
/// # Errors
/// When the run cannot go on.
pub async fn carry_out(
    directory: &RunDirectory,
    manifest: &Manifest,
    plan: &PlanRecord,
    providers: &Providers,
    state: RunState,
    options: Options,
) -> Result<RunState, SessionError> {
    let journal = Journal::open(&directory.journal()).map_err(RunError::from)?;
    // Before anything is created there.
    if let Some(entry) = Entry::of(manifest, plan, directory.path()) {
        entry
            .enter(&StateDirectory::of_this_user())
            .map_err(SessionError::Register)?;
    }
    let run = Run {
        name: manifest.run.clone(),
        directory: directory.clone(),
        plan,
        files: ExperimentFiles::of_run(directory, manifest)?,
        events: Events::new(journal, state, options.observers),
        fleet: providers,
        stop: options.stop,
        keep: options.keep,
        patience: options.patience,
        this_machine: RwLock::default(),
    };
    run.execute(options.resumed).await?;
    Ok(run.events.state())
}
