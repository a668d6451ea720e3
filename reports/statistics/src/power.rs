//! What a design can find: the shift of the window levels that a comparison of n windows with m finds with a given
//! probability. The main type is [`Power`].
//!
//! The power is that of [`permutation::mean_difference`] itself, simulated. Of each made-up pair of groups
//! [`Swaps::critical_shift`] gives the smallest shift that the test finds; it finds every larger one too, so that the share of
//! critical shifts below δ is the power at δ, and their quantile is the shift that is found with a given power. Student's
//! formula (Cohen, *Statistical Power Analysis*, 1988) promises too much here: at a level that only a few labellings reach, a shift
//! must set the groups wholly apart, and its 80 % are 57 % with 7 windows against 7 at 0.001.
//!
//! Where there are too many labellings to count for each made-up pair, the test is that of Student, which the permutation test
//! of means approaches (Lehmann and Romano, *Testing Statistical Hypotheses*, 15.2); its power is simulated in the same way. It
//! approaches it slowly at small levels, where groups that are shifted apart are not normal together: as long as the report's test
//! is exact, t is therefore the mean of those at which the permutation test begins to reject some made-up pairs, and not Student's
//! quantile.

use std::{collections::BTreeMap, sync::Mutex};

use rayon::prelude::*;
use statrs::distribution::{ChiSquared, ContinuousCDF, StudentsT};

use crate::{
    effect,
    noise_model::{Noise, Tails},
    permutation,
    relabelling::{Effort, labellings},
    replicates::{self, Rounds},
    swaps::{self, Swaps},
};

/// The power that designs are asked for.
pub const POWER: f64 = 0.8;

/// One comparison of window levels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Comparison {
    /// Windows of the one scenario.
    pub n: usize,
    /// Windows of the other.
    pub m: usize,
    /// The level of this comparison: in a family of k pairs, α / k in Holm's first step.
    pub alpha: f64,
}

/// What window levels are like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Levels {
    /// How often they are far off.
    pub tails: Tails,
    /// Degrees of freedom of the estimate of their standard deviation; none where it is known. What is estimated is taken to
    /// be σ² = s² ν / χ²(ν), and the power is the mean over that.
    pub freedom: Option<usize>,
}

impl Levels {
    /// Normal ones of a known standard deviation.
    pub const NORMAL: Self = Self {
        tails: Tails::Normal,
        freedom: None,
    };
}

/// The power of one comparison, as simulated.
#[derive(Debug, Clone, PartialEq)]
pub struct Power {
    /// The smallest shift that each made-up pair of groups finds, in standard deviations of levels, in order.
    critical: Vec<f64>,
}

/// Made-up pairs of groups for a plan: the standard error of a power of 80 % is 0.4 percentage points.
pub const REPEATS: usize = 10_000;
/// Pairs of groups that are made up in one go: results do not depend on how many processors there are.
const AT_ONCE: usize = 100;
/// Sums up to which each made-up pair is tested exactly: 12 : 12.
const EXACT: f64 = 8_192.0;
/// Made-up pairs whose t is looked for, where there are more: by their sums together, and by their number.
const SUMS_FOR_T: f64 = 16_777_216.0;
const MOST_FOR_T: f64 = 400.0;
/// Rounds up to which each made-up experiment is tested exactly.
const EXACT_ROUNDS: usize = 12;
/// Made-up experiments whose t is looked for, where there are more: by their sums together, and by their number. t differs less from
/// one to another where rounds are many.
const SUMS_OF_ROUNDS: f64 = 1_048_576.0;
const LEAST_FOR_T: f64 = 20.0;
const MOST_ROUNDS_FOR_T: f64 = 100.0;
/// In standard deviations of levels.
const PRECISION: f64 = 1e-3;
const SEED: u64 = 16;

impl Power {
    /// Simulates; none where windows are too few for the level, or the level is not above 0.
    #[must_use]
    pub fn simulated(comparison: Comparison, levels: Levels, repeats: usize) -> Option<Self> {
        let Comparison { n, m, alpha } = comparison;
        if permutation::reachable_p(n, m, Effort::of_a_report(SEED)) >= alpha {
            return None;
        }
        let test = Test::of(comparison, levels.tails)?;
        Some(Self::made_up(repeats, levels, |noise| {
            let a = group(n, levels.tails, noise);
            let b = group(m, levels.tails, noise);
            test.critical_shift(&a, &b)
        }))
    }

