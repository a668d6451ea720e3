//! Permutation tests with the window as the unit. The values of a window share what happened in it, so that they are no
//! independent measurements; windows are, and under the hypothesis that two scenarios are one and the same, the labels of
//! their windows can be dealt anew. The main functions are [`mean_difference`] for two scenarios and [`max_t`] for a
//! family of pairs.
//!
//! The statistic is the difference of the mean window levels over what it varies by when labels are dealt anew,
//!
//! ```text
//! T = |mean(a) − mean(b)| / √(1/n + 1/m)
//! ```
//!
//! (for two scenarios the divisor is a constant and changes nothing; in a family it makes pairs of unequal numbers of
//! windows comparable). A difference of means is in metres, is zero where deployment shifts nothing, and of all
//! statistics has the most power against a shift where window levels are near normal (Lehmann and Romano, *Testing
//! Statistical Hypotheses*, 5.9). What it is blind to, spread and shape, is for the tests on distributions.
//!
//! [`max_t`] is the single-step maximum-statistic adjustment of Westfall and Young (*Resampling-Based Multiple Testing*,
//! 1993, 2.5): labels are dealt anew over all windows of the family at once, and a pair's adjusted p is the share of
//! labellings whose largest T reaches the pair's. It is exact for the hypothesis that no scenario differs. That a single
//! pair differs follows from it only if the scenarios' windows spread alike (Petrondas and Gabriel, *Multiple Comparisons
//! by Rerandomization Tests*, 1983); Holm's adjustment of the pairs' own p-values does not need that.

use crate::statistics::relabelling::{Coverage, Effort, PermutationTest, Relabellings, labellings};

/// The exact test of two scenarios' window levels; none if a side has no window.
#[must_use]
pub fn mean_difference(a: &[f64], b: &[f64], effort: Effort) -> Option<PermutationTest> {
    if a.is_empty() || b.is_empty() {
        return None;
    }
    let levels: Vec<f64> = centred(&[a, b]);
    let sizes = [a.len(), b.len()];
    let all = Relabellings::of(&sizes, effort, |labels| {
        let sums = sums(labels, &levels, 2);
        t(&sums, &sizes, (0, 1))
    });
    Some(all.test())
}

/// The smallest p that [`mean_difference`] can reach with n windows against m, whatever is measured: 2 / C(n + m, n), and
/// half of that for unequal numbers, where the mirror image of the most extreme labelling is not as extreme.
#[must_use]
pub fn smallest_p(n: usize, m: usize) -> f64 {
    if n == 0 || m == 0 {
        return 1.0;
    }
    let extreme = if n == m { 2.0 } else { 1.0 };
    (extreme / labellings(&[n, m])).min(1.0)
}

/// A family's adjusted p-values.
#[derive(Debug, Clone, PartialEq)]
pub struct MaxT {
    /// One for each pair, in the order given.
    pub p: Vec<f64>,
    /// The smallest that any could be.
    pub smallest_p: f64,
    /// Labellings looked at, the observed one included.
    pub labellings: u64,
    /// How.
    pub coverage: Coverage,
}

/// Work of a family, in pairs times labellings: some seconds.
const FAMILY_WORK: u64 = 1_000_000_000;

/// Adjusts a family of pairs of scenarios, given by their places in `scenarios`, which has the window levels of each.
/// None if there is no pair, or a pair names a scenario without windows or none at all.
#[must_use]
pub fn max_t(scenarios: &[&[f64]], pairs: &[(usize, usize)], effort: Effort) -> Option<MaxT> {
    let sizes: Vec<usize> = scenarios.iter().map(|levels| levels.len()).collect();
    let has_windows = |at: usize| sizes.get(at).is_some_and(|size| *size > 0);
    if pairs.is_empty() || !pairs.iter().all(|(a, b)| has_windows(*a) && has_windows(*b)) {
        return None;
    }
    let levels = centred(scenarios);
    let effort = effort.at_most(FAMILY_WORK / (pairs.len() + levels.len()) as u64);
    let all = Relabellings::of(&sizes, effort, |labels| {
        let sums = sums(labels, &levels, sizes.len());
        pairs
            .iter()
            .map(|pair| t(&sums, &sizes, *pair))
            .fold(0.0, f64::max)
    });
    let observed: Vec<f64> = scenarios
        .iter()
        .map(|levels| levels.iter().sum::<f64>())
        .collect();
    let centre = mean(&scenarios.concat());
    let sums: Vec<f64> = observed
        .iter()
        .zip(&sizes)
        .map(|(sum, size)| sum - centre * *size as f64)
        .collect();
    Some(MaxT {
        p: pairs
            .iter()
            .map(|pair| all.share_at_least(t(&sums, &sizes, *pair)))
            .collect(),
        smallest_p: all.smallest_share(),
        labellings: all.looked_at(),
        coverage: all.coverage,
    })
}

