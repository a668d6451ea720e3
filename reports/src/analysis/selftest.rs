//! How often each method finds a difference where there is none, for data like that of a run: the windows of each scenario
//! against each other, and made-up windows with the run's autocorrelation and with its windows' own shifts. The main
//! function is [`selftest`].

use record::report_settings::ReportSettings;
use serde::Serialize;

use crate::{
    analysis::{power, sample::Sample},
    statistics::{
        block_permutation, dependence::Dependence, effect, ks, multiplicity::holm, noise_model::Noise,
        permutation, relabelling::Effort, shape::ShapeTests,
    },
};

/// What a selftest found.
#[derive(Debug, Clone, PartialEq)]
pub struct SelfTest {
    /// What made-up windows are like.
    pub model: Model,
    /// Each method on each kind of data.
    pub rates: Vec<Rate>,
}

/// What the windows of a run are like.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Model {
    /// Scenarios with data.
    pub scenarios: usize,
    /// Windows that most scenarios have.
    pub windows: usize,
    /// Values in the longest window.
    pub values: usize,
    /// Autocorrelation of neighbouring values within windows, none below 0.
    pub phi: f64,
    /// Standard deviation of values within windows, in metres.
    pub within_m: f64,
    /// Standard deviation of window levels beyond what correlated values alone give, in metres.
    pub between_m: f64,
}

/// How often one method was wrong.
#[derive(Debug, Clone, PartialEq)]
pub struct Rate {
    /// The method.
    pub method: &'static str,
    /// The data.
    pub data: &'static str,
    /// The level it was asked to hold.
    pub nominal: f64,
    /// Trials that it rejected.
    pub rejected: usize,
    /// Trials; none where no p could have been below the level.
    pub trials: usize,
}

impl Rate {
    /// The share of rejections; none without a trial.
    #[must_use]
    pub fn share(&self) -> Option<f64> {
        (self.trials > 0).then(|| self.rejected as f64 / self.trials as f64)
    }

    /// Wilson's 95 % interval of the rate (1927); from 0 to 1 without a trial.
    #[must_use]
    pub fn interval(&self) -> (f64, f64) {
        const Z: f64 = 1.959_963_984_540_054;
        if self.trials == 0 {
            return (0.0, 1.0);
        }
        let n = self.trials as f64;
        let share = self.rejected as f64 / n;
        let centre = share + Z * Z / (2.0 * n);
        let half = Z * (share * (1.0 - share) / n + Z * Z / (4.0 * n * n)).sqrt();
        let scale = 1.0 + Z * Z / n;
        (
            ((centre - half) / scale).max(0.0),
            ((centre + half) / scale).min(1.0),
        )
    }
}

/// Real windows of one scenario against each other.
pub const REAL: &str = "this run";
/// Made-up windows of one level.
pub const ALIKE: &str = "made up, one level";
/// Made-up windows that shift as the run's do.
pub const SHIFTED: &str = "made up, as measured";

/// Levels that methods are asked to hold, besides the run's own.
const USUAL: f64 = 0.05;

/// Tries the methods; none for a run without two windows of one scenario whose values differ.
#[must_use]
pub fn selftest(samples: &[Sample], settings: &ReportSettings, repeats: usize) -> Option<SelfTest> {
    let model = Model::of(samples)?;
    let mut counts = Counts {
        levels: [USUAL, settings.alpha],
        rates: Vec::new(),
    };
    within_scenarios(samples, settings, &mut counts);
    for (data, between_m) in [(ALIKE, 0.0), (SHIFTED, model.between_m)] {
        let mut noise = Noise::new(settings.seed);
        for _ in 0..repeats {
            trial(&model, between_m, data, &mut noise, settings, &mut counts);
        }
    }
    Some(SelfTest {
        model,
        rates: counts.rates,
    })
}

impl Model {
    fn of(samples: &[Sample]) -> Option<Self> {
        let windows: Vec<&[f64]> = samples.iter().map(|sample| sample.errors_m.as_slice()).collect();
        let found = Dependence::of(&windows)?;
        let scenarios: Vec<usize> = samples
            .chunk_by(|a, b| a.scenario == b.scenario)
            .map(<[Sample]>::len)
            .collect();
        let values = windows.iter().map(|window| window.len()).max()?;
        let variance: f64 = windows
            .iter()
            .map(|window| {
                let mean = window.iter().sum::<f64>() / window.len().max(1) as f64;
                window.iter().map(|value| (value - mean).powi(2)).sum::<f64>()
            })
            .sum::<f64>()
            / found.n as f64;
        let of_values = variance * found.time / values as f64;
        let of_levels = power::spread_of_levels(samples)?.powi(2);
        Some(Self {
            scenarios: scenarios.len(),
            windows: scenarios.iter().copied().max()?,
            values,
            phi: found.lag_one().clamp(0.0, 0.99),
            within_m: variance.sqrt(),
            between_m: (of_levels - of_values).max(0.0).sqrt(),
        })
    }