    /// The power of [`Rounds::test`] for so many rounds, in standard deviations of environment means within a round; none where
    /// rounds are too few for the level.
    #[must_use]
    pub fn of_rounds(rounds: usize, alpha: f64, levels: Levels, repeats: usize) -> Option<Self> {
        let effort = Effort::of_a_report(SEED);
        if replicates::reachable_p(rounds, effort) >= alpha {
            return None;
        }
        let made_up = |noise: &mut Noise| {
            let [a, b] = [(); 2].map(|()| group(rounds, levels.tails, noise));
            std::iter::zip(a, b).map(|(a, b)| b - a).collect::<Vec<f64>>()
        };
        let critical = |differences: &[f64]| {
            let rounds = Rounds::of(differences.iter().map(|it| (Some(0.0), Some(*it))))?;
            rounds.critical_shift(alpha, effort, PRECISION / 10.0)
        };
        if rounds <= EXACT_ROUNDS {
            return Some(Self::made_up(repeats, levels, |noise| critical(&made_up(noise))));
        }
        // As for windows: t where the test itself begins to reject some, and not Student's quantile.
        let t = |experiment: u64| {
            let differences = made_up(&mut Noise::new(SEED + experiment));
            Some((effect::level(&differences)? + critical(&differences)?) / error_of_mean(&differences)?)
        };
        let sums = 2.0_f64.powi(i32::try_from(rounds.div_ceil(2)).unwrap_or(i32::MAX));
        let experiments = (SUMS_OF_ROUNDS / sums).clamp(LEAST_FOR_T, MOST_ROUNDS_FOR_T) as u64;
        let found: Vec<f64> = (0..experiments).into_par_iter().filter_map(t).collect();
        let t = effect::level(&found)?;
        Some(Self::made_up(repeats, levels, |noise| {
            let differences = made_up(noise);
            Some(t * error_of_mean(&differences)? - effect::level(&differences)?)
        }))
    }

    /// Of so many made-up experiments, each with the shift that it finds.
    fn made_up(repeats: usize, levels: Levels, found: impl Fn(&mut Noise) -> Option<f64> + Sync) -> Self {
        let chunks = repeats.div_ceil(AT_ONCE) as u64;
        let mut critical: Vec<f64> = (0..chunks)
            .into_par_iter()
            .flat_map_iter(|chunk| {
                let (found, mut noise) = (&found, Noise::new(SEED + chunk));
                (0..AT_ONCE).map(move |_| {
                    let shift = found(&mut noise).unwrap_or(f64::INFINITY);
                    match levels.freedom {
                        Some(freedom) => shift * (freedom as f64 / noise.chi_squared(freedom)).sqrt(),
                        None => shift,
                    }
                })
            })
            .collect();
        critical.sort_by(f64::total_cmp);
        Self { critical }
    }

    /// The probability that a shift of so many standard deviations of levels is found.
    #[must_use]
    pub fn of(&self, shift: f64) -> f64 {
        let found = self.critical.partition_point(|critical| *critical <= shift);
        found as f64 / self.critical.len().max(1) as f64
    }

    /// The shift that is found with that probability, in standard deviations of levels.
    #[must_use]
    pub fn shift(&self, power: f64) -> f64 {
        let place = (power * self.critical.len() as f64).ceil() as usize;
        let at = place.clamp(1, self.critical.len().max(1)) - 1;
        self.critical.get(at).copied().unwrap_or(f64::INFINITY)
    }
}

/// What a made-up pair of groups is tested with.
#[derive(Debug, Clone, Copy)]
enum Test {
    /// Rejects while at most so many labellings are as extreme.
    Permutation { most: u64 },
    /// Rejects from that t on.
    Student { t: f64 },
}

impl Test {
    fn of(Comparison { n, m, alpha }: Comparison, tails: Tails) -> Option<Self> {
        // p < alpha, and not p = alpha.
        let most = ((alpha * labellings(&[n, m])).ceil() - 1.0) as u64;
        let sums = swaps::sums(n, m);
        if sums <= EXACT {
            return Some(Self::Permutation { most });
        }
        if permutation::is_exact(n, m, Effort::of_a_report(SEED)) {
            let pairs = (SUMS_FOR_T / sums).min(MOST_FOR_T).ceil() as u64;
            let t = |pair: u64| {
                let mut noise = Noise::new(SEED + pair);
                let (a, b) = (group(n, tails, &mut noise), group(m, tails, &mut noise));
                let shift = Swaps::of(&a, &b)?.critical_shift(most, PRECISION)?;
                Some((effect::level(&b)? - effect::level(&a)? + shift) / standard_error(&a, &b)?)
            };
            let found: Vec<f64> = (0..pairs).into_par_iter().filter_map(t).collect();
            return (!found.is_empty()).then(|| Self::Student {
                t: found.iter().sum::<f64>() / found.len() as f64,
            });
        }
        let student = StudentsT::new(0.0, 1.0, (n + m).checked_sub(2)? as f64).ok()?;
        Some(Self::Student {
            t: student.inverse_cdf(1.0 - alpha / 2.0),
        })
    }

