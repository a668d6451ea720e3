//! Tests with the environment as the unit: two things were each measured once in every round, in an environment made anew, and the
//! order within a round was drawn. The main type is [`Rounds`].
//!
//! Under the hypothesis that the two are alike, which of a round's two environments is called a and which b is the draw of the
//! order, whatever an environment does to its windows, however windows follow from those before them, and wherever the machine
//! drifts over the run. Labels of whole environments are therefore exchanged within rounds, which flips the sign of the round's
//! difference: a randomisation test (Fisher, *The Design of Experiments*, 1935, 21; Lehmann and Romano, *Testing Statistical
//! Hypotheses*, 5.10), exact over all 2^N flips. The statistic is the absolute mean of the differences.
//!
//! The interval is the test's own, inverted: if differences are symmetric around the shift, the means of all subsets of them divide
//! the line into parts that have the shift equally often (Hartigan, *Using subsample values as typical values*, JASA 64, 1969).

use oorandom::Rand64;

use crate::{
    effect::Interval,
    relabelling::{Coverage, Effort, PermutationTest, Relabellings, TIE},
};

/// The differences of two things in the rounds that have both, from the first to the second.
#[derive(Debug, Clone, PartialEq)]
pub struct Rounds(Vec<f64>);

impl Rounds {
    /// Of the means of each round's environment of the first and the second; a round where either is missing is left out. None
    /// where that leaves no round.
    pub fn of(rounds: impl IntoIterator<Item = (Option<f64>, Option<f64>)>) -> Option<Self> {
        let both = rounds.into_iter().filter_map(|(a, b)| Some(b? - a?));
        let differences: Vec<f64> = both.filter(|difference| difference.is_finite()).collect();
        (!differences.is_empty()).then_some(Self(differences))
    }

    /// How many rounds have both.
    #[must_use]
    pub fn count(&self) -> usize {
        self.0.len()
    }

    /// The mean difference, from the first to the second, in the unit of the means.
    #[must_use]
    pub fn shift(&self) -> f64 {
        self.0.iter().sum::<f64>() / self.0.len() as f64
    }

    /// The test that the two are alike. Flips are counted and not looked at one by one, as far as [`is_counted`] goes; beyond that,
    /// they are drawn.
    #[must_use]
    pub fn test(&self, effort: Effort) -> PermutationTest {
        let statistic = self.shift().abs();
        if !is_counted(self.count(), effort) {
            return self.drawn(effort);
        }
        let flips = flips(self.count());
        let tie = self.tie();
        // Whatever the sign of the sum, differences are taken such that it is positive.
        let sign = if self.shift() < 0.0 { -1.0 } else { 1.0 };
        let share = |subsets: u64| (2.0 * subsets as f64 / flips).min(1.0);
        let p = match statistic * self.0.len() as f64 <= tie {
            true => 1.0,
            false => share(at_most(&self.0, sign, 0.0, tie / 2.0)),
        };
        let zeros = self.0.iter().filter(|difference| difference.abs() <= tie / 2.0);
        PermutationTest {
            statistic,
            p,
            smallest_p: share(1 << zeros.count().min(63)),
            labellings: flips as u64,
            coverage: Coverage::Exact,
        }
    }

    fn drawn(&self, effort: Effort) -> PermutationTest {
        let strata = vec![[1, 1]; self.0.len()];
        let all = Relabellings::within(&strata, effort, |labels| {
            // Of each round the label of its first environment decides.
            let flipped = labels.chunks_exact(2).map(|labels| labels.first() == Some(&1));
            let signed = std::iter::zip(&self.0, flipped);
            let sum: f64 = signed
                .map(|(difference, flipped)| if flipped { -difference } else { *difference })
                .sum();
            (sum / self.0.len() as f64).abs()
        });
        all.test()
    }

    /// Sums that differ by less are equal, as in `relabelling`.
    fn tie(&self) -> f64 {
        TIE * self.0.iter().map(|difference| difference.abs()).sum::<f64>()
    }

