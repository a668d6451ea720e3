//! One run as it was measured: every scenario of the plan with how it ended and the windows it left. The main type is
//! [`Run`]; [`load`] reads it from its directory, and nothing after that touches the disk.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};

use rayon::prelude::*;
use record::{
    causes::with_causes,
    layout,
    progress::Progress,
    report_settings::ErrorOf,
    run_directory::{
        ControlTrace, EnvironmentRecord, Event, Expected, Journal, LogError, Manifest, Outcome, Place,
        PlannedScenario, PlantTrace, ReadError, Revision, RunDirectory, RunRecords, ScenarioChecksums,
        read_environment, read_window,
    },
    settings::Settings,
    window::{Verdict, WindowRecord},
};

use crate::redaction::REMARK;

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
    /// Letters of the scenarios of which it has windows that count.
    pub scenarios: Vec<String>,
    /// Lines of its journal that a crash cut, from 1.
    pub cut_lines: Vec<usize>,
    /// Whether its journal has checksums of itself and of the other files: not in runs of earlier versions.
    pub is_checked: bool,
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
    /// Its last environment's record, if it came so far.
    pub environment: Option<EnvironmentRecord>,
    /// Why that record cannot be read, if it is there and cannot.
    pub unknown: Option<String>,
    /// One for each window of the plan; none if the scenario is infeasible or was not selected.
    pub windows: Vec<Window>,
    /// What broke on the way, whether or not it was measured again.
    pub broken: Vec<BrokenWindow>,
}

/// How a scenario ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Ending {
    /// It could not run.
    Infeasible {
        /// Why.
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
        /// How.
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
        /// Its log, digested.
        trace: ControlTrace,
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
    /// It was there.
    Lost,
}

/// A window that broke, kept aside.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BrokenWindow {
    /// Its number.
    pub window: u32,
    /// The environment that measured it.
    pub environment: String,
    /// Why.
    pub reason: String,
}

impl ScenarioRun {
    /// Whether its numbers were made up by its provider.
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

    /// The windows that count, with their records and logs.
    pub fn counted(&self) -> impl Iterator<Item = (u32, &WindowRecord, &ControlTrace)> {
        self.windows.iter().filter_map(|window| match &window.state {
            WindowState::Counted { record, trace } => Some((window.number, &**record, trace)),
            _ => None,
        })
    }
}

/// Reads a run directory as its own settings ask for.
///
/// # Errors
/// As [`load_by`].
pub fn load(path: impl AsRef<Path>) -> Result<Run, ReadError> {
    load_by(path.as_ref(), None)
}

/// Reads a run directory, scenarios side by side, for the error of other positions than its settings ask for where that is
/// said. Logs are read once and digested: of a run of 28 windows of 6000 s, some megabytes stay.
///
/// # Errors
/// When it is missing, half-written, damaged or of a later format, and when the system does not let a file be read.
pub fn load_by(path: &Path, error: Option<ErrorOf>) -> Result<Run, ReadError> {
    let directory = RunDirectory::new(path);
    let RunRecords {
        manifest,
        plan,
        journal,
        checksums,
    } = RunRecords::read(&directory)?;
    let error = error.unwrap_or(manifest.report.error);
    let mut histories = histories(&journal);
    let with_history = |planned: PlannedScenario| {
        let history = histories.remove(&planned.slug).unwrap_or_default();
        (planned, history)
    };
    let scenarios: Vec<(PlannedScenario, History)> = plan.scenarios.into_iter().map(with_history).collect();
    // Of two that are at fault always the first is told, whichever is read first.
    let scenarios: Vec<Result<ScenarioRun, ReadError>> = scenarios
        .into_par_iter()
        .map(|(planned, history)| {
            let checksums = checksums.scenario(&planned.slug);
            load_scenario(&directory, planned, history, &checksums, error)
        })
        .collect();
    let scenarios: Vec<ScenarioRun> = scenarios.into_iter().collect::<Result<_, _>>()?;
    let mut remarks = Vec::from_iter(manifest.redacted.then(|| REMARK.to_owned()));
    remarks.extend(scenarios.iter().filter_map(ScenarioRun::remark));
    Ok(Run {
        report_folder: directory.report(),
        parts: vec![RunPart::of(directory, &manifest, &scenarios, &journal)],
        remarks,
        manifest,
        error,
        scenarios,
    })
}

/// What the journal says of one scenario.
#[derive(Default)]
struct History {
    ending: Option<Ending>,
    providers: BTreeSet<String>,
    broken: Vec<BrokenWindow>,
    /// Windows that were measured or collected.
    windows: BTreeMap<u32, MissingWindow>,
}

