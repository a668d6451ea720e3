//! A scenario in a report: how it ended, what its windows are worth, what its platform was. The main type is
//! [`ScenarioReport`].

use std::fmt;

use record::{
    axis::{NATIVE, VIRTUALIZATION, axis_text},
    experiment::Compare,
    report_settings::ReportSettings,
    run_directory::{BrokenWindow, EnvironmentRecord, Outcome},
    window::Verdict,
};
use serde_json::{Map, Value};

use crate::{
    analysis::{
        calls::Calls, health::Health, measured_experiment::MeasuredExperiment, quantity::Quantity,
        sample::Sample, within::WithinWindows,
    },
    input::run::{Ending, MissingWindow, ScenarioRun, Window, WindowState},
};

/// One scenario in the report.
#[derive(Debug, Clone, PartialEq)]
pub struct ScenarioReport {
    /// Its letter.
    pub id: String,
    /// Its slug.
    pub slug: String,
    /// Axis to value.
    pub axes: Map<String, Value>,
    /// Which experiment it ran.
    pub experiment: MeasuredExperiment,
    /// Whether it belongs to the baseline.
    pub is_baseline: bool,
    /// Whether its numbers were computed and not measured.
    pub is_simulated: bool,
    /// How it ended.
    pub standing: Standing,
    /// Why, if not completed.
    pub reason: Option<String>,
    /// What to do about it.
    pub hint: Option<String>,
    /// One for each window of the plan.
    pub windows: Vec<WindowReport>,
    /// What broke on the way.
    pub broken: Vec<BrokenWindow>,
    /// How many more broke.
    pub broken_beside: usize,
    /// What its platform was, if it came so far.
    pub environment: Option<EnvironmentRecord>,
    /// What its values within windows have to do with each other; none without a window that counts.
    pub within: Option<WithinWindows>,
    /// How well its platform held the schedule; none without a window that counts, and none of a command.
    pub health: Option<Health>,
    /// What the calls of a command came to; none without a window that counts, and none of the ball on the plate.
    pub calls: Option<Calls>,
}

/// How a scenario stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Standing {
    /// All windows are there.
    Completed,
    /// The workload said that the experiment went wrong.
    Failed,
    /// The infrastructure failed.
    Errored,
    /// It could not run.
    Infeasible,
    /// It was left out of this run.
    NotSelected,
    /// It was asked to stop.
    Interrupted,
    /// It began, and nothing says that it ended.
    Unfinished,
    /// It has not begun.
    NotStarted,
}

impl Standing {
    /// Its name in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Completed => Outcome::Completed.name(),
            Self::Failed => Outcome::Failed.name(),
            Self::Errored => Outcome::Errored.name(),
            Self::Infeasible => "infeasible",
            Self::Interrupted => Outcome::Interrupted.name(),
            Self::Unfinished => "unfinished",
            Self::NotSelected => "not selected",
            Self::NotStarted => "not started",
        }
    }
}

/// One window in the report.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WindowReport {
    /// Its number, from 1.
    pub number: u32,
    /// `valid`, `suspect`, `invalid`, `broken` or `missing`.
    pub verdict: &'static str,
    /// Values in its sample; 0 if it has none.
    pub n: usize,
    /// Whether it counts.
    pub is_counted: bool,
    /// Why, if not valid.
    pub reasons: Vec<String>,
}

/// What was found of some windows in a row that are not valid. Displayed, one remark without the reasons.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct VerdictReport<'a> {
    /// Which, such as `windows 2 to 3`.
    pub windows: String,
    /// How many they are.
    pub count: usize,
    /// As [`WindowReport::verdict`].
    pub verdict: &'static str,
    /// Whether they count all the same.
    pub counted: bool,
    /// What the window's verdict is based on, one sentence each.
    pub reasons: &'a [String],
}

impl fmt::Display for VerdictReport<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let counted = if self.counted { "counted" } else { "not counted" };
        write!(f, "{} {}, {counted}", self.windows, self.verdict)
    }
}

impl ScenarioReport {
    /// Windows that count.
    #[must_use]
    pub fn windows_counted(&self) -> usize {
        self.windows.iter().filter(|window| window.is_counted).count()
    }

    /// Windows that count and are not valid.
    #[must_use]
    pub fn windows_suspect(&self) -> usize {
        let counted = self.windows.iter().filter(|window| window.is_counted);
        counted.filter(|it| it.verdict != Verdict::Valid.name()).count()
    }

