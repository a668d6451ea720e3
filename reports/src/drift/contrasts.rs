//! Scenarios compared with each other over many nights, the night as a block: what a platform does, apart from what one environment
//! did. The main type is [`NightContrasts`].
//!
//! Each night made every scenario's environment anew, so that a night is a round of one long run: the test, its interval and the
//! components are those of [`statistics::replicates`] and [`statistics::variance_components`]. The labels of a night were only
//! drawn if its order was (`--seed`). With the same order each night the test needs instead that differences of nights are independent
//! and symmetric around the shift.

use std::fmt::Write as _;

use record::settings::{Dynamics, Settings};
use serde::Serialize;
use statistics::{
    effect::Interval,
    multiplicity::holm,
    relabelling::{Effort, PermutationTest},
    replicates::{Rounds, smallest_p},
    variance_components::{Components, Leaf, Nested},
};

use super::{Metric, Night, night::Measured};
use crate::analysis::setup::differing_settings;

/// Pairs up to which every one is compared: those of some forty scenarios.
const MOST_PAIRS: usize = 800;

/// What nights show of the scenarios that the newest of them knows, in the metric that its experiment is about.
#[derive(Debug, Clone, PartialEq)]
pub struct NightContrasts {
    /// The metric.
    pub metric: Metric,
    /// Every two scenarios with the same experiment and a night in common, by slug.
    pub pairs: Vec<NightContrast>,
    /// What windows of a night and nights add to the variance of all scenarios, each around its own mean, in the square of the unit; none
    /// without two nights.
    pub components: Option<Components>,
    /// Pairs that were left out, since there are so many.
    pub left_out: usize,
}

/// Two scenarios over the nights.
#[derive(Debug, Clone, PartialEq)]
pub struct NightContrast {
    /// Slug of the first.
    pub a: String,
    /// Slug of the second.
    pub b: String,
    /// Nights in which both have windows that count.
    pub nights: usize,
    /// The test that flips the signs of nights' differences.
    pub test: PermutationTest,
    /// The smallest p that so many nights can reach.
    pub smallest_p: f64,
    /// p adjusted by Holm's method for all pairs.
    pub p_holm: f64,
    /// The mean shift from the first to the second.
    pub shift: f64,
    /// Its interval, for all pairs together at 1 − α where so many nights can.
    pub interval: Option<Interval>,
}

impl NightContrasts {
    /// Of nights, the newest last. All pairs are one family.
    #[must_use]
    pub fn of(nights: &[Night], alpha: f64, seed: u64) -> Self {
        let effort = Effort::of_a_report(seed);
        let known: Vec<(&String, &Measured)> = nights
            .last()
            .map_or_else(Vec::new, |newest| newest.scenarios.iter().collect());
        let metric = nights
            .last()
            .map(|night| night.metric.clone())
            .unwrap_or_default();
        let (mut found, mut left_out) = (Vec::new(), 0);
        for (at, (a, first)) in known.iter().enumerate() {
            let alike = known
                .iter()
                .skip(at + 1)
                .filter(|(_, second)| are_alike(first, second));
            for (b, _) in alike {
                let Some(rounds) = rounds(nights, &metric, a, b) else {
                    continue;
                };
                match found.len() < MOST_PAIRS {
                    true => found.push((*a, *b, rounds)),
                    false => left_out += 1,
                }
            }
        }
        let tests: Vec<PermutationTest> = found.iter().map(|(.., rounds)| rounds.test(effort)).collect();
        let adjusted = holm(&tests.iter().map(|test| test.p).collect::<Vec<_>>());
        let asked = 1.0 - alpha / found.len().max(1) as f64;
        let pairs = found.into_iter().zip(tests).zip(adjusted);
        let pairs = pairs.map(|(((a, b, rounds), test), p_holm)| NightContrast {
            a: a.clone(),
            b: b.clone(),
            nights: rounds.count(),
            test,
            smallest_p: smallest_p(rounds.count()),
            p_holm,
            shift: rounds.shift(),
            interval: rounds.interval(asked, effort),
        });
        Self {
            pairs: pairs.collect(),
            components: components(
                nights,
                &metric,
                known.iter().map(|(scenario, _)| scenario.as_str()),
            ),
            left_out,
            metric,
        }
    }

