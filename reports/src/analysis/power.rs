//! What a design can find: the shift of the window levels that a comparison of n windows with m finds with a given
//! probability. The main function is [`detectable_shift`].
//!
//! ```text
//! δ = (t(1 − α/2) + t(power)) · s · √(1/n + 1/m)         t with n + m − 2 degrees of freedom
//! ```
//!
//! with s the standard deviation of window levels within a scenario: the usual approximation of the power of Student's
//! test, which the permutation test of means approaches (Lehmann and Romano, *Testing Statistical Hypotheses*, 15.2). It
//! holds only where the permutation test can reach α at all.

use statrs::distribution::{ContinuousCDF, StudentsT};

use crate::{
    analysis::sample::Sample,
    statistics::{effect, permutation},
};

/// The power that designs are asked for.
pub const POWER: f64 = 0.8;

/// The shift that is found with probability [`POWER`] at the level α, in the unit of `spread`; none where windows are too
/// few to reach α.
#[must_use]
pub fn detectable_shift(n: usize, m: usize, spread: f64, alpha: f64) -> Option<f64> {
    if permutation::smallest_p(n, m) >= alpha {
        return None;
    }
    let freedom = (n + m).checked_sub(2)? as f64;
    let student = StudentsT::new(0.0, 1.0, freedom).ok()?;
    let quantiles = student.inverse_cdf(1.0 - alpha / 2.0) + student.inverse_cdf(POWER);
    Some(quantiles * spread * (1.0 / n as f64 + 1.0 / m as f64).sqrt())
}

/// The fewest windows a scenario whose comparison can reach α; none if `alpha` is not above 0.
#[must_use]
pub fn fewest_windows(alpha: f64) -> Option<usize> {
    (1..600).find(|n| permutation::smallest_p(*n, *n) < alpha)
}

/// The standard deviation of window levels within scenarios, pooled, in metres; none where no scenario has two windows.
#[must_use]
pub fn spread_of_levels(samples: &[Sample]) -> Option<f64> {
    let scenarios = samples.chunk_by(|a, b| a.scenario == b.scenario);
    pooled_spread(scenarios.map(|of_one| -> Vec<f64> {
        let levels = of_one.iter().map(|sample| effect::level(&sample.errors_m));
        levels.flatten().collect()
    }))
}

/// The standard deviation of values around the means of their groups, pooled, in their unit; none where no group has two.
#[must_use]
pub fn pooled_spread(groups: impl IntoIterator<Item = impl AsRef<[f64]>>) -> Option<f64> {
    let mut squares = 0.0;
    let mut freedom = 0.0;
    for group in groups {
        let group = group.as_ref();
        let mean = effect::level(group).unwrap_or_default();
        squares += group.iter().map(|value| (value - mean).powi(2)).sum::<f64>();
        freedom += group.len().saturating_sub(1) as f64;
    }
    (freedom > 0.0).then(|| (squares / freedom).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    // Cohen, Statistical Power Analysis (1988), table 2.4.1: 17 a group find one standard deviation with 80 % at 0.05.
    #[test]
    fn seventeen_a_side_find_one_standard_deviation() {
        let shift = detectable_shift(17, 17, 1.0, 0.05).unwrap();
        assert!((shift - 1.0).abs() < 0.02, "{shift}");
    }

    #[test]
    fn four_a_side_find_nothing_at_a_thousandth() {
        assert_eq!(detectable_shift(4, 4, 1e-9, 0.001), None);
        assert_eq!(fewest_windows(0.001), Some(7));
        assert_eq!(fewest_windows(0.0), None);
    }

    #[test]
    fn the_spread_is_within_scenarios_and_not_between_them() {
        let sample = |scenario: &str, level: f64| Sample {
            scenario: scenario.to_owned(),
            window: 1,
            first_period: 1,
            errors_m: vec![level],
        };
        let samples = [
            sample("a", 1.0),
            sample("a", 3.0),
            sample("b", 11.0),
            sample("b", 13.0),
        ];
        assert!((spread_of_levels(&samples).unwrap() - 2.0_f64.sqrt()).abs() < 1e-12);
        assert_eq!(spread_of_levels(&samples[..1]), None);
    }
}
