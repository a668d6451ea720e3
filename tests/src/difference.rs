//! How far two samples are apart, and how sure that is. The main type is [`Difference`].
//!
//! By the normal approximation, which wants large samples: means with their own variances (Welch), shares with their own
//! variances (Fleiss, Levin and Paik, Statistical Methods for Rates and Proportions, 3rd edition, section 3.2).

/// Two-sided 99.9 % of the normal distribution: the paper's p < 0.001.
const QUANTILE: f64 = 3.290_53;
/// One-sided 90 %.
const POWER_QUANTILE: f64 = 1.281_55;

/// An estimate of `other - reference` with its standard error, in the unit of the samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Difference {
    /// The difference of the samples.
    pub estimate: f64,
    standard_error: f64,
}

impl Difference {
    /// Of the means of independent values; each sample has at least two.
    #[must_use]
    pub fn of_means(reference: &[f64], other: &[f64]) -> Self {
        Self {
            estimate: mean(other) - mean(reference),
            standard_error: (variance_of_mean(reference) + variance_of_mean(other)).sqrt(),
        }
    }

    /// Of two shares, each a count and of how many.
    #[must_use]
    pub fn of_shares(reference: (usize, usize), other: (usize, usize)) -> Self {
        let share = |(part, whole): (usize, usize)| part as f64 / whole as f64;
        let variance = |of: (usize, usize)| share(of) * (1.0 - share(of)) / of.1 as f64;
        Self {
            estimate: share(other) - share(reference),
            standard_error: (variance(reference) + variance(other)).sqrt(),
        }
    }

    /// How far the 99.9 % interval reaches to either side of the estimate.
    #[must_use]
    pub fn reach(&self) -> f64 {
        QUANTILE * self.standard_error
    }

    /// A true difference of this size is found in nine of ten tries.
    #[must_use]
    pub fn visible(&self) -> f64 {
        (QUANTILE + POWER_QUANTILE) * self.standard_error
    }

    /// Whether the interval has zero in it: the samples cannot be told apart at p < 0.001.
    #[must_use]
    pub fn may_be_none(&self) -> bool {
        self.estimate.abs() <= self.reach()
    }

    /// Whether the whole interval is within the bound, so that the difference is, too.
    #[must_use]
    pub fn is_within(&self, bound: f64) -> bool {
        self.estimate.abs() + self.reach() <= bound
    }
}

/// The arithmetic mean.
#[must_use]
pub fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// The standard deviation of the population that the values are a sample of.
#[must_use]
pub fn deviation(values: &[f64]) -> f64 {
    let mean = mean(values);
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    (squares / (values.len() - 1) as f64).sqrt()
}

fn variance_of_mean(values: &[f64]) -> f64 {
    deviation(values).powi(2) / values.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_differ_with_the_error_of_both() {
        let found = Difference::of_means(&[1.0, 2.0, 3.0, 4.0], &[3.0, 5.0]);
        assert_eq!(found.estimate, 1.5);
        // 5/3 / 4 and 2 / 2.
        assert!((found.standard_error - (5.0_f64 / 12.0 + 1.0).sqrt()).abs() < 1e-12);
        assert!((found.reach() / found.standard_error - 3.290_53).abs() < 1e-12);
        assert!(found.visible() > found.reach());
    }

    /// 0.01 apart at 0.2 and 10 000 each: the error is `sqrt(0.2·0.8/10⁴ + 0.21·0.79/10⁴)` = 0.0057.
    #[rstest::rstest]
    #[case((2000, 10_000), (2100, 10_000), true)]
    #[case((2000, 10_000), (2200, 10_000), false)]
    #[case((2200, 10_000), (2000, 10_000), false)]
    #[case((0, 100), (0, 100), true)]
    #[case((0, 100), (100, 100), false)]
    fn shares_are_told_apart_once_they_differ_by_more_than_chance(
        #[case] reference: (usize, usize),
        #[case] other: (usize, usize),
        #[case] same: bool,
    ) {
        let found = Difference::of_shares(reference, other);
        assert_eq!(found.may_be_none(), same, "{found:?}");
    }

    #[test]
    fn a_difference_is_within_a_bound_only_when_its_interval_is() {
        let found = Difference {
            estimate: -0.1,
            standard_error: 0.01,
        };
        assert!(found.is_within(0.1330));
        assert!(!found.is_within(0.1328));
        assert!(
            !Difference {
                estimate: f64::NAN,
                ..found
            }
            .is_within(1.0)
        );
        assert!(
            !Difference {
                estimate: f64::NAN,
                ..found
            }
            .may_be_none()
        );
    }
}
