//! The same run decided in other ways: by each method, each metric, with other first periods left out, by the other positions. What
//! is said of the platforms should not hang on such a choice, and a reader sees whether it does. The function is [`other_ways`].

use captures::traffic::Traffic;
use record::report_settings::{ErrorOf, Method, Metric, ReportSettings};
use serde::Serialize;

use super::report::{Report, analyse};
use crate::input::run::Run;

/// One way.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Way {
    /// What of the settings is another: `method`, `metric`, `discard_periods` or `error`; empty for the report's own.
    pub setting: &'static str,
    /// Its value; empty for the report's own.
    pub value: String,
    /// Rejected window pairs within scenarios, and all of them.
    pub within: [usize; 2],
    /// Those of different scenarios.
    pub between: [usize; 2],
    /// Pairs of the family that are told apart, and all of them.
    pub told_apart: [usize; 2],
}

/// The report's own way first, then those that differ from it in one setting. `by_other_positions` is the run with the errors of the
/// other positions, where there is one.
#[must_use]
pub fn other_ways(report: &Report, run: &Run, by_other_positions: Option<&Run>) -> Vec<Way> {
    let settings = &report.settings;
    let way = |run: &Run, setting: &'static str, value: &str, settings: &ReportSettings| {
        Way::of(setting, value, &analyse(run, Traffic::default(), settings))
    };
    let mut ways = vec![Way::of("", "", report)];
    let others = other_settings(settings).into_iter();
    let others = others.filter(|(setting, ..)| *setting == METHOD || is_of_the_ball(run));
    ways.extend(others.map(|(setting, value, settings)| way(run, setting, &value, &settings)));
    ways.extend(by_other_positions.map(|other| way(other, "error", &written(&other.error), settings)));
    ways
}

/// The one setting that a report of a command has, too.
const METHOD: &str = "method";

fn is_of_the_ball(run: &Run) -> bool {
    let mut scenarios = run.scenarios.iter();
    scenarios.any(|scenario| scenario.planned.settings.experiment.is_none())
}

/// Those that differ in one setting, with its name and its value.
fn other_settings(own: &ReportSettings) -> Vec<(&'static str, String, ReportSettings)> {
    let mut all = Vec::new();
    for method in Method::ALL {
        all.push((
            METHOD,
            method.name().to_owned(),
            ReportSettings {
                method,
                ..own.clone()
            },
        ));
    }
    for metric in Metric::ALL {
        all.push((
            "metric",
            written(&metric),
            ReportSettings {
                metric,
                ..own.clone()
            },
        ));
    }
    for discard_periods in [0, 1] {
        all.push((
            "discard_periods",
            discard_periods.to_string(),
            ReportSettings {
                discard_periods,
                ..own.clone()
            },
        ));
    }
    all.retain(|(.., settings)| settings != own);
    all
}

/// A value as a matrix file has it.
fn written(value: &impl Serialize) -> String {
    let value = serde_json::to_value(value).unwrap_or_default();
    value.as_str().unwrap_or_default().to_owned()
}

/// The positions that a report is not of.
#[must_use]
pub const fn other_positions(error: ErrorOf) -> ErrorOf {
    match error {
        ErrorOf::Received => ErrorOf::TruePosition,
        ErrorOf::TruePosition => ErrorOf::Received,
    }
}

impl Way {
    fn of(setting: &'static str, value: &str, report: &Report) -> Self {
        let counted = |is_within: bool| {
            let tallies = report
                .tallies
                .iter()
                .filter(|tally| (tally.a == tally.b) == is_within);
            tallies.fold([0, 0], |[rejected, pairs], tally| {
                [rejected + tally.rejected, pairs + tally.pairs]
            })
        };
        let pairs = &report.contrasts.pairs;
        let told_apart = pairs.iter().filter(|pair| pair.verdict.is_difference());
        Self {
            setting,
            value: value.to_owned(),
            within: counted(true),
            between: counted(false),
            told_apart: [told_apart.count(), pairs.len()],
        }
    }
}