    /// An interval for the shift that has it in at least this share of all cases, or, if so few rounds cannot, the widest there is
    /// with the confidence it has: 1 − 2 / 2^N. None for a single round. Beyond what [`is_counted`], subsets are drawn.
    #[must_use]
    pub fn interval(&self, confidence: f64, effort: Effort) -> Option<Interval> {
        if self.count() < 2 {
            return None;
        }
        let means = SubsetMeans::of(self, effort);
        let parts = means.parts();
        // The tie that rounding makes of 0.05 · 40 / 2 must not cost a part.
        let outside = ((1.0 - confidence) * parts / 2.0 + 1e-9).floor().max(1.0);
        Some(Interval {
            low: means.smallest(outside, TIE)?,
            high: -SubsetMeans::of(&self.mirrored(), effort).smallest(outside, TIE)?,
            confidence: 1.0 - 2.0 * outside / parts,
        })
    }

    /// The shift of all differences, upwards, from which on [`Self::test`] finds it at a level; none where so few rounds find none.
    ///
    /// Where the sum is above 0, a flip is as extreme as what was measured if the sum of what it flips is at most 0, or that of the
    /// rest. So p is twice the share of subsets, the empty one among them, whose mean is at most 0; and with a shift δ added to all,
    /// of those whose mean was at most −δ.
    #[must_use]
    pub fn critical_shift(&self, alpha: f64, effort: Effort, precision: f64) -> Option<f64> {
        let means = SubsetMeans::of(self, effort);
        // p < alpha, and not p = alpha. The empty subset is always one of them.
        let others = (alpha * means.parts() / 2.0).ceil() - 1.0;
        Some(-means.smallest(others, precision)?)
    }

    /// From the second to the first.
    fn mirrored(&self) -> Self {
        Self(self.0.iter().map(|difference| -difference).collect())
    }
}

/// All flips of so many rounds.
fn flips(rounds: usize) -> f64 {
    2.0_f64.powi(i32::try_from(rounds).unwrap_or(i32::MAX))
}

/// Whether that effort does for every flip of so many rounds: each is a subset of the one half and a subset of the other, so that
/// the sums of the subsets of both are enough to count them (as in [`crate::swaps`]). A report's does up to 32 rounds.
fn is_counted(rounds: usize, effort: Effort) -> bool {
    flips(rounds / 2) + flips(rounds.div_ceil(2)) <= effort.enumerate as f64
}

/// How many subsets, the empty one among them, have a sum of at most `limit`, once all have that sign and are shifted.
fn at_most(differences: &[f64], sign: f64, shift: f64, limit: f64) -> u64 {
    let (first, second) = differences.split_at(differences.len() / 2);
    let sums = |part: &[f64]| {
        let mut sums = vec![0.0];
        for difference in part {
            let with: Vec<f64> = sums.iter().map(|sum| sum + sign * difference + shift).collect();
            sums.extend(with);
            // Two lists in order, which the sort merges.
            sums.sort_by(f64::total_cmp);
        }
        sums
    };
    let (first, second) = (sums(first), sums(second));
    let mut below = second.len();
    let mut count = 0;
    for sum in first {
        while below > 0 && sum + second[below - 1] > limit {
            below -= 1;
        }
        count += below as u64;
    }
    count
}

/// The means of all subsets of differences but the empty one.
enum SubsetMeans<'a> {
    /// Each by itself.
    Listed(Vec<f64>),
    /// Too many for that; how many lie below any limit is counted.
    Counted(&'a Rounds),
}

impl<'a> SubsetMeans<'a> {
    fn of(rounds: &'a Rounds, effort: Effort) -> Self {
        let differences = &rounds.0;
        if flips(differences.len()) <= effort.enumerate as f64 {
            return Self::Listed(all_means(differences));
        }
        if is_counted(differences.len(), effort) {
            return Self::Counted(rounds);
        }
        let mut random = Rand64::new(u128::from(effort.seed));
        let draw = |_| {
            let chosen: Vec<bool> = differences.iter().map(|_| random.rand_u64() >> 63 == 1).collect();
            let chosen = std::iter::zip(differences, chosen).filter(|(_, is_in)| *is_in);
            let (sum, count) = chosen.fold((0.0, 0_u32), |(sum, count), (value, _)| (sum + value, count + 1));
            (count > 0).then(|| sum / f64::from(count))
        };
        Self::Listed((0..effort.draws).filter_map(draw).collect())
    }

