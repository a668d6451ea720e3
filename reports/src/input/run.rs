//! One run as it was measured: every scenario of the plan with how it ended and the windows it left. The main type is
//! [`Run`]; [`load`] reads it from its directory, and nothing after that touches the disk.

use std::{collections::BTreeSet, path::Path};

use rayon::prelude::*;
use record::{
    causes::with_causes,
    layout,
    report_settings::ErrorOf,
    run_directory::{
        BrokenWindow, ControlTrace, EnvironmentRecord, Expected, Journal, LogError, MadeEnvironment,
        Manifest, NotWhole, Outcome, Place, PlannedScenario, PlantTrace, ReadError, Revision, RoundState,
        RunDirectory, RunRecords, ScenarioState, read_environment, read_whole_record,
    },
    settings::Settings,
    window::{LoopsRecord, Verdict, WindowRecord},
};

use crate::{
    input::{
        overheads,
        window_data::{WindowData, read_metrics},
    },
    redaction::REMARK,
};

/// Everything that a report is made of.
#[derive(Debug, Clone, PartialEq)]
pub struct Run {
    /// Where its report goes.
    pub report_folder: Place,
    /// What was asked.
    pub manifest: Manifest,
    /// The plan's scenarios, in letter order.
    pub scenarios: Vec<ScenarioRun>,
    /// The run directories that it was read from: one, unless runs were put together.
    pub parts: Vec<RunPart>,
    /// The positions that the errors of its traces are of.
    pub error: ErrorOf,
    /// What a reader must know of how it was put together.
    pub remarks: Vec<String>,
}

/// One run directory.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RunPart {
    /// Where it is.
    pub directory: RunDirectory,
    /// The run's name.
    pub run: String,
    /// When it was asked for, RFC 3339.
    pub created: String,
    /// Version of `matrix`.
    pub matrix_version: String,
    /// The revision of its sources, where it is known.
    pub matrix_revision: Option<Revision>,
    /// What was asked.
    pub asked: Asked,
    /// Letters of the scenarios of which it has windows that count.
    pub scenarios: Vec<String>,
    /// Lines of its journal that a crash cut, from 1.
    pub cut_lines: Vec<usize>,
    /// Whether its journal has checksums of itself and of the other files: not in runs of earlier versions.
    pub is_checked: bool,
}

/// What was asked of a run, as its manifest has it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Asked {
    /// The words of the command; none in runs of earlier versions and in redacted copies.
    pub invocation: Vec<String>,
    /// Where the matrix file was.
    pub matrix_file: String,
    /// The matrix file; empty in redacted copies.
    pub matrix_text: String,
    /// The profile that was chosen.
    pub profile: Option<String>,
    /// How the scenarios were put in order.
    pub order: String,
    /// Seed of that order.
    pub seed: u64,
}

impl RunPart {
    fn of(
        directory: RunDirectory,
        manifest: &Manifest,
        scenarios: &[ScenarioRun],
        journal: &Journal,
    ) -> Self {
        let measured = scenarios
            .iter()
            .filter(|scenario| scenario.counted().next().is_some());
        Self {
            directory,
            run: manifest.run.clone(),
            created: manifest.created.clone(),
            matrix_version: manifest.matrix_version.clone(),
            matrix_revision: manifest.matrix_revision.clone(),
            asked: Asked {
                invocation: manifest.invocation.clone(),
                matrix_file: manifest.matrix_file.clone(),
                matrix_text: manifest.matrix_text.clone(),
                profile: manifest.profile.clone(),
                order: manifest.order.clone(),
                seed: manifest.seed,
            },
            scenarios: measured.map(|scenario| scenario.planned.id.clone()).collect(),
            cut_lines: journal.cut_lines.clone(),
            is_checked: journal.is_checked(),
        }
    }
}

/// One scenario.
#[derive(Debug, Clone, PartialEq)]
pub struct ScenarioRun {
    /// As planned.
    pub planned: PlannedScenario,
    /// How it ended.
    pub ending: Ending,
    /// The providers of its environments, as the journal and `environment.json` name them.
    pub providers: BTreeSet<String>,
    /// Its environments that were made, as the journal has them.
    pub made: Vec<MadeEnvironment>,
    /// Its last environment's record, if it came so far.
    pub environment: Option<EnvironmentRecord>,
    /// Why that record cannot be read, if it is there and cannot.
    pub unknown: Option<String>,
    /// One for each window of the plan; none if the scenario is infeasible or was not selected.
    pub windows: Vec<Window>,
    /// What broke on the way, whether or not it was measured again.
    pub broken: Vec<BrokenWindow>,
    /// How many more broke.
    pub broken_beside: usize,
    /// How long each environment took beyond its windows, in seconds: being made, connected, collected and removed. Of those alone
    /// that measured to their end in one go.
    pub overheads_s: Vec<f64>,
    /// The checksum of the files of a user's experiment, if it has some.
    pub experiment_sha256: Option<String>,
}

