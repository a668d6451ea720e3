//! By how much the mean window levels of two scenarios differ, where neither their numbers nor their spreads need be equal. The
//! main type is [`MeanShift`].
//!
//! The permutation test of a difference of means is exact where two scenarios are one and the same. It is no test of equal means:
//! with 3 windows of standard deviation 5 against 10 of 1 it rejects a third of equal means at a nominal 0.05. Two tests of equal
//! means are made here, and the larger p counts:
//!
//! - The *studentised permutation test* (Janssen, *Studentized permutation tests for non-i.i.d. hypotheses*, 1997; Chung and
//!   Romano, *Exact and asymptotically robust permutation tests*, 2013): the labels are permuted under
//!   `t = (mean(b) − mean(a)) / √(s²_a/n + s²_b/m)`. It is exact where the two distributions are equal but for a shift,
//!   whatever they are, and right in the limit of many windows for unequal numbers and spreads.
//! - *Welch's test* (1947): the same t against Student's distribution with Satterthwaite's degrees of freedom. It holds for unequal
//!   numbers and spreads of few windows, where levels are near normal; means of many values are.
//!
//! A hypothesis is rejected where both reject it, so that the error is at most the level where *either* set of assumptions holds.
//! The interval is of the shifts that are not rejected: the longer of both on each side. Its confidence is what so few windows
//! can have: at most 1 − 2 / C(2n, n), 97.1 % for 4 and 4.

use statrs::distribution::{ContinuousCDF, StudentsT};

use crate::{
    effect::{Interval, level},
    relabelling::{Coverage, Effort, Relabellings},
};

/// The tests of every shift between two scenarios.
#[derive(Debug, Clone, PartialEq)]
pub struct MeanShift {
    /// mean(b) − mean(a), in the unit of the levels.
    pub difference: f64,
    /// s²_a/n + s²_b/m.
    variance: f64,
    /// Satterthwaite's degrees of freedom.
    freedom: f64,
    labellings: Vec<Labelling>,
    /// How the labellings were gone through.
    pub coverage: Coverage,
    /// The size of the largest level around its mean: what is far below it is 0 but for rounding.
    scale: f64,
    /// Labellings that are as extreme as the observed one whatever the shift: itself, and its mirror image.
    always: usize,
    is_even: bool,
}

/// One labelling with the second's windows moved back by the observed difference and e more. Its difference of means is
/// `difference − share · e`, and the variance of that `q[0] − 2 q[1] e + q[2] e²`.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Labelling {
    difference: f64,
    share: f64,
    q: [f64; 3],
}

/// Counts of labellings that differ by rounding.
const EQUAL: f64 = 1e-9;

impl MeanShift {
    /// That of the window levels of two scenarios; none where one has fewer than two windows, which say nothing of its spread.
    #[must_use]
    pub fn of(a: &[f64], b: &[f64], effort: Effort) -> Option<Self> {
        if a.len() < 2 || b.len() < 2 {
            return None;
        }
        let (n, m) = (a.len() as f64, b.len() as f64);
        let means = [level(a)?, level(b)?];
        let centred = |levels: &[f64], mean: f64| levels.iter().map(|it| it - mean).collect::<Vec<f64>>();
        let levels = [centred(a, means[0]), centred(b, means[1])].concat();
        let scale = levels
            .iter()
            .chain(a)
            .chain(b)
            .fold(0.0_f64, |most, it| most.max(it.abs()));
        let of_side =
            |levels: &[f64]| levels.iter().map(|it| it * it).sum::<f64>() / (levels.len() - 1) as f64;
        let of_means = [of_side(&levels[..a.len()]) / n, of_side(&levels[a.len()..]) / m];
        let variance = of_means[0] + of_means[1];
        let mut labellings = Vec::new();
        let all = Relabellings::of(&[a.len(), b.len()], effort, |labels| {
            labellings.push(Labelling::of(labels, &levels, [a.len(), b.len()]));
            0.0
        });
        let freedom = variance.powi(2) / (of_means[0].powi(2) / (n - 1.0) + of_means[1].powi(2) / (m - 1.0));
        Some(Self {
            difference: means[1] - means[0],
            // Equal levels differ from their mean by rounding.
            variance: if variance > (scale * 1e-12).powi(2) {
                variance
            } else {
                0.0
            },
            freedom: if freedom.is_finite() { freedom } else { n + m - 2.0 },
            always: labellings.iter().filter(|it| it.q[2] <= EQUAL).count(),
            labellings,
            coverage: all.coverage,
            scale,
            is_even: a.len() == b.len(),
        })
    }