    /// The parts into which they divide the line.
    fn parts(&self) -> f64 {
        match self {
            Self::Listed(means) => (means.len() + 1) as f64,
            Self::Counted(rounds) => flips(rounds.count()),
        }
    }

    /// The one at a place in ascending order, from 1; none where there is none. Where they are counted, it is within `precision` of the
    /// range of the differences.
    fn smallest(self, place: f64, precision: f64) -> Option<f64> {
        if place < 1.0 || place > self.parts() - 1.0 {
            return None;
        }
        match self {
            Self::Listed(mut means) => {
                let (_, mean, _) = means.select_nth_unstable_by(place as usize - 1, f64::total_cmp);
                Some(*mean)
            }
            Self::Counted(rounds) => {
                let differences = &rounds.0;
                let mut low = differences.iter().copied().fold(f64::INFINITY, f64::min);
                let mut high = differences.iter().copied().fold(f64::NEG_INFINITY, f64::max);
                let precision = precision * (high - low);
                while high - low > precision {
                    let middle = f64::midpoint(low, high);
                    if middle <= low || middle >= high {
                        break;
                    }
                    // The empty subset, whose sum stays 0, is not one of them.
                    let below = at_most(differences, 1.0, -middle, 0.0) - 1;
                    if below as f64 >= place {
                        high = middle;
                    } else {
                        low = middle;
                    }
                }
                Some(high)
            }
        }
    }
}

/// With each difference, the mean of every subset of those before it.
fn all_means(differences: &[f64]) -> Vec<f64> {
    let mut sums = vec![(0.0, 0_u32)];
    for difference in differences {
        let with: Vec<(f64, u32)> = sums
            .iter()
            .map(|(sum, count)| (sum + difference, count + 1))
            .collect();
        sums.extend(with);
    }
    let others = sums.into_iter().skip(1);
    others.map(|(sum, count)| sum / f64::from(count)).collect()
}

/// The smallest p that [`Rounds::test`] can reach in so many rounds, whatever is measured: 2 / 2^N.
#[must_use]
pub fn smallest_p(rounds: usize) -> f64 {
    let halvings = i32::try_from(rounds).unwrap_or(i32::MAX);
    (2.0 * 0.5_f64.powi(halvings)).min(1.0)
}

/// The smallest p that [`Rounds::test`] can reach with that effort: [`smallest_p`], but no less than one of the flips that are drawn
/// where there are too many to look at each.
#[must_use]
pub fn reachable_p(rounds: usize, effort: Effort) -> f64 {
    let smallest = smallest_p(rounds);
    match is_counted(rounds, effort) {
        true => smallest,
        false => smallest.max(1.0 / (f64::from(effort.draws) + 1.0)),
    }
}

