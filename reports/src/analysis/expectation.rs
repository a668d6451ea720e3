//! Whether scenarios are what the matrix file expects of them (`report.expect`). The main type is [`ExpectedMean`].

use record::{report_settings::ReportSettings, run_directory::PlannedScenario};
use statistics::effect::{self, Estimate};

use crate::{
    analysis::{
        quantity::Quantity,
        sample::{Sample, levels},
    },
    input::run::Run,
};

/// The mean of a metric over the windows of a scenario that count, beside what is expected of it; in the unit of files.
#[derive(Debug, Clone, PartialEq)]
pub struct ExpectedMean {
    /// The scenario's letter.
    pub scenario: String,
    /// What was expected, without the distances that are allowed.
    pub value: f64,
    /// The smallest mean that is as expected.
    pub low: Option<f64>,
    /// The largest.
    pub high: Option<f64>,
    /// How many windows count.
    pub windows: usize,
    /// Their mean, with an interval of 95 % over windows.
    pub mean: Estimate,
}

/// How a mean is not as expected.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Miss {
    /// The limit that it is beyond.
    pub limit: f64,
    /// Whether it is less than the limit, or else more.
    pub is_below: bool,
    /// Whether the interval lies beyond the limit, too, so that it is none of chance between windows.
    pub is_sure: bool,
}

impl ExpectedMean {
    /// Of each scenario that has windows that count, and of which something is expected.
    #[must_use]
    pub fn all(run: &Run, quantity: &Quantity, samples: &[Sample], settings: &ReportSettings) -> Vec<Self> {
        let of = |planned: &PlannedScenario| {
            let expectation = settings.expected(&quantity.name, planned)?;
            let levels = levels(samples, &planned.id);
            let mean = effect::level(&levels)?;
            let [low, high] = expectation.limits();
            Some(Self {
                scenario: planned.id.clone(),
                value: expectation.value.in_unit(),
                low,
                high,
                windows: levels.len(),
                mean: Estimate {
                    value: mean,
                    interval: effect::mean_interval(&levels),
                },
            })
        };
        run.scenarios
            .iter()
            .filter_map(|scenario| of(&scenario.planned))
            .collect()
    }

    /// How it is not as expected; none if it is.
    #[must_use]
    pub fn miss(&self) -> Option<Miss> {
        let interval = self.mean.interval;
        let below = self.low.filter(|low| self.mean.value < *low).map(|limit| Miss {
            limit,
            is_below: true,
            is_sure: interval.is_some_and(|it| it.high < limit),
        });
        let above = self
            .high
            .filter(|high| self.mean.value > *high)
            .map(|limit| Miss {
                limit,
                is_below: false,
                is_sure: interval.is_some_and(|it| it.low > limit),
            });
        below.or(above)
    }
}

#[cfg(test)]
mod tests {
    use rstest::rstest;
    use statistics::effect::Interval;

    use super::*;

    /// From 114 to 126, measured within ± 2.
    #[rstest]
    #[case::inside(120.0, None)]
    #[case::at_the_limit(126.0, None)]
    #[case::just_beyond(127.0, Some(Miss { limit: 126.0, is_below: false, is_sure: false }))]
    #[case::far_beyond(130.0, Some(Miss { limit: 126.0, is_below: false, is_sure: true }))]
    #[case::just_less(113.0, Some(Miss { limit: 114.0, is_below: true, is_sure: false }))]
    #[case::far_less(100.0, Some(Miss { limit: 114.0, is_below: true, is_sure: true }))]
    fn a_mean_beyond_a_limit_is_a_miss_and_sure_where_its_interval_is_beyond_too(
        #[case] mean: f64,
        #[case] miss: Option<Miss>,
    ) {
        let measured = ExpectedMean {
            scenario: "a".to_owned(),
            value: 120.0,
            low: Some(114.0),
            high: Some(126.0),
            windows: 4,
            mean: Estimate {
                value: mean,
                interval: Some(Interval {
                    low: mean - 2.0,
                    high: mean + 2.0,
                    confidence: 0.95,
                }),
            },
        };
        assert_eq!(measured.miss(), miss);
        let open = ExpectedMean {
            low: None,
            high: None,
            ..measured
        };
        assert_eq!(open.miss(), None);
    }
}
