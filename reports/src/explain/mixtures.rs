//! The simulated error on mixtures of two platforms, and what each factor has of their difference. Pure; the main types are [`Design`] and
//! [`Mixed`].
//!
//! The part of a factor is by how much the error changes if that factor alone is exchanged for the other platform's, as the mean over all
//! orders in which the four can be exchanged (L. S. Shapley, *A value for n-person games*, 1953): parts add up to the difference of the two
//! simulations, and a factor that changes nothing has no part.

use rayon::prelude::*;
use record::{report_settings::ReportSettings, settings::Settings};
use simulation::closed_loop::Platform;

use crate::analysis::simulated_errors::period_errors_m;

/// The factor of which captures are needed.
pub(super) const DELAYS: &str = "delays";
/// What can be exchanged, in the order of the table.
pub(super) const FACTORS: [Factor; 4] = [
    Factor {
        name: "lateness",
        words: "late ticks",
        exchange: |platform, other| {
            platform.controller.clone_from(&other.controller);
            platform.plant.clone_from(&other.plant);
        },
    },
    Factor {
        name: "stalls",
        words: "stalls",
        exchange: |platform, other| platform.stalls.clone_from(&other.stalls),
    },
    Factor {
        name: DELAYS,
        words: "delays of messages",
        exchange: |platform, other| {
            let loss = platform.network.impairment.loss;
            platform.network.clone_from(&other.network);
            platform.network.impairment.loss = loss;
        },
    },
    Factor {
        name: "losses",
        words: "lost packets",
        exchange: |platform, other| platform.network.impairment.loss = other.network.impairment.loss,
    },
];
/// Subsets of the factors. The bits of one's number are the factors that are the second platform's.
pub(super) const MIXTURES: usize = 1 << FACTORS.len();

/// Control steps of one simulation, after what is left out: of a longer window it is as good, with more seeds.
const LONGEST: u64 = 75_000;
/// Simulations of a mixture, of all pairs of platforms together: fewer say nothing of their spread, and more are not worth their time.
const FEWEST: u64 = 8;
const MOST: u64 = 100;

/// What differs between two platforms.
pub(super) struct Factor {
    pub name: &'static str,
    pub words: &'static str,
    /// Puts the other's into a platform.
    exchange: fn(&mut Platform, &Platform),
}

/// A value of each mixture.
pub(super) type OfMixtures = [f64; MIXTURES];

/// What is simulated.
pub(super) struct Design<'a> {
    settings: &'a Settings,
    report: ReportSettings,
    seed: u64,
    /// Simulations of a mixture of one pair of platforms.
    pub seeds: u64,
    /// Of each simulation, after those that are left out.
    pub periods: u64,
}

/// What one pair of platforms gave.
pub(super) struct Mixed {
    /// Of each seed the mean error on each mixture, in metres.
    pub means_m: Vec<OfMixtures>,
    /// The errors of all periods of all seeds on each mixture, in metres; alike mixtures have those of the first.
    pub errors_m: Vec<Vec<f64>>,
}

impl<'a> Design<'a> {
    /// Of so many pairs of platforms, with so many control steps of all simulations together or a few more.
    pub fn of(
        settings: &'a Settings,
        report: &'a ReportSettings,
        (seed, steps): (u64, u64),
        pairs: usize,
    ) -> Self {
        let per_period = settings.steps_per_period().max(1);
        let periods = settings
            .periods_per_window()
            .clamp(1, (LONGEST / per_period).max(1));
        // Whatever a record says: no more is discarded than a window has.
        let in_a_window = u32::try_from(settings.periods_per_window()).unwrap_or(u32::MAX);
        let report = ReportSettings {
            discard_periods: report.discard_periods.min(in_a_window),
            ..report.clone()
        };
        let of_one = (u64::from(report.discard_periods) + periods) * per_period;
        let pairs = pairs.max(1) as u64;
        let of_each = |simulations: u64| simulations.div_ceil(pairs);
        Self {
            settings,
            report,
            seed,
            seeds: of_each((steps / (MIXTURES as u64 * of_one)).clamp(FEWEST, MOST)),
            periods,
        }
    }

