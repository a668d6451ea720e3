//! Which of the packets' quantities go with a difference in tracking error. The main type is [`Explanation`].
//!
//! Within a window, one platform and one network, a period with longer delays may have a larger error. That slope, times the
//! scenarios' difference in the quantity, is the part of the difference in error that goes with it: a [`ExplainedPart`].

use captures::{
    packets::Topic,
    traffic::{Quantity, Traffic, WindowTraffic},
};
use statistics::{
    effect::{Interval, level},
    explained_part::{ExplainedPart, WindowSums},
};

use crate::analysis::{contrast::Contrast, packet_counts::sampled, sample::Sample};

/// What goes with the difference in error of two scenarios.
#[derive(Debug, Clone, PartialEq)]
pub struct Explanation {
    /// Letter of the first scenario.
    pub a: String,
    /// Letter of the second.
    pub b: String,
    /// Mean of the second's window means less that of the first's.
    pub shift: f64,
    /// Every quantity that varies within windows, what goes with the largest part of the shift first.
    pub factors: Vec<Factor>,
}

/// One quantity.
#[derive(Debug, Clone, PartialEq)]
pub struct Factor {
    /// Of which direction.
    pub topic: Topic,
    /// The quantity of the packets.
    pub quantity: Quantity,
    /// Of the shift, what goes with it: the difference in the quantity's unit, the slope in metres for one of it, the part in metres.
    pub explained: ExplainedPart,
}

impl Factor {
    /// Whether there is a part at all, as far as the windows tell.
    #[must_use]
    pub fn is_told(&self) -> bool {
        let beyond = |interval: Interval| interval.low > 0.0 || interval.high < 0.0;
        self.explained.part.interval.is_some_and(beyond)
    }
}

/// Those of all pairs of the family whose scenarios have captures.
#[must_use]
pub fn explanations(pairs: &[Contrast], samples: &[Sample], traffic: &Traffic) -> Vec<Explanation> {
    let sampled = sampled(traffic, samples);
    let windows = |id: &str| -> Vec<(&WindowTraffic, &Sample)> {
        let of_it = |(_, sample): &(&WindowTraffic, &Sample)| sample.scenario == id;
        sampled.iter().copied().filter(of_it).collect()
    };
    let of = |pair: &Contrast| {
        let (first, second) = (windows(&pair.a), windows(&pair.b));
        let mut factors: Vec<Factor> = Vec::new();
        for topic in Topic::ALL {
            for quantity in Quantity::ALL {
                let sums = |windows: &[(&WindowTraffic, &Sample)]| -> Vec<WindowSums> {
                    let sums = windows
                        .iter()
                        .map(|(window, sample)| sums(window, sample, topic, quantity));
                    sums.flatten().collect()
                };
                factors.extend(
                    ExplainedPart::of(&sums(&first), &sums(&second)).map(|explained| Factor {
                        topic,
                        quantity,
                        explained,
                    }),
                );
            }
        }
        factors.sort_by(|a, b| {
            b.explained
                .part
                .value
                .abs()
                .total_cmp(&a.explained.part.value.abs())
        });
        let mean_error_m = |windows: &[(&WindowTraffic, &Sample)]| {
            mean(windows.iter().filter_map(|(_, sample)| level(&sample.values)))
        };
        Some(Explanation {
            a: pair.a.clone(),
            b: pair.b.clone(),
            shift: mean_error_m(&second)? - mean_error_m(&first)?,
            factors,
        })
    };
    pairs.iter().filter_map(of).collect()
}

/// What one window says of a quantity and the error, over the periods that have both.
fn sums(window: &WindowTraffic, sample: &Sample, topic: Topic, quantity: Quantity) -> Option<WindowSums> {
    let periods = window.direction(topic).periods.iter();
    let counted = periods.skip(sample.first_value.saturating_sub(1) as usize);
    let both: Vec<(f64, f64)> = counted
        .zip(&sample.values)
        .filter_map(|(period, error_m)| Some((quantity.of(period)?, *error_m)))
        .collect();
    WindowSums::of(&both)
}

/// None of none.
fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0_u32), |(sum, count), value| (sum + value, count + 1));
    (count > 0).then(|| sum / f64::from(count))
}

