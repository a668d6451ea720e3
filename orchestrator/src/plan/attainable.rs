//! What a design can detect at all: the smallest p-value that its comparisons can reach. The main type is
//! [`Attainable`].
//!
//! Two samples of n and m values without ties that do not overlap give the smallest p of the exact two-sample
//! Kolmogorov-Smirnov test: of the C(n+m, n) equally likely arrangements only the two with one sample wholly before the
//! other are as extreme, so p = 2 / C(n+m, n) (Gibbons and Chakraborti, *Nonparametric Statistical Inference*, 6.3).

use schemars::JsonSchema;
use serde::Serialize;
use statistics::ks::smallest_attainable_p;

/// Sizes of two samples and the smallest p their comparison can reach.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, JsonSchema)]
pub struct Pair {
    /// Values in the one.
    pub n: u64,
    /// Values in the other.
    pub m: u64,
    /// Smallest attainable p.
    pub p: f64,
}

/// The range over all comparisons of a plan.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, JsonSchema)]
pub struct Attainable {
    /// A comparison is rejected below this.
    pub alpha: f64,
    /// The comparison that can reach the smallest p.
    pub best: Pair,
    /// The comparison that can reach the least.
    pub worst: Pair,
}

impl Attainable {
    /// From the sizes of all samples, one for each window of each scenario that runs; nothing to compare gives none.
    #[must_use]
    pub fn of(alpha: f64, mut sizes: Vec<u64>) -> Option<Self> {
        sizes.sort_unstable();
        let (Some(&[a, b]), Some(&[y, z])) = (sizes.first_chunk(), sizes.last_chunk()) else {
            return None;
        };
        let pair = |n, m| Pair {
            n,
            m,
            p: smallest_p(n, m),
        };
        Some(Self {
            alpha,
            best: pair(y, z),
            worst: pair(a, b),
        })
    }
}

/// Smallest p of a two-sided exact KS test of `n` and `m` values; 1 if there is nothing to compare.
#[must_use]
pub fn smallest_p(n: u64, m: u64) -> f64 {
    let values = |count: u64| usize::try_from(count).unwrap_or(usize::MAX);
    smallest_attainable_p(values(n), values(m))
}

/// Fewest values in two samples of equal size whose comparison can be rejected at `alpha`; none if `alpha` is 0.
#[must_use]
pub fn fewest_values(alpha: f64) -> Option<u64> {
    // p falls almost fourfold with each value: at 600 it is below every double.
    (1..600).find(|n| smallest_p(*n, *n) < alpha)
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    #[rstest]
    #[case(1, 1, 1.0)]
    #[case(4, 4, 2.0 / 70.0)]
    #[case(7, 8, 2.0 / 6435.0)]
    #[case(8, 8, 2.0 / 12870.0)]
    #[case(0, 8, 1.0)]
    fn the_smallest_p_counts_the_two_extreme_arrangements(#[case] n: u64, #[case] m: u64, #[case] p: f64) {
        assert!((smallest_p(n, m) - p).abs() < 1e-15, "{}", smallest_p(n, m));
        assert!((smallest_p(n, m) - smallest_p(m, n)).abs() < 1e-15);
    }

    #[test]
    fn the_papers_samples_are_far_beyond_its_alpha() {
        // 2 / C(120, 60)
        let expected = 2.0 / 96_614_908_840_363_322_603_893_139_521_372_656.0;
        assert!(
            (smallest_p(60, 60) / expected - 1.0).abs() < 1e-12,
            "{:e}",
            smallest_p(60, 60)
        );
    }

    #[test]
    fn huge_samples_do_not_overflow() {
        assert!(smallest_p(u64::from(u32::MAX), u64::from(u32::MAX)) < f64::MIN_POSITIVE);
    }

    #[rstest]
    #[case(0.001, Some(7))]
    #[case(0.05, Some(4))]
    #[case(0.5, Some(2))]
    #[case(0.0, None)]
    fn the_fewest_values_that_can_reject(#[case] alpha: f64, #[case] fewest: Option<u64>) {
        assert_eq!(fewest_values(alpha), fewest);
    }

    #[test]
    fn the_range_is_over_all_pairs_of_samples() {
        let attainable = Attainable::of(0.001, vec![8, 7, 8, 8]).unwrap();
        assert_eq!((attainable.worst.n, attainable.worst.m), (7, 8));
        assert_eq!((attainable.best.n, attainable.best.m), (8, 8));
        assert_eq!(Attainable::of(0.001, vec![8]), None);
    }
}
