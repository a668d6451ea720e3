//! How often the intervals and tests of contrasts hold what they promise, on made-up windows whose truth is known. CI runs it small,
//! and `cargo run -p reports --example referee` prints the whole tables. The main functions are [`Design::coverage`],
//! [`Design::rejections`], [`Family::errors`] and [`margin_errors`].

use rayon::prelude::*;
use statrs::distribution::{ContinuousCDF, Normal, StudentsT};

use crate::{
    effect::{self, Effect, Interval},
    mean_shift::MeanShift,
    noise_model::Noise,
    permutation,
    relabelling::Effort,
};

/// Values in a made-up window: normal, of standard deviation 1 around the window's level.
const VALUES: usize = 60;

/// How the levels of a scenario's windows are distributed, with mean 0 and standard deviation 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Levels {
    /// Normal.
    Normal,
    /// Student's t with 3 degrees of freedom.
    HeavyTails,
    /// Lognormal with σ = 1: skewed.
    Skewed,
    /// Normal, one in ten with five times the standard deviation.
    Contaminated,
}

impl Levels {
    /// Its name in tables.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Normal => "normal",
            Self::HeavyTails => "t3",
            Self::Skewed => "lognormal",
            Self::Contaminated => "contaminated",
        }
    }

    fn draw(self, random: &mut Noise) -> f64 {
        let normal = random.normal();
        match self {
            Self::Normal => normal,
            Self::HeavyTails => {
                let squares: f64 = (0..3).map(|_| random.normal().powi(2)).sum();
                // The variance of t with 3 degrees of freedom is 3.
                normal / squares.sqrt()
            }
            Self::Skewed => skewed(normal),
            Self::Contaminated => {
                // One in ten: a normal number is above 1.2816.
                let factor = if random.normal() > 1.281_551_565_545 {
                    5.0
                } else {
                    1.0
                };
                normal * factor / CONTAMINATED.sqrt()
            }
        }
    }

    /// So many levels that each stand for as large a share of all.
    fn quantiles(self, count: usize) -> Vec<f64> {
        let shares = (0..count).map(|at| (at as f64 + 0.5) / count as f64);
        let student = StudentsT::new(0.0, 1.0, 3.0).ok();
        let quantile = |share: f64| match self {
            Self::Normal => normal().inverse_cdf(share),
            Self::HeavyTails => student.map_or(0.0, |it| it.inverse_cdf(share)) / 3.0_f64.sqrt(),
            Self::Skewed => skewed(normal().inverse_cdf(share)),
            Self::Contaminated => {
                let below = |x: f64| 0.9 * normal().cdf(x) + 0.1 * normal().cdf(x / 5.0);
                let (mut low, mut high) = (-40.0, 40.0);
                for _ in 0..60 {
                    let middle = f64::midpoint(low, high);
                    if below(middle) < share {
                        low = middle
                    } else {
                        high = middle
                    }
                }
                low / CONTAMINATED.sqrt()
            }
        };
        shares.map(quantile).collect()
    }
}

/// Variance of the contaminated levels before they are scaled.
const CONTAMINATED: f64 = 0.9 + 0.1 * 25.0;

fn skewed(normal: f64) -> f64 {
    let e = std::f64::consts::E;
    (normal.exp() - e.sqrt()) / ((e - 1.0) * e).sqrt()
}

fn normal() -> Normal {
    Normal::standard()
}

/// Two made-up scenarios.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Design {
    /// Windows of each.
    pub windows: [usize; 2],
    /// How their levels are distributed.
    pub levels: Levels,
    /// Standard deviation of the levels of each, in those of a value.
    pub spread: [f64; 2],
    /// By how much the mean level of the second is larger.
    pub shift: f64,
}