/// How a scenario ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Ending {
    /// It could not run.
    Infeasible {
        /// The reason that the journal has.
        reason: String,
        /// What would make it feasible.
        fix: Option<String>,
    },
    /// It was left out of this run, although it may be feasible.
    NotSelected {
        /// By what.
        reason: String,
    },
    /// Work on it has not begun.
    NotStarted,
    /// Work on it began, and the journal does not say that it ended.
    Unfinished,
    /// The journal says how.
    Ended {
        /// How the scenario ended.
        outcome: Outcome,
        /// Why, if not completed.
        reason: Option<String>,
        /// What to do about it.
        hint: Option<String>,
    },
}

/// One window of the plan.
#[derive(Debug, Clone, PartialEq)]
pub struct Window {
    /// Its number, from 1.
    pub number: u32,
    /// Its folder.
    pub folder: Place,
    /// What there is of it.
    pub state: WindowState,
}

/// What there is of a window.
#[derive(Debug, Clone, PartialEq)]
pub enum WindowState {
    /// It counts.
    Counted {
        /// What it says of itself.
        record: Box<WindowRecord>,
        /// What was measured.
        data: WindowData,
    },
    /// It is whole, and its own checks found that it is worth nothing.
    Invalid {
        /// What it says of itself.
        record: Box<WindowRecord>,
    },
    /// It is there in part.
    Broken {
        /// How it can be told.
        reason: String,
    },
    /// It is not there.
    Missing {
        /// What the journal says of it.
        known: MissingWindow,
    },
}

/// What the journal says of a window that is not there.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum MissingWindow {
    /// Nothing.
    #[default]
    NotMeasured,
    /// The workload had completed it.
    NotCollected,
    /// Its folder is there, and the journal does not have it as collected, by which alone it is known whether it is as it was written.
    Unknown,
    /// It was there.
    Lost,
}

impl ScenarioRun {
    /// Whether its numbers were computed and not measured.
    #[must_use]
    pub fn is_simulated(&self) -> bool {
        // Without an environment there is no number. Plans of earlier versions do not say it: `fake` was the only such provider.
        !self.providers.is_empty() && (self.planned.simulated || self.providers.contains("fake"))
    }

    /// What is not known of it.
    fn remark(&self) -> Option<String> {
        let why = self.unknown.as_ref()?;
        Some(format!(
            "The platform of {} is not known: {why}.",
            self.planned.id
        ))
    }

    /// The windows that count, with their records and what was measured in them.
    pub fn counted(&self) -> impl Iterator<Item = (u32, &WindowRecord, &WindowData)> {
        self.windows.iter().filter_map(|window| match &window.state {
            WindowState::Counted { record, data } => Some((window.number, &**record, data)),
            _ => None,
        })
    }
}

/// Reads a run directory as its own settings ask for.
///
/// # Errors
/// As [`load_from`].
pub fn load(path: impl AsRef<Path>) -> Result<Run, ReadError> {
    load_from(&RunDirectory::new(path.as_ref()), None)
}

