//! One run, brought down to what is followed from night to night: a few numbers a window. The main type is [`Night`].

use std::collections::BTreeMap;

use captures::traffic::{Traffic, WindowTraffic};
use record::{
    experiment::Compare,
    name::{by_name, name},
    quantity::Length,
    run_directory::EnvironmentRecord,
};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use statistics::effect::median;

use crate::{
    analysis::{
        agreement::files,
        quantity::Quantity,
        sample::{Sample, levels, samples},
    },
    drift::{Compact, Metric},
    input::{
        overheads::seconds_between,
        run::{Ending, Run, ScenarioRun, WindowState},
    },
};

/// Why a night has no number for a scenario.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MissingData {
    /// Windows were measured, and none counts.
    Invalid(String),
    /// Nothing was measured.
    Absent(String),
    /// Nothing was to be measured: it cannot run there, or was not selected.
    NotAsked(String),
}

/// One run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Night {
    /// The run's name.
    #[serde(deserialize_with = "name")]
    pub run: String,
    /// When it was asked for, RFC 3339.
    pub created: String,
    /// Whether some of its numbers were computed and not measured.
    pub is_simulated: bool,
    /// The metric that its experiment is about.
    #[serde(default)]
    pub metric: Metric,
    /// The equivalence margin of the tracking error that was declared, in metres; `report/night.json` has it under the name that it
    /// had.
    #[serde(rename = "matters_m")]
    pub equivalence_margin_m: Option<f64>,
    /// Those of the metrics of a command, in the unit of each.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub equivalence_margins: BTreeMap<Metric, f64>,
    /// By slug.
    #[serde(deserialize_with = "by_name")]
    pub scenarios: BTreeMap<String, Measured>,
}

/// What a night has of one scenario.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// All that was asked for: the experiment's settings, the workload's bytes, the provider's settings.
    pub configuration: Compact<Value>,
    /// What it ran on, if it came so far.
    pub environment: Option<Compact<EnvironmentRecord>>,
    /// The numbers, one for each window or environment.
    pub values: BTreeMap<Metric, Vec<f64>>,
    /// Of each metric that is compared byte for byte, by its name, the SHA-256 of each window.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub contents: BTreeMap<String, BTreeMap<u32, String>>,
    /// Why there are none.
    pub lack: Option<MissingData>,
}

impl Measured {
    /// The night's level: the median of its numbers.
    #[must_use]
    pub fn level(&self, metric: &Metric) -> Option<f64> {
        median(self.values.get(metric)?.clone())
    }

    /// Whether the night has anything of a metric.
    #[must_use]
    pub fn has(&self, metric: &Metric) -> bool {
        match metric {
            Metric::Content { name } => self.contents.get(name).is_some_and(|windows| !windows.is_empty()),
            numbers => self.level(numbers).is_some(),
        }
    }
}

impl Night {
    /// The equivalence margins that were declared, each in the unit of its metric.
    #[must_use]
    pub fn margins(&self) -> BTreeMap<Metric, f64> {
        let error = self
            .equivalence_margin_m
            .map(|margin_m| (Metric::TrackingError, margin_m));
        let of_commands = self.equivalence_margins.iter();
        let of_commands = of_commands.map(|(metric, margin)| (metric.clone(), *margin));
        error.into_iter().chain(of_commands).collect()
    }

    /// The day of the week on which it was asked for, in UTC, from 0 (Thursday) to 6.
    pub(super) fn weekday(&self) -> Option<usize> {
        let created = humantime::parse_rfc3339(&self.created).ok()?;
        let since = created.duration_since(std::time::UNIX_EPOCH).ok()?;
        Some((since.as_secs() / 86_400 % 7) as usize)
    }

    /// That of a run and its packets, in the metric that its own settings ask for.
    #[must_use]
    pub fn of(run: &Run, traffic: &Traffic) -> Self {
        let settings = &run.manifest.report;
        let quantities = Quantity::of_run(run, settings);
        let followed: Vec<(Metric, &Quantity, Vec<Sample>)> = quantities
            .iter()
            .filter(|quantity| quantity.compare == Compare::Ks)
            .map(|quantity| (Metric::of(quantity), quantity, samples(run, settings, quantity)))
            .collect();
        let mut scenarios = BTreeMap::new();
        for scenario in &run.scenarios {
            let planned = &scenario.planned;
            let mut values = BTreeMap::<Metric, Vec<f64>>::new();
            for (metric, _, samples) in &followed {
                values.insert(metric.clone(), levels(samples, &planned.id));
            }
            let contents = contents(scenario, &quantities);
            let counts = values.values().any(|levels| !levels.is_empty())
                || contents.values().any(|windows| !windows.is_empty());
            for (_, record, data) in scenario.counted() {
                let age = data.trace().and_then(|trace| trace.mean_state_age_s);
                values.entry(Metric::StateAge).or_default().extend(age);
                let late_s = record
                    .loops()
                    .map(|done| done.controller.lateness_p99_ns as f64 / 1e9);
                values.entry(Metric::Lateness).or_default().extend(late_s);
            }
            let packets = traffic.scenarios.get(&planned.id);
            let delays = packets
                .iter()
                .flat_map(|found| &found.windows)
                .filter_map(delay_s);
            values.insert(Metric::PacketDelay, delays.collect());
            let took = scenario
                .made
                .iter()
                .filter_map(|made| seconds_between(made.begun.as_deref()?, &made.done));
            values.insert(Metric::Provisioning, took.collect());
            scenarios.insert(
                planned.slug.clone(),
                Measured {
                    configuration: Compact::of(&configuration(run, scenario)),
                    environment: scenario.environment.as_ref().map(Compact::of),
                    lack: (!counts).then(|| lack(scenario)),
                    values,
                    contents,
                },
            );
        }
        Self {
            run: run.manifest.run.clone(),
            created: run.manifest.created.clone(),
            is_simulated: run.scenarios.iter().any(ScenarioRun::is_simulated),
            metric: quantities.first().map(Metric::of).unwrap_or_default(),
            equivalence_margin_m: settings.equivalence_margin.map(Length::metres),
            equivalence_margins: followed
                .iter()
                .filter(|(_, quantity, _)| !quantity.is_tracking_error)
                .filter_map(|(metric, quantity, _)| Some((metric.clone(), quantity.equivalence_margin?)))
                .collect(),
            scenarios,
        }
    }
}

