//! Whether a series goes up or down without a jump. The main type is [`Trend`].
//!
//! The test of Mann (*Nonparametric tests against trend*, Econometrica 13, 1945) and Kendall: of all pairs of nights, how
//! many more rise than fall, against what that is when nights come in any order; ties as Kendall corrects the variance
//! (*Rank Correlation Methods*, 1975, chapter 4). The slope is the median of all pairs' (Sen, *Estimates of the regression
//! coefficient based on Kendall's tau*, JASA 63, 1968).

use statrs::distribution::{ContinuousCDF, Normal};

/// The fewest values: below, the normal distribution is no approximation (Kendall: 10, and by simulation 8).
pub const FEWEST: usize = 10;

/// A slope and what speaks for it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Trend {
    /// From one value to the next, in their unit.
    pub slope: f64,
    /// The two-sided p of there being none.
    pub p: f64,
}

impl Trend {
    /// That of a series; none of fewer than [`FEWEST`] values, or of equal ones.
    #[must_use]
    pub fn of(series: &[f64]) -> Option<Self> {
        if series.len() < FEWEST {
            return None;
        }
        let mut surplus = 0.0_f64;
        let mut slopes = Vec::with_capacity(series.len() * (series.len() - 1) / 2);
        for (at, first) in series.iter().enumerate() {
            for (later, second) in series.iter().enumerate().skip(at + 1) {
                let rise = second - first;
                if rise != 0.0 {
                    surplus += rise.signum();
                }
                slopes.push(rise / (later - at) as f64);
            }
        }
        let spread = variance(series).sqrt();
        if spread <= 0.0 {
            return None;
        }
        // Half of a step, since the surplus goes by twos.
        let z = (surplus.abs() - 1.0).max(0.0) / spread;
        let middle = slopes.len() / 2;
        let (_, slope, _) = slopes.select_nth_unstable_by(middle, f64::total_cmp);
        Some(Self {
            slope: *slope,
            p: 2.0 * Normal::standard().sf(z),
        })
    }
}

/// The variance of the surplus without a trend: (n(n − 1)(2n + 5) − Σ t(t − 1)(2t + 5)) / 18, over groups of t equal values.
fn variance(series: &[f64]) -> f64 {
    let of = |count: usize| {
        let n = count as f64;
        n * (n - 1.0) * (2.0 * n + 5.0)
    };
    let mut sorted = series.to_vec();
    sorted.sort_by(f64::total_cmp);
    let ties: f64 = sorted.chunk_by(|a, b| a == b).map(|equal| of(equal.len())).sum();
    (of(series.len()) - ties) / 18.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise_model::Noise;

    // By hand: ten values in order have the largest surplus, 45, of variance 10·9·25/18 = 125: z = 44/√125.
    #[test]
    fn ten_values_in_order_have_the_p_of_kendalls_table() {
        let series: Vec<f64> = (0..10).map(|night| f64::from(night) * 0.5).collect();
        let trend = Trend::of(&series).unwrap();
        assert_eq!(trend.slope, 0.5);
        let z = 44.0 / 125.0_f64.sqrt();
        assert!((trend.p - 2.0 * Normal::standard().sf(z)).abs() < 1e-15);
        assert!((trend.p - 8.3e-5).abs() < 1e-6, "{}", trend.p);
    }

    #[test]
    fn ties_narrow_the_variance() {
        // n = 10 with a group of 4: (10·9·25 − 4·3·13)/18.
        let series = [1.0, 1.0, 1.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0];
        assert!((variance(&series) - (2250.0 - 156.0) / 18.0).abs() < 1e-12);
    }

    #[test]
    fn one_night_far_off_hardly_moves_the_slope() {
        let mut series: Vec<f64> = (0..20).map(f64::from).collect();
        series[10] = 1e6;
        let trend = Trend::of(&series).unwrap();
        assert!((trend.slope - 1.0).abs() < 0.1, "{}", trend.slope);
    }

    #[test]
    fn nothing_is_told_of_few_or_equal_values() {
        assert_eq!(Trend::of(&[1.0, 2.0, 3.0]), None);
        assert_eq!(Trend::of(&[1.0; 30]), None);
    }

    #[test]
    fn noise_alone_has_a_trend_as_seldom_as_the_level_says() {
        let mut noise = Noise::new(3);
        let found = (0..1000)
            .filter(|_| {
                let series: Vec<f64> = (0..12).map(|_| noise.normal()).collect();
                Trend::of(&series).unwrap().p < 0.05
            })
            .count();
        // Of a binomial of 1000 at 0.05, 99.9 % lies within 29 and 74.
        assert!((29..=74).contains(&found), "{found}");
    }
}
