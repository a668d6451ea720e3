//! All the ways to permute the labels of things that are exchangeable under a hypothesis: windows, or blocks of values. A
//! permutation test looks at its statistic under each of them. The main type is [`Relabellings`].
//!
//! Where there are few enough, every distinct labelling is looked at once, and shares of them are exact. Where there are
//! more, as many as asked for are drawn with a fixed seed, and the observed one is counted among them, so that the share
//! is (b + 1) / (B + 1) and never 0 (Phipson and Smyth, *Permutation p-values should never be zero*, 2010).

use std::ops::Range;

use oorandom::Rand64;

/// How much work a permutation test may be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Effort {
    /// Labellings up to which every one is looked at.
    pub enumerate: u64,
    /// Labellings drawn where there are more.
    pub draws: u32,
    /// Seed of the draws.
    pub seed: u64,
}

impl Effort {
    /// That of a report: exact up to 10 windows against 10, else p to 1e-4.
    #[must_use]
    pub const fn of_a_report(seed: u64) -> Self {
        Self {
            enumerate: 200_000,
            draws: 9_999,
            seed,
        }
    }

    /// The same, but with draws enough that a p of a tenth of the level can be reached.
    #[must_use]
    pub fn reaching(self, level: f64) -> Self {
        let draws = (10.0 / level).ceil().min(f64::from(u32::MAX));
        Self {
            draws: self.draws.max(draws as u32),
            ..self
        }
    }

    /// The same, but for no more than `labellings` in all, and at least 999 draws.
    #[must_use]
    pub fn at_most(self, labellings: u64) -> Self {
        Self {
            enumerate: self.enumerate.min(labellings.max(1_000)),
            draws: self
                .draws
                .min(u32::try_from(labellings).unwrap_or(u32::MAX).max(999)),
            ..self
        }
    }
}

/// How the labellings were gone through. It stands with each p-value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Coverage {
    /// Every distinct one, once.
    Exact,
    /// So many draws, and the observed one.
    MonteCarlo,
}

impl Coverage {
    /// Its name in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Exact => "exact",
            Self::MonteCarlo => "monte-carlo",
        }
    }
}

/// A statistic under every labelling that was looked at, the observed one first.
#[derive(Debug, Clone, PartialEq)]
pub struct Relabellings {
    statistics: Vec<f64>,
    largest: f64,
    /// How they were gone through.
    pub coverage: Coverage,
}

/// What a permutation test found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PermutationTest {
    /// The statistic as observed.
    pub statistic: f64,
    /// The share of labellings whose statistic is at least the observed one.
    pub p: f64,
    /// The smallest p that any labelling of these very values could have had.
    pub smallest_p: f64,
    /// Labellings looked at, the observed one included.
    pub labellings: u64,
    /// How they were gone through.
    pub coverage: Coverage,
}

/// Statistics that differ by less than this share of the largest are equal: sums in another order differ by rounding,
/// and a tie that rounding breaks would make p too small. Counting as ties can only make it larger.
pub(crate) const TIE: f64 = 1e-9;

impl Relabellings {
    /// Deals labels 0, 1, … to `sizes[0]`, `sizes[1]`, … things, and takes the statistic under each labelling. The
    /// things stand in the order of their observed labels; the statistic gets the label of each.
    #[must_use]
    pub fn of(sizes: &[usize], effort: Effort, statistic: impl FnMut(&[usize]) -> f64) -> Self {
        Self::within(&[sizes], effort, statistic)
    }

