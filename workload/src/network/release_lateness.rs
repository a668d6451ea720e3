//! How late an emulator lets packets go: counted as they go, read by others at any time. The main types are
//! [`ReleaseLateness`] and [`ReleaseCounts`].
//!
//! Buckets as in HdrHistogram (<https://hdrhistogram.org>): one for each nanosecond up to 64 ns, from there on 64 for
//! each power of two, so that no value is off by more than 1/64. There is room up to 68 s, and what is later than that
//! counts in the last one. Counting is two stores: nothing is allocated and nobody waits.

use std::sync::atomic::{AtomicU64, Ordering};

use record::window::ReleaseRecord;

/// Buckets of one power of two, as a power of two.
const FINENESS_BITS: u32 = 6;
const FINENESS: u64 = 1 << FINENESS_BITS;
/// The power of two that the last buckets begin with.
const HIGHEST_BIT: u32 = 35;
const BUCKETS: usize = ((HIGHEST_BIT - FINENESS_BITS + 2) as usize) << FINENESS_BITS;

/// The times from due to released of all packets so far. One thread counts; any may read.
#[derive(Debug)]
pub struct ReleaseLateness {
    buckets: Box<[AtomicU64]>,
    total_ns: AtomicU64,
}

/// What had been counted at one moment.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ReleaseCounts {
    buckets: Vec<u64>,
    total_ns: u64,
}

impl Default for ReleaseLateness {
    fn default() -> Self {
        Self {
            buckets: (0..BUCKETS).map(|_| AtomicU64::new(0)).collect(),
            total_ns: AtomicU64::new(0),
        }
    }
}

impl ReleaseLateness {
    /// One more packet. To be called by one thread only.
    pub fn count(&self, lateness_ns: u64) {
        // The only writer needs no atomic addition.
        let add = |to: &AtomicU64, more: u64| {
            to.store(to.load(Ordering::Relaxed).wrapping_add(more), Ordering::Relaxed);
        };
        if let Some(bucket) = self.buckets.get(bucket_of(lateness_ns)) {
            add(bucket, 1);
        }
        add(&self.total_ns, lateness_ns);
    }

    /// What has been counted so far. A packet that is counted just now may be in it in part.
    #[must_use]
    pub fn counts(&self) -> ReleaseCounts {
        let read = |from: &AtomicU64| from.load(Ordering::Relaxed);
        ReleaseCounts {
            buckets: self.buckets.iter().map(read).collect(),
            total_ns: read(&self.total_ns),
        }
    }
}

impl ReleaseCounts {
    /// What was counted since `earlier`. Percentiles are the upper ends of their buckets, so that they are too large by
    /// 1/64 at most and never too small.
    #[must_use]
    pub fn since(&self, earlier: &Self) -> ReleaseRecord {
        let pairs = self.buckets.iter().zip(&earlier.buckets);
        let counts: Vec<u64> = pairs.map(|(now, before)| now.saturating_sub(*before)).collect();
        let released: u64 = counts.iter().sum();
        let at = |share: f64| {
            let rank = ((share * released as f64).ceil() as u64).max(1);
            let mut below = 0;
            let bucket = counts.iter().position(|count| {
                below += count;
                below >= rank
            });
            bucket.map_or(0, upper_end)
        };
        let total_ns = self.total_ns.saturating_sub(earlier.total_ns);
        ReleaseRecord {
            released,
            lateness_mean_ns: total_ns as f64 / released.max(1) as f64,
            lateness_p99_ns: at(0.99),
            lateness_p999_ns: at(0.999),
            lateness_max_ns: at(1.0),
        }
    }
}

fn bucket_of(lateness_ns: u64) -> usize {
    if lateness_ns < FINENESS {
        return usize::try_from(lateness_ns).unwrap_or(0);
    }
    let shift = lateness_ns.ilog2() - FINENESS_BITS;
    let place = (u64::from(shift) << FINENESS_BITS) + (lateness_ns >> shift);
    usize::try_from(place).unwrap_or(BUCKETS).min(BUCKETS - 1)
}

/// The largest value that a bucket counts, in nanoseconds.
fn upper_end(bucket: usize) -> u64 {
    let place = bucket as u64;
    let shift = (place >> FINENESS_BITS).saturating_sub(1);
    let begins = place - (shift << FINENESS_BITS);
    ((begins + 1) << shift) - 1
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rstest::rstest;

    use super::*;

    #[rstest]
    #[case::exact_when_small(63, 63)]
    #[case::exact_still(127, 127)]
    #[case::to_one_in_64(1_000_000, 1_007_615)]
    #[case::longest((1 << 36) - 1, (1 << 36) - 1)]
    #[case::beyond_it(u64::MAX, (1 << 36) - 1)]
    fn a_value_is_read_back_as_the_upper_end_of_its_bucket(#[case] counted_ns: u64, #[case] read_ns: u64) {
        assert_eq!(upper_end(bucket_of(counted_ns)), read_ns);
    }

    proptest! {
        #[test]
        fn no_value_is_off_by_more_than_one_in_64(value in 0_u64..1 << 36) {
            let read = upper_end(bucket_of(value));
            prop_assert!(value <= read && read - value <= value / FINENESS, "{value} {read}");
        }
    }

    #[test]
    fn a_window_has_the_packets_since_it_began_only() {
        let lateness = ReleaseLateness::default();
        lateness.count(5_000_000);
        let began = lateness.counts();
        (1..=60).for_each(|ns| lateness.count(ns));
        let record = lateness.counts().since(&began);
        assert_eq!(
            record,
            ReleaseRecord {
                released: 60,
                lateness_mean_ns: 30.5,
                lateness_p99_ns: 60,
                lateness_p999_ns: 60,
                lateness_max_ns: 60,
            }
        );
    }

    #[test]
    fn one_late_packet_in_a_thousand_is_in_the_maximum_and_not_in_the_percentiles() {
        let lateness = ReleaseLateness::default();
        let began = lateness.counts();
        (0..1999).for_each(|_| lateness.count(40));
        lateness.count(100);
        let record = lateness.counts().since(&began);
        assert_eq!(
            (
                record.lateness_p99_ns,
                record.lateness_p999_ns,
                record.lateness_max_ns
            ),
            (40, 40, 100)
        );
    }

    #[test]
    fn a_window_without_packets_was_not_late() {
        let counts = ReleaseLateness::default().counts();
        assert_eq!(counts.since(&counts), ReleaseRecord::default());
    }
}
