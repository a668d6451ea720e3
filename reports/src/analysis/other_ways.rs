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
pub fn other_ways(run: &Run, by_other_positions: Option<&Run>, settings: &ReportSettings) -> Vec<Way> {
    let is_of_the_ball = run
        .scenarios
        .iter()
        .any(|scenario| scenario.planned.settings.experiment.is_none());
    let way = |run: &Run, setting: &'static str, value: &str, settings: &ReportSettings| {
        Way::of(setting, value, &analyse(run, Traffic::default(), settings))
    };
    let mut ways = vec![way(run, "", "", settings)];
    for method in Method::ALL
        .into_iter()
        .filter(|method| *method != settings.method)
    {
        let with_it = ReportSettings {
            method,
            ..settings.clone()
        };
        ways.push(way(run, "method", method.name(), &with_it));
    }
    if !is_of_the_ball {
        return ways;
    }
    for metric in Metric::ALL
        .into_iter()
        .filter(|metric| *metric != settings.metric)
    {
        let with_it = ReportSettings {
            metric,
            ..settings.clone()
        };
        ways.push(way(run, "metric", &written(&metric), &with_it));
    }
    for discard_periods in [0, 1]
        .into_iter()
        .filter(|periods| *periods != settings.discard_periods)
    {
        let with_it = ReportSettings {
            discard_periods,
            ..settings.clone()
        };
        ways.push(way(
            run,
            "discard_periods",
            &discard_periods.to_string(),
            &with_it,
        ));
    }
    if let Some(other) = by_other_positions {
        ways.push(way(other, "error", &written(&other.error), settings));
    }
    ways
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