    /// What to say of the windows that are not valid, a remark for each run of the same verdict for the same reasons;
    /// empty for a scenario that was never begun.
    #[must_use]
    pub fn verdicts(&self) -> Vec<VerdictReport<'_>> {
        if self.standing == Standing::NotStarted {
            return Vec::new();
        }
        let same = |a: &WindowReport, b: &WindowReport| a.verdict == b.verdict && a.reasons == b.reasons;
        let runs = self.windows.chunk_by(same).filter_map(|run| {
            let (first, last) = (run.first()?, run.last()?);
            (first.verdict != Verdict::Valid.name()).then(|| VerdictReport {
                windows: match run.len() {
                    1 => format!("window {}", first.number),
                    _ => format!("windows {} to {}", first.number, last.number),
                },
                count: run.len(),
                verdict: first.verdict,
                counted: first.is_counted,
                reasons: &first.reasons,
            })
        });
        runs.collect()
    }

    /// Whether the plan has a way to run it.
    #[must_use]
    pub fn can_run(&self) -> bool {
        self.standing != Standing::Infeasible
    }

    /// Its virtualization: natively where it has no such axis.
    #[must_use]
    pub fn virtualization(&self) -> String {
        self.axis(VIRTUALIZATION).unwrap_or_else(|| NATIVE.to_owned())
    }

    /// What it runs on: the values of all axes but virtualization.
    #[must_use]
    pub fn platform(&self) -> String {
        let others = self.axes.iter().filter(|(axis, _)| *axis != VIRTUALIZATION);
        let values: Vec<String> = others.map(|(_, value)| axis_text(value)).collect();
        match values.is_empty() {
            true => "this machine".to_owned(),
            false => values.join(" "),
        }
    }

    /// The value of an axis as text, if the scenario has that axis.
    #[must_use]
    pub fn axis(&self, name: &str) -> Option<String> {
        self.axes.get(name).map(axis_text)
    }
}

/// A scenario of the run, with its samples.
pub(super) fn scenario_report(
    scenario: &ScenarioRun,
    settings: &ReportSettings,
    quantity: &Quantity,
    samples: &[Sample],
) -> ScenarioReport {
    let (standing, reason, hint) = standing(&scenario.ending);
    let planned = &scenario.planned;
    let n = |window: u32| {
        let sample = samples
            .iter()
            .find(|sample| sample.scenario == planned.id && sample.window == window);
        sample.map_or(0, |sample| sample.values.len())
    };
    ScenarioReport {
        id: planned.id.clone(),
        slug: planned.slug.clone(),
        axes: planned.axes.clone(),
        experiment: MeasuredExperiment::of(&planned.settings),
        is_baseline: settings.is_baseline(planned),
        is_simulated: scenario.is_simulated(),
        standing,
        reason,
        hint,
        windows: scenario
            .windows
            .iter()
            .map(|window| window_report(window, n(window.number), quantity))
            .collect(),
        broken: scenario.broken.clone(),
        broken_beside: scenario.broken_beside,
        environment: scenario.environment.clone(),
        within: WithinWindows::of(scenario, samples, settings),
        health: Health::of(scenario),
        calls: Calls::of(scenario),
    }
}

fn standing(ending: &Ending) -> (Standing, Option<String>, Option<String>) {
    let resume = || Some("`matrix resume` goes on with it".to_owned());
    match ending {
        Ending::Infeasible { reason, fix } => (Standing::Infeasible, Some(reason.clone()), fix.clone()),
        Ending::NotSelected { reason } => (Standing::NotSelected, Some(reason.clone()), None),
        Ending::NotStarted => (
            Standing::NotStarted,
            Some("its turn had not come when the run ended".to_owned()),
            resume(),
        ),
        Ending::Unfinished => {
            let reason = "it is being measured, or whatever measured it was killed";
            (Standing::Unfinished, Some(reason.to_owned()), resume())
        }
        Ending::Ended {
            outcome,
            reason,
            hint,
        } => {
            let standing = match outcome {
                Outcome::Completed => Standing::Completed,
                Outcome::Failed => Standing::Failed,
                Outcome::Errored => Standing::Errored,
                Outcome::Interrupted => Standing::Interrupted,
            };
            (standing, reason.clone(), hint.clone())
        }
    }
}

fn window_report(window: &Window, n: usize, quantity: &Quantity) -> WindowReport {
    let (verdict, mut reasons) = match &window.state {
        WindowState::Counted { record, .. } | WindowState::Invalid { record } => {
            (record.verdict.name(), record.reasons.clone())
        }
        WindowState::Broken { reason } => ("broken", vec![reason.clone()]),
        WindowState::Missing { known } => ("missing", vec![words_for(*known).to_owned()]),
    };
    let is_measured = matches!(window.state, WindowState::Counted { .. });
    // A metric that is compared byte for byte has no values.
    let is_left_out = quantity.compare == Compare::Ks && n == 0;
    if is_measured && is_left_out {
        reasons.push(match quantity.is_tracking_error {
            true => "all its periods are left out".to_owned(),
            false => format!("it has no value of {}", quantity.with_file_unit(&quantity.name)),
        });
    }
    WindowReport {
        number: window.number,
        verdict,
        n,
        is_counted: is_measured && !is_left_out,
        reasons,
    }
}

/// Why a window is not there.
const fn words_for(missing: MissingWindow) -> &'static str {
    match missing {
        MissingWindow::NotMeasured => "it was not measured",
        MissingWindow::NotCollected => "it was measured, and has not been collected",
        MissingWindow::Unknown => {
            "it is there, and events.jsonl does not have it as collected: `matrix resume` collects or measures it again"
        }
        MissingWindow::Lost => "it was collected, and is not there any more",
    }
}