fn histories(journal: &Journal) -> BTreeMap<String, History> {
    let mut histories: BTreeMap<String, History> = BTreeMap::new();
    for entry in &journal.entries {
        match entry.event.clone() {
            Event::ScenarioStarted { scenario, .. } => {
                histories.entry(scenario).or_default().ending = Some(Ending::Unfinished);
            }
            Event::EnvironmentCreating {
                scenario, provider, ..
            } => {
                histories.entry(scenario).or_default().providers.insert(provider);
            }
            Event::WindowBroken {
                scenario,
                environment,
                window,
                reason,
            } => {
                let broken = BrokenWindow {
                    window,
                    environment,
                    reason,
                };
                let history = histories.entry(scenario).or_default();
                history.broken.push(broken);
                history.windows.remove(&window);
            }
            Event::Workload {
                scenario,
                progress: Progress::WindowComplete { window, .. },
            } => {
                let history = histories.entry(scenario).or_default();
                history.windows.insert(window, MissingWindow::NotCollected);
            }
            Event::WindowCollected { scenario, window, .. } => {
                let history = histories.entry(scenario).or_default();
                history.windows.insert(window, MissingWindow::Lost);
            }
            Event::ScenarioFinished {
                scenario,
                outcome,
                reason,
                hint,
            } => {
                let ending = Ending::Ended {
                    outcome,
                    reason,
                    hint,
                };
                histories.entry(scenario).or_default().ending = Some(ending);
            }
            _ => {}
        }
    }
    histories
}

fn load_scenario(
    directory: &RunDirectory,
    planned: PlannedScenario,
    history: History,
    checksums: &ScenarioChecksums,
    error: ErrorOf,
) -> Result<ScenarioRun, ReadError> {
    let environment = directory.environment(&planned.slug);
    let read = || read_environment(&environment, checksums.environments());
    // One that the journal has and that is gone is an error to read, and so is remarked on.
    let is_expected = environment.exists() || checksums.environments().next().is_some();
    let (environment, unknown) = match is_expected.then(read) {
        None => (None, None),
        Some(Ok(environment)) => (Some(environment), None),
        Some(Err(error @ ReadError::FutureFormat { .. })) => return Err(error),
        // What is not known of a platform must not cost what was measured on it.
        Some(Err(error)) => (None, Some(with_causes(&error))),
    };
    let ending = ending(&planned, history.ending);
    let measured = !matches!(ending, Ending::Infeasible { .. } | Ending::NotSelected { .. });
    let wanted = if measured { planned.settings.windows } else { 0 };
    let windows = (1..=wanted)
        .map(|number| {
            let folder = directory.window(&planned.slug, number);
            let state = match folder.exists() {
                true => load_window(&folder, &planned, number, checksums.window(number), error)?,
                false => WindowState::Missing {
                    known: history.windows.get(&number).copied().unwrap_or_default(),
                },
            };
            Ok(Window {
                number,
                folder,
                state,
            })
        })
        .collect::<Result<_, ReadError>>()?;
    let mut providers = history.providers;
    providers.extend(environment.as_ref().map(|record| record.provider.clone()));
    Ok(ScenarioRun {
        planned,
        ending,
        providers,
        environment,
        unknown,
        windows,
        broken: history.broken,
    })
}

/// The first step of a window that lost some, which may be among them. The log of any other begins with it.
fn first_step(record: &WindowRecord, settings: &Settings) -> Option<u64> {
    let step_ns = u64::try_from(settings.rate.step().as_nanos()).ok()?;
    let started_ns = u64::try_from(record.started_ns).ok()?;
    (record.controller.lost_ticks > 0).then(|| started_ns / step_ns.max(1))
}

fn ending(planned: &PlannedScenario, journaled: Option<Ending>) -> Ending {
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
    match (&planned.not_selected, journaled) {
        (_, Some(ending)) => ending,
        (Some(reason), None) => Ending::NotSelected {
            reason: reason.clone(),
        },
        (None, None) => Ending::NotStarted,
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
    let about = folder.join(layout::WINDOW);
    if !about.exists() {
        return broken("window.json is missing, so it was never finished".to_owned());
    }
    let record = match read_window(folder, sha256) {
        Err(ReadError::Impossible { source, .. }) => {
            return broken(format!("window.json cannot be what was measured: {source}"));
        }
        Err(ReadError::Damaged { how, .. }) => return broken(format!("window.json is damaged: {how}")),
        Err(ReadError::Json { source, .. }) => {
            return broken(format!("window.json cannot be understood: {source}"));
        }
        read => read?,
    };
    if record.window != number {
        return broken(format!("window.json is that of window {}", record.window));
    }
    if !record.complete {
        return broken(format!(
            "{} of {} steps were done",
            record.steps_done, record.steps_expected
        ));
    }
    if record.verdict == Verdict::Invalid {
        return Ok(WindowState::Invalid {
            record: Box::new(record),
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
    let expected = Expected {
        steps: planned.settings.steps_per_window(),
        lost: record.controller.lost_ticks,
        first_step: first_step(&record, &planned.settings),
        steps_per_period: planned.settings.steps_per_period().max(1),
        file,
    };
    match ControlTrace::read(&log, expected, truth.as_ref()) {
        Ok(trace) => Ok(WindowState::Counted {
            record: Box::new(record),
            trace,
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