    /// The same for things in several strata, stratum by stratum: a label stays in its stratum. Of every two labellings of
    /// the strata each is seen with each.
    #[must_use]
    pub fn within<S: AsRef<[usize]>>(
        strata: &[S],
        effort: Effort,
        mut statistic: impl FnMut(&[usize]) -> f64,
    ) -> Self {
        let mut labels: Vec<usize> = Vec::new();
        let mut places: Vec<Range<usize>> = Vec::new();
        for sizes in strata {
            let begin = labels.len();
            let sizes = sizes.as_ref().iter().enumerate();
            labels.extend(sizes.flat_map(|(label, size)| std::iter::repeat_n(label, *size)));
            places.push(begin..labels.len());
        }
        let all: f64 = strata.iter().map(|sizes| labellings(sizes.as_ref())).product();
        let mut statistics = vec![statistic(&labels)];
        let coverage = if all <= effort.enumerate as f64 {
            while next_within(&mut labels, &places) {
                statistics.push(statistic(&labels));
            }
            Coverage::Exact
        } else {
            let mut random = Rand64::new(u128::from(effort.seed));
            for _ in 0..effort.draws {
                for place in &places {
                    shuffle(&mut labels[place.clone()], &mut random);
                }
                statistics.push(statistic(&labels));
            }
            Coverage::MonteCarlo
        };
        let largest = statistics.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        Self {
            statistics,
            largest,
            coverage,
        }
    }

    /// The share of labellings whose statistic is at least `observed`.
    #[must_use]
    pub fn share_at_least(&self, observed: f64) -> f64 {
        let limit = observed - TIE * self.largest.abs();
        let reached = self.statistics.iter().filter(|other| **other >= limit).count();
        reached as f64 / self.statistics.len() as f64
    }

    /// The smallest share there is: that of the largest statistic.
    #[must_use]
    pub fn smallest_share(&self) -> f64 {
        self.share_at_least(self.largest)
    }

    /// How many were looked at, the observed one included.
    #[must_use]
    pub fn looked_at(&self) -> u64 {
        self.statistics.len() as u64
    }

    /// The test of the observed labelling against all.
    #[must_use]
    pub fn test(&self) -> PermutationTest {
        let statistic = self.statistics.first().copied().unwrap_or(f64::NAN);
        PermutationTest {
            statistic,
            p: self.share_at_least(statistic),
            smallest_p: self.smallest_share(),
            labellings: self.looked_at(),
            coverage: self.coverage,
        }
    }
}

/// How many distinct labellings there are: the multinomial coefficient, infinite where a double has no number for it.
#[must_use]
pub fn labellings(sizes: &[usize]) -> f64 {
    let mut count = 1.0_f64;
    let mut total = 0_usize;
    for size in sizes {
        for k in 1..=*size {
            total += 1;
            // Every partial product is a whole number, and rounding keeps it one below 2^53.
            count = (count * total as f64 / k as f64).round();
        }
    }
    count
}

/// The next labelling in lexicographic order; false after the last.
fn next(labels: &mut [usize]) -> bool {
    let Some(pivot) = labels.windows(2).rposition(|pair| pair[0] < pair[1]) else {
        return false;
    };
    if let Some(after) = labels.iter().rposition(|label| *label > labels[pivot]) {
        labels.swap(pivot, after);
    }
    labels[pivot + 1..].reverse();
    true
}

/// The next labelling of the strata, the first of which turn fastest; false after the last.
fn next_within(labels: &mut [usize], strata: &[Range<usize>]) -> bool {
    strata.iter().any(|place| {
        let labels = &mut labels[place.clone()];
        let has_next = next(labels);
        if !has_next {
            // The last labelling is the first one backwards.
            labels.reverse();
        }
        has_next
    })
}

