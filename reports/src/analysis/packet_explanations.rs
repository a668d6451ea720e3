//! Which of the packets' quantities go with a difference in tracking error. The main type is [`Explanation`].
//!
//! Within a window, one platform and one network, a period with longer delays may have a larger error: that slope is
//! estimated from the periods of all windows of both scenarios, each window around its own mean (least squares with
//! fixed effects), so that nothing that makes the windows or scenarios differ goes into it. Slope times the
//! scenarios' difference in the quantity is the part of the difference in error that goes with it (Kitagawa, *Components
//! of a Difference Between Two Rates*, 1955). Its interval is by bootstrap over windows. It is what goes with it, and not
//! what is caused by it: quantities go with each other, so their parts do not add up.

use captures::{
    packets::Topic,
    traffic::{Quantity, Traffic, WindowTraffic},
};
use oorandom::Rand64;
use record::report_settings::ReportSettings;
use statistics::effect::{Estimate, Interval, level, percentiles, tail};

use crate::analysis::{contrast::Contrast, packet_counts::sampled, sample::Sample};

/// Bootstrap resamples.
const RESAMPLES: u32 = 1_999;

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
    /// Mean of the second scenario's window means less that of the first's, in the quantity's unit.
    pub difference: f64,
    /// Correlation with the error within windows.
    pub correlation: f64,
    /// Metres of error for one unit, within windows.
    pub slope: f64,
    /// The part of the shift that goes with the difference.
    pub part: Estimate,
}

impl Factor {
    /// Whether there is a part at all, as far as the windows tell.
    #[must_use]
    pub fn is_told(&self) -> bool {
        let beyond = |interval: Interval| interval.low > 0.0 || interval.high < 0.0;
        self.part.interval.is_some_and(beyond)
    }
}

/// Those of all pairs of the family whose scenarios have captures.
#[must_use]
pub fn explanations(
    pairs: &[Contrast],
    samples: &[Sample],
    traffic: &Traffic,
    settings: &ReportSettings,
) -> Vec<Explanation> {
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
                let sums = |windows: &[(&WindowTraffic, &Sample)]| -> Vec<Sums> {
                    let sums = windows
                        .iter()
                        .map(|(window, sample)| Sums::of(window, sample, topic, quantity));
                    sums.flatten().collect()
                };
                factors.extend(factor(
                    topic,
                    quantity,
                    &sums(&first),
                    &sums(&second),
                    settings.seed,
                ));
            }
        }
        factors.sort_by(|a, b| b.part.value.abs().total_cmp(&a.part.value.abs()));
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

/// What one window says of a quantity and the error: sums of squares and products around its means.
#[derive(Debug, Clone, Copy)]
struct Sums {
    mean: f64,
    quantity_squares: f64,
    error_squares: f64,
    products: f64,
}

impl Sums {
    /// Over the periods that have both; none if none has.
    fn of(window: &WindowTraffic, sample: &Sample, topic: Topic, quantity: Quantity) -> Option<Self> {
        let periods = window.direction(topic).periods.iter();
        let counted = periods.skip(sample.first_value.saturating_sub(1) as usize);
        let both: Vec<(f64, f64)> = counted
            .zip(&sample.values)
            .filter_map(|(period, error_m)| Some((quantity.of(period)?, *error_m)))
            .collect();
        let mean_x = mean(both.iter().map(|(x, _)| *x))?;
        let mean_y = mean(both.iter().map(|(_, y)| *y))?;
        let mut sums = Self {
            mean: mean_x,
            quantity_squares: 0.0,
            error_squares: 0.0,
            products: 0.0,
        };
        for (x, y) in both {
            sums.quantity_squares += (x - mean_x) * (x - mean_x);
            sums.error_squares += (y - mean_y) * (y - mean_y);
            sums.products += (x - mean_x) * (y - mean_y);
        }
        Some(sums)
    }
}

/// None if the quantity or the error is the same in all periods of each window.
fn factor(topic: Topic, quantity: Quantity, a: &[Sums], b: &[Sums], seed: u64) -> Option<Factor> {
    let found = Fit::of(a.iter().copied(), b.iter().copied())?;
    let mut random = Rand64::new(u128::from(seed));
    let interval = tail(a.len(), b.len()).and_then(|tail| {
        let mut parts = Vec::new();
        for _ in 0..RESAMPLES {
            let mut draw = |from: &[Sums]| -> Vec<Sums> {
                let drawn = from
                    .iter()
                    .map(|_| random.rand_range(0..from.len() as u64) as usize);
                drawn.filter_map(|at| from.get(at).copied()).collect()
            };
            let (a, b) = (draw(a), draw(b));
            parts.extend(Fit::of(a.into_iter(), b.into_iter()).map(|fit| fit.part()));
        }
        percentiles(parts, tail)
    });
    Some(Factor {
        topic,
        quantity,
        difference: found.difference,
        correlation: found.correlation,
        slope: found.slope,
        part: Estimate {
            value: found.part(),
            interval,
        },
    })
}