    /// The smallest upward shift of the second group that is found; none if none is.
    fn critical_shift(self, a: &[f64], b: &[f64]) -> Option<f64> {
        match self {
            Self::Permutation { most } => Swaps::of(a, b)?.critical_shift(most, PRECISION),
            Self::Student { t } => Some(t * standard_error(a, b)? - (effect::level(b)? - effect::level(a)?)),
        }
    }
}

fn group(size: usize, tails: Tails, noise: &mut Noise) -> Vec<f64> {
    (0..size).map(|_| noise.of(tails)).collect()
}

/// Of the difference of the means, by the pooled spread.
fn standard_error(a: &[f64], b: &[f64]) -> Option<f64> {
    Some(pooled_spread([a, b])? * (1.0 / a.len() as f64 + 1.0 / b.len() as f64).sqrt())
}

/// Of the mean, by the spread of the values.
fn error_of_mean(values: &[f64]) -> Option<f64> {
    Some(Spread::pooled([values])?.deviation / (values.len() as f64).sqrt())
}

/// The shift that is found with probability [`POWER`] at the level α, in the unit of `spread`, the known standard deviation of
/// normal levels; none where windows are too few to reach α. It is right to 3 percentage points of power.
#[must_use]
pub fn detectable_shift(n: usize, m: usize, spread: f64, alpha: f64) -> Option<f64> {
    const FEWER: usize = 1_000;
    // Nights compare hundreds of series of the same numbers of windows at the same level, in standard deviations once and for all.
    static KNOWN: Mutex<BTreeMap<(usize, usize, u64), Option<f64>>> = Mutex::new(BTreeMap::new());
    let design = (n, m, alpha.to_bits());
    let known = KNOWN.lock().ok().and_then(|known| known.get(&design).copied());
    let shift = known.unwrap_or_else(|| {
        let power = Power::simulated(Comparison { n, m, alpha }, Levels::NORMAL, FEWER);
        let shift = power.map(|power| power.shift(POWER));
        if let Ok(mut known) = KNOWN.lock() {
            known.insert(design, shift);
        }
        shift
    });
    Some(shift? * spread)
}

/// The fewest windows a scenario whose comparison can reach α; none if `alpha` is not above 0.
#[must_use]
pub fn fewest_windows(alpha: f64) -> Option<usize> {
    (1..600).find(|n| permutation::smallest_p(*n, *n) < alpha)
}

/// The standard deviation of values around the means of their groups.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spread {
    /// The estimate, in the unit of the values.
    pub deviation: f64,
    /// Its degrees of freedom, at least 1: values less groups.
    pub freedom: usize,
}

impl Spread {
    /// Pooled over the groups; none where no group has two values.
    #[must_use]
    pub fn pooled(groups: impl IntoIterator<Item = impl AsRef<[f64]>>) -> Option<Self> {
        let mut squares = 0.0;
        let mut freedom = 0;
        for group in groups {
            let group = group.as_ref();
            let mean = effect::level(group).unwrap_or_default();
            squares += group.iter().map(|value| (value - mean).powi(2)).sum::<f64>();
            freedom += group.len().saturating_sub(1);
        }
        (freedom > 0).then(|| Self {
            deviation: (squares / freedom as f64).sqrt(),
            freedom,
        })
    }

    /// That of the values of a table around what their row and their column add: with rows for scenarios and columns for rounds,
    /// that of environment means within a round. None with fewer than two rows or columns, or rows of unequal length.
    #[must_use]
    pub fn of_table(rows: &[Vec<f64>]) -> Option<Self> {
        let columns = rows.first()?.len();
        let freedom = rows.len().checked_sub(1)? * columns.checked_sub(1)?;
        if freedom == 0 || rows.iter().any(|row| row.len() != columns) {
            return None;
        }
        let of_column = |at: usize| rows.iter().map(|row| row[at]).sum::<f64>() / rows.len() as f64;
        let of_columns: Vec<f64> = (0..columns).map(of_column).collect();
        let overall = effect::level(&of_columns)?;
        let squares = rows.iter().flat_map(|row| {
            let of_row = effect::level(row).unwrap_or_default();
            let both = std::iter::zip(row, &of_columns);
            both.map(move |(value, of_column)| (value - of_row - of_column + overall).powi(2))
        });
        Some(Self {
            deviation: (squares.sum::<f64>() / freedom as f64).sqrt(),
            freedom,
        })
    }
}