    /// The p-value of a shift: the larger one of both tests.
    #[must_use]
    pub fn p(&self, shift: f64) -> f64 {
        self.p_studentised(shift).max(self.p_welch(shift))
    }

    /// That of the studentised permutation test.
    #[must_use]
    pub fn p_studentised(&self, shift: f64) -> f64 {
        let reached = self.as_extreme(shift - self.difference, usize::MAX);
        reached as f64 / self.labellings.len() as f64
    }

    /// That of Welch's test.
    #[must_use]
    pub fn p_welch(&self, shift: f64) -> f64 {
        let e = (shift - self.difference).abs();
        if e <= self.scale * 1e-12 {
            return 1.0;
        }
        if self.variance == 0.0 {
            return 0.0;
        }
        let t = e / self.variance.sqrt();
        StudentsT::new(0.0, 1.0, self.freedom).map_or(1.0, |student| (2.0 * student.cdf(-t)).min(1.0))
    }

    /// Labellings looked at, the observed one included.
    #[must_use]
    pub fn looked_at(&self) -> u64 {
        self.labellings.len() as u64
    }

    /// The smallest p that any shift can have.
    #[must_use]
    pub fn smallest_p(&self) -> f64 {
        self.always as f64 / self.labellings.len() as f64
    }

    /// The shifts that are not rejected, with at least that confidence; none where so few windows, or so few draws, cannot
    /// have it.
    #[must_use]
    pub fn interval(&self, confidence: f64) -> Option<Interval> {
        let all = self.labellings.len() as f64;
        let may_be = ((1.0 - confidence) * all * (1.0 + EQUAL)).floor() as usize;
        // With the same number on both sides each labelling has its mirror image, and the share of both is what there is.
        let beyond = match (self.coverage, self.is_even) {
            (Coverage::Exact, true) => may_be - may_be % 2,
            _ => may_be,
        };
        if beyond < self.always {
            return None;
        }
        let confidence = match self.coverage {
            Coverage::Exact => 1.0 - beyond as f64 / all,
            Coverage::MonteCarlo => confidence,
        };
        Some(Interval {
            low: self.difference - self.reach(-1.0, beyond, confidence)?,
            high: self.difference + self.reach(1.0, beyond, confidence)?,
            confidence,
        })
    }

    /// The interval of at least that confidence, or else of the best that so few windows can have.
    #[must_use]
    pub fn interval_or_best(&self, confidence: f64) -> Option<Interval> {
        let best = 1.0 - self.smallest_p();
        self.interval(confidence.min(best))
            .filter(|it| it.confidence > 0.0)
    }

    /// How far from the observed difference the interval goes on one side, where so many labellings may be as extreme.
    fn reach(&self, side: f64, beyond: usize, confidence: f64) -> Option<f64> {
        if self.variance == 0.0 {
            return Some(0.0);
        }
        let student = StudentsT::new(0.0, 1.0, self.freedom).ok()?;
        let welch = student.inverse_cdf(0.5 + confidence / 2.0) * self.variance.sqrt();
        let is_rejected = |e: f64| self.as_extreme(side * e, beyond + 1) <= beyond;
        if is_rejected(welch) {
            return Some(welch);
        }
        let (mut inside, mut outside) = (welch, 2.0 * welch);
        while !is_rejected(outside) {
            (inside, outside) = (outside, 2.0 * outside);
            if !outside.is_finite() {
                return None;
            }
        }
        for _ in 0..30 {
            let middle = f64::midpoint(inside, outside);
            if is_rejected(middle) {
                outside = middle;
            } else {
                inside = middle;
            }
        }
        Some(outside)
    }

