//! How large a difference is, in the unit of the error and with an interval. Windows are the units: intervals come from
//! how windows differ, since the values of one window are no independent measurements. The main type is [`Effect`].
//!
//! - **Shift**: the difference of the mean window levels, second less first. Its interval is of all shifts of the mean level that
//!   [`MeanShift`] does not reject.
//! - **Wasserstein-1 distance** of the pooled values: by how much the errors would have to be moved on the mean to make
//!   the one distribution the other. Never negative.
//! - **Probability of superiority**: that a value of the second scenario is larger than one of the first, ties by half.
//!
//! The interval of the distance is `W ± t ∫ √V(x) dx`, cut off at 0, with `V(x) = s²_a(x)/n + s²_b(x)/m` of the windows' distribution
//! functions at x. By the triangle inequality the distance is in error by at most ∫ |error of F − G|, whose size is at most ∫ √V
//! (Minkowski) and reaches it where windows are moved as a whole; t is Student's quantile with Satterthwaite's degrees of freedom.
//!
//! The interval of the probability is Student's on the logit scale, as Perme and Manevski recommend (*Confidence intervals for the
//! Mann-Whitney test*, 2019), with windows in place of values: the variance is that of the windows' mean placements (Brunner and
//! Munzel 2000), on one degree of freedom less than the smaller side has windows. Where no two windows overlap it is Clopper and
//! Pearson's of as many pairs of windows as there are of the smaller side. docs/statistics/effects.md has the coverage of all three.

use statrs::distribution::{ContinuousCDF, StudentsT};

use crate::{mean_shift::MeanShift, pooled_ranks::PooledRanks};

/// The confidence that intervals are made for.
pub const CONFIDENCE: f64 = 0.95;

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
    /// The difference of the mean window levels, in metres.
    pub shift: Estimate,
    /// Wasserstein-1 distance of the pooled values, in metres.
    pub wasserstein: Estimate,
    /// Probability of superiority of the second.
    pub superiority: Estimate,
}