    /// For a person: a line for each pair, then what adds to the variance.
    #[must_use]
    pub fn text(&self) -> String {
        let mut text = "\nEach two scenarios, the night as a block\n".to_owned();
        if self.pairs.is_empty() {
            text.push_str("- no two scenarios of the same experiment have a night in common\n");
        }
        let shown = |value: f64| self.metric.text(value);
        for pair in &self.pairs {
            let _ = write!(
                text,
                "- {} against {}: {} in {} nights",
                pair.b,
                pair.a,
                shown(pair.shift),
                pair.nights
            );
            if let Some(interval) = pair.interval {
                let (low, high) = (shown(interval.low), shown(interval.high));
                let _ = write!(
                    text,
                    ", from {low} to {high} ({:.1} %)",
                    interval.confidence * 100.0
                );
            }
            let _ = writeln!(
                text,
                "; p = {:.2e}, by Holm {:.2e}, smallest {:.2e}",
                pair.test.p, pair.p_holm, pair.smallest_p
            );
        }
        if self.left_out > 0 {
            let _ = writeln!(text, "- {} more pairs are left out", self.left_out);
        }
        let spread = |level| {
            self.components
                .as_ref()?
                .level(level)
                .map(|it| shown(it.spread()))
        };
        if let (Some(windows), Some(nights)) = (spread(1), spread(2)) {
            let _ = writeln!(
                text,
                "- windows of a night spread by {windows}, and nights add {nights}"
            );
        }
        text
    }

    /// For programs.
    #[must_use]
    pub fn json(&self) -> NightContrastsEntry<'_> {
        let variance = |level| Some(self.components.as_ref()?.level(level)?.variance);
        NightContrastsEntry {
            metric: self.metric.name(),
            unit: self.metric.unit(),
            pairs: self.pairs.iter().map(entry).collect(),
            between_windows: variance(1),
            between_nights: variance(2),
            left_out: self.left_out,
        }
    }
}

/// The scenarios compared with each other, the night as a block.
#[derive(Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct NightContrastsEntry<'a> {
    /// The metric's name.
    metric: &'a str,
    /// Its unit, in which shifts are.
    unit: &'a str,
    /// Every two scenarios with the same experiment and a night in common.
    pairs: Vec<NightContrastEntry<'a>>,
    /// The variance of window levels within a night, in the square of the unit; null if it is not known.
    between_windows: Option<f64>,
    /// The variance that nights add, unbiased and so below 0 at times, in the square of the unit; null if it is not known.
    between_nights: Option<f64>,
    /// Pairs that were left out, since there are too many.
    left_out: usize,
}

/// Two scenarios over the nights.
#[derive(Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
struct NightContrastEntry<'a> {
    /// Slug of the first scenario.
    a: &'a str,
    /// Slug of the second.
    b: &'a str,
    /// Nights in which both have windows that count.
    nights: usize,
    /// p-value of the test that flips the signs of the nights' differences.
    p: f64,
    /// The smallest p that so many nights can have.
    smallest_p: f64,
    /// Flips examined, the observed one included.
    labellings: u64,
    /// `exact`, or `monte-carlo` if flips were drawn.
    method: &'static str,
    /// `p` adjusted by Holm's method for all pairs.
    p_holm: f64,
    /// The mean shift of the tracking error from the first to the second, in metres.
    shift: f64,
    /// The lower end of its interval, in metres; null for a single night.
    shift_low: Option<f64>,
    /// The upper end.
    shift_high: Option<f64>,
    /// The confidence of that interval for this pair alone.
    confidence: Option<f64>,
}

fn entry(pair: &NightContrast) -> NightContrastEntry<'_> {
    NightContrastEntry {
        a: &pair.a,
        b: &pair.b,
        nights: pair.nights,
        p: pair.test.p,
        smallest_p: pair.smallest_p,
        labellings: pair.test.labellings,
        method: pair.test.coverage.name(),
        p_holm: pair.p_holm,
        shift: pair.shift,
        shift_low: pair.interval.map(|interval| interval.low),
        shift_high: pair.interval.map(|interval| interval.high),
        confidence: pair.interval.map(|interval| interval.confidence),
    }
}

/// Of two scenarios, the level of each night.
fn rounds(nights: &[Night], metric: &Metric, a: &str, b: &str) -> Option<Rounds> {
    let level = |night: &Night, slug: &str| night.scenarios.get(slug)?.level(metric);
    Rounds::of(nights.iter().map(|night| (level(night, a), level(night, b))))
}