/// All levels in a row, less their mean: sums of numbers around zero lose least.
fn centred(scenarios: &[&[f64]]) -> Vec<f64> {
    let levels = scenarios.concat();
    let centre = mean(&levels);
    levels.iter().map(|level| level - centre).collect()
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

fn sums(labels: &[usize], levels: &[f64], count: usize) -> Vec<f64> {
    let mut sums = vec![0.0; count];
    for (label, level) in labels.iter().zip(levels) {
        if let Some(sum) = sums.get_mut(*label) {
            *sum += level;
        }
    }
    sums
}

fn t(sums: &[f64], sizes: &[usize], (a, b): (usize, usize)) -> f64 {
    let of = |at: usize| Some((*sums.get(at)?, *sizes.get(at)? as f64));
    let (Some((sum_a, n)), Some((sum_b, m))) = (of(a), of(b)) else {
        return 0.0;
    };
    (sum_a / n - sum_b / m).abs() / (1.0 / n + 1.0 / m).sqrt()
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    const EFFORT: Effort = Effort::of_a_report(1);

    #[test]
    fn four_windows_apart_from_four_have_two_of_seventy() {
        let test = mean_difference(&[1.0, 2.0, 3.0, 4.0], &[5.0, 6.0, 7.0, 8.0], EFFORT).unwrap();
        assert_eq!(
            (test.p, test.smallest_p, test.labellings),
            (2.0 / 70.0, 2.0 / 70.0, 70)
        );
        assert_eq!(test.coverage, Coverage::Exact);
    }

    // Expected: scipy.stats.permutation_test with statistic |mean(x) − mean(y)|, alternative "greater", exact;
    // reports/tests/data/window_tests.py.
    #[rstest]
    #[case(&[0.236, 0.241, 0.239, 0.240], &[0.238, 0.2405, 0.2425, 0.244], 18.0 / 70.0)]
    #[case(&[1.0, 2.0], &[1.5, 2.5, 4.0], 0.4)]
    #[case(&[0.1, 0.2, 0.3], &[0.1, 0.2, 0.3], 1.0)]
    #[case(&[0.1], &[0.2], 1.0)]
    fn it_is_scipys_exact_permutation_test(#[case] a: &[f64], #[case] b: &[f64], #[case] p: f64) {
        let test = mean_difference(a, b, EFFORT).unwrap();
        assert!((test.p - p).abs() < 1e-12, "{}", test.p);
        assert_eq!(
            mean_difference(b, a, EFFORT).unwrap().p,
            test.p,
            "in either order"
        );
    }

    #[rstest]
    #[case(4, 4, 2.0 / 70.0)]
    #[case(2, 4, 1.0 / 15.0)]
    #[case(1, 1, 1.0)]
    #[case(0, 4, 1.0)]
    #[case(7, 7, 2.0 / 3432.0)]
    fn the_smallest_p_is_known_beforehand(#[case] n: usize, #[case] m: usize, #[case] p: f64) {
        assert_eq!(smallest_p(n, m), p);
    }

    #[test]
    fn no_window_is_no_test() {
        assert_eq!(mean_difference(&[], &[1.0], EFFORT), None);
    }

    #[test]
    fn a_family_of_one_pair_is_the_pairs_own_test() {
        let (a, b) = ([0.236, 0.241, 0.239, 0.240], [0.238, 0.2405, 0.2425, 0.244]);
        let own = mean_difference(&a, &b, EFFORT).unwrap();
        let family = max_t(&[&a, &b], &[(0, 1)], EFFORT).unwrap();
        assert_eq!(family.p, [own.p]);
        assert_eq!(family.smallest_p, own.smallest_p);
    }

    #[test]
    fn a_family_is_never_less_strict_than_the_largest_of_the_pairs_within_it() {
        // By hand: three scenarios of two windows, all pairs: 90 labellings. The widest gap there can be is that between
        // {1, 2} and {5, 6}: the pair that has it can be any of 3, in 2 orders.
        let (a, b, c) = ([1.0, 2.0], [3.0, 4.0], [5.0, 6.0]);
        let family = max_t(&[&a, &b, &c], &[(0, 1), (0, 2), (1, 2)], EFFORT).unwrap();
        assert_eq!(family.labellings, 90);
        assert!((family.p[1] - 6.0 / 90.0).abs() < 1e-12, "{:?}", family.p);
        assert_eq!(family.smallest_p, family.p[1]);
        assert!(family.p[0] > family.p[1]);
        assert_eq!(family.p[0], family.p[2]);
    }

    #[test]
    fn many_scenarios_are_drawn_and_say_so() {
        let levels: Vec<Vec<f64>> = (0..7)
            .map(|s| (0..4).map(|w| f64::from(s * 4 + w)).collect())
            .collect();
        let levels: Vec<&[f64]> = levels.iter().map(Vec::as_slice).collect();
        let family = max_t(&levels, &[(0, 6), (0, 1)], EFFORT).unwrap();
        assert_eq!(
            (family.coverage, family.labellings),
            (Coverage::MonteCarlo, 10_000)
        );
        assert!(family.p[0] < 0.001 && family.p[1] > 0.5, "{:?}", family.p);
    }

    #[test]
    fn a_pair_of_nothing_is_no_family() {
        assert_eq!(max_t(&[&[1.0], &[]], &[(0, 1)], EFFORT), None);
        assert_eq!(max_t(&[&[1.0]], &[(0, 3)], EFFORT), None);
        assert_eq!(max_t(&[&[1.0]], &[], EFFORT), None);
    }
}
