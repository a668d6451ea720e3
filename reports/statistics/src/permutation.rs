//! Permutation tests with the window as the unit. The values of a window share what happened in it, so that they are no
//! independent measurements; windows are, and under the hypothesis that two scenarios are one and the same, the labels of
//! their windows can be permuted. The main functions are [`mean_difference`] for two scenarios and [`max_t`] for a
//! family of pairs.
//!
//! The statistic is the difference of the mean window levels over what it varies by when labels are permuted,
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
//! [`max_t`] is the step-down maximum-statistic adjustment of Westfall and Young (*Resampling-Based Multiple Testing*, 1993,
//! 2.6) by *residuals*. Each scenario's windows are taken around their own mean, these residuals are dealt anew over all windows
//! of the family, and a pair's adjusted p is the share of dealings in which the largest T of all pairs that are not further apart
//! reaches the pair's; T is over the pooled standard deviation within scenarios.
//!
//! Residuals, because pairs are tested: to permute the windows of all scenarios is exact for the hypothesis that no scenario
//! differs, and for a pair means that the windows of a third scenario which does differ are dealt to the pair (no *subset
//! pivotality*; Petrondas and Gabriel, *Multiple Comparisons by Rerandomization Tests*, 1983). One scenario far off then hides
//! all other differences. What is dealt here does not depend on which scenarios differ. The price: it assumes that windows
//! spread alike in all scenarios, whatever their distribution, and is no longer exact, but right in the limit of many windows of the
//! family together. Holm's adjustment of the pairs' own p-values needs neither.

use oorandom::Rand64;

use crate::{
    relabelling::{Coverage, Effort, PermutationTest, Relabellings, labellings, shuffle},
    swaps::{self, Swaps},
};

/// Sums of levels that may be made for each labelling that may be looked at: a sum is made and counted in the time of a few
/// numbers, a labelling in that of all.
const SUMS_A_LABELLING: f64 = 8.0;

/// Whether [`mean_difference`] counts every labelling of n windows against m: in a report up to 19 : 19.
#[must_use]
pub fn is_exact(n: usize, m: usize, effort: Effort) -> bool {
    swaps::sums(n, m) <= effort.enumerate as f64 * SUMS_A_LABELLING
}

/// The test of two scenarios' window levels, exact where [`is_exact`]; none if a side has no window.
#[must_use]
pub fn mean_difference(a: &[f64], b: &[f64], effort: Effort) -> Option<PermutationTest> {
    if a.is_empty() || b.is_empty() {
        return None;
    }
    let levels: Vec<f64> = centred(&[a, b]);
    let sizes = [a.len(), b.len()];
    if is_exact(a.len(), b.len(), effort) {
        let (a, b) = levels.split_at(a.len());
        let swaps = Swaps::of(a, b)?;
        let all = labellings(&sizes);
        return Some(PermutationTest {
            statistic: t(&[a.iter().sum::<f64>(), b.iter().sum::<f64>()], &sizes, (0, 1)),
            p: swaps.at_least(swaps.difference().abs()) as f64 / all,
            smallest_p: swaps.at_least(swaps.largest()) as f64 / all,
            labellings: all as u64,
            coverage: Coverage::Exact,
        });
    }
    let all = Relabellings::of(&sizes, effort, |labels| {
        let sums = sums(labels, &levels, 2);
        t(&sums, &sizes, (0, 1))
    });
    Some(all.test())
}

/// The smallest p that [`mean_difference`] can reach with that effort, whatever is measured: [`smallest_p`], but no less than
/// one of the labellings that are drawn where there are too many to count.
#[must_use]
pub fn reachable_p(n: usize, m: usize, effort: Effort) -> f64 {
    let smallest = smallest_p(n, m);
    if is_exact(n, m, effort) {
        smallest
    } else {
        smallest.max(1.0 / (f64::from(effort.draws) + 1.0))
    }
}

/// The smallest share of all labellings that n windows against m can have, whatever is measured: 2 / C(n + m, n), and
/// half of that for unequal numbers, where the mirror image of the most extreme labelling is not as extreme.
#[must_use]
pub fn smallest_p(n: usize, m: usize) -> f64 {
    if n == 0 || m == 0 {
        return 1.0;
    }
    let extreme = if n == m { 2.0 } else { 1.0 };
    (extreme / labellings(&[n, m])).min(1.0)
}

/// The same for a test that looks at labellings one by one, and draws them if there are too many: no p is below one of the draws.
#[must_use]
pub fn attainable_p(n: usize, m: usize, effort: Effort) -> f64 {
    let of_all = smallest_p(n, m);
    if labellings(&[n, m]) <= effort.enumerate as f64 {
        of_all
    } else {
        of_all.max(1.0 / (f64::from(effort.draws) + 1.0))
    }
}

