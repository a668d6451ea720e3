//! A measurement checked against itself: the times recorded in a window, put through the loop, give its error again. The function is
//! [`replay`].
//!
//! ```text
//! control.csv ┐ in the order in which ticks began                 ┌ of each window: by how much the errors of its periods
//!             ├──────────────────────────────────► simulation::replay ─┤ differ, and the step from which on positions do
//! plant.csv   ┘ of all windows of an environment                  └
//! ```
//!
//! Both logs are read once and as a stream.

use record::{
    control_log::ControlRow,
    layout,
    run_directory::{PlannedScenario, ReadError, RunDirectory, RunRecords, ScenarioState},
    settings::Settings,
};
use serde::{Deserialize, Serialize};
use simulation::replay::Replay;

use crate::input::loop_logs::{LoggedWindow, LoopLogs, Row, logged_windows, of_the_ball, runs_of_the_loop};

/// What is nearer is the same, in metres: the logs have what decides on it to the last digit.
pub const SAME_M: f64 = 1e-6;

/// What a run came to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(title = "matrix replay --json"))]
pub struct ReplayDocument {
    /// The run.
    pub run: String,
    /// The scenarios with logs of the ball on the plate, in letter order.
    pub scenarios: Vec<ScenarioReplay>,
}

/// What a scenario came to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ScenarioReplay {
    /// Its letter.
    pub id: String,
    /// Its slug.
    pub slug: String,
    /// Whether it was computed and not measured.
    #[serde(default)]
    pub simulated: bool,
    /// Its windows that have a record, in order.
    pub windows: Vec<WindowReplay>,
}

/// What a window came to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct WindowReplay {
    /// Its number.
    pub window: u32,
    /// Why it cannot be replayed, if so; up to where it can, the numbers below hold.
    pub reason: Option<String>,
    /// Periods that were replayed.
    pub periods: u64,
    /// The largest difference of the error (mean |e_x| + mean |e_y|) of a period, in metres.
    pub largest_difference_m: f64,
    /// Its mean over the periods.
    pub mean_difference_m: f64,
    /// From where on positions differ by more than a micrometre, if they do.
    pub parts: Option<Parting>,
}

/// Where what was recorded and what is replayed part.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Parting {
    /// The log.
    pub log: String,
    /// The step.
    pub step: u64,
    /// By how much the positions differ there, in metres.
    pub difference_m: f64,
}

impl WindowReplay {
    /// Whether all of it gives the same.
    #[must_use]
    pub fn is_the_same(&self) -> bool {
        self.reason.is_none() && self.parts.is_none() && self.largest_difference_m <= SAME_M
    }

    /// Why it is suspect, in a clause; none if all of it gives the same.
    #[must_use]
    pub fn doubt(&self) -> Option<String> {
        let parts = self.parts.as_ref().map(
            |Parting {
                 log,
                 step,
                 difference_m,
             }| {
                let difference_um = difference_m * 1e6;
                format!("from step {step} of {log} on positions differ, there by {difference_um:.4} µm")
            },
        );
        let reason = self
            .reason
            .as_ref()
            .map(|reason| format!("not replayed to its end: {reason}"));
        let doubts: Vec<String> = parts.into_iter().chain(reason).collect();
        match (doubts.is_empty(), self.is_the_same()) {
            (true, true) => None,
            (true, false) => Some("errors differ by more than a micrometre".to_owned()),
            (false, _) => Some(doubts.join("; ")),
        }
    }
}

/// Why a run cannot be replayed.
#[derive(Debug, thiserror::Error)]
pub enum ReplayRunError {
    /// The run directory.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// There is nothing to replay.
    #[error("no scenario of {run} has logs of the ball on the plate")]
    NoLogs {
        /// The run.
        run: String,
    },
}

impl ReplayRunError {
    /// What to do about it.
    #[must_use]
    pub fn hint(&self) -> String {
        match self {
            Self::Read(error) => error.hint(),
            Self::NoLogs { .. } => "replay a run of the built-in experiment".to_owned(),
        }
    }
}

/// Replays all windows of a run, scenarios side by side.
///
/// # Errors
/// When the run directory cannot be read, or has nothing to replay.
pub fn replay(directory: &RunDirectory) -> Result<ReplayDocument, ReplayRunError> {
    let records = RunRecords::read_unpruned(directory)?;
    let mut scenarios = of_the_ball(&records, |planned, known| {
        Ok::<_, ReadError>(ScenarioReplay {
            id: planned.id.clone(),
            slug: planned.slug.clone(),
            simulated: planned.simulated,
            windows: of_scenario(directory, planned, known)?,
        })
    })?;
    scenarios.retain(|scenario| !scenario.windows.is_empty());
    match scenarios.is_empty() {
        true => Err(ReplayRunError::NoLogs {
            run: records.manifest.run,
        }),
        false => Ok(ReplayDocument {
            run: records.manifest.run,
            scenarios,
        }),
    }
}

