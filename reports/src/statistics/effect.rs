//! How large a difference is, in the unit of the error and with an interval. Windows are the units: intervals come from
//! how windows differ, since the values of one window are no independent measurements. The main type is [`Effect`].
//!
//! - **Shift**: the Hodges-Lehmann estimate (1963) on window levels, the median of all differences of a window mean of
//!   the second scenario and one of the first. Its interval is exact for any distribution that is only shifted: the k-th
//!   smallest and largest of the differences, with k from the distribution of the rank-sum statistic (Moses). With few
//!   windows it has a confidence of its own, that is stated: 4 against 4 give 97.1 % at k = 1, and 2 against 2 no more
//!   than 66.7 %.
//! - **Wasserstein-1 distance** of the pooled values: by how much the errors would have to be moved on the mean to make
//!   the one distribution the other. Never negative, so that it is not 0 for two scenarios alike.
//! - **Probability of superiority**: that a value of the second scenario is larger than one of the first, ties by half.
//!
//! The intervals of the latter two are by bootstrap over windows, the percentiles widened for few windows as Hesterberg
//! has it (*What Teachers Should Know About the Bootstrap*, 2015, section 5.3): without it, 4 windows give intervals that
//! are a fifth too short. docs/statistics/effects.md has the coverage measured.

use oorandom::Rand64;
use statrs::distribution::{ContinuousCDF, Normal, StudentsT};

use crate::statistics::pooled_ranks::PooledRanks;

/// The confidence that intervals are made for.
pub const CONFIDENCE: f64 = 0.95;

/// Bootstrap resamples.
const RESAMPLES: u64 = 4_999;

/// Work of the bootstraps of all pairs, in values walked along: some seconds. Longer samples and more pairs get fewer
/// resamples.
const WORK: u64 = 1_000_000_000;
const FEWEST_RESAMPLES: u64 = 499;

/// Windows against windows up to which the rank-sum distribution is computed, as a product.
const EXACT_PAIRS: usize = 2_500;

/// An estimate and its interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// The estimate.
    pub value: f64,
    /// The interval; none where there are too few windows for any.
    pub interval: Option<Interval>,
}

/// Where the quantity lies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interval {
    /// From.
    pub low: f64,
    /// To.
    pub high: f64,
    /// With which confidence: what was asked for, or the best that so few windows have.
    pub confidence: f64,
}

/// By how much two scenarios differ; positive or above one half where the second has the larger errors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Effect {
    /// Hodges-Lehmann shift of the window means, in metres.
    pub shift_m: Estimate,
    /// Wasserstein-1 distance of the pooled values, in metres.
    pub wasserstein_m: Estimate,
    /// Probability of superiority of the second.
    pub superiority: Estimate,
}

impl Effect {
    /// That of two scenarios, given the values of each of their windows; none if one of them has none. It is one of so
    /// many `pairs`, which share the work.
    #[must_use]
    pub fn of(a: &[&[f64]], b: &[&[f64]], pairs: usize, seed: u64) -> Option<Self> {
        let shift_m = hodges_lehmann(&levels(a), &levels(b))?;
        let windows: Vec<&[f64]> = a.iter().chain(b).copied().collect();
        let merged = PooledRanks::of(&windows);
        let above = above(&merged, a.len());
        let of = |counts: &[usize]| distribution_effects(&merged, &above, a.len(), counts);
        let (wasserstein, superiority) = of(&vec![1; windows.len()]);
        let tail = tail(a.len(), b.len());
        let (mut distances, mut probabilities) = (Vec::new(), Vec::new());
        let resamples = if tail.is_some() {
            RESAMPLES
                .min(WORK / (merged.len() * pairs).max(1) as u64)
                .max(FEWEST_RESAMPLES)
        } else {
            0
        };
        let mut random = Rand64::new(u128::from(seed));
        for _ in 0..resamples {
            let mut counts = vec![0; windows.len()];
            let mut draw = |from: usize, to: usize| {
                for _ in from..to {
                    counts[random.rand_range(from as u64..to as u64) as usize] += 1;
                }
            };
            draw(0, a.len());
            draw(a.len(), windows.len());
            let (wasserstein, superiority) = of(&counts);
            distances.push(wasserstein);
            probabilities.push(superiority);
        }
        Some(Self {
            shift_m,
            wasserstein_m: Estimate {
                value: wasserstein,
                interval: tail.and_then(|tail| percentiles(distances, tail)),
            },
            superiority: Estimate {
                value: superiority,
                interval: tail.and_then(|tail| percentiles(probabilities, tail)),
            },
        })
    }
}