/// The designs whose coverage is told.
pub static DESIGNS: &[Design] = &[
    design([2, 2], Levels::Normal, [1.0, 1.0], 1.0),
    design([3, 3], Levels::Normal, [1.0, 1.0], 1.0),
    design([4, 4], Levels::Normal, [1.0, 1.0], 0.0),
    design([4, 4], Levels::Normal, [1.0, 1.0], 1.0),
    design([4, 4], Levels::Normal, [1.0, 1.0], 3.0),
    design([4, 4], Levels::Normal, [0.2, 0.2], 0.1),
    design([4, 4], Levels::HeavyTails, [1.0, 1.0], 1.0),
    design([4, 4], Levels::Skewed, [1.0, 1.0], 1.0),
    design([4, 4], Levels::Contaminated, [1.0, 1.0], 1.0),
    design([4, 4], Levels::Normal, [0.3, 3.0], 1.0),
    design([4, 12], Levels::Normal, [3.0, 0.5], 0.0),
    design([3, 10], Levels::Normal, [2.0, 0.3], 0.5),
    design([7, 7], Levels::Normal, [1.0, 1.0], 1.0),
    design([9, 9], Levels::Normal, [1.0, 1.0], 1.0),
];

/// Equal means of unequal numbers and spreads, whose false rejections are told.
pub static EQUAL_MEANS: &[Design] = &[
    design([3, 10], Levels::Normal, [5.0, 1.0], 0.0),
    design([4, 12], Levels::Normal, [5.0, 1.0], 0.0),
    design([4, 8], Levels::Normal, [4.0, 1.0], 0.0),
    design([7, 7], Levels::Normal, [1.0, 5.0], 0.0),
    design([4, 4], Levels::Normal, [1.0, 1.0], 0.0),
    design([7, 7], Levels::Normal, [1.0, 1.0], 0.0),
    design([4, 8], Levels::HeavyTails, [4.0, 1.0], 0.0),
    design([4, 8], Levels::Skewed, [4.0, 1.0], 0.0),
];

const fn design(windows: [usize; 2], levels: Levels, spread: [f64; 2], shift: f64) -> Design {
    Design {
        windows,
        levels,
        spread,
        shift,
    }
}

/// Shares of repetitions in which an interval contains the truth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Coverage {
    /// Of the shift.
    pub shift: f64,
    /// What the interval of the shift claims.
    pub shift_confidence: f64,
    /// Of the Wasserstein distance.
    pub wasserstein: f64,
    /// Of the probability of superiority.
    pub superiority: f64,
    /// Repetitions in which some interval could not be made.
    pub without: usize,
}

/// Shares of repetitions in which equal means are rejected.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rejections {
    /// By the permutation test of the difference of means.
    pub difference: f64,
    /// By the studentised permutation test.
    pub studentised: f64,
    /// By Welch's test.
    pub welch: f64,
    /// By both of these.
    pub both: f64,
}

impl Design {
    /// The levels of the windows of both.
    fn levels(&self, random: &mut Noise) -> [Vec<f64>; 2] {
        let mut of = |side: usize, centre: f64| -> Vec<f64> {
            let level = |_| centre + self.spread[side] * self.levels.draw(random);
            (0..self.windows[side]).map(level).collect()
        };
        [of(0, 0.0), of(1, self.shift)]
    }

    /// How often the 95 % intervals of [`Effect`] contain the truth. The same seed gives the same.
    #[must_use]
    pub fn coverage(&self, repetitions: usize, seed: u64) -> Coverage {
        let (distance, superiority) = self.truth();
        let one = |nth: usize| -> Option<[Interval; 3]> {
            let mut random = Noise::new(seed_of(seed, nth));
            let windows = self.levels(&mut random).map(|levels| {
                let window =
                    |level: f64| -> Vec<f64> { (0..VALUES).map(|_| level + random.normal()).collect() };
                levels.into_iter().map(window).collect::<Vec<_>>()
            });
            let [a, b] = windows
                .each_ref()
                .map(|side| side.iter().map(Vec::as_slice).collect::<Vec<&[f64]>>());
            let effort = Effort::of_a_report(seed);
            let shift = MeanShift::of(&effect::levels(&a), &effect::levels(&b), effort);
            let effect = Effect::of(&a, &b, shift.as_ref())?;
            Some([
                effect.shift.interval?,
                effect.wasserstein.interval?,
                effect.superiority.interval?,
            ])
        };
        let made: Vec<[Interval; 3]> = (0..repetitions).into_par_iter().filter_map(one).collect();
        let truth = [self.shift, distance, superiority];
        let share = |which: usize| {
            let covered = made
                .iter()
                .filter(|of| of[which].low <= truth[which] && truth[which] <= of[which].high);
            covered.count() as f64 / made.len().max(1) as f64
        };
        Coverage {
            shift: share(0),
            shift_confidence: made.first().map_or(0.0, |of| of[0].confidence),
            wasserstein: share(1),
            superiority: share(2),
            without: repetitions - made.len(),
        }
    }

