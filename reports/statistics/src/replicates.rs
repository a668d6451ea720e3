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
    relabelling::{Effort, PermutationTest, Relabellings},
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

    /// The test that the two are alike.
    #[must_use]
    pub fn test(&self, effort: Effort) -> PermutationTest {
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

    /// An interval for the shift that has it in at least this share of all cases, or, if so few rounds cannot, the widest there is
    /// with the confidence it has: 1 − 2 / 2^N. None for a single round. Beyond what `effort` enumerates, subsets are drawn.
    #[must_use]
    pub fn interval(&self, confidence: f64, effort: Effort) -> Option<Interval> {
        let rounds = self.0.len();
        if rounds < 2 {
            return None;
        }
        let mut means = self.subset_means(effort);
        means.sort_by(f64::total_cmp);
        let parts = (means.len() + 1) as f64;
        // The tie that rounding makes of 0.05 · 40 / 2 must not cost a part.
        let outside = ((1.0 - confidence) * parts / 2.0 + 1e-9).floor().max(1.0);
        let last = means.len().checked_sub(outside as usize)?;
        Some(Interval {
            low: *means.get(outside as usize - 1)?,
            high: *means.get(last)?,
            confidence: 1.0 - 2.0 * outside / parts,
        })
    }

    /// The mean of every subset but the empty one, or of so many that are drawn.
    fn subset_means(&self, effort: Effort) -> Vec<f64> {
        let mean = |is_in: &dyn Fn(usize) -> bool| {
            let chosen = self.0.iter().enumerate().filter(|(at, _)| is_in(*at));
            let (sum, count) = chosen.fold((0.0, 0_u32), |(sum, count), (_, value)| (sum + value, count + 1));
            (count > 0).then(|| sum / f64::from(count))
        };
        let subsets = u32::try_from(self.0.len())
            .ok()
            .and_then(|rounds| 1_u64.checked_shl(rounds));
        match subsets.filter(|subsets| *subsets <= effort.enumerate) {
            Some(subsets) => (1..subsets)
                .filter_map(|subset| mean(&|at| subset >> at & 1 == 1))
                .collect(),
            None => {
                let mut random = Rand64::new(u128::from(effort.seed));
                let draw = |_| {
                    let chosen: Vec<bool> = self.0.iter().map(|_| random.rand_u64() >> 63 == 1).collect();
                    mean(&|at| chosen.get(at).copied().unwrap_or(false))
                };
                (0..effort.draws).filter_map(draw).collect()
            }
        }
    }
}

/// The smallest p that [`Rounds::test`] can reach in so many rounds, whatever is measured: 2 / 2^N.
#[must_use]
pub fn smallest_p(rounds: usize) -> f64 {
    let halvings = i32::try_from(rounds).unwrap_or(i32::MAX);
    (2.0 * 0.5_f64.powi(halvings)).min(1.0)
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