struct Fit {
    slope: f64,
    correlation: f64,
    difference: f64,
}

impl Fit {
    fn of(a: impl Iterator<Item = Sums> + Clone, b: impl Iterator<Item = Sums> + Clone) -> Option<Self> {
        let sum = |of: fn(&Sums) -> f64| a.clone().chain(b.clone()).map(|sums| of(&sums)).sum::<f64>();
        let (xx, yy, xy) = (
            sum(|sums| sums.quantity_squares),
            sum(|sums| sums.error_squares),
            sum(|sums| sums.products),
        );
        let difference = mean(b.map(|sums| sums.mean))? - mean(a.map(|sums| sums.mean))?;
        (xx > 0.0 && yy > 0.0).then(|| Self {
            slope: xy / xx,
            correlation: xy / (xx * yy).sqrt(),
            difference,
        })
    }

    fn part(&self) -> f64 {
        self.slope * self.difference
    }
}

/// None of none.
fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0_u32), |(sum, count), value| (sum + value, count + 1));
    (count > 0).then(|| sum / f64::from(count))
}

#[cfg(test)]
mod tests {
    use captures::traffic::{DirectionTraffic, PeriodTraffic};

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

    fn sums(windows: &[(WindowTraffic, Sample)], quantity: Quantity) -> Vec<Sums> {
        let of =
            |(traffic, sample): &(WindowTraffic, Sample)| Sums::of(traffic, sample, Topic::State, quantity);
        windows.iter().filter_map(of).collect()
    }

    fn factor_of(
        a: &[(WindowTraffic, Sample)],
        b: &[(WindowTraffic, Sample)],
        quantity: Quantity,
    ) -> Option<Factor> {
        factor(Topic::State, quantity, &sums(a, quantity), &sums(b, quantity), 0)
    }

    #[test]
    fn the_example_of_the_docs() {
        let first = [(0.020, 0, 0.010), (0.022, 0, 0.011)];
        let second = [(0.030, 0, 0.016), (0.032, 0, 0.017)];
        let a = [window(1, &first), window(2, &first)];
        let b = [window(1, &second), window(2, &second)];
        let found = factor_of(&a, &b, Quantity::OneWayDelay).unwrap();
        assert!((found.slope - 0.5).abs() < 1e-9, "{found:?}");
        assert!((found.difference - 0.010).abs() < 1e-9, "{found:?}");
        assert!((found.part.value - 0.005).abs() < 1e-9, "{found:?}");
        assert!(found.is_told());
    }

    #[test]
    fn what_is_the_same_in_all_periods_explains_nothing() {
        let a = [window(1, &[(0.020, 1, 0.010), (0.022, 1, 0.011)])];
        assert_eq!(factor_of(&a, &a, Quantity::Lost), None);
        assert_eq!(factor_of(&a, &[], Quantity::OneWayDelay), None);
    }

    #[test]
    fn of_two_quantities_the_one_that_the_error_follows_is_told_and_the_other_is_not() {
        let mut random = Rand64::new(7);
        let mut windows = |base_s: f64| -> Vec<(WindowTraffic, Sample)> {
            let mut of = |number| {
                let mut period = || {
                    let delay_s = base_s + random.rand_float() * 0.002;
                    let lost = random.rand_range(0..5) as u32;
                    (delay_s, lost, 0.5 * delay_s + random.rand_float() * 0.0001)
                };
                let periods: Vec<_> = (0..60).map(|_| period()).collect();
                window(number, &periods)
            };
            (1..=6).map(&mut of).collect()
        };
        let (a, b) = (windows(0.020), windows(0.030));
        let delay = factor_of(&a, &b, Quantity::OneWayDelay).unwrap();
        let interval = delay.part.interval.unwrap();
        assert!(interval.low < 0.005 && 0.005 < interval.high, "{delay:?}");
        assert!(delay.is_told() && delay.correlation > 0.9, "{delay:?}");
        let lost = factor_of(&a, &b, Quantity::Lost).unwrap();
        assert!(!lost.is_told() && lost.correlation.abs() < 0.2, "{lost:?}");
    }
}