impl Effect {
    /// That of two scenarios, given the values of each of their windows, and the tests of their levels if each has two windows;
    /// none if one of them has none.
    #[must_use]
    pub fn of(a: &[&[f64]], b: &[&[f64]], shift: Option<&MeanShift>) -> Option<Self> {
        let shifted = level(&levels(b))? - level(&levels(a))?;
        let windows: Vec<&[f64]> = a.iter().chain(b).copied().collect();
        let merged = PooledRanks::of(&windows);
        let interval = shift.and_then(|shift| shift.interval_or_best(CONFIDENCE));
        Some(Self {
            shift: Estimate {
                value: shifted,
                interval,
            },
            wasserstein: wasserstein(&merged, a.len()),
            superiority: superiority(&merged, a.len()),
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

/// ∫ |F − G| of the pooled values of both sides.
fn wasserstein(merged: &PooledRanks, first: usize) -> Estimate {
    let sizes: Vec<f64> = merged.sizes().iter().map(|size| *size as f64).collect();
    let (of_a, of_b) = sizes.split_at(first);
    let shares = [1.0 / of_a.iter().sum::<f64>(), -1.0 / of_b.iter().sum::<f64>()];
    let weights: Vec<f64> = (0..sizes.len())
        .map(|it| shares[usize::from(it >= first)])
        .collect();
    let value = merged.distances(&weights).wasserstein;
    let interval = spread_of_functions(merged, first).and_then(|[a, b]| {
        let size = a.hypot(b);
        let freedom =
            size.powi(4) / (a.powi(4) / (of_a.len() - 1) as f64 + b.powi(4) / (of_b.len() - 1) as f64);
        // Where no window differs from another of its side, there is nothing to be uncertain of.
        let quantile = if size > 0.0 {
            student_quantile(freedom, CONFIDENCE)?
        } else {
            0.0
        };
        Some(Interval {
            low: (value - quantile * size).max(0.0),
            high: value + quantile * size,
            confidence: CONFIDENCE,
        })
    });
    Estimate { value, interval }
}

/// ∫ √(s²(x)/n) dx of the distribution functions of the windows of each side; none where a side has a single one.
fn spread_of_functions(merged: &PooledRanks, first: usize) -> Option<[f64; 2]> {
    let sides = [first, merged.sizes().len() - first];
    if sides.iter().any(|windows| *windows < 2) {
        return None;
    }
    let mut functions = vec![0.0; merged.sizes().len()];
    // Σ F and Σ F² over the windows of each side.
    let mut sums = [[0.0; 2]; 2];
    let mut integrals = [0.0; 2];
    let mut before: Option<f64> = None;
    for (value, windows) in merged.distinct() {
        let width = value - before.unwrap_or(value);
        for (integral, ([sum, squares], count)) in integrals.iter_mut().zip(sums.iter().zip(sides)) {
            let count = count as f64;
            let variance = (squares - sum * sum / count).max(0.0) / (count - 1.0) / count;
            *integral += variance.sqrt() * width;
        }
        for window in windows {
            let [sum, squares] = &mut sums[usize::from(*window >= first)];
            let function = functions.get_mut(*window)?;
            let after = *function + 1.0 / *merged.sizes().get(*window)? as f64;
            *sum += after - *function;
            *squares += after * after - *function * *function;
            *function = after;
        }
        before = Some(value);
    }
    Some(integrals)
}

/// P(a value of the second > one of the first) of the pooled values, ties by half.
fn superiority(merged: &PooledRanks, first: usize) -> Estimate {
    let sizes: Vec<f64> = merged.sizes().iter().map(|size| *size as f64).collect();
    let (of_a, of_b) = sizes.split_at(first);
    let (values_a, values_b) = (of_a.iter().sum::<f64>(), of_b.iter().sum::<f64>());
    let above = above(merged, first);
    let value = above.iter().flatten().sum::<f64>() / (values_a * values_b);
    // The placement of each window among all values of the other side.
    let placements_a: Vec<f64> = of_a
        .iter()
        .enumerate()
        .map(|(at, size)| above.iter().map(|row| row[at]).sum::<f64>() / (size * values_b))
        .collect();
    let placements_b: Vec<f64> = of_b
        .iter()
        .zip(&above)
        .map(|(size, row)| row.iter().sum::<f64>() / (size * values_a))
        .collect();
    let interval = variance_of_mean(&placements_a)
        .zip(variance_of_mean(&placements_b))
        .and_then(|(a, b)| logit_interval(value, (a + b).sqrt(), of_a.len().min(of_b.len())));
    Estimate { value, interval }
}

/// The interval of the mean of some levels at [`CONFIDENCE`], by Student's distribution; none of fewer than two.
#[must_use]
pub fn mean_interval(levels: &[f64]) -> Option<Interval> {
    let (mean, variance) = level(levels).zip(variance_of_mean(levels))?;
    let reach = student_quantile((levels.len() - 1) as f64, CONFIDENCE)? * variance.sqrt();
    Some(Interval {
        low: mean - reach,
        high: mean + reach,
        confidence: CONFIDENCE,
    })
}

/// s²/n; none of fewer than two.
fn variance_of_mean(values: &[f64]) -> Option<f64> {
    let mean = level(values).filter(|_| values.len() > 1)?;
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    Some(squares / (values.len() - 1) as f64 / values.len() as f64)
}

/// The interval of a probability with that standard error, of so many windows on the smaller side.
fn logit_interval(value: f64, error: f64, windows: usize) -> Option<Interval> {
    /// Nearer to 0 or 1 all windows of a side lie beyond all of the other but for rounding.
    const APART: f64 = 1e-12;
    let of = |low: f64, high: f64| Interval {
        low,
        high,
        confidence: CONFIDENCE,
    };
    let all_or_none = ((1.0 - CONFIDENCE) / 2.0).powf(1.0 / windows as f64);
    if value >= 1.0 - APART {
        return Some(of(all_or_none, 1.0));
    }
    if value <= APART {
        return Some(of(0.0, 1.0 - all_or_none));
    }
    let logit = (value / (1.0 - value)).ln();
    let reach = student_quantile((windows - 1) as f64, CONFIDENCE)? * error / (value * (1.0 - value));
    let share = |logit: f64| 1.0 / (1.0 + (-logit).exp());
    Some(of(share(logit - reach), share(logit + reach)))
}

/// How many standard errors an interval of that confidence reaches to each side, by Student's distribution; none without freedom.
#[must_use]
pub fn student_quantile(freedom: f64, confidence: f64) -> Option<f64> {
    let student = StudentsT::new(0.0, 1.0, freedom).ok()?;
    Some(student.inverse_cdf(0.5 + confidence / 2.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::relabelling::Effort;

    fn close(left: f64, right: f64) {
        assert!((left - right).abs() < 1e-9, "{left} {right}");
    }

    fn of(a: &[&[f64]], b: &[&[f64]]) -> Option<Effect> {
        let shift = MeanShift::of(&levels(a), &levels(b), Effort::of_a_report(0));
        Effect::of(a, b, shift.as_ref())
    }

    #[test]
    fn a_shift_is_found_as_it_is() {
        let a: [&[f64]; 4] = [&[0.9, 1.1], &[2.0], &[3.0], &[4.0]];
        let b: [&[f64]; 4] = [&[1.25], &[2.25], &[3.25], &[4.25]];
        let shift = of(&a, &b).unwrap().shift;
        close(shift.value, 0.25);
        let interval = shift.interval.unwrap();
        close(interval.confidence, 1.0 - 2.0 / 70.0);
        close(f64::midpoint(interval.low, interval.high), 0.25);
    }

    #[test]
    fn windows_that_do_not_overlap_have_the_interval_of_so_few_pairs_of_windows() {
        let (a, b): ([&[f64]; 4], [&[f64]; 4]) = (
            [&[1.0, 2.0], &[1.5], &[1.0], &[2.0]],
            [&[5.0], &[6.0], &[7.0], &[5.5]],
        );
        for (found, low, high) in [
            (of(&a, &b), 0.025_f64.powf(0.25), 1.0),
            (of(&b, &a), 0.0, 1.0 - 0.025_f64.powf(0.25)),
        ] {
            let interval = found.unwrap().superiority.interval.unwrap();
            close(interval.low, low);
            close(interval.high, high);
        }
    }

    // By hand: both windows of b are at 1 and 3, those of a at 0 and 0. Between 0 and 1 F is 1 and G is 0, between 1 and 3 G is
    // 0.5: W = 1 + 2 · 0.5. The functions of b's windows differ between 1 and 3 alone, where s²/n is 0.25.
    #[test]
    fn the_interval_of_the_distance_is_of_how_the_windows_functions_vary() {
        let found = of(&[&[0.0], &[0.0]], &[&[1.0], &[3.0]]).unwrap().wasserstein;
        close(found.value, 2.0);
        let interval = found.interval.unwrap();
        // Student's 0.975 quantile with one degree of freedom is 12.7062.
        assert!((interval.high - (2.0 + 12.706_205)).abs() < 1e-5, "{interval:?}");
        close(interval.low, 0.0);
    }

    // Expected: scipy.stats.wasserstein_distance and mannwhitneyu(b, a).statistic / (n m) of the pooled values;
    // reports/statistics/tests/data/window_tests.py.
    #[test]
    fn distances_and_superiority_are_those_of_scipy() {
        let a: [&[f64]; 2] = [&[0.23, 0.25, 0.24], &[0.22, 0.26]];
        let b: [&[f64]; 2] = [&[0.25, 0.27], &[0.24, 0.29, 0.25, 0.21]];
        let effect = of(&a, &b).unwrap();
        close(effect.wasserstein.value, 0.015);
        close(effect.superiority.value, 19.5 / 30.0);
    }

    #[test]
    fn identical_scenarios_have_no_shift_no_distance_and_no_superior_one() {
        let windows: [&[f64]; 4] = [&[1.0, 2.0], &[2.0, 3.0], &[1.0, 1.0], &[5.0]];
        let effect = of(&windows, &windows).unwrap();
        close(effect.shift.value, 0.0);
        close(effect.wasserstein.value, 0.0);
        close(effect.superiority.value, 0.5);
        let interval = effect.superiority.interval.unwrap();
        assert!(interval.low < 0.5 && 0.5 < interval.high);
    }

    #[test]
    fn one_window_a_side_has_no_interval() {
        let effect = of(&[&[1.0, 2.0]], &[&[3.0, 4.0]]).unwrap();
        assert_eq!(effect.shift.interval, None);
        assert_eq!(effect.wasserstein.interval, None);
        assert_eq!(effect.superiority.interval, None);
        assert_eq!(of(&[], &[&[1.0]]), None);
    }

    // Student's quantile for two degrees of freedom is 4.302653, as every table of it has.
    #[test]
    fn the_interval_of_a_mean_is_students() {
        let interval = mean_interval(&[1.0, 2.0, 3.0]).unwrap();
        let reach = 4.302_653 / 3.0_f64.sqrt();
        assert!((interval.low - (2.0 - reach)).abs() < 1e-5, "{interval:?}");
        assert!((interval.high - (2.0 + reach)).abs() < 1e-5, "{interval:?}");
        assert_eq!(mean_interval(&[1.0]), None);
    }
}