/// A family's adjusted p-values.
#[derive(Debug, Clone, PartialEq)]
pub struct MaxT {
    /// One for each pair, in the order given.
    pub p: Vec<f64>,
    /// The smallest that any could be.
    pub smallest_p: f64,
    /// Dealings looked at, the observed one included.
    pub labellings: u64,
    /// Whether every labelling was looked at, or a sample of them.
    pub coverage: Coverage,
}

/// Work of a family, in pairs times dealings: some seconds.
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
    let windows: usize = sizes.iter().sum();
    let draws = effort.at_most(FAMILY_WORK / (pairs.len() + windows) as u64).draws;
    let observed = Studentised::of(&scenarios.concat(), &sizes).each(pairs);
    // From the pair that is furthest apart to the one that is least.
    let mut order: Vec<usize> = (0..pairs.len()).collect();
    order.sort_by(|a, b| observed[*b].total_cmp(&observed[*a]));
    let mut reached = vec![0_u32; pairs.len()];
    let mut dealt = residuals(scenarios);
    if !dealt.is_empty() {
        // A single window has no residual of its own.
        dealt = dealt.iter().copied().cycle().take(windows).collect();
        let mut random = Rand64::new(u128::from(effort.seed));
        for _ in 0..draws {
            shuffle(&mut dealt, &mut random);
            let under = Studentised::of(&dealt, &sizes).each(pairs);
            let mut largest = 0.0_f64;
            for at in order.iter().rev() {
                largest = largest.max(under[*at]);
                reached[*at] += u32::from(largest >= observed[*at] * (1.0 - TIE));
            }
        }
    } else {
        reached.fill(draws);
    }
    let share = |reached: u32| f64::from(reached + 1) / f64::from(draws + 1);
    let mut p = vec![1.0; pairs.len()];
    let mut before = 0.0_f64;
    for at in order {
        before = before.max(share(reached[at]));
        p[at] = before;
    }
    Some(MaxT {
        p,
        smallest_p: share(0),
        labellings: u64::from(draws) + 1,
        coverage: Coverage::MonteCarlo,
    })
}

/// T that differ by a smaller share are equal but for rounding.
const TIE: f64 = 1e-9;

/// Each window's level around the mean of its scenario, as large as it would be around the true mean; without scenarios of a
/// single window.
fn residuals(scenarios: &[&[f64]]) -> Vec<f64> {
    let several = scenarios.iter().filter(|levels| levels.len() > 1);
    several
        .flat_map(|levels| {
            let (mean, n) = (mean(levels), levels.len() as f64);
            levels
                .iter()
                .map(move |level| (level - mean) * (n / (n - 1.0)).sqrt())
        })
        .collect()
}

/// The means of scenarios and what they vary by.
struct Studentised<'a> {
    sizes: &'a [usize],
    means: Vec<f64>,
    /// Pooled standard deviation within scenarios.
    spread: f64,
}

impl<'a> Studentised<'a> {
    /// Of levels in a row, so many of each scenario.
    fn of(levels: &[f64], sizes: &'a [usize]) -> Self {
        let mut means = Vec::with_capacity(sizes.len());
        let (mut squares, mut freedom) = (0.0, 0.0);
        let mut rest = levels;
        for size in sizes {
            let (own, others) = rest.split_at(*size);
            let centre = mean(own);
            squares += own.iter().map(|level| (level - centre).powi(2)).sum::<f64>();
            freedom += size.saturating_sub(1) as f64;
            means.push(centre);
            rest = others;
        }
        Self {
            sizes,
            means,
            spread: (squares / freedom).sqrt(),
        }
    }

    /// T of each pair: 0 where there is no difference, and infinite where there is one and nothing varies.
    fn each(&self, pairs: &[(usize, usize)]) -> Vec<f64> {
        let t = |(a, b): &(usize, usize)| {
            let difference = (self.means[*a] - self.means[*b]).abs();
            let of_sizes = (1.0 / self.sizes[*a] as f64 + 1.0 / self.sizes[*b] as f64).sqrt();
            if difference > 0.0 {
                difference / (self.spread * of_sizes)
            } else {
                0.0
            }
        };
        pairs.iter().map(t).collect()
    }
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
    use crate::noise_model::Noise;

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
    // reports/statistics/tests/data/window_tests.py.
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

    // Until now 9 999 labellings were drawn of 11 : 11 and more: p = 1e-4 at best, of which 21 pairs leave 0.0021 by Holm.
    #[rstest]
    #[case(11)]
    #[case(16)]
    fn windows_wholly_apart_reach_the_smallest_p_also_where_labellings_are_many(#[case] windows: usize) {
        let levels: Vec<f64> = (0..2 * windows).map(|at| at as f64).collect();
        let (a, b) = levels.split_at(windows);
        let test = mean_difference(a, b, EFFORT).unwrap();
        assert_eq!(
            (test.p, test.coverage),
            (smallest_p(windows, windows), Coverage::Exact)
        );
        assert_eq!(test.smallest_p, test.p);
        assert_eq!(reachable_p(windows, windows, EFFORT), test.p);
    }