fn of_scenario(
    directory: &RunDirectory,
    planned: &PlannedScenario,
    known: &ScenarioState,
) -> Result<Vec<WindowReplay>, ReadError> {
    let windows = logged_windows(directory, planned, known)?;
    let runs = runs_of_the_loop(&windows);
    Ok(runs.flat_map(|run| of_run(&planned.settings, run)).collect())
}

/// Contiguous windows.
fn of_run(settings: &Settings, windows: &[LoggedWindow]) -> Vec<WindowReplay> {
    let mut tallies: Vec<Tally> = windows
        .iter()
        .map(|(_, record)| Tally::of(record.window))
        .collect();
    let begins = windows.first().is_some_and(|(_, record)| record.starts_run);
    if !begins {
        let reason = "the window before it, from which it goes on, is not there";
        tallies
            .iter_mut()
            .for_each(|tally| tally.reason = Some(reason.to_owned()));
        return tallies.into_iter().map(Tally::finish).collect();
    }
    let mut at = 0;
    if let Err(reason) = merge(settings, windows, &mut tallies, &mut at) {
        for (place, tally) in tallies.iter_mut().enumerate().skip(at) {
            tally.reason = Some(match place == at {
                true => reason.clone(),
                false => "the window before it, from which it goes on, cannot be replayed".to_owned(),
            });
        }
    }
    tallies.into_iter().map(Tally::finish).collect()
}

/// Puts the rows of both logs through the loop. `at` is the window under way, for who has to say why it cannot be replayed.
fn merge(
    settings: &Settings,
    windows: &[LoggedWindow],
    tallies: &mut [Tally],
    at: &mut usize,
) -> Result<(), String> {
    let per_period = settings.steps_per_period().max(1);
    let mut replay = Replay::new(settings);
    for row in LoopLogs::of(windows) {
        match row? {
            Row::Plant(recorded) => {
                let replayed = replay.tick(&recorded).map_err(|error| error.to_string())?;
                let moved = moved([recorded.x_m, recorded.y_m], [replayed.x_m, replayed.y_m]);
                if let Some(tally) = tallies.get_mut(*at) {
                    tally.look(layout::PLANT_LOG, recorded.step, moved);
                }
            }
            Row::Control {
                window,
                row: recorded,
            } => {
                *at = window;
                let replayed = replay.step(&recorded).map_err(|error| error.to_string())?;
                let moved = moved([recorded.x_m, recorded.y_m], [replayed.x_m, replayed.y_m]);
                if let Some(tally) = tallies.get_mut(window) {
                    tally.look(layout::CONTROL_LOG, recorded.step, moved);
                    tally.add(recorded.step / per_period, [&recorded, &replayed].map(error_m));
                }
            }
        }
    }
    Ok(())
}

fn moved(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).abs().max((a[1] - b[1]).abs())
}

fn error_m(row: &ControlRow) -> f64 {
    (row.reference_x_m - row.x_m).abs() + (row.reference_y_m - row.y_m).abs()
}

/// What a window comes to.
struct Tally {
    window: u32,
    reason: Option<String>,
    /// Of the period under way: its number, the sums of both errors, and how many steps.
    period: Option<(u64, [f64; 2], u64)>,
    periods: u64,
    largest_m: f64,
    sum_m: f64,
    parts: Option<Parting>,
}

impl Tally {
    const fn of(window: u32) -> Self {
        Self {
            window,
            reason: None,
            period: None,
            periods: 0,
            largest_m: 0.0,
            sum_m: 0.0,
            parts: None,
        }
    }

    fn look(&mut self, log: &str, step: u64, moved_m: f64) {
        // What is no number is not the same either.
        let is_same = moved_m <= SAME_M;
        if self.parts.is_none() && !is_same {
            self.parts = Some(Parting {
                log: log.to_owned(),
                step,
                difference_m: moved_m,
            });
        }
    }

    fn add(&mut self, period: u64, errors_m: [f64; 2]) {
        if self.period.is_some_and(|(number, ..)| number != period) {
            self.end_period();
        }
        let (_, sums, steps) = self.period.get_or_insert((period, [0.0; 2], 0));
        *sums = [sums[0] + errors_m[0], sums[1] + errors_m[1]];
        *steps += 1;
    }

    fn end_period(&mut self) {
        if let Some((_, [recorded, replayed], steps)) = self.period.take() {
            let difference_m = (recorded - replayed).abs() / steps as f64;
            self.periods += 1;
            self.sum_m += difference_m;
            self.largest_m = self.largest_m.max(difference_m);
        }
    }

    fn finish(mut self) -> WindowReplay {
        self.end_period();
        WindowReplay {
            window: self.window,
            reason: self.reason,
            periods: self.periods,
            largest_difference_m: self.largest_m,
            mean_difference_m: self.sum_m / self.periods.max(1) as f64,
            parts: self.parts,
        }
    }
}
