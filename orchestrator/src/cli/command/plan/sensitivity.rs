//! `matrix plan FILE --sensitivity`: what a pair of windows of each scenario would detect. The main function is [`of`].

use std::fmt::Write as _;

use record::{
    report_settings::ReportSettings,
    run_directory::PlannedScenario,
    settings::{Dynamics, Settings},
};
use reports::analysis::{
    calibration::Rate,
    sensitivity::{Design, Detected, Disturbance, Sensitivity},
    setup::differing_settings,
};
use schemars::JsonSchema;
use serde::Serialize;

/// Pairs of windows that a power is the share of.
const MOST_PAIRS: usize = 40;
/// With fewer a power of 90 % cannot be told from one of 50 %.
const FEWEST_PAIRS: usize = 10;
/// How many control steps the pairs of one disturbance may have at one size.
const STEPS: u64 = 1_000_000;

/// Scenarios that simulate alike, and what a pair of their windows would detect.
pub struct OfScenarios<'a> {
    scenarios: Vec<&'a str>,
    settings: &'a Settings,
    found: Sensitivity,
}

/// Simulates each distinct experiment of the selected scenarios once.
pub fn of<'a>(
    scenarios: impl Iterator<Item = &'a PlannedScenario>,
    report: &ReportSettings,
    seed: u64,
) -> Vec<OfScenarios<'a>> {
    let mut distinct: Vec<(Vec<&str>, &Settings)> = Vec::new();
    for scenario in scenarios.filter(|scenario| scenario.not_selected.is_none()) {
        let settings = &scenario.settings;
        let alike = |other: &Settings| {
            differing_settings(other, settings).is_empty()
                && other.periods_per_window() == settings.periods_per_window()
        };
        match distinct.iter_mut().find(|(_, other)| alike(other)) {
            Some((ids, _)) => ids.push(&scenario.id),
            None => distinct.push((vec![&scenario.id], settings)),
        }
    }
    distinct
        .into_iter()
        .map(|(scenarios, settings)| OfScenarios {
            scenarios,
            settings,
            found: Design {
                settings,
                report,
                pairs: pairs(settings),
                seed,
            }
            .sensitivity(),
        })
        .collect()
}

/// How many pairs are simulated in bounded time.
fn pairs(settings: &Settings) -> usize {
    let pairs = STEPS / settings.steps_per_window().max(1);
    usize::try_from(pairs)
        .unwrap_or(MOST_PAIRS)
        .clamp(FEWEST_PAIRS, MOST_PAIRS)
}

/// A disturbance and its unit: for JSON, and for people.
fn names(disturbance: Disturbance) -> (String, String, &'static str) {
    match disturbance {
        Disturbance::Delay => (
            "delay_each_way_ms".to_owned(),
            "more delay each way".to_owned(),
            "ms",
        ),
        Disturbance::Loss => (
            "loss_at_each_end_percent".to_owned(),
            "more loss at each end of a link".to_owned(),
            "%",
        ),
        Disturbance::Stalls(length) => {
            let ms = length.as_millis();
            (
                format!("ticks_{ms}_ms_late_percent"),
                format!("ticks {ms} ms late"),
                "%",
            )
        }
    }
}

/// For people.
pub fn as_text(all: &[OfScenarios<'_>]) -> String {
    let mut text = String::new();
    for of in all {
        let alike = &of.found.alike;
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "a pair of windows of {} (`{}`, {} periods of {}) detects at p < {} with 90 % power, in virtual time:",
            of.scenarios.join(", "),
            of.settings.dynamics.name(),
            of.settings.periods_per_window(),
            of.settings.period,
            alike.nominal,
        );
        for detected in &of.found.detected {
            let (_, name, unit) = names(detected.disturbance);
            let size = match detected.size {
                Some(size) => format!("{} {unit}", short(size)),
                None => format!("more than {} {unit}", short(detected.disturbance.largest())),
            };
            let _ = writeln!(text, "  {name:<32} {size:<16} {}", share(&detected.power));
        }
        let _ = writeln!(text, "  {:<32} {:<16} {}", "two windows alike", "", share(alike));
    }
    text
}

fn share(rate: &Rate) -> String {
    let (low, high) = rate.interval();
    format!(
        "{} of {} new pairs, 95 % interval {:.0} % to {:.0} %",
        rate.rejected,
        rate.trials,
        low * 100.0,
        high * 100.0
    )
}

/// Two digits: the search is no finer.
fn short(size: f64) -> String {
    let digits = (1.0 - size.abs().max(f64::MIN_POSITIVE).log10().floor()).max(0.0);
    format!("{size:.*}", digits as usize)
}