    /// How often equal means are rejected at a level. The same seed gives the same.
    #[must_use]
    pub fn rejections(&self, level: f64, repetitions: usize, seed: u64) -> Rejections {
        let effort = Effort::of_a_report(seed);
        let one = |nth: usize| -> Option<[bool; 4]> {
            let [a, b] = self.levels(&mut Noise::new(seed_of(seed, nth)));
            let difference = permutation::mean_difference(&a, &b, effort)?;
            let shift = MeanShift::of(&a, &b, effort)?;
            let p = [
                difference.p,
                shift.p_studentised(0.0),
                shift.p_welch(0.0),
                shift.p(0.0),
            ];
            Some(p.map(|p| p <= level))
        };
        let made: Vec<[bool; 4]> = (0..repetitions).into_par_iter().filter_map(one).collect();
        let share =
            |which: usize| made.iter().filter(|of| of[which]).count() as f64 / made.len().max(1) as f64;
        Rejections {
            difference: share(0),
            studentised: share(1),
            welch: share(2),
            both: share(3),
        }
    }

    /// The Wasserstein distance and the probability of superiority of the values of both scenarios.
    fn truth(&self) -> (f64, f64) {
        const LEVELS: usize = 400;
        const STEPS: usize = 2_000;
        let quantiles = self.levels.quantiles(LEVELS);
        let of = |side: usize, centre: f64| -> Vec<f64> {
            let spread = self.spread[side];
            quantiles.iter().map(|level| centre + spread * level).collect()
        };
        let (a, b) = (of(0, 0.0), of(1, self.shift));
        let below = |levels: &[f64], x: f64| {
            levels.iter().map(|level| normal().cdf(x - level)).sum::<f64>() / LEVELS as f64
        };
        let ends = |pick: fn(f64, f64) -> f64| a.iter().chain(&b).copied().fold(a[0], pick);
        let (low, high) = (ends(f64::min) - 6.0, ends(f64::max) + 6.0);
        let step = (high - low) / STEPS as f64;
        let gap = |at: usize| {
            let x = low + (at as f64 + 0.5) * step;
            (below(&a, x) - below(&b, x)).abs() * step
        };
        let distance = if self.spread[0] == self.spread[1] {
            // A shift moves every value as far.
            self.shift.abs()
        } else {
            (0..STEPS).into_par_iter().map(gap).sum()
        };
        let larger: f64 = b
            .par_iter()
            .map(|b| {
                a.iter()
                    .map(|a| normal().cdf((b - a) / 2.0_f64.sqrt()))
                    .sum::<f64>()
            })
            .sum();
        (distance, larger / (LEVELS * LEVELS) as f64)
    }
}

fn seed_of(seed: u64, nth: usize) -> u64 {
    (seed << 32) ^ nth as u64
}

/// Made-up scenarios, each pair of which is compared.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Family<'a> {
    /// Windows of each.
    pub windows: usize,
    /// How their levels are distributed.
    pub levels: Levels,
    /// The mean level of each.
    pub means: &'a [f64],
}

/// Shares of made-up families, by the p-values of [`permutation::max_t`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FamilyErrors {
    /// Those with a rejected pair of equal means.
    pub false_rejections: f64,
    /// The pairs of unequal means that are rejected, of all such pairs; 0 if there is none.
    pub found: f64,
}