    /// Simulates all mixtures of the nth pair of platforms, each with the same seeds.
    pub fn mix(&self, nth: usize, [a, b]: &[&Platform; 2]) -> Mixed {
        let mixtures: Vec<Platform> = (0..MIXTURES)
            .map(|mixture| {
                let mut platform = (*a).clone();
                for (bit, factor) in FACTORS.iter().enumerate() {
                    if mixture >> bit & 1 == 1 {
                        (factor.exchange)(&mut platform, b);
                    }
                }
                platform
            })
            .collect();
        // Where both have the same of a factor, mixtures are the same, too.
        let same_as: Vec<usize> = mixtures
            .iter()
            .map(|mixture| mixtures.iter().position(|it| it == mixture).unwrap_or_default())
            .collect();
        let first = nth as u64 * self.seeds;
        let seeds: Vec<u64> = (first..first + self.seeds).collect();
        let of_seeds: Vec<Vec<Vec<f64>>> = seeds
            .into_par_iter()
            .map(|number| {
                let seed = (self.seed << 32) ^ number;
                let each = mixtures.iter().zip(&same_as).enumerate();
                each.map(|(place, (platform, first))| match *first == place {
                    true => self.errors_m(platform, seed),
                    false => Vec::new(),
                })
                .collect()
            })
            .collect();
        let means_m = of_seeds.iter().map(|errors_m| {
            let mut means_m = [f64::NAN; MIXTURES];
            for (mean_m, first) in means_m.iter_mut().zip(&same_as) {
                let errors_m = errors_m.get(*first).map_or(&[][..], Vec::as_slice);
                *mean_m = errors_m.iter().sum::<f64>() / errors_m.len() as f64;
            }
            means_m
        });
        let pooled = same_as.iter().map(|first| {
            let of_one = of_seeds.iter().filter_map(|errors_m| errors_m.get(*first));
            of_one.flatten().copied().collect()
        });
        Mixed {
            means_m: means_m.collect(),
            errors_m: pooled.collect(),
        }
    }

    fn errors_m(&self, platform: &Platform, seed: u64) -> Vec<f64> {
        let steps = self.periods * self.settings.steps_per_period().max(1);
        let (settings, report) = (self.settings, &self.report);
        period_errors_m(settings, report, report.error, platform, (steps, seed))
    }
}

/// The mean over pairs of platforms or seeds.
pub(super) fn mean(of: &[OfMixtures]) -> OfMixtures {
    let mut mean = [0.0; MIXTURES];
    for values in of {
        mean.iter_mut()
            .zip(values)
            .for_each(|(sum, value)| *sum += value / of.len() as f64);
    }
    mean
}

/// By how much the value of the second platform is larger than that of the first.
pub(super) fn total(values: &OfMixtures) -> f64 {
    values[MIXTURES - 1] - values[0]
}

/// Shapley's value of a factor.
pub(super) fn shapley(values: &OfMixtures, factor: usize) -> f64 {
    let factorial = |n: u32| f64::from((1..=n).product::<u32>());
    let factors = FACTORS.len() as u32;
    let without = (0..MIXTURES).filter(|mixture| mixture >> factor & 1 == 0);
    without
        .map(|mixture| {
            let before = mixture.count_ones();
            let weight = factorial(before) * factorial(factors - before - 1) / factorial(factors);
            let with = values.get(mixture | 1 << factor).copied().unwrap_or(f64::NAN);
            weight * (with - values.get(mixture).copied().unwrap_or(f64::NAN))
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn parts_add_up_and_a_factor_that_changes_nothing_has_none(values: [i32; MIXTURES]) {
            let mut values = values.map(f64::from);
            let sum: f64 = (0..FACTORS.len()).map(|factor| shapley(&values, factor)).sum();
            prop_assert!((sum - total(&values)).abs() < 1e-3);
            // The second factor is made to change nothing.
            for mixture in 0..MIXTURES {
                values[mixture | 2] = values[mixture & !2];
            }
            prop_assert_eq!(shapley(&values, 1), 0.0);
        }
    }

    #[test]
    fn of_factors_that_add_up_each_has_its_own() {
        let own = [1.0, 20.0, 300.0, 4000.0];
        let mut values = [0.0; MIXTURES];
        for (mixture, value) in values.iter_mut().enumerate() {
            let in_it = own.iter().enumerate().filter(|(bit, _)| mixture >> bit & 1 == 1);
            *value = in_it.map(|(_, own)| own).sum();
        }
        for (factor, own) in own.iter().enumerate() {
            assert!((shapley(&values, factor) - own).abs() < 1e-9);
        }
    }
}