/// Scenarios that simulate alike, and what a pair of their windows would detect.
#[derive(Debug, Serialize, JsonSchema)]
pub struct SensitivityRecord<'a> {
    /// Letters of the scenarios.
    scenarios: &'a [&'a str],
    /// Which rules plant, controller and messages follow.
    dynamics: Dynamics,
    /// Periods in a window.
    periods: u64,
    /// The level: a pair with a smaller p is rejected.
    alpha: f64,
    /// How often two undisturbed windows are told apart.
    alike: RejectedPairs,
    /// What is detected of each disturbance.
    detects: Vec<DetectedRecord>,
}

/// The smallest size of a disturbance that is detected with 90 % power.
#[derive(Debug, Serialize, JsonSchema)]
struct DetectedRecord {
    /// The disturbance and, at the end of its name, its unit, such as `delay_each_way_ms`.
    disturbance: String,
    /// The size, in that unit; null where the largest is not detected.
    detected: Option<f64>,
    /// The largest size that is tried, in that unit.
    largest: f64,
    /// How often the disturbance was detected on new pairs: at that size, or at the largest.
    power: RejectedPairs,
}

/// How many simulated pairs of windows were rejected.
#[derive(Debug, Serialize, JsonSchema)]
struct RejectedPairs {
    /// Pairs that were rejected.
    rejected: usize,
    /// Pairs that were simulated.
    pairs: usize,
    /// Lower end of the 95 % interval of the share, 0 to 1.
    low: f64,
    /// Upper end of that interval.
    high: f64,
}

impl From<&Rate> for RejectedPairs {
    fn from(rate: &Rate) -> Self {
        let (low, high) = rate.interval();
        Self {
            rejected: rate.rejected,
            pairs: rate.trials,
            low,
            high,
        }
    }
}

/// For programs.
pub fn records<'a>(all: &'a [OfScenarios<'a>]) -> Vec<SensitivityRecord<'a>> {
    let detected = |detected: &Detected| DetectedRecord {
        disturbance: names(detected.disturbance).0,
        detected: detected.size,
        largest: detected.disturbance.largest(),
        power: (&detected.power).into(),
    };
    let record = |of: &'a OfScenarios<'a>| SensitivityRecord {
        scenarios: &of.scenarios,
        dynamics: of.settings.dynamics,
        periods: of.settings.periods_per_window(),
        alpha: of.found.alike.nominal,
        alike: (&of.found.alike).into(),
        detects: of.found.detected.iter().map(detected).collect(),
    };
    all.iter().map(record).collect()
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use record::quantity::TimeSpan;

    use super::*;

    fn rate(rejected: usize) -> Rate {
        Rate {
            method: String::new(),
            data: "",
            nominal: 0.001,
            rejected,
            trials: 40,
            independent: 40,
        }
    }

    fn found(settings: &Settings) -> OfScenarios<'_> {
        OfScenarios {
            scenarios: vec!["a", "c"],
            settings,
            found: Sensitivity {
                alike: rate(0),
                detected: vec![
                    Detected {
                        disturbance: Disturbance::Delay,
                        size: Some(0.4321),
                        power: rate(37),
                    },
                    Detected {
                        disturbance: Disturbance::Stalls(Duration::from_millis(10)),
                        size: None,
                        power: rate(3),
                    },
                ],
            },
        }
    }

    #[test]
    fn a_size_that_is_not_detected_is_more_than_the_largest() {
        let settings = Settings::of(Dynamics::Author);
        insta::assert_snapshot!(as_text(&[found(&settings)]), @r"
        a pair of windows of a, c (`author`, 60 periods of 100s) detects at p < 0.001 with 90 % power, in virtual time:
          more delay each way              0.43 ms          37 of 40 new pairs, 95 % interval 80 % to 97 %
          ticks 10 ms late                 more than 25 %   3 of 40 new pairs, 95 % interval 3 % to 20 %
          two windows alike                                 0 of 40 new pairs, 95 % interval 0 % to 9 %
        ");
    }

    #[test]
    fn a_program_gets_null_for_what_is_not_detected() {
        let settings = Settings::of(Dynamics::Robust);
        let json = serde_json::to_value(records(&[found(&settings)])).unwrap();
        assert_eq!(json[0]["dynamics"], "robust");
        assert_eq!(json[0]["detects"][0]["disturbance"], "delay_each_way_ms");
        assert_eq!(json[0]["detects"][1]["disturbance"], "ticks_10_ms_late_percent");
        assert!(json[0]["detects"][1]["detected"].is_null());
        assert_eq!(json[0]["detects"][1]["largest"], 25.0);
    }

    #[test]
    fn long_windows_are_simulated_in_fewer_pairs_and_never_in_too_few() {
        let of = |window_s| {
            let mut settings = Settings::of(Dynamics::Author);
            settings.window = TimeSpan::from_secs(window_s);
            pairs(&settings)
        };
        assert_eq!([of(100), of(1000), of(6000)], [40, 20, 10]);
    }
}