/// The level of a window: the mean of its values; none of an empty one.
#[must_use]
pub fn level(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// The middle one, or the mean of the two in the middle; none of none.
#[must_use]
pub fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let upper = *values.get(values.len() / 2)?;
    let lower = *values.get((values.len() - 1) / 2)?;
    Some(f64::midpoint(lower, upper))
}

/// The levels of some windows, without the empty ones.
#[must_use]
pub fn levels(windows: &[&[f64]]) -> Vec<f64> {
    windows.iter().filter_map(|window| level(window)).collect()
}

/// The shift from the first levels to the second.
fn hodges_lehmann(a: &[f64], b: &[f64]) -> Option<Estimate> {
    let mut differences: Vec<f64> = b.iter().flat_map(|b| a.iter().map(move |a| b - a)).collect();
    differences.sort_by(f64::total_cmp);
    let count = differences.len();
    let (low, high) = (
        differences.get(count.checked_sub(1)? / 2)?,
        differences.get(count / 2)?,
    );
    let value = (low + high) / 2.0;
    let (rank, confidence) = rank_of_interval(a.len(), b.len());
    let interval = differences
        .get(rank - 1)
        .zip(differences.get(count.saturating_sub(rank)))
        .filter(|_| confidence > 0.0)
        .map(|(low, high)| Interval {
            low: *low,
            high: *high,
            confidence,
        });
    Some(Estimate { value, interval })
}

/// The k for which the k-th smallest and k-th largest difference bound the shift with at least [`CONFIDENCE`], and with
/// which confidence they do; k = 1 and what that gives, if no k does.
fn rank_of_interval(n: usize, m: usize) -> (usize, f64) {
    if n * m > EXACT_PAIRS {
        let (n, m) = (n as f64, m as f64);
        let spread = (n * m * (n + m + 1.0) / 12.0).sqrt();
        let rank = (n * m / 2.0 - normal_quantile(0.5 + CONFIDENCE / 2.0) * spread).floor();
        return ((rank as usize).max(1), CONFIDENCE);
    }
    let shares = rank_sum(n, m);
    let mut below = 0.0;
    let mut found = (1, 0.0);
    for (k, share) in (1..).zip(&shares) {
        below += share;
        let confidence = 1.0 - 2.0 * below;
        if k == 1 {
            found = (1, confidence.max(0.0));
        } else if confidence >= CONFIDENCE {
            found = (k, confidence);
        } else {
            break;
        }
    }
    found
}

/// P(U = u) of Mann and Whitney's U without ties, for u from 0 to n m, by their recursion: the largest value is from the
/// one sample or the other.
fn rank_sum(n: usize, m: usize) -> Vec<f64> {
    // shares[j] is the distribution for i values against j, i growing.
    let mut shares: Vec<Vec<f64>> = vec![vec![1.0]; m + 1];
    for i in 1..=n {
        let mut next: Vec<Vec<f64>> = vec![vec![1.0]];
        for j in 1..=m {
            let total = (i + j) as f64;
            let mut here = vec![0.0; i * j + 1];
            for (u, share) in shares[j].iter().enumerate() {
                here[u + j] += i as f64 / total * share;
            }
            for (u, share) in next[j - 1].iter().enumerate() {
                here[u] += j as f64 / total * share;
            }
            next.push(here);
        }
        shares = next;
    }
    shares.pop().unwrap_or_default()
}