/// Reads a run directory, scenarios side by side, for the error of other positions than its settings ask for where that is
/// said. Logs are read once and digested: of a run of 28 windows of 6000 s, some megabytes stay.
///
/// # Errors
/// When it is missing, half-written, damaged or of a later format, and when the system does not let a file be read.
pub fn load_from(directory: &RunDirectory, error: Option<ErrorOf>) -> Result<Run, ReadError> {
    let RunRecords {
        manifest,
        plan,
        journal,
        mut state,
    } = RunRecords::read_unpruned(directory)?;
    let error = error.unwrap_or(manifest.report.error);
    let mut stays = overheads::stays(&journal);
    let with_state = |planned: PlannedScenario| {
        let state = state.scenarios.remove(&planned.slug).unwrap_or_default();
        let stays = stays.remove(&planned.slug).unwrap_or_default();
        let overheads = stays.iter().map(|stay| stay.overhead_s(&planned.settings));
        let overheads_s = overheads.collect();
        (planned, state, overheads_s)
    };
    let scenarios: Vec<(PlannedScenario, ScenarioState, Vec<f64>)> =
        plan.scenarios.into_iter().map(with_state).collect();
    // Of two that are at fault always the first is told, whichever is read first.
    let scenarios: Vec<Result<ScenarioRun, ReadError>> = scenarios
        .into_par_iter()
        .map(|(planned, state, overheads_s)| {
            let scenario = load_scenario(directory, planned, state, &journal, error)?;
            Ok(ScenarioRun {
                overheads_s,
                experiment_sha256: manifest.experiment_sha256.clone(),
                ..scenario
            })
        })
        .collect();
    let scenarios: Vec<ScenarioRun> = scenarios.into_iter().collect::<Result<_, _>>()?;
    let mut remarks = Vec::from_iter(manifest.redacted.then(|| REMARK.to_owned()));
    remarks.extend(scenarios.iter().filter_map(ScenarioRun::remark));
    Ok(Run {
        report_folder: directory.report(),
        parts: vec![RunPart::of(directory.clone(), &manifest, &scenarios, &journal)],
        remarks,
        manifest,
        error,
        scenarios,
    })
}

fn load_scenario(
    directory: &RunDirectory,
    planned: PlannedScenario,
    journaled: ScenarioState,
    journal: &Journal,
    error: ErrorOf,
) -> Result<ScenarioRun, ReadError> {
    let environment = directory.environment(&planned.slug);
    let read = || read_environment(&environment, journaled.environment_sha256s());
    // One that the journal has and that is gone is an error to read, and so is remarked on.
    let is_expected = environment.exists() || journaled.environment_sha256s().next().is_some();
    let (environment, unknown) = match is_expected.then(read) {
        None => (None, None),
        Some(Ok(environment)) => (Some(environment), None),
        Some(Err(error @ ReadError::FutureFormat { .. })) => return Err(error),
        // What is not known of a platform must not cost what was measured on it.
        Some(Err(error)) => (None, Some(with_causes(&error))),
    };
    let ending = ending(&planned, &journaled);
    let measured = !matches!(ending, Ending::Infeasible { .. } | Ending::NotSelected { .. });
    let wanted = if measured {
        planned.settings.all_windows()
    } else {
        0
    };
    let windows = (1..=wanted)
        .map(|number| {
            let folder = directory.window(&planned.slug, number);
            // Whether it is as it was written is known of what the journal has. A cut journal has fewer.
            let is_unknown = journal.is_checked() && !journaled.collected.contains_key(&number);
            let state = match folder.exists() {
                true if is_unknown => WindowState::Missing {
                    known: MissingWindow::Unknown,
                },
                true => load_window(&folder, &planned, number, journaled.window_sha256(number), error)?,
                false => WindowState::Missing {
                    known: missing(&journaled, number),
                },
            };
            Ok(Window {
                number,
                folder,
                state,
            })
        })
        .collect::<Result<_, ReadError>>()?;
    let mut providers = journaled.providers;
    providers.extend(environment.as_ref().map(|record| record.provider.clone()));
    Ok(ScenarioRun {
        experiment_sha256: None,
        planned,
        ending,
        providers,
        environment,
        unknown,
        windows,
        made: journaled.made,
        broken: journaled.broken,
        broken_beside: journaled.broken_beside,
        overheads_s: Vec::new(),
    })
}

/// The first step of a window that lost some, which may be among them. The log of any other begins with it.
fn first_step(record: &WindowRecord, lost: u64, settings: &Settings) -> Option<u64> {
    let step_ns = u64::try_from(settings.rate.step().as_nanos()).ok()?;
    let started_ns = u64::try_from(record.started_ns).ok()?;
    (lost > 0).then(|| started_ns / step_ns.max(1))
}

fn ending(planned: &PlannedScenario, journaled: &ScenarioState) -> Ending {
    if !planned.feasible {
        let reason = planned
            .reason
            .clone()
            .unwrap_or_else(|| "the plan does not say why".to_owned());
        return Ending::Infeasible {
            reason,
            fix: planned.fix.clone(),
        };
    }
    match (of_rounds(planned, journaled), &planned.not_selected) {
        (Some(ending), _) => ending,
        (None, Some(reason)) => Ending::NotSelected {
            reason: reason.clone(),
        },
        (None, None) => Ending::NotStarted,
    }
}