/// How much further levels spread than something known explains.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Beyond {
    /// The standard deviation of what is left, in the unit of the values; 0 where they spread less than is explained.
    pub deviation: f64,
    /// The lower end of its 95 % interval; 0 where what is known may be all.
    pub low: f64,
    /// The upper end.
    pub high: f64,
}

impl Beyond {
    /// What is left of a spread once a variance is taken out. The interval is that of the spread's variance, by χ², less what is
    /// explained, which is taken to be known.
    #[must_use]
    pub fn of(spread: Spread, explained: f64) -> Self {
        let left = |variance: f64| (variance - explained).max(0.0).sqrt();
        let found = spread.deviation.powi(2);
        let freedom = spread.freedom as f64;
        let quantile = |share: f64| {
            let chi_squared = ChiSquared::new(freedom);
            chi_squared.map_or(f64::NAN, |chi_squared| chi_squared.inverse_cdf(share))
        };
        Self {
            deviation: left(found),
            low: left(found * freedom / quantile(0.975)),
            high: left(found * freedom / quantile(0.025)),
        }
    }
}

/// [`Spread::pooled`], without its degrees of freedom.
#[must_use]
pub fn pooled_spread(groups: impl IntoIterator<Item = impl AsRef<[f64]>>) -> Option<f64> {
    Spread::pooled(groups).map(|spread| spread.deviation)
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    const REPORT: Effort = Effort::of_a_report(1);

    /// How often `mean_difference` finds a shift, group by group.
    fn found(
        comparison: Comparison,
        tails: Tails,
        shift: f64,
        repeats: u64,
        spread: impl Fn(&mut Noise) -> f64,
    ) -> f64 {
        let found = (0..repeats).filter(|seed| {
            let mut noise = Noise::new(1_000_000 + seed);
            let deviation = spread(&mut noise);
            let mut group = |size: usize, shift: f64| -> Vec<f64> {
                (0..size).map(|_| shift + deviation * noise.of(tails)).collect()
            };
            let (a, b) = (group(comparison.n, 0.0), group(comparison.m, shift));
            permutation::mean_difference(&a, &b, REPORT).unwrap().p < comparison.alpha
        });
        found.count() as f64 / repeats as f64
    }

    // Student's formula says 2.774 for the first and finds 57 %, 3.005 and 54 % for the second, 2.371 and 63 % for the third.
    #[rstest]
    #[case(7, 7, 0.001)]
    #[case(9, 9, 0.001 / 21.0)]
    #[case(4, 4, 0.05)]
    #[case(10, 10, 0.001 / 21.0)]
    #[case(8, 8, 0.001)]
    #[case(10, 10, 0.05)]
    #[case(4, 9, 0.01)]
    #[case(13, 13, 0.001 / 21.0)]
    fn a_shift_that_is_said_to_be_found_in_80_percent_is(
        #[case] n: usize,
        #[case] m: usize,
        #[case] alpha: f64,
    ) {
        let comparison = Comparison { n, m, alpha };
        let power = Power::simulated(comparison, Levels::NORMAL, 4_000).unwrap();
        let shift = power.shift(POWER);
        let found = found(comparison, Tails::Normal, shift, 4_000, |_| 1.0);
        assert!((found - POWER).abs() < 0.02, "{shift}: {found}");
        assert!((power.of(shift) - POWER).abs() < 1e-3);
    }

    // Cohen, Statistical Power Analysis (1988), table 2.4.1: 17 a group find one standard deviation with 80 % at 0.05.
    #[test]
    fn seventeen_a_side_find_one_standard_deviation() {
        let shift = detectable_shift(17, 17, 1.0, 0.05).unwrap();
        assert!((shift - 1.0).abs() < 0.04, "{shift}");
    }

    #[test]
    fn an_estimated_spread_is_as_uncertain_as_its_degrees_of_freedom() {
        let comparison = Comparison {
            n: 7,
            m: 7,
            alpha: 0.001,
        };
        let estimated = Levels {
            freedom: Some(6),
            ..Levels::NORMAL
        };
        let known = Power::simulated(comparison, Levels::NORMAL, 4_000).unwrap();
        let estimated = Power::simulated(comparison, estimated, 4_000).unwrap();
        let shift = estimated.shift(POWER);
        assert!(shift > known.shift(POWER) * 1.15, "{shift}");
        // A true spread for each pilot that had found 1.
        let of_pilots = |noise: &mut Noise| (6.0 / noise.chi_squared(6)).sqrt();
        let found = found(comparison, Tails::Normal, shift, 4_000, of_pilots);
        assert!((found - POWER).abs() < 0.02, "{found}");
    }

    #[test]
    fn heavy_tails_find_less_of_what_needs_groups_wholly_apart() {
        let comparison = Comparison {
            n: 9,
            m: 9,
            alpha: 0.001 / 21.0,
        };
        let heavy = Levels {
            tails: Tails::Heavy,
            ..Levels::NORMAL
        };
        let shift = Power::simulated(comparison, Levels::NORMAL, 2_000)
            .unwrap()
            .shift(POWER);
        let said = Power::simulated(comparison, heavy, 4_000).unwrap().of(shift);
        let found = found(comparison, Tails::Heavy, shift, 4_000, |_| 1.0);
        assert!((said - found).abs() < 0.025, "{said} {found}");
    }

    #[test]
    fn what_is_left_of_a_spread_has_the_interval_of_its_variance() {
        let spread = Spread {
            deviation: 2.0,
            freedom: 9,
        };
        // R: 4 * 9 / qchisq(c(.975, .025), 9) are 1.892 500 and 13.331 27.
        let found = Beyond::of(spread, 1.0);
        assert!((found.deviation - 3.0_f64.sqrt()).abs() < 1e-12);
        assert!((found.low - 0.892_500_f64.sqrt()).abs() < 1e-4, "{found:?}");
        assert!((found.high - 12.331_27_f64.sqrt()).abs() < 1e-3, "{found:?}");
        let none = Beyond::of(spread, 5.0);
        assert_eq!((none.deviation, none.low), (0.0, 0.0));
        assert!(none.high > 2.0);
    }

    #[test]
    fn four_a_side_find_nothing_at_a_thousandth() {
        assert_eq!(detectable_shift(4, 4, 1e-9, 0.001), None);
        assert_eq!(fewest_windows(0.001), Some(7));
        assert_eq!(fewest_windows(0.0), None);
    }

    #[test]
    fn the_spread_of_a_table_is_what_rows_and_columns_leave() {
        let additive = [vec![1.0, 2.0, 5.0], vec![11.0, 12.0, 15.0]];
        let none = Spread::of_table(&additive).unwrap();
        assert!(none.deviation < 1e-12 && none.freedom == 2);
        let [mut first, second] = additive;
        first[0] += 2.0;
        first[1] -= 2.0;
        let spread = Spread::of_table(&[first.clone(), second]).unwrap();
        // The interaction is ±1 in the first two columns: four squares of 1.
        assert!((spread.deviation - 2.0_f64.sqrt()).abs() < 1e-12, "{spread:?}");
        assert_eq!(Spread::of_table(&[first.clone()]), None);
        assert_eq!(Spread::of_table(&[first, vec![1.0]]), None);
        assert_eq!(Spread::of_table(&[]), None);
    }

    #[rstest]
    #[case(9, 0.05, Tails::Normal)]
    #[case(11, 0.001, Tails::Heavy)]
    #[case(14, 0.05, Tails::Normal)]
    #[case(18, 0.001 / 21.0, Tails::Normal)]
    fn the_power_of_rounds_is_that_of_their_test(
        #[case] rounds: usize,
        #[case] alpha: f64,
        #[case] tails: Tails,
    ) {
        let levels = Levels {
            tails,
            ..Levels::NORMAL
        };
        let shift = Power::of_rounds(rounds, alpha, levels, 4_000)
            .unwrap()
            .shift(POWER);
        let (mut noise, effort, repeats) = (Noise::new(99), Effort::of_a_report(SEED), 2_000);
        let found = (0..repeats).filter(|_| {
            let both = (0..rounds).map(|_| (Some(noise.of(tails)), Some(noise.of(tails) + shift)));
            Rounds::of(both.collect::<Vec<_>>()).unwrap().test(effort).p < alpha
        });
        let found = found.count() as f64 / f64::from(repeats);
        // Three standard errors of both simulations.
        assert!((found - POWER).abs() < 0.033, "{found}");
    }

    #[test]
    fn five_rounds_find_nothing_at_a_twentieth() {
        assert_eq!(Power::of_rounds(5, 0.05, Levels::NORMAL, 100), None);
    }

    #[test]
    fn the_spread_is_within_groups_and_not_between_them() {
        let groups = [vec![1.0, 3.0], vec![11.0, 13.0]];
        let spread = Spread::pooled(&groups).unwrap();
        assert!((spread.deviation - 2.0_f64.sqrt()).abs() < 1e-12);
        assert_eq!(spread.freedom, 2);
        assert_eq!(Spread::pooled([[1.0]]), None);
    }
}