/// The fewest rounds whose test can reach a p below `alpha`; none if `alpha` is not above 0.
#[must_use]
pub fn fewest_rounds(alpha: f64) -> Option<usize> {
    (1..=1000).find(|rounds| smallest_p(*rounds) < alpha)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rstest::rstest;

    use super::*;

    const EFFORT: Effort = Effort::of_a_report(1);

    fn rounds(differences: &[f64]) -> Rounds {
        Rounds::of(
            differences
                .iter()
                .map(|difference| (Some(0.0), Some(*difference))),
        )
        .unwrap()
    }

    /// Darwin's fifteen pairs of maize, cross-fertilised less self-fertilised, in eighths of an inch; Fisher, *The Design of
    /// Experiments*, 21, counts 1726 of the 32 768 flips whose sum is as large in magnitude: p = 0.05267.
    #[test]
    fn it_is_fishers_test_of_darwins_maize() {
        let darwin = [49, -67, 8, 16, 6, 23, 28, 41, 14, 29, 56, 24, 75, 60, -48];
        let test = rounds(&darwin.map(f64::from)).test(EFFORT);
        assert_eq!(test.labellings, 32_768);
        assert!(
            (test.p - 1726.0 / 32_768.0).abs() < 1e-12,
            "{}",
            test.p * 32_768.0
        );
    }

    #[rstest]
    #[case(1, 1.0)]
    #[case(2, 0.5)]
    #[case(6, 0.03125)]
    fn the_smallest_p_is_known_beforehand(#[case] count: usize, #[case] p: f64) {
        let differences: Vec<f64> = (1..=count).map(|round| round as f64).collect();
        let test = rounds(&differences).test(EFFORT);
        assert_eq!((smallest_p(count), test.p, test.smallest_p), (p, p, p));
    }

    #[test]
    fn six_rounds_are_the_fewest_for_a_twentieth_and_eleven_for_a_thousandth() {
        assert_eq!(fewest_rounds(0.05), Some(6));
        assert_eq!(fewest_rounds(0.001), Some(11));
        assert_eq!(fewest_rounds(0.0), None);
    }

    #[test]
    fn what_is_drawn_reaches_no_less_than_one_of_the_draws() {
        let of = |count: usize| rounds(&(1..=count).map(|it| it as f64).collect::<Vec<_>>()).test(EFFORT);
        let (counted, drawn) = (of(32), of(40));
        assert_eq!((drawn.p, reachable_p(40, EFFORT)), (1e-4, 1e-4));
        assert_eq!(
            (counted.p, reachable_p(32, EFFORT)),
            (smallest_p(32), smallest_p(32))
        );
        assert_eq!(
            (counted.coverage, drawn.coverage),
            (Coverage::Exact, Coverage::MonteCarlo)
        );
    }

    #[rstest]
    #[case(6, 0.05)]
    #[case(8, 0.05)]
    #[case(9, 0.3)]
    #[case(11, 0.001)]
    fn the_test_finds_what_is_above_the_critical_shift_and_nothing_below(
        #[case] count: usize,
        #[case] alpha: f64,
    ) {
        let mut noise = crate::noise_model::Noise::new(7);
        for _ in 0..40 {
            let differences: Vec<f64> = (0..count).map(|_| noise.normal()).collect();
            let critical = rounds(&differences).critical_shift(alpha, EFFORT, TIE).unwrap();
            let p = |shift: f64| {
                let shifted: Vec<f64> = differences.iter().map(|it| it + shift).collect();
                rounds(&shifted).test(EFFORT).p
            };
            let is_above = rounds(&differences).shift() + critical > 1e-6;
            assert!(p(critical + 1e-6) < alpha, "{differences:?}");
            assert!(!is_above || p(critical - 1e-6) >= alpha, "{differences:?}");
        }
    }

    #[test]
    fn too_few_rounds_find_no_shift() {
        assert_eq!(rounds(&[1.0; 5]).critical_shift(0.05, EFFORT, TIE), None);
        assert_eq!(rounds(&[1.0; 6]).critical_shift(0.05, EFFORT, TIE), Some(-1.0));
    }

    #[test]
    fn a_round_with_one_side_is_left_out() {
        let rounds = Rounds::of([
            (Some(1.0), Some(3.0)),
            (Some(1.0), None),
            (None, Some(9.0)),
            (Some(2.0), Some(3.0)),
        ]);
        let rounds = rounds.unwrap();
        assert_eq!((rounds.count(), rounds.shift()), (2, 1.5));
        assert_eq!(Rounds::of([(None, Some(1.0))]), None);
    }

    #[test]
    fn an_interval_is_of_subset_means_and_has_the_confidence_it_says() {
        // By hand: of the 7 means of subsets of {1, 2, 6} the outermost are 1 and 6, and 8 parts have the shift equally often.
        let interval = rounds(&[1.0, 6.0, 2.0]).interval(0.95, EFFORT).unwrap();
        assert_eq!(
            (interval.low, interval.high, interval.confidence),
            (1.0, 6.0, 0.75)
        );
        // The next ones are 1.5 and 4.
        let interval = rounds(&[1.0, 6.0, 2.0]).interval(0.5, EFFORT).unwrap();
        assert_eq!(
            (interval.low, interval.high, interval.confidence),
            (1.5, 4.0, 0.5)
        );
        assert_eq!(rounds(&[1.0]).interval(0.95, EFFORT), None);
    }

    #[test]
    fn counted_subsets_agree_with_those_looked_at_one_by_one() {
        let mut noise = crate::noise_model::Noise::new(6);
        for count in 3..=10 {
            let differences: Vec<f64> = (0..count).map(|_| 0.5 + noise.normal()).collect();
            let rounds = rounds(&differences);
            let counted_only = Effort {
                enumerate: (1 << count) - 1,
                ..EFFORT
            };
            assert!(matches!(
                SubsetMeans::of(&rounds, counted_only),
                SubsetMeans::Counted(_)
            ));
            let (one_by_one, counted) = (
                rounds.interval(0.9, EFFORT).unwrap(),
                rounds.interval(0.9, counted_only).unwrap(),
            );
            assert_eq!(one_by_one.confidence, counted.confidence);
            assert!(
                (one_by_one.low - counted.low).abs() < 1e-8,
                "{one_by_one:?} {counted:?}"
            );
            assert!((one_by_one.high - counted.high).abs() < 1e-8);
            let all = Relabellings::within(&vec![[1, 1]; count], EFFORT, |labels| {
                let flipped = labels.chunks_exact(2).map(|labels| labels[0] == 1);
                let signed = std::iter::zip(&differences, flipped);
                let signed =
                    signed.map(|(difference, flipped)| if flipped { -difference } else { *difference });
                (signed.sum::<f64>() / count as f64).abs()
            });
            let (all, test) = (all.test(), rounds.test(EFFORT));
            assert_eq!(
                (all.p, all.smallest_p, all.labellings),
                (test.p, test.smallest_p, test.labellings)
            );
        }
    }

    #[test]
    fn many_rounds_are_drawn_and_agree_with_all() {
        let mut noise = crate::noise_model::Noise::new(5);
        let differences: Vec<f64> = (0..14).map(|_| 0.4 + noise.normal()).collect();
        let few = Effort {
            enumerate: 100,
            ..EFFORT
        };
        let (all, drawn) = (rounds(&differences), rounds(&differences));
        let (all, by_all) = (all.test(EFFORT), all.interval(0.95, EFFORT).unwrap());
        let (drawn, by_draws) = (drawn.test(few), drawn.interval(0.95, few).unwrap());
        assert!((all.p - drawn.p).abs() < 0.02, "{} {}", all.p, drawn.p);
        assert!((by_all.low - by_draws.low).abs() < 0.05 && (by_all.high - by_draws.high).abs() < 0.05);
    }

    proptest! {
        /// Under the hypothesis each of the 2^N flips is as likely to be the measured one. Of their p-values no more than a
        /// share x is at most x, for every x, and without ties they are uniform on 2/2^N, 4/2^N, … 1.
        #[test]
        fn over_all_flips_of_any_data_p_is_uniform(differences in prop::collection::vec(-100.0..100.0_f64, 1..7)) {
            let flips = 1_u32 << differences.len();
            let flipped = |flip: u32| -> Vec<f64> {
                let signed = differences.iter().enumerate();
                signed.map(|(at, value)| if flip >> at & 1 == 1 { -value } else { *value }).collect()
            };
            let mut p: Vec<f64> = (0..flips).map(|flip| rounds(&flipped(flip)).test(EFFORT).p).collect();
            p.sort_by(f64::total_cmp);
            for (at, p) in p.iter().enumerate() {
                // The share of flips with a p of at most this one.
                let at_most = (at + 1) as f64 / f64::from(flips);
                prop_assert!(at_most <= p + 1e-12, "{at} of {flips}: {p}");
            }
            let distinct: std::collections::BTreeSet<u64> = p.iter().map(|p| (p * f64::from(flips)).round() as u64).collect();
            let magnitudes = differences.iter().all(|value| value.abs() > 1e-3);
            if magnitudes && distinct.len() as u32 == flips / 2 {
                let uniform: Vec<u64> = (1..=u64::from(flips / 2)).map(|k| 2 * k).collect();
                prop_assert_eq!(Vec::from_iter(distinct), uniform);
            }
        }
    }
}
