//! One scenario and metric along the nights. The main type is [`Series`].

use std::collections::BTreeSet;

use record::run_directory::Difference;
use statistics::effect::median;

use super::{Acknowledgements, Judgement, Metric, MissingData, Night, Verdict, night::Measured};
use crate::analysis::fields::differing;

/// What one scenario and metric came to, night after night.
#[derive(Debug, Clone, PartialEq)]
pub struct Series<'a> {
    /// The scenario's slug.
    pub scenario: String,
    /// What was measured.
    pub metric: Metric,
    /// The nights that have a number, the earliest first.
    pub(super) points: Vec<Point<'a>>,
    /// What the newest night lacks to have one.
    pub(super) lack: Option<MissingData>,
}

/// A night with a number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Point<'a> {
    pub run: &'a str,
    /// Its place among all nights.
    pub night: usize,
    pub level: f64,
    pub measured: &'a Measured,
}

impl Point<'_> {
    /// The lowest and the highest window of the night.
    pub(super) fn range(&self, metric: &Metric) -> Option<[f64; 2]> {
        let values = self.measured.values.get(metric)?;
        let low = values.iter().copied().reduce(f64::min)?;
        let high = values.iter().copied().reduce(f64::max)?;
        Some([low, high])
    }
}

/// What else changed where a metric did.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Cause {
    /// What was asked for is not the same: the fields that differ. The infrastructure need not have done anything.
    Configuration(Vec<String>),
    /// What it ran on is not the same.
    Infrastructure(Vec<Difference>),
    /// Nothing that is recorded.
    Unexplained,
}

/// One series for each scenario that the newest night was asked for, or that earlier ones measured and it still knows, and
/// each metric.
#[must_use]
pub fn series_of(nights: &[Night]) -> Vec<Series<'_>> {
    let Some(newest) = nights.last() else {
        return Vec::new();
    };
    let mut all = Vec::new();
    for scenario in newest.scenarios.keys() {
        for metric in metrics(nights, scenario) {
            let series = Series::of(nights, scenario, metric);
            let never_asked = never_asked(series.lack.as_ref()) && series.points.is_empty();
            // A metric that no night has, or that is the same in all as far as it is measured, is none of this platform's; but
            // for the one that it is about.
            let levels = || series.points.iter().map(|point| point.level);
            let range = levels().reduce(f64::max).zip(levels().reduce(f64::min));
            let is_constant =
                range.is_none_or(|(highest, lowest)| highest - lowest <= series.metric.resolution());
            let not_its = is_constant && !series.metric.is_of_experiment();
            let is_given_up = is_given_up(newest, scenario, &series.metric);
            if !never_asked && !not_its && !is_given_up {
                all.push(series);
            }
        }
    }
    all
}

/// Every scenario and metric that any night has numbers of.
pub(super) fn every_series(nights: &[Night]) -> Vec<Series<'_>> {
    let scenarios: BTreeSet<&str> = nights
        .iter()
        .flat_map(|night| night.scenarios.keys().map(String::as_str))
        .collect();
    let of = |scenario| {
        metrics(nights, scenario)
            .into_iter()
            .map(move |metric| (scenario, metric))
    };
    let all = scenarios.into_iter().flat_map(of);
    all.map(|(scenario, metric)| Series::of(nights, scenario, metric))
        .collect()
}

/// Whether a metric of a user's experiment is none of it any more: it was renamed, or has another unit. Its earlier nights are no lack
/// of the newest.
fn is_given_up(newest: &Night, scenario: &str, metric: &Metric) -> bool {
    let declared = newest
        .scenarios
        .get(scenario)
        .is_some_and(|it| it.values.contains_key(metric));
    metric.is_of_experiment() && *metric != newest.metric && !declared
}

/// What any night has of a scenario, in a fixed order; at least what the newest night's experiment is about.
fn metrics(nights: &[Night], scenario: &str) -> BTreeSet<Metric> {
    let measured = nights.iter().filter_map(|night| night.scenarios.get(scenario));
    let about = nights.last().map(|night| night.metric.clone());
    // Another look is for these.
    let about = about.filter(|metric| !matches!(metric, Metric::Content { .. }));
    measured
        .flat_map(|measured| measured.values.keys().cloned())
        .chain(about)
        .collect()
}

/// What a reader must know of some nights, whatever they are judged to be.
pub(super) fn remarks(nights: &[Night]) -> Vec<String> {
    let simulated = nights.iter().filter(|night| night.is_simulated).count();
    let made_up = (simulated > 0).then(|| {
        format!(
            "SIMULATED, NOT MEASURED: numbers of {simulated} of {} runs were computed and not measured",
            nights.len()
        )
    });
    made_up.into_iter().chain(given_up(nights)).collect()
}

/// That metrics of earlier nights are followed no longer.
fn given_up(nights: &[Night]) -> Option<String> {
    let (newest, earlier) = nights.split_last()?;
    let mut names = BTreeSet::new();
    for (scenario, measured) in earlier.iter().flat_map(|night| &night.scenarios) {
        let given_up = measured.values.iter().filter(|(metric, levels)| {
            !levels.is_empty()
                && newest.scenarios.contains_key(scenario)
                && is_given_up(newest, scenario, metric)
        });
        names.extend(given_up.map(|(metric, _)| match metric.unit() {
            "" => format!("`{}`", metric.name()),
            unit => format!("`{}` in {unit}", metric.name()),
        }));
    }
    (!names.is_empty()).then(|| {
        format!(
            "earlier runs measured {}, which the newest run's experiment does not have: that is followed no longer",
            names.into_iter().collect::<Vec<_>>().join(", ")
        )
    })
}