    /// How many labellings have a t at least as large as the observed one when the second's windows are moved back by e more
    /// than the observed difference. Counting ends at `enough`.
    fn as_extreme(&self, e: f64, enough: usize) -> usize {
        // A tie that only rounding breaks is a tie.
        let rounding = (self.scale * 1e-12).powi(2);
        let is_extreme = |it: &&Labelling| {
            let of_means = (it.difference - it.share * e).powi(2);
            let variance = (it.q[0] - 2.0 * it.q[1] * e + it.q[2] * e * e).max(0.0);
            (of_means * self.variance) * (1.0 + EQUAL) + rounding * rounding >= e * e * variance
        };
        self.labellings.iter().filter(is_extreme).take(enough).count()
    }
}

impl Labelling {
    fn of(labels: &[usize], levels: &[f64], [first, second]: [usize; 2]) -> Self {
        // Of each side: Σ z, Σ z², how many are the second scenario's, and Σ z of those.
        let mut sums = [[0.0_f64; 4]; 2];
        for (at, (label, z)) in labels.iter().zip(levels).enumerate() {
            let sum = &mut sums[usize::from(*label == 1)];
            let is_moved = if at >= first { 1.0 } else { 0.0 };
            sum[0] += z;
            sum[1] += z * z;
            sum[2] += is_moved;
            sum[3] += is_moved * z;
        }
        let mut q = [0.0; 3];
        for ([z, zz, i, zi], size) in sums.iter().zip([first as f64, second as f64]) {
            let divisor = (size - 1.0) * size;
            q[0] += (zz - z * z / size) / divisor;
            q[1] += (zi - z * i / size) / divisor;
            q[2] += (i - i * i / size) / divisor;
        }
        let [of_first, of_second] = sums;
        let (n, m) = (first as f64, second as f64);
        Self {
            difference: of_second[0] / m - of_first[0] / n,
            share: of_second[2] / m - of_first[2] / n,
            q,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const EFFORT: Effort = Effort::of_a_report(1);
    const A: [f64; 4] = [0.236, 0.241, 0.239, 0.240];
    const B: [f64; 4] = [0.238, 0.2405, 0.2425, 0.244];

    fn close(left: f64, right: f64) {
        assert!((left - right).abs() < 1e-9, "{left} {right}");
    }

    #[test]
    fn welchs_part_is_welchs_test() {
        let shift = MeanShift::of(&A, &B, EFFORT).unwrap();
        close(shift.difference, 0.00225);
        close(shift.p_welch(0.0), welch_by_hand());
    }

    /// From the textbook's formulas.
    fn welch_by_hand() -> f64 {
        let squares = |values: &[f64]| {
            let mean = values.iter().sum::<f64>() / 4.0;
            values.iter().map(|it| (it - mean).powi(2)).sum::<f64>() / 3.0 / 4.0
        };
        let (a, b) = (squares(&A), squares(&B));
        let freedom = (a + b).powi(2) / ((a * a + b * b) / 3.0);
        let student = StudentsT::new(0.0, 1.0, freedom).unwrap();
        2.0 * student.cdf(-0.00225 / (a + b).sqrt())
    }

    /// By enumeration of all labellings, with t computed anew for each.
    #[test]
    fn the_permutation_part_is_the_share_of_labellings_with_as_large_a_t() {
        let shift = MeanShift::of(&A, &B, EFFORT).unwrap();
        let t = |x: &[f64], y: &[f64]| {
            let of = |values: &[f64]| {
                let mean = level(values).unwrap();
                let squares: f64 = values.iter().map(|it| (it - mean).powi(2)).sum();
                (mean, squares / (values.len() - 1) as f64 / values.len() as f64)
            };
            let ((x, of_x), (y, of_y)) = (of(x), of(y));
            (y - x).abs() / (of_x + of_y).sqrt()
        };
        for moved in [0.0, 0.001, -0.004, 0.006] {
            let b: Vec<f64> = B.iter().map(|it| it - moved).collect();
            let all = [&A[..], &b].concat();
            let observed = t(&A, &b);
            let reached = (0_u32..256)
                .filter(|chosen| chosen.count_ones() == 4)
                .filter(|chosen| {
                    let side = |wanted: bool| {
                        let own = all
                            .iter()
                            .enumerate()
                            .filter(|(at, _)| (chosen >> at & 1 == 1) == wanted);
                        own.map(|(_, value)| *value).collect::<Vec<f64>>()
                    };
                    t(&side(true), &side(false)) >= observed * (1.0 - 1e-9)
                });
            close(shift.p_studentised(moved), reached.count() as f64 / 70.0);
        }
    }

    #[test]
    fn the_interval_is_of_what_is_not_rejected() {
        let shift = MeanShift::of(&A, &B, EFFORT).unwrap();
        let interval = shift.interval(0.95).unwrap();
        close(interval.confidence, 1.0 - 2.0 / 70.0);
        let width = interval.high - interval.low;
        for (inside, outside) in [
            (interval.low + 0.001 * width, interval.low - 0.001 * width),
            (interval.high - 0.001 * width, interval.high + 0.001 * width),
        ] {
            assert!(shift.p(inside) > 2.0 / 70.0 - 1e-3, "{}", shift.p(inside));
            assert!(shift.p(outside) <= 2.0 / 70.0 + 1e-12, "{}", shift.p(outside));
        }
        assert!(interval.low < shift.difference && shift.difference < interval.high);
    }

    #[rstest::rstest]
    #[case(2, 1.0 - 2.0 / 6.0)]
    #[case(3, 0.9)]
    #[case(4, 1.0 - 2.0 / 70.0)]
    fn few_windows_have_the_best_confidence_that_they_can_have(#[case] n: usize, #[case] confidence: f64) {
        let (a, b) = (&A[..n], &B[..n]);
        let shift = MeanShift::of(a, b, EFFORT).unwrap();
        close(shift.interval_or_best(0.95).unwrap().confidence, confidence);
        close(shift.smallest_p(), 1.0 - confidence);
        assert_eq!(shift.interval(0.999), None);
    }

    #[test]
    fn a_shift_moves_its_interval_and_a_unit_scales_it() {
        let of = |factor: f64, moved: f64| {
            let scaled = |levels: &[f64], by: f64| Vec::from_iter(levels.iter().map(|it| factor * it + by));
            let shift = MeanShift::of(&scaled(&A, 0.0), &scaled(&B, moved), EFFORT).unwrap();
            shift.interval(0.95).unwrap()
        };
        let (one, other) = (of(1.0, 0.0), of(1000.0, 7.0));
        assert!((1000.0 * one.low + 7.0 - other.low).abs() < 1e-6);
        assert!((1000.0 * one.high + 7.0 - other.high).abs() < 1e-6);
    }

    #[test]
    fn levels_that_are_all_equal_have_an_interval_of_one_number() {
        let shift = MeanShift::of(&[0.1; 4], &[0.3; 4], EFFORT).unwrap();
        let interval = shift.interval(0.95).unwrap();
        close(interval.low, 0.2);
        close(interval.high, 0.2);
        close(shift.p(0.0), 2.0 / 70.0);
        close(MeanShift::of(&[0.1; 4], &[0.1; 4], EFFORT).unwrap().p(0.0), 1.0);
    }

    #[test]
    fn one_window_says_nothing_of_its_spread() {
        assert_eq!(MeanShift::of(&[1.0], &[1.0, 2.0], EFFORT), None);
        assert_eq!(MeanShift::of(&[], &[], EFFORT), None);
    }

    #[test]
    fn draws_have_an_interval_near_that_of_all_labellings() {
        let levels = |from: f64| Vec::from_iter((0..8).map(|it| from + f64::from(it * it % 7)));
        let (a, b) = (levels(0.0), levels(3.0));
        let all = MeanShift::of(&a, &b, EFFORT).unwrap();
        let drawn = Effort {
            enumerate: 1,
            ..EFFORT
        };
        let drawn = MeanShift::of(&a, &b, drawn).unwrap();
        assert_eq!(
            (all.coverage, drawn.coverage),
            (Coverage::Exact, Coverage::MonteCarlo)
        );
        let [all, drawn] = [all, drawn].map(|it| it.interval(0.95).unwrap());
        assert!(
            (all.low - drawn.low).abs() < 0.1 * (all.high - all.low),
            "{all:?} {drawn:?}"
        );
    }
}
