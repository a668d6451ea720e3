//! How times spread within a window, counted as they come in memory of fixed size. The main type is [`Spread`].

use std::iter;

use hdrhistogram::Histogram;

/// Values are told apart to one in a thousand: three digits.
const DIGITS: u8 = 3;
/// What takes longer counts as this long: a packet is given up for lost long before.
pub(super) const LONGEST_NS: i64 = 60_000_000_000;
/// Steps of the curve that is kept for drawings.
const CURVE: usize = 100;

/// A distribution of times. Quantiles are right to one in a thousand, mean and ends exactly.
#[derive(Debug, Clone, PartialEq)]
pub struct Spread {
    /// How many.
    pub count: u64,
    /// Their mean, in seconds.
    pub mean_s: f64,
    /// The shortest, in seconds.
    pub min_s: f64,
    /// The longest, in seconds.
    pub max_s: f64,
    /// The quantiles from 0 to 1 in steps of a hundredth, in seconds.
    pub quantiles_s: Vec<f64>,
}

/// Times that are being counted.
#[derive(Debug, Clone)]
pub(super) struct SpreadTally {
    /// From the first time on: it has 100 kB.
    histogram: Option<Histogram<u32>>,
    count: u64,
    sum_ns: i64,
    min_ns: i64,
    max_ns: i64,
}

impl Default for SpreadTally {
    fn default() -> Self {
        Self {
            histogram: None,
            count: 0,
            sum_ns: 0,
            min_ns: i64::MAX,
            max_ns: i64::MIN,
        }
    }
}

impl SpreadTally {
    pub fn add(&mut self, ns: i64) {
        self.count += 1;
        self.sum_ns = self.sum_ns.saturating_add(ns);
        self.min_ns = self.min_ns.min(ns);
        self.max_ns = self.max_ns.max(ns);
        // A time below nothing, of a clock that was put back, counts as none.
        if self.histogram.is_none() {
            // Never an error for a number of digits up to 5.
            self.histogram = Histogram::new_with_max(LONGEST_NS.unsigned_abs(), DIGITS).ok();
        }
        if let Some(histogram) = &mut self.histogram {
            histogram.saturating_record(u64::try_from(ns).unwrap_or(0));
        }
    }

    pub fn finish(self) -> Option<Spread> {
        let histogram = self.histogram.filter(|_| self.count > 0)?;
        let [min_s, max_s] = [self.min_ns, self.max_ns].map(|ns| ns as f64 / 1e9);
        let between = inner_quantiles(&histogram).into_iter();
        let between = between.map(|ns| (ns as f64 / 1e9).clamp(min_s, max_s));
        Some(Spread {
            count: self.count,
            mean_s: self.sum_ns as f64 / self.count as f64 / 1e9,
            min_s,
            max_s,
            quantiles_s: iter::once(min_s).chain(between).chain([max_s]).collect(),
        })
    }
}

/// The quantiles between 0 and 1, in nanoseconds: `value_at_quantile` of each. That walks along all counters for each of them;
/// this does once.
fn inner_quantiles(histogram: &Histogram<u32>) -> Vec<u64> {
    let total = histogram.len() as f64;
    let rank = |step: usize| (step as f64 / CURVE as f64 * total).ceil() as u64;
    let mut found = Vec::with_capacity(CURVE);
    let mut below = 0;
    for bucket in histogram.iter_recorded() {
        below += bucket.count_since_last_iteration();
        while found.len() + 1 < CURVE && below >= rank(found.len() + 1) {
            found.push(bucket.value_iterated_to());
        }
    }
    found
}

impl Spread {
    /// Half of the times are no longer.
    #[must_use]
    pub fn median_s(&self) -> f64 {
        self.quantiles_s.get(CURVE / 2).copied().unwrap_or_default()
    }

    /// 99 of a hundred are no longer.
    #[must_use]
    pub fn p99_s(&self) -> f64 {
        self.quantiles_s.get(CURVE - 1).copied().unwrap_or_default()
    }
}

/// The distribution function of several spreads together: times in seconds, ascending, each with the share that is no longer.
/// As fine as their quantiles.
#[must_use]
pub fn together(spreads: &[&Spread]) -> Vec<(f64, f64)> {
    let count: f64 = spreads.iter().map(|spread| spread.count as f64).sum();
    let mut steps: Vec<(f64, f64)> = spreads
        .iter()
        .flat_map(|spread| {
            let share = spread.count as f64 / (spread.quantiles_s.len() as f64 * count);
            spread.quantiles_s.iter().map(move |time_s| (*time_s, share))
        })
        .collect();
    steps.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut below = 0.0;
    for (_, share) in &mut steps {
        below += *share;
        *share = below;
    }
    steps
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn of_no_times_there_is_no_spread() {
        assert_eq!(SpreadTally::default().finish(), None);
    }

    #[test]
    fn spreads_together_weigh_by_how_many_times_they_have() {
        let of = |times: &[i64]| {
            let mut tally = SpreadTally::default();
            times.iter().for_each(|ns| tally.add(*ns));
            tally.finish().unwrap()
        };
        let (few, many) = (of(&[1_000_000_000]), of(&[2_000_000_000; 3]));
        let curve = together(&[&many, &few]);
        let (_, share) = curve.iter().rfind(|(time_s, _)| *time_s < 1.5).unwrap();
        assert!((share - 0.25).abs() < 1e-9, "{share}");
        assert!((curve.last().unwrap().1 - 1.0).abs() < 1e-9);
    }

    proptest! {
        #[test]
        fn the_quantiles_are_those_of_the_histogram(times in prop::collection::vec(0_u64..10_000_000_000, 1..300)) {
            let mut histogram = Histogram::<u32>::new_with_max(LONGEST_NS.unsigned_abs(), DIGITS).unwrap();
            times.iter().for_each(|ns| histogram.saturating_record(*ns));
            let each = (1..CURVE).map(|step| histogram.value_at_quantile(step as f64 / CURVE as f64));
            prop_assert_eq!(inner_quantiles(&histogram), each.collect::<Vec<_>>());
        }

        #[test]
        fn a_quantile_is_right_to_one_in_a_thousand(mut times in prop::collection::vec(0_i64..10_000_000_000, 1..400)) {
            let mut tally = SpreadTally::default();
            times.iter().for_each(|ns| tally.add(*ns));
            let spread = tally.finish().unwrap();
            times.sort_unstable();
            prop_assert_eq!((spread.min_s, spread.max_s), (times[0] as f64 / 1e9, times[times.len() - 1] as f64 / 1e9));
            for (share, found) in [(0.5, spread.median_s()), (0.99, spread.p99_s())] {
                let rank = ((share * times.len() as f64).ceil() as usize).max(1);
                let expected = times[rank - 1] as f64 / 1e9;
                prop_assert!((found - expected).abs() <= expected / 1000.0 + 1e-9, "{found} {expected}");
            }
        }
    }
}