/// How a scenario ended, by how each of its rounds did: as the one that ended worst, which is named where there are several. None
/// where none was begun.
fn of_rounds(planned: &PlannedScenario, journaled: &ScenarioState) -> Option<Ending> {
    let rank = |state: &RoundState| match state.outcome {
        None => 0,
        Some(Outcome::Interrupted) => 1,
        Some(Outcome::Errored) => 2,
        Some(Outcome::Failed) => 3,
        Some(Outcome::Completed) => 4,
    };
    let begun = |state: &RoundState| state.started || state.outcome.is_some();
    let rounds = journaled.rounds.iter().filter(|(_, state)| begun(state));
    let (round, worst) = rounds.min_by_key(|(_, state)| rank(state))?;
    let all_begun = planned
        .rounds()
        .all(|round| journaled.rounds.get(&round).is_some_and(begun));
    let several = planned.settings.environments > 1;
    Some(match worst.outcome {
        None => Ending::Unfinished,
        Some(Outcome::Completed) if !all_begun => Ending::Unfinished,
        Some(outcome) => Ending::Ended {
            outcome,
            reason: worst.reason.clone().map(|reason| match several {
                true => format!("environment {round}: {reason}"),
                false => reason,
            }),
            hint: worst.hint.clone(),
        },
    })
}

/// What the journal says of a window that is not there.
fn missing(journaled: &ScenarioState, window: u32) -> MissingWindow {
    match (
        journaled.collected.contains_key(&window),
        journaled.completed.contains(&window),
    ) {
        (true, _) => MissingWindow::Lost,
        (false, true) => MissingWindow::NotCollected,
        (false, false) => MissingWindow::NotMeasured,
    }
}

fn load_window(
    folder: &Place,
    planned: &PlannedScenario,
    number: u32,
    sha256: Option<&str>,
    error: ErrorOf,
) -> Result<WindowState, ReadError> {
    let broken = |reason: String| Ok(WindowState::Broken { reason });
    // Of the files beside it, those that are read are looked at as they are read.
    let record = match read_whole_record(folder, number, sha256) {
        Ok(record) => record,
        Err(NotWhole::Broken(reason)) => return broken(reason),
        Err(NotWhole::Replaced(error) | NotWhole::Unreadable(error)) => return Err(error),
    };
    if record.verdict == Verdict::Invalid {
        return Ok(WindowState::Invalid {
            record: Box::new(record),
        });
    }
    if let Some(experiment) = &planned.settings.experiment {
        return Ok(match read_metrics(folder, experiment, &record)? {
            Ok(data) => WindowState::Counted {
                record: Box::new(record),
                data,
            },
            Err(reason) => WindowState::Broken { reason },
        });
    }
    let log = folder.join(layout::CONTROL_LOG);
    let described = |name: &str| record.files.iter().find(|file| file.name == name);
    let Some(file) = described(layout::CONTROL_LOG) else {
        return broken("window.json does not name control.csv".to_owned());
    };
    if !log.exists() {
        return broken("control.csv is missing".to_owned());
    }
    let truth = match error {
        ErrorOf::Received => None,
        ErrorOf::TruePosition => {
            let place = folder.join(layout::PLANT_LOG);
            let Some(file) = described(layout::PLANT_LOG) else {
                return Err(ReadError::NoTruth { path: place.path() });
            };
            match PlantTrace::read(&place, file) {
                Ok(truth) => Some(truth),
                Err(error) => return unusable(&place, error),
            }
        }
    };
    let Some(LoopsRecord { controller, .. }) = record.loops() else {
        return broken("window.json is that of another experiment".to_owned());
    };
    let lost = controller.lost_ticks;
    let expected = Expected {
        steps: planned.settings.steps_per_window(),
        lost,
        first_step: first_step(&record, lost, &planned.settings),
        steps_per_period: planned.settings.steps_per_period().max(1),
        file,
    };
    match ControlTrace::read(&log, expected, truth.as_ref()) {
        Ok(trace) => Ok(WindowState::Counted {
            record: Box::new(record),
            data: WindowData::Ball(trace),
        }),
        Err(error) => unusable(&log, error),
    }
}

/// A window does not count for its log: a host may have written anything into it, and that is no reason for the others not to.
fn unusable(log: &Place, error: LogError) -> Result<WindowState, ReadError> {
    match error.is_of_the_system() {
        true => Err(ReadError::Log {
            path: log.path(),
            source: error,
        }),
        false => Ok(WindowState::Broken {
            reason: format!("{} cannot be used: {error}; {}", log.name(), error.cause()),
        }),
    }
}