#[cfg(test)]
mod tests {
    use captures::traffic::{DirectionTraffic, PeriodTraffic};
    use statistics::noise_model::Noise;

    use super::*;

    /// One window whose states have these delays and losses, and the errors of its periods.
    fn window(number: u32, periods: &[(f64, u32, f64)]) -> (WindowTraffic, Sample) {
        let direction = |topic, periods: &[(f64, u32, f64)]| DirectionTraffic {
            topic,
            periods: periods
                .iter()
                .map(|(delay_s, lost, _)| PeriodTraffic {
                    sent: 100,
                    lost: *lost,
                    one_way_s: Some(*delay_s),
                    ..PeriodTraffic::default()
                })
                .collect(),
            strays: 0,
            one_way: None,
            rtt: None,
            jitter: None,
            gap: None,
        };
        let traffic = WindowTraffic {
            window: number,
            dropped: 0,
            directions: [direction(Topic::State, periods), direction(Topic::Command, &[])],
        };
        let sample = Sample {
            scenario: "a".to_owned(),
            window: number,
            first_value: 1,
            values: periods.iter().map(|(_, _, error_m)| *error_m).collect(),
        };
        (traffic, sample)
    }

    fn explained_by(
        a: &[(WindowTraffic, Sample)],
        b: &[(WindowTraffic, Sample)],
        quantity: Quantity,
    ) -> Option<ExplainedPart> {
        let [a, b] = [a, b].map(|windows| -> Vec<WindowSums> {
            let of =
                |(traffic, sample): &(WindowTraffic, Sample)| sums(traffic, sample, Topic::State, quantity);
            windows.iter().filter_map(of).collect()
        });
        ExplainedPart::of(&a, &b)
    }

    #[test]
    fn the_example_of_the_docs() {
        let first = [(0.020, 0, 0.010), (0.022, 0, 0.011)];
        let second = [(0.030, 0, 0.016), (0.032, 0, 0.017)];
        let a = [window(1, &first), window(2, &first)];
        let b = [window(1, &second), window(2, &second)];
        let found = explained_by(&a, &b, Quantity::OneWayDelay).unwrap();
        assert!((found.slope - 0.5).abs() < 1e-9, "{found:?}");
        assert!((found.difference - 0.010).abs() < 1e-9, "{found:?}");
        assert!((found.part.value - 0.005).abs() < 1e-9, "{found:?}");
    }

    #[test]
    fn what_is_the_same_in_all_periods_explains_nothing() {
        let a = [window(1, &[(0.020, 1, 0.010), (0.022, 1, 0.011)])];
        assert_eq!(explained_by(&a, &a, Quantity::Lost), None);
        assert_eq!(explained_by(&a, &[], Quantity::OneWayDelay), None);
    }

    #[test]
    fn of_two_quantities_the_one_that_the_error_follows_is_told_and_the_other_is_not() {
        let mut noise = Noise::new(7);
        let mut windows = |base_s: f64| -> Vec<(WindowTraffic, Sample)> {
            let mut of = |number| {
                let mut period = || {
                    let delay_s = base_s + noise.normal() * 0.0006;
                    let lost = u32::from(noise.normal() > 0.0);
                    (delay_s, lost, 0.5 * delay_s + noise.normal() * 0.00003)
                };
                let periods: Vec<_> = (0..60).map(|_| period()).collect();
                window(number, &periods)
            };
            (1..=6).map(&mut of).collect()
        };
        let (a, b) = (windows(0.020), windows(0.030));
        let delay = explained_by(&a, &b, Quantity::OneWayDelay).unwrap();
        let interval = delay.part.interval.unwrap();
        assert!(interval.low < 0.005 && 0.005 < interval.high, "{delay:?}");
        assert!(interval.low > 0.0 && delay.correlation > 0.9, "{delay:?}");
        let lost = explained_by(&a, &b, Quantity::Lost).unwrap();
        let interval = lost.part.interval.unwrap();
        assert!(interval.low < 0.0 && 0.0 < interval.high, "{lost:?}");
        assert!(lost.correlation.abs() < 0.2, "{lost:?}");
    }
}