impl Family<'_> {
    /// How often equal means are rejected at a level by max-T, in families dealt so often. The same seed gives the same.
    #[must_use]
    pub fn errors(&self, level: f64, draws: u32, repetitions: usize, seed: u64) -> FamilyErrors {
        let scenarios = self.means.len();
        let pairs: Vec<(usize, usize)> = (0..scenarios)
            .flat_map(|a| (a + 1..scenarios).map(move |b| (a, b)))
            .collect();
        let is_alike = |(a, b): &(usize, usize)| self.means[*a] == self.means[*b];
        let one = |nth: usize| -> (bool, usize) {
            let mut random = Noise::new(seed_of(seed, nth));
            let levels: Vec<Vec<f64>> = self
                .means
                .iter()
                .map(|mean| {
                    (0..self.windows)
                        .map(|_| mean + self.levels.draw(&mut random))
                        .collect()
                })
                .collect();
            let levels: Vec<&[f64]> = levels.iter().map(Vec::as_slice).collect();
            let effort = Effort {
                draws,
                ..Effort::of_a_report(seed_of(seed, nth))
            };
            let p = permutation::max_t(&levels, &pairs, effort).map_or(Vec::new(), |found| found.p);
            let rejected = || {
                pairs
                    .iter()
                    .zip(&p)
                    .filter(|(_, p)| **p <= level)
                    .map(|(pair, _)| pair)
            };
            (
                rejected().any(is_alike),
                rejected().filter(|pair| !is_alike(pair)).count(),
            )
        };
        let made: Vec<(bool, usize)> = (0..repetitions).into_par_iter().map(one).collect();
        let different = pairs.iter().filter(|pair| !is_alike(pair)).count() * repetitions;
        let found: usize = made.iter().map(|(_, found)| found).sum();
        FamilyErrors {
            false_rejections: made.iter().filter(|(is_false, _)| *is_false).count() as f64
                / repetitions.max(1) as f64,
            found: found as f64 / different.max(1) as f64,
        }
    }
}

/// Shares of made-up families with a false statement on the margin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MarginErrors {
    /// By the 95 % interval of each pair, whatever the family.
    pub by_each: f64,
    /// By the intervals that hold for all pairs at once.
    pub by_all: f64,
}