    fn scenario(&self, between_m: f64, noise: &mut Noise) -> Vec<Vec<f64>> {
        (0..self.windows)
            .map(|_| {
                let level = between_m * noise.normal();
                let values = noise.ar1(self.values, self.phi).into_iter();
                values.map(|value| level + self.within_m * value).collect()
            })
            .collect()
    }
}

struct Counts {
    levels: [f64; 2],
    rates: Vec<Rate>,
}

impl Counts {
    fn add(&mut self, method: &'static str, data: &'static str, p: Option<f64>) {
        self.add_above(method, data, p.map(|p| (p, 0.0)));
    }

    /// A p and the smallest that it could have been: what could not have been rejected is no trial.
    fn add_above(&mut self, method: &'static str, data: &'static str, found: Option<(f64, f64)>) {
        let Some((p, smallest)) = found else { return };
        for nominal in self.levels {
            let same =
                |rate: &&mut Rate| rate.method == method && rate.data == data && rate.nominal == nominal;
            let rejected = usize::from(p < nominal);
            let trials = usize::from(smallest < nominal);
            match self.rates.iter_mut().find(same) {
                Some(rate) => {
                    rate.rejected += rejected;
                    rate.trials += trials;
                }
                None => self.rates.push(Rate {
                    method,
                    data,
                    nominal,
                    rejected,
                    trials,
                }),
            }
        }
    }
}

const KS: &str = "KS of two windows";
const BLOCKS: &str = "KS, blocks dealt anew";
const LEVEL: &str = "level, windows dealt anew";

/// Each two windows of a scenario, and each way to take half of its windows for another scenario.
fn within_scenarios(samples: &[Sample], settings: &ReportSettings, counts: &mut Counts) {
    for of_one in samples.chunk_by(|a, b| a.scenario == b.scenario) {
        let windows: Vec<&[f64]> = of_one.iter().map(|sample| sample.errors_m.as_slice()).collect();
        let block = Dependence::block_of(&windows);
        for (at, x) in windows.iter().enumerate() {
            for y in windows.iter().skip(at + 1) {
                counts.add(KS, REAL, ks::test(x, y).ok().map(|test| test.p));
                counts.add_above(BLOCKS, REAL, by_blocks(x, y, block, settings.seed));
            }
        }
        let levels = effect::levels(&windows);
        // Up to 16 windows: 65 536 ways, each of them twice.
        if (2..=16).contains(&levels.len()) {
            for chosen in 1_u32..1 << (levels.len() - 1) {
                let (a, b): (Vec<_>, Vec<_>) = levels
                    .iter()
                    .enumerate()
                    .partition(|(at, _)| chosen & (1 << at) != 0);
                if a.len() == levels.len() / 2 {
                    let values = |side: Vec<(usize, &f64)>| {
                        side.into_iter().map(|(_, level)| *level).collect::<Vec<_>>()
                    };
                    let test = permutation::mean_difference(&values(a), &values(b), effort(settings.seed));
                    counts.add(LEVEL, REAL, test.map(|test| test.p));
                }
            }
        }
    }
}

fn trial(
    model: &Model,
    between_m: f64,
    data: &'static str,
    noise: &mut Noise,
    settings: &ReportSettings,
    counts: &mut Counts,
) {
    let scenarios: Vec<Vec<Vec<f64>>> = (0..model.scenarios.max(2))
        .map(|_| model.scenario(between_m, noise))
        .collect();
    let windows = |at: usize| -> Vec<&[f64]> {
        scenarios
            .get(at)
            .map(|windows| windows.iter().map(Vec::as_slice).collect())
            .unwrap_or_default()
    };
    let (a, b) = (windows(0), windows(1));
    if let (Some(x), Some(y)) = (a.first(), b.first()) {
        counts.add(KS, data, ks::test(x, y).ok().map(|test| test.p));
        let block = Dependence::block_of(&a).max(Dependence::block_of(&b));
        counts.add_above(BLOCKS, data, by_blocks(x, y, block, settings.seed));
    }
    let levels: Vec<Vec<f64>> = (0..scenarios.len())
        .map(|at| effect::levels(&windows(at)))
        .collect();
    let levels: Vec<&[f64]> = levels.iter().map(Vec::as_slice).collect();
    let effort = effort(settings.seed);
    let pairs: Vec<(usize, usize)> = (0..levels.len())
        .flat_map(|a| (a + 1..levels.len()).map(move |b| (a, b)))
        .collect();
    let raw: Vec<f64> = pairs
        .iter()
        .filter_map(|(a, b)| permutation::mean_difference(levels.get(*a)?, levels.get(*b)?, effort))
        .map(|test| test.p)
        .collect();
    counts.add(LEVEL, data, raw.first().copied());
    if let Some(shape) = ShapeTests::of(&a, &b, effort) {
        counts.add("KS, windows dealt anew", data, Some(shape.kolmogorov_smirnov.p));
        counts.add("A-D, windows dealt anew", data, Some(shape.anderson_darling.p));
        counts.add("energy, windows dealt anew", data, Some(shape.energy.p));
    }
    let smallest = |p: &[f64]| p.iter().copied().reduce(f64::min);
    counts.add("family by Holm", data, smallest(&holm(&raw)));
    let max_t = permutation::max_t(&levels, &pairs, effort);
    counts.add(
        "family by max-T",
        data,
        max_t.and_then(|max_t| smallest(&max_t.p)),
    );
}