/// Whether two scenarios ran the same experiment, as far as their settings are known.
fn are_alike(a: &Measured, b: &Measured) -> bool {
    let settings = |of: &Measured| {
        let mut configuration = of.configuration.read();
        let settings = configuration.get_mut("settings")?.take();
        Settings::from_json(settings, Dynamics::Robust).ok()
    };
    match (settings(a), settings(b)) {
        (Some(a), Some(b)) => differing_settings(&a, &b).is_empty(),
        _ => false,
    }
}

/// Of the nights of each scenario its windows; nights with one window say nothing of windows and are left out.
fn components<'a>(
    nights: &[Night],
    metric: &Metric,
    scenarios: impl Iterator<Item = &'a str>,
) -> Option<Components> {
    let trees = scenarios.filter_map(|slug| {
        let of_night = |night: &Night| {
            let windows = night.scenarios.get(slug)?.values.get(metric)?;
            Leaf::of(windows, 1.0).map(Nested::Leaf)
        };
        let leaves: Vec<Nested> = nights.iter().filter_map(of_night).collect();
        (leaves.len() > 1).then_some(Nested::Group(leaves))
    });
    Components::of(&trees.collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use serde_json::json;
    use statistics::noise_model::Noise;

    use super::*;
    use crate::drift::Compact;

    fn measured(level_m: f64, rate: &str) -> Measured {
        let windows = [-1e-4, 1e-4].map(|off| level_m + off);
        Measured {
            configuration: Compact::of(&json!({"settings": {"rate": rate}})),
            environment: None,
            values: BTreeMap::from([(Metric::TrackingError, windows.to_vec())]),
            lack: None,
            contents: BTreeMap::new(),
        }
    }

    /// Nights that move by far more than scenarios differ: b is by a millimetre above a, and c has another rate.
    fn nights(count: usize) -> Vec<Night> {
        let mut noise = Noise::new(3);
        let night = |number: usize| {
            let night_m = 0.2 + 0.01 * noise.normal();
            let mut level_m = |shift: f64| night_m + shift + 2e-4 * noise.normal();
            let scenarios = [("a", 0.0, "50Hz"), ("b", 1e-3, "50Hz"), ("c", 0.0, "25Hz")]
                .map(|(slug, shift, rate)| (slug.to_owned(), measured(level_m(shift), rate)));
            Night {
                run: format!("night-{number}"),
                created: String::new(),
                is_simulated: false,
                metric: Metric::TrackingError,
                equivalence_margin_m: None,
                equivalence_margins: BTreeMap::new(),
                scenarios: BTreeMap::from(scenarios),
            }
        };
        (0..count).map(night).collect()
    }

    #[test]
    fn a_shift_far_below_the_spread_of_nights_is_found_within_nights() {
        let contrasts = NightContrasts::of(&nights(12), 0.05, 0);
        let [pair] = contrasts.pairs.as_slice() else {
            panic!("c ran another experiment: {contrasts:#?}")
        };
        assert_eq!((pair.a.as_str(), pair.b.as_str(), pair.nights), ("a", "b", 12));
        assert_eq!(pair.p_holm, smallest_p(12));
        let interval = pair.interval.unwrap();
        assert!(
            interval.low > 0.0 && interval.low < 1e-3 && interval.high > 1e-3,
            "{interval:?}"
        );
        // Nights spread by 10 mm and windows of a night by 0.14 mm.
        let between = contrasts.components.as_ref().unwrap().level(2).unwrap().spread();
        assert!((0.004..0.02).contains(&between), "{between}");
        assert!((pair.shift - 1e-3).abs() < 4e-4, "{}", pair.shift);
        assert!(contrasts.text().contains("- b against a: "));
    }

    #[test]
    fn one_night_compares_nothing_by_itself() {
        let contrasts = NightContrasts::of(&nights(1), 0.05, 0);
        assert_eq!(
            (contrasts.pairs[0].test.p, contrasts.pairs[0].interval),
            (1.0, None)
        );
        assert_eq!(contrasts.components, None);
        assert!(
            NightContrasts::of(&[], 0.05, 0)
                .text()
                .contains("no two scenarios")
        );
    }
}