/// Families of so many pairs of scenarios, each with so many windows and a true shift of exactly the margin, so that both "it matters"
/// and "it is immaterial" are untrue: how often either is said of some pair. The same seed gives the same.
#[must_use]
pub fn margin_errors(
    pairs: usize,
    windows: usize,
    level: f64,
    repetitions: usize,
    seed: u64,
) -> MarginErrors {
    const MARGIN: f64 = 2.0;
    let of_pair = design([windows; 2], Levels::Normal, [1.0, 1.0], MARGIN);
    let effort = Effort::of_a_report(seed).reaching(level / pairs as f64);
    let is_said = |interval: Option<Interval>| {
        interval.is_some_and(|it| it.low > MARGIN || (it.low > -MARGIN && it.high < MARGIN))
    };
    let one = |nth: usize| -> [bool; 2] {
        let mut random = Noise::new(seed_of(seed, nth));
        let mut said = [false; 2];
        for _ in 0..pairs {
            let [a, b] = of_pair.levels(&mut random);
            let Some(shift) = MeanShift::of(&a, &b, effort) else {
                continue;
            };
            said[0] |= is_said(shift.interval(effect::CONFIDENCE));
            said[1] |= is_said(shift.interval(1.0 - level / pairs as f64));
        }
        said
    };
    let made: Vec<[bool; 2]> = (0..repetitions).into_par_iter().map(one).collect();
    let share = |which: usize| made.iter().filter(|of| of[which]).count() as f64 / repetitions.max(1) as f64;
    MarginErrors {
        by_each: share(0),
        by_all: share(1),
    }
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    const REPETITIONS: usize = 400;
    /// 2.6 standard errors of a share of 0.95.
    const ERROR: f64 = 0.029;

    #[rstest]
    #[case::two_windows(0)]
    #[case::alike(2)]
    #[case::far_apart(4)]
    #[case::hardly_apart(5)]
    #[case::unequal_spreads(9)]
    #[case::unequal_numbers(11)]
    fn intervals_cover_what_they_say(#[case] nth: usize) {
        let found = DESIGNS[nth].coverage(REPETITIONS, 3);
        assert_eq!(found.without, 0);
        let error =
            2.6 * (found.shift_confidence * (1.0 - found.shift_confidence) / REPETITIONS as f64).sqrt();
        assert!(found.shift >= found.shift_confidence - error, "{found:?}");
        assert!(
            found.wasserstein >= 0.95 - ERROR && found.superiority >= 0.95 - ERROR,
            "{found:?}"
        );
    }

    #[rstest]
    #[case::three_of_ten(0)]
    #[case::four_of_eight(2)]
    #[case::unequal_spreads(3)]
    fn equal_means_of_unequal_spreads_are_rejected_about_as_often_as_they_should_be(#[case] nth: usize) {
        let found = EQUAL_MEANS[nth].rejections(0.05, 1_000, 3);
        // 0.05 and 2.9 standard errors; the test of the difference itself is at 0.34, 0.20 and 0.07.
        assert!(found.both <= 0.07, "{found:?}");
        assert!(found.difference > found.both, "{found:?}");
    }

    #[test]
    fn equal_distributions_are_rejected_no_more_often_than_they_may_be() {
        let found = EQUAL_MEANS[4].rejections(0.05, 1_000, 4);
        // 2 of 70 labellings, and 2.6 standard errors.
        assert!(
            found.studentised <= 0.0286 + 0.014 && found.both <= found.studentised,
            "{found:?}"
        );
        assert!(found.both > 0.005, "{found:?}");
    }

    // Of 8 pairs at exactly the margin, each by its own 95 % interval, one or more is told in many of the families.
    #[test]
    fn statements_on_the_margin_hold_for_all_pairs_at_once() {
        let found = margin_errors(8, 8, 0.05, 200, 5);
        assert!(found.by_each > 0.09, "{found:?}");
        assert!(found.by_all <= 0.09, "{found:?}");
    }

    #[test]
    fn the_truth_of_a_normal_design_is_its_closed_form() {
        let (distance, superiority) = design([4, 4], Levels::Normal, [1.0, 1.0], 1.0).truth();
        // Φ(1 / √4).
        assert!((superiority - 0.691_462).abs() < 1e-3, "{superiority}");
        assert_eq!(distance, 1.0);
        // Of normal distributions with one mean, E|N| · (σ − τ).
        let (distance, superiority) = design([4, 4], Levels::Normal, [0.0, 2.0], 0.0).truth();
        let expected = (2.0 / std::f64::consts::PI).sqrt() * (5.0_f64.sqrt() - 1.0);
        assert!((distance / expected - 1.0).abs() < 0.01, "{distance} {expected}");
        assert!((superiority - 0.5).abs() < 1e-9);
    }

    #[rstest]
    #[case(Levels::Normal)]
    #[case(Levels::HeavyTails)]
    #[case(Levels::Skewed)]
    #[case(Levels::Contaminated)]
    fn levels_that_are_drawn_have_the_quantiles_that_truth_is_made_of(#[case] levels: Levels) {
        let mut random = Noise::new(9);
        let mut drawn: Vec<f64> = (0..20_001).map(|_| levels.draw(&mut random)).collect();
        drawn.sort_by(f64::total_cmp);
        let quantiles = levels.quantiles(101);
        for at in [10, 50, 90] {
            let share = (at as f64 + 0.5) / 101.0;
            let found = drawn[(share * 20_001.0) as usize];
            assert!(
                (found - quantiles[at]).abs() < 0.05,
                "{levels:?} {at}: {found} {}",
                quantiles[at]
            );
        }
    }
}