/// How many pairs of a value of window `i` of the first scenario and one of window `j` of the second have the second one
/// larger, ties by half: `above[j][i]`.
fn above(merged: &PooledRanks, first: usize) -> Vec<Vec<f64>> {
    let seconds = merged.sizes().len() - first;
    let mut above = vec![vec![0.0; first]; seconds];
    let mut below = vec![0.0; first];
    for (_, windows) in merged.distinct() {
        let mut here = vec![0.0; first];
        for window in windows.iter().filter(|window| **window < first) {
            here[*window] += 1.0;
        }
        for window in windows.iter().filter(|window| **window >= first) {
            for (count, (below, here)) in above[window - first].iter_mut().zip(below.iter().zip(&here)) {
                *count += below + here / 2.0;
            }
        }
        for (below, here) in below.iter_mut().zip(&here) {
            *below += here;
        }
    }
    above
}

/// Wasserstein-1 distance and probability of superiority when each window is there so many times.
fn distribution_effects(
    merged: &PooledRanks,
    above: &[Vec<f64>],
    first: usize,
    counts: &[usize],
) -> (f64, f64) {
    let values = |windows: std::ops::Range<usize>| -> f64 {
        windows
            .map(|window| (counts[window] * merged.sizes()[window]) as f64)
            .sum()
    };
    let (n, m) = (values(0..first), values(first..counts.len()));
    let weights: Vec<f64> = counts
        .iter()
        .enumerate()
        .map(|(window, count)| {
            if window < first {
                *count as f64 / n
            } else {
                -(*count as f64) / m
            }
        })
        .collect();
    let larger: f64 = above
        .iter()
        .zip(&counts[first..])
        .map(|(row, times)| {
            let row: f64 = row
                .iter()
                .zip(counts)
                .map(|(pairs, times)| pairs * *times as f64)
                .sum();
            row * *times as f64
        })
        .sum();
    (merged.distances(&weights).wasserstein, larger / (n * m))
}

/// The share of resamples beyond each end of the interval: the normal tail of Student's quantile, widened for the
/// bootstrap's spread that is short by √((n − 1)/n). None for a single window on a side, which says nothing of spread.
pub(crate) fn tail(n: usize, m: usize) -> Option<f64> {
    let fewest = n.min(m) as f64;
    if fewest < 2.0 {
        return None;
    }
    let student = StudentsT::new(0.0, 1.0, (n + m - 2) as f64).ok()?;
    let quantile = student.inverse_cdf(0.5 + CONFIDENCE / 2.0);
    let normal = Normal::new(0.0, 1.0).ok()?;
    Some(normal.cdf(-quantile * (fewest / (fewest - 1.0)).sqrt()))
}

fn normal_quantile(share: f64) -> f64 {
    Normal::new(0.0, 1.0).map_or(f64::INFINITY, |normal| normal.inverse_cdf(share))
}

