//! How work on a scenario ends: with an outcome, or since the infrastructure could not do what it needs. The main types are
//! [`Ending`] and [`ScenarioError`].

use std::{io, path::PathBuf, time::Duration};

use record::{causes::with_causes, identity::IdentityMismatch, run_directory::Outcome};

use crate::{
    disk_space, escaping,
    journal::JournalError,
    provider::ProviderError,
    run::{RunError, collection::CollectionError},
};

/// Why the infrastructure could not do what a scenario needs.
#[derive(Debug, thiserror::Error)]
pub(in crate::run) enum ScenarioError {
    #[error(transparent)]
    Journal(#[from] JournalError),
    #[error(transparent)]
    Provider(#[from] ProviderError),
    #[error(transparent)]
    Collection(#[from] CollectionError),
    #[error("cannot write into the run directory")]
    RunDirectory(#[from] io::Error),
    /// The first of two failures is the one to mend: the second may well be its consequence.
    #[error(
        "{}; what there was of the environment could not be removed: {}",
        with_causes(first),
        with_causes(second)
    )]
    NotRemoved {
        first: ProviderError,
        second: Box<ScenarioError>,
    },
    #[error(
        "the disk of {place} has {} free, and {windows} windows take about {}",
        disk_space::in_words(*free),
        disk_space::in_words(*wanted)
    )]
    NoRoom {
        place: String,
        windows: usize,
        wanted: u64,
        free: u64,
    },
    /// It was out of reach when the run was planned, or has become another since.
    #[error("{}", .0.reason)]
    AnotherHost(IdentityMismatch),
    #[error("nothing was heard of the workload for {} s: it, its host or its engine stands still", lasted.as_secs())]
    StandsStill { lasted: Duration },
    #[error("the workload said {lines} different things, more than any does")]
    SaysTooMuch { lines: usize },
    #[error(
        "the environment did not give out every measured window; missing: {}",
        numbers(windows)
    )]
    NotGivenOut { windows: Vec<u32> },
    #[error("`{environment}` of {} still measures on this host", run_directory.display())]
    StillMeasuring {
        environment: String,
        run_directory: PathBuf,
    },
}

impl From<RunError> for ScenarioError {
    fn from(error: RunError) -> Self {
        match error {
            RunError::Journal(error) => Self::Journal(error),
            RunError::Collection(error) => Self::Collection(error),
            RunError::RunDirectory(error) => Self::RunDirectory(error),
        }
    }
}

fn numbers(windows: &[u32]) -> String {
    let numbers: Vec<String> = windows.iter().map(u32::to_string).collect();
    numbers.join(", ")
}

/// How one environment ended.
pub(super) struct Ending {
    pub(super) outcome: Outcome,
    pub(super) reason: Option<String>,
    pub(super) hint: Option<String>,
    /// Whether its node failed or was taken away: another may do.
    pub(super) lost_its_node: bool,
}

/// What came of work on a scenario in one round.
pub(super) enum Work {
    /// It ended.
    Ended(Ending),
    /// Its job is in its batch system's queue, and this process does not wait for it.
    Left,
}

impl Ending {
    pub(super) fn of(outcome: Outcome, reason: Option<String>, hint: Option<String>) -> Self {
        Self {
            outcome,
            reason,
            hint,
            lost_its_node: false,
        }
    }

    pub(super) fn errored(trouble: &ScenarioError) -> Self {
        let hint = match trouble {
            ScenarioError::Provider(error) => error.hint(),
            ScenarioError::Journal(error) => Some(error.hint()),
            ScenarioError::Collection(error) => Some(error.hint()),
            ScenarioError::RunDirectory(error) => Some(disk_space::hint(error)),
            ScenarioError::NoRoom { .. } => Some("make room on the disk and `matrix resume`".to_owned()),
            ScenarioError::AnotherHost(contradiction) => Some(contradiction.fix.clone()),
            ScenarioError::StandsStill { .. } => {
                Some("`matrix resume` goes on with it when it gets on, `matrix clean` removes it".to_owned())
            }
            ScenarioError::SaysTooMuch { .. } => {
                Some("see on its host what runs there; `matrix clean` removes it".to_owned())
            }
            ScenarioError::NotGivenOut { .. } => Some(
                "`matrix resume` asks for them again; if they are gone, `matrix clean` removes the environment, and they \
                 are measured again"
                    .to_owned(),
            ),
            ScenarioError::StillMeasuring { run_directory, .. } => Some(format!(
                "`matrix resume {}` goes on with it, `matrix clean` removes it",
                escaping::pasted(run_directory)
            )),
            ScenarioError::NotRemoved { first, .. } => {
                let clean = "`matrix clean` removes what is left".to_owned();
                Some(match first.hint() {
                    Some(hint) => format!("{hint}; {clean}"),
                    None => clean,
                })
            }
        };
        Self::of(Outcome::Errored, Some(with_causes(trouble)), hint)
    }
}