fn contents(scenario: &ScenarioRun, quantities: &[Quantity]) -> BTreeMap<String, BTreeMap<u32, String>> {
    let identical = quantities.iter().filter(|it| it.compare == Compare::Identical);
    let of_metric = identical.map(|quantity| {
        let windows = files(scenario, &quantity.name).into_iter();
        let windows = windows.map(|(window, content)| (window, content.sha256.clone()));
        (quantity.name.clone(), windows.collect())
    });
    of_metric.collect()
}

fn configuration(run: &Run, scenario: &ScenarioRun) -> Value {
    let provider = scenario.planned.provider();
    let mut configuration = json!({
        "settings": scenario.planned.settings,
        "workload_sha256": run.manifest.workload_sha256,
        "provider": run.manifest.providers.get(&provider),
        "metric": run.manifest.report.metric,
        "error": run.manifest.report.error,
        "discard_periods": run.manifest.report.discard_periods,
        "warm_up": run.manifest.report.warm_up,
    });
    // A night of an earlier version has no such field, and is not another configuration for that.
    if let Some(sha256) = &run.manifest.experiment_sha256 {
        configuration["experiment_sha256"] = sha256.as_str().into();
    }
    configuration
}

/// Why none of its windows counts.
fn lack(scenario: &ScenarioRun) -> MissingData {
    let reasons: Vec<String> = scenario
        .windows
        .iter()
        .filter_map(|window| match &window.state {
            WindowState::Invalid { record } if record.reasons.is_empty() => {
                Some((window.number, "no reason is recorded".to_owned()))
            }
            WindowState::Invalid { record } => Some((
                window.number,
                record::window::reasons_in_one_line(&record.reasons),
            )),
            _ => None,
        })
        .map(|(number, reasons)| format!("window {number}: {reasons}"))
        .collect();
    if !reasons.is_empty() {
        return MissingData::Invalid(reasons.join("; "));
    }
    MissingData::Absent(match &scenario.ending {
        Ending::Infeasible { reason, .. } => return MissingData::NotAsked(format!("infeasible: {reason}")),
        Ending::NotSelected { reason } => return MissingData::NotAsked(format!("not selected: {reason}")),
        Ending::NotStarted => "it was not begun".to_owned(),
        Ending::Unfinished => "it did not come to its end".to_owned(),
        Ending::Ended {
            outcome,
            reason: Some(reason),
            ..
        } => format!("{}: {reason}", outcome.name()),
        Ending::Ended { outcome, .. } => format!("{}, and no window counts", outcome.name()),
    })
}

/// The mean delay of all packets of a window, in seconds.
fn delay_s(window: &WindowTraffic) -> Option<f64> {
    let spreads = window
        .directions
        .iter()
        .filter_map(|direction| direction.one_way.as_ref());
    let (sum, count) = spreads.fold((0.0, 0), |(sum, count), spread| {
        (sum + spread.mean_s * spread.count as f64, count + spread.count)
    });
    (count > 0).then(|| sum / count as f64)
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    #[rstest]
    #[case("2026-11-22T02:18:49.250Z", "2026-11-22T02:19:00.000Z", Some(10.75))]
    #[case("2026-11-22T02:18:49.250Z", "2026-11-22T02:18:48.000Z", None)]
    #[case("yesterday", "2026-11-22T02:18:48.000Z", None)]
    fn a_time_between_is_that_of_the_journals_stamps(
        #[case] from: &str,
        #[case] to: &str,
        #[case] seconds: Option<f64>,
    ) {
        assert_eq!(seconds_between(from, to), seconds);
    }

    #[test]
    fn the_median_of_four_is_between_the_two_in_the_middle() {
        assert_eq!(median(vec![4.0, 1.0, 9.0, 2.0]), Some(3.0));
        assert_eq!(median(vec![]), None);
    }
}