/// The interval that leaves out so large a share of the resampled values on each side.
pub(crate) fn percentiles(mut values: Vec<f64>, tail: f64) -> Option<Interval> {
    values.sort_by(f64::total_cmp);
    let beyond = (tail * values.len() as f64).floor() as usize;
    Some(Interval {
        low: *values.get(beyond)?,
        high: *values.get(values.len().checked_sub(beyond + 1)?)?,
        confidence: CONFIDENCE,
    })
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    fn close(left: f64, right: f64) {
        assert!((left - right).abs() < 1e-9, "{left} {right}");
    }

    #[rstest]
    #[case(4, 4, 1, 1.0 - 2.0 / 70.0)]
    #[case(3, 3, 1, 0.9)]
    #[case(2, 2, 1, 1.0 - 2.0 / 6.0)]
    #[case(1, 1, 1, 0.0)]
    // Hollander and Wolfe, Nonparametric Statistical Methods, table A.6: P(U ≤ 2) = 4/252 at 5 and 5.
    #[case(5, 5, 3, 1.0 - 8.0 / 252.0)]
    fn the_interval_of_the_shift_has_the_confidence_that_the_rank_sum_gives(
        #[case] n: usize,
        #[case] m: usize,
        #[case] rank: usize,
        #[case] confidence: f64,
    ) {
        let (found, has) = rank_of_interval(n, m);
        assert_eq!(found, rank);
        close(has, confidence);
    }

    #[test]
    fn the_rank_sum_distribution_is_symmetric_and_sums_to_one() {
        let shares = rank_sum(7, 5);
        assert_eq!(shares.len(), 36);
        close(shares.iter().sum(), 1.0);
        close(shares[3], shares[32]);
        close(shares[0], 1.0 / 792.0);
    }

    #[test]
    fn many_windows_use_the_normal_limit_near_the_exact_rank() {
        let exact = rank_of_interval(50, 50).0 as f64;
        let limit = rank_of_interval(51, 50).0 as f64;
        assert!((limit / exact - 1.0).abs() < 0.05, "{exact} {limit}");
    }

    #[test]
    fn a_shift_is_found_as_it_is() {
        let a: [&[f64]; 4] = [&[0.9, 1.1], &[2.0], &[3.0], &[4.0]];
        let b: [&[f64]; 4] = [&[1.25], &[2.25], &[3.25], &[4.25]];
        let shift = Effect::of(&a, &b, 1, 0).unwrap().shift_m;
        close(shift.value, 0.25);
        let interval = shift.interval.unwrap();
        close(interval.low, 1.25 - 4.0);
        close(interval.high, 4.25 - 1.0);
    }

    // Expected: scipy.stats.wasserstein_distance and mannwhitneyu(b, a).statistic / (n m) of the pooled values;
    // reports/tests/data/window_tests.py.
    #[test]
    fn distances_and_superiority_are_those_of_scipy() {
        let a: [&[f64]; 2] = [&[0.23, 0.25, 0.24], &[0.22, 0.26]];
        let b: [&[f64]; 2] = [&[0.25, 0.27], &[0.24, 0.29, 0.25, 0.21]];
        let effect = Effect::of(&a, &b, 1, 0).unwrap();
        close(effect.wasserstein_m.value, 0.015);
        close(effect.superiority.value, 19.5 / 30.0);
    }

    #[test]
    fn identical_scenarios_have_no_shift_no_distance_and_no_superior_one() {
        let windows: [&[f64]; 4] = [&[1.0, 2.0], &[2.0, 3.0], &[1.0, 1.0], &[5.0]];
        let effect = Effect::of(&windows, &windows, 1, 0).unwrap();
        close(effect.shift_m.value, 0.0);
        close(effect.wasserstein_m.value, 0.0);
        close(effect.superiority.value, 0.5);
        let interval = effect.superiority.interval.unwrap();
        assert!(interval.low < 0.5 && 0.5 < interval.high);
    }

    #[test]
    fn one_window_a_side_has_no_interval() {
        let effect = Effect::of(&[&[1.0, 2.0]], &[&[3.0, 4.0]], 1, 0).unwrap();
        assert_eq!(effect.shift_m.interval, None);
        assert_eq!(effect.wasserstein_m.interval, None);
        assert_eq!(effect.superiority.interval, None);
        assert_eq!(Effect::of(&[], &[&[1.0]], 1, 0), None);
    }

    #[test]
    fn a_seed_repeats() {
        let a: [&[f64]; 3] = [&[0.1, 0.2], &[0.3, 0.1], &[0.2, 0.2]];
        let b: [&[f64]; 3] = [&[0.2, 0.2], &[0.4, 0.1], &[0.3, 0.2]];
        assert_eq!(Effect::of(&a, &b, 1, 3), Effect::of(&a, &b, 1, 3));
    }
}