/// Durstenfeld's shuffle.
pub fn shuffle<T>(items: &mut [T], random: &mut Rand64) {
    for last in (1..items.len()).rev() {
        let other = random.rand_range(0..last as u64 + 1) as usize;
        items.swap(last, other);
    }
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    const SMALL: Effort = Effort {
        enumerate: 1000,
        draws: 999,
        seed: 1,
    };

    #[rstest]
    #[case(&[4, 4], 70.0)]
    #[case(&[4, 4, 4], 34_650.0)]
    #[case(&[2, 2, 2], 90.0)]
    #[case(&[10, 10], 184_756.0)]
    #[case(&[3], 1.0)]
    #[case(&[], 1.0)]
    #[case(&[600, 600, 600], f64::INFINITY)]
    fn labellings_are_counted_by_the_multinomial(#[case] sizes: &[usize], #[case] count: f64) {
        assert_eq!(labellings(sizes), count);
    }

    #[test]
    fn every_labelling_is_seen_once_and_the_observed_one_first() {
        let mut seen = Vec::new();
        let all = Relabellings::of(&[2, 1, 1], SMALL, |labels| {
            seen.push(labels.to_vec());
            0.0
        });
        assert_eq!(all.coverage, Coverage::Exact);
        assert_eq!(seen[0], [0, 0, 1, 2]);
        let mut distinct = seen.clone();
        distinct.sort();
        distinct.dedup();
        assert_eq!((seen.len(), distinct.len()), (12, 12));
    }

    #[test]
    fn in_strata_each_labelling_of_the_one_is_seen_with_each_of_the_other() {
        let mut seen = Vec::new();
        let all = Relabellings::within(&[[2, 2], [1, 2]], SMALL, |labels| {
            assert_eq!(labels[..4].iter().sum::<usize>(), 2);
            assert_eq!(labels[4..].iter().sum::<usize>(), 2);
            seen.push(labels.to_vec());
            0.0
        });
        assert_eq!((all.coverage, all.looked_at()), (Coverage::Exact, 6 * 3));
        assert_eq!(seen[0], [0, 0, 1, 1, 0, 1, 1]);
        seen.sort();
        seen.dedup();
        assert_eq!(seen.len(), 18);
    }

    #[test]
    fn a_draw_keeps_each_strata_sizes() {
        let effort = Effort {
            enumerate: 1,
            ..SMALL
        };
        let all = Relabellings::within(&[[3, 1], [1, 3]], effort, |labels| {
            assert_eq!(
                (labels[..4].iter().sum::<usize>(), labels[4..].iter().sum()),
                (1, 3)
            );
            0.0
        });
        assert_eq!((all.coverage, all.looked_at()), (Coverage::MonteCarlo, 1000));
    }

    #[test]
    fn a_draw_keeps_the_sizes_and_a_seed_repeats() {
        let run = |seed| {
            let mut sum = Vec::new();
            let effort = Effort {
                enumerate: 1,
                seed,
                ..SMALL
            };
            let all = Relabellings::of(&[3, 5], effort, |labels| {
                assert_eq!(labels.iter().sum::<usize>(), 5);
                sum.push(labels.to_vec());
                0.0
            });
            assert_eq!((all.coverage, all.looked_at()), (Coverage::MonteCarlo, 1000));
            sum
        };
        assert_eq!(run(1), run(1));
        assert_ne!(run(1), run(2));
    }

    #[test]
    fn a_tie_that_only_rounding_breaks_is_a_tie() {
        let all = Relabellings::of(&[1, 1], SMALL, |labels| {
            if labels[0] == 0 { 0.3 } else { 0.1 + 0.2 - 1e-17 }
        });
        assert_eq!(all.test().p, 1.0);
    }

    #[test]
    fn nothing_but_equal_values_have_a_p_of_one() {
        let test = Relabellings::of(&[4, 4], SMALL, |_| 0.0).test();
        assert_eq!((test.p, test.smallest_p, test.labellings), (1.0, 1.0, 70));
    }

    #[test]
    fn a_p_of_draws_is_never_zero() {
        let effort = Effort {
            enumerate: 1,
            ..SMALL
        };
        let mut first = true;
        let test = Relabellings::of(&[8, 8], effort, |_| {
            if std::mem::take(&mut first) { 1.0 } else { 0.0 }
        })
        .test();
        assert_eq!(test.p, 1.0 / 1000.0);
    }

    #[test]
    fn a_small_level_is_given_the_draws_that_it_needs() {
        let effort = Effort::of_a_report(0);
        assert_eq!(effort.reaching(0.05), effort);
        assert_eq!(effort.reaching(0.001 / 36.0).draws, 360_000);
    }

    #[test]
    fn less_effort_never_means_fewer_than_999_draws() {
        let effort = Effort::of_a_report(0).at_most(10);
        assert_eq!((effort.enumerate, effort.draws), (1000, 999));
        assert_eq!(Effort::of_a_report(0).at_most(u64::MAX), Effort::of_a_report(0));
    }
}