/// What is said of scenarios that earlier nights have measured and the newest does not know: that is no pass, until somebody says
/// that it is meant.
pub(super) fn gone(nights: &[Night], known: &Acknowledgements) -> Vec<Judgement> {
    let Some((newest, earlier)) = nights.split_last() else {
        return Vec::new();
    };
    let of = |scenario: &str| Judgement {
        scenario: scenario.to_owned(),
        metric: earlier
            .last()
            .map(|night| night.metric.clone())
            .unwrap_or_default(),
        verdict: Verdict::TooLittle {
            reason: format!(
                "earlier runs have it and the newest does not; if it is to be left out, acknowledge that with `since: {}`",
                newest.run
            ),
        },
        nights: earlier.iter().filter(|night| measured(night, scenario)).count(),
        findings: Vec::new(),
    };
    not_in(newest, earlier)
        .into_iter()
        .filter(|scenario| !known.is_left_out(nights, scenario))
        .map(of)
        .collect()
}

fn measured(night: &Night, scenario: &str) -> bool {
    let measured = night.scenarios.get(scenario);
    measured.is_some_and(|measured| measured.has(&night.metric))
}

/// Scenarios that earlier nights have measured and the newest does not know.
fn not_in<'a>(newest: &Night, earlier: &'a [Night]) -> Vec<&'a str> {
    let known: BTreeSet<&str> = earlier
        .iter()
        .flat_map(|night| {
            let scenarios = night.scenarios.keys().map(String::as_str);
            scenarios.filter(|scenario| measured(night, scenario))
        })
        .collect();
    known
        .into_iter()
        .filter(|scenario| !newest.scenarios.contains_key(*scenario))
        .collect()
}

impl<'a> Series<'a> {
    fn of(nights: &'a [Night], scenario: &str, metric: Metric) -> Self {
        let measured = |night: &'a Night| night.scenarios.get(scenario);
        let points = nights.iter().enumerate().filter_map(|(place, night)| {
            let measured = measured(night)?;
            Some(Point {
                run: &night.run,
                night: place,
                level: measured.level(&metric)?,
                measured,
            })
        });
        let newest = nights.last().and_then(measured);
        let has_number = newest.is_some_and(|newest| newest.level(&metric).is_some());
        let points = points.collect();
        Self {
            scenario: scenario.to_owned(),
            metric,
            points,
            lack: match newest {
                Some(newest) => lacks(newest, has_number),
                None => Some(none_there()),
            },
        }
    }

    /// Without the nights before that run.
    pub(super) fn from(mut self, run: Option<&str>) -> Self {
        let first = run.and_then(|run| self.points.iter().position(|point| point.run == run));
        self.points.drain(..first.unwrap_or(0));
        self
    }
}

/// The middle of the levels of some nights; 0 of none.
pub(super) fn level_of(points: &[Point<'_>]) -> f64 {
    median(points.iter().map(|point| point.level).collect()).unwrap_or_default()
}

impl Cause {
    /// What is not the same of a night and a later one.
    pub(super) fn between(before: &Measured, since: &Measured) -> Self {
        let fields: Vec<String> = differing(&before.configuration.read(), &since.configuration.read())
            .into_iter()
            .map(|(field, ..)| field)
            .collect();
        match fields.is_empty() {
            true => Self::between_platforms(before, since),
            false => Self::Configuration(fields),
        }
    }

    /// The same, whatever was asked for.
    pub(super) fn between_platforms(before: &Measured, since: &Measured) -> Self {
        let platform = |of: &Measured| of.environment.as_ref()?.read();
        let differences = platform(before)
            .zip(platform(since))
            .map(|(before, since)| before.differences(&since))
            .unwrap_or_default();
        match differences.is_empty() {
            true => Self::Unexplained,
            false => Self::Infrastructure(differences),
        }
    }
}

/// What a series has to say that has no number tonight.
pub(super) fn lacking(series: &Series<'_>) -> Option<Verdict> {
    series.lack.clone().map(Verdict::from)
}

/// What a night lacks to have something of a metric, if it has not.
pub(super) fn lacks(measured: &Measured, has: bool) -> Option<MissingData> {
    (!has).then(|| measured.lack.clone().unwrap_or_else(none_there))
}

fn none_there() -> MissingData {
    MissingData::Absent("the newest run has nothing of it".to_owned())
}

pub(super) const fn never_asked(lack: Option<&MissingData>) -> bool {
    matches!(lack, Some(MissingData::NotAsked(_)))
}

impl From<MissingData> for Verdict {
    fn from(lack: MissingData) -> Self {
        match lack {
            MissingData::Invalid(reason) => Self::Invalid { reason },
            MissingData::Absent(reason) | MissingData::NotAsked(reason) => Self::TooLittle { reason },
        }
    }
}