/// Rates to a percent need no p to more than a thousandth.
const fn effort(seed: u64) -> Effort {
    Effort {
        enumerate: 2_000,
        draws: 1_999,
        seed,
    }
}

/// p, and the smallest that it could have been.
fn by_blocks(x: &[f64], y: &[f64], block: usize, seed: u64) -> Option<(f64, f64)> {
    let test = block_permutation::test(x, y, block, effort(seed))?;
    Some((test.p, block_permutation::smallest_p(x, y, block, effort(seed))))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples(between_m: f64, phi: f64) -> Vec<Sample> {
        let mut noise = Noise::new(9);
        let mut samples = Vec::new();
        for scenario in ["a", "b", "c"] {
            for window in 1..=4 {
                let level = 0.24 + between_m * noise.normal();
                samples.push(Sample {
                    scenario: scenario.to_owned(),
                    window,
                    first_period: 1,
                    errors_m: noise
                        .ar1(60, phi)
                        .into_iter()
                        .map(|value| level + 0.002 * value)
                        .collect(),
                });
            }
        }
        samples
    }

    fn share(found: &SelfTest, method: &str, data: &str) -> f64 {
        let rate = found
            .rates
            .iter()
            .find(|rate| rate.method == method && rate.data == data && rate.nominal == 0.05);
        rate.and_then(Rate::share).unwrap()
    }

    #[test]
    fn values_taken_for_independent_reject_too_often_and_windows_do_not() {
        let found = selftest(&samples(0.002, 0.5), &ReportSettings::default(), 100).unwrap();
        assert!((0.2..0.7).contains(&found.model.phi), "{:?}", found.model);
        assert!(share(&found, KS, SHIFTED) > 0.3);
        assert!(share(&found, KS, ALIKE) > 0.1);
        for method in [
            LEVEL,
            "family by Holm",
            "family by max-T",
            "energy, windows dealt anew",
        ] {
            for data in [ALIKE, SHIFTED] {
                assert!(share(&found, method, data) <= 0.12, "{method}, {data}");
            }
        }
    }

    #[test]
    fn real_windows_are_held_against_each_other() {
        let found = selftest(&samples(0.0, 0.0), &ReportSettings::default(), 0).unwrap();
        let trials = |method| {
            let rate = found.rates.iter().find(|rate| rate.method == method);
            rate.map(|rate| (rate.data, rate.trials))
        };
        assert_eq!(trials(KS), Some((REAL, 18)));
        assert_eq!(trials(LEVEL), Some((REAL, 9)), "three ways to halve four windows");
    }

    #[test]
    fn windows_of_too_few_blocks_are_no_trials_of_blocks() {
        let found = selftest(&samples(0.0, 0.97), &ReportSettings::default(), 0).unwrap();
        let rate = |method, nominal| {
            let mut rates = found.rates.iter();
            rates
                .find(|rate| rate.method == method && rate.nominal == nominal)
                .map(|rate| (rate.rejected, rate.trials, rate.share().is_some()))
        };
        assert_eq!(rate(BLOCKS, 0.001), Some((0, 0, false)));
        assert!(matches!(rate(KS, 0.001), Some((_, 18, true))));
    }

    #[test]
    fn one_window_a_scenario_has_nothing_alike() {
        let one = samples(0.0, 0.0).into_iter().filter(|sample| sample.window == 1);
        assert_eq!(
            selftest(&one.collect::<Vec<_>>(), &ReportSettings::default(), 1),
            None
        );
    }

    #[test]
    fn a_rate_has_wilsons_interval() {
        let rate = Rate {
            method: KS,
            data: REAL,
            nominal: 0.05,
            rejected: 5,
            trials: 100,
        };
        // Expected: statsmodels proportion_confint(5, 100, method="wilson").
        let (low, high) = rate.interval();
        assert!(
            (low - 0.021_543_679_154).abs() < 1e-7 && (high - 0.111_750_469_232).abs() < 1e-7,
            "{low} {high}"
        );
    }
}