    #[test]
    fn what_is_drawn_reaches_no_less_than_one_of_the_draws() {
        let levels: Vec<f64> = (0..50).map(f64::from).collect();
        let (a, b) = levels.split_at(25);
        let test = mean_difference(a, b, EFFORT).unwrap();
        assert_eq!(test.coverage, Coverage::MonteCarlo);
        assert_eq!((test.p, reachable_p(25, 25, EFFORT)), (1e-4, 1e-4));
    }

    #[test]
    fn draws_reach_no_smaller_p_than_one_of_them() {
        assert_eq!(attainable_p(4, 4, EFFORT), 2.0 / 70.0);
        assert_eq!(attainable_p(20, 20, EFFORT), 1e-4);
    }

    #[test]
    fn no_window_is_no_test() {
        assert_eq!(mean_difference(&[], &[1.0], EFFORT), None);
    }

    /// Made-up levels of so many scenarios, alike but for what is added to each.
    fn levels(random: &mut Noise, windows: usize, added: &[f64]) -> Vec<Vec<f64>> {
        let scenario = |added: &f64| (0..windows).map(|_| added + random.normal()).collect();
        added.iter().map(scenario).collect()
    }

    fn family(levels: &[Vec<f64>], pairs: &[(usize, usize)], draws: u32) -> MaxT {
        let levels: Vec<&[f64]> = levels.iter().map(Vec::as_slice).collect();
        max_t(&levels, pairs, Effort { draws, ..EFFORT }).unwrap()
    }

    const ALL: [(usize, usize); 3] = [(0, 1), (0, 2), (1, 2)];

    // a and b are wholly apart. With the windows of all scenarios dealt, as until version 0.1, c made 0.80 of it.
    #[test]
    fn one_scenario_far_off_hides_no_other_difference() {
        let (a, b) = (vec![1.0, 1.1, 0.9, 1.05], vec![1.5, 1.4, 1.6, 1.55]);
        let near = family(&[a.clone(), b.clone(), vec![1.02, 0.95, 1.0, 1.08]], &ALL, 9_999);
        let far = family(&[a, b, vec![101.0, 100.9, 101.1, 100.95]], &ALL, 9_999);
        assert!(near.p[0] < 0.01, "{near:?}");
        assert!(far.p[0] < 0.01, "{far:?}");
        assert_eq!(far.p[1], far.smallest_p);
    }

    #[test]
    fn a_step_down_never_turns_the_order_of_the_pairs() {
        let mut random = Noise::new(3);
        let found = family(&levels(&mut random, 4, &[0.0, 1.0, 3.0]), &ALL, 999);
        assert!(found.p[1] <= found.p[0] && found.p[1] <= found.p[2], "{found:?}");
        assert_eq!((found.coverage, found.labellings), (Coverage::MonteCarlo, 1000));
    }

    /// At a nominal 0.05, in 300 families each; the limit is 2.6 standard errors above.
    #[rstest]
    #[case::none_differs(&[0.0, 0.0, 0.0])]
    #[case::one_is_far_off(&[0.0, 0.0, 50.0])]
    fn alike_pairs_are_rejected_as_often_as_they_should_be(#[case] added: &[f64]) {
        let mut random = Noise::new(11);
        let rejected = (0..300).filter(|_| {
            let found = family(&levels(&mut random, 4, added), &ALL, 199);
            ALL.iter()
                .zip(&found.p)
                .any(|((a, b), p)| added[*a] == added[*b] && *p <= 0.05)
        });
        let rejected = rejected.count();
        assert!((2..=25).contains(&rejected), "{rejected} of 300");
    }

    #[test]
    fn single_windows_are_told_apart_by_the_spread_of_the_others() {
        let found = family(
            &[
                vec![5.0],
                vec![0.0, 0.1, -0.1, 0.05],
                vec![0.02, -0.03, 0.07, 0.0],
            ],
            &ALL,
            999,
        );
        assert!(found.p[0] < 0.01 && found.p[2] > 0.5, "{found:?}");
        assert_eq!(family(&[vec![5.0], vec![0.0]], &[(0, 1)], 999).p, [1.0]);
    }

    #[test]
    fn equal_levels_are_no_difference() {
        let same = vec![0.1; 4];
        let found = family(&[same.clone(), same.clone(), vec![0.2; 4]], &ALL, 999);
        assert_eq!(found.p[0], 1.0);
        assert_eq!(found.p[1], found.smallest_p);
    }

    #[test]
    fn a_pair_of_nothing_is_no_family() {
        assert_eq!(max_t(&[&[1.0], &[]], &[(0, 1)], EFFORT), None);
        assert_eq!(max_t(&[&[1.0]], &[(0, 3)], EFFORT), None);
        assert_eq!(max_t(&[&[1.0]], &[], EFFORT), None);
    }
}
