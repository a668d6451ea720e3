//! How long a round trip takes: the smoothed time and its deviation, which make the retransmission timeout, and the shortest
//! of the last five minutes, which makes the reordering window. The main type is [`RoundTrip`].
//!
//! Sources: RFC 6298 with Linux's variant of the deviation (`tcp_rtt_estimator`): it falls once a round trip and by a quarter
//! at most, a round trip shorter than before raises it by an eighth only, and it is never below 200 ms (`tcp_rto_min_us`). The
//! shortest: `tcp_update_rtt_min` and `lib/win_minmax.c`.

/// `TCP_RTO_MIN`, the least that the deviation counts.
pub(super) const LEAST_DEVIATION_US: i64 = 200_000;
/// `tcp_min_rtt_wlen`.
const SHORTEST_OF_US: i64 = 300_000_000;

/// Estimates from measured round trips, in microseconds.
#[derive(Debug, Clone)]
pub(super) struct RoundTrip {
    /// Eight times the smoothed round trip; zero until one was measured.
    smoothed_us_8: i64,
    /// Four times the mean deviation.
    deviation_us_4: i64,
    /// The largest of this round trip.
    largest_us_4: i64,
    /// What counts.
    variation_us: i64,
    /// A round trip is over when this byte was acknowledged.
    round_end: u64,
    shortest: Shortest,
}

impl RoundTrip {
    pub fn new() -> Self {
        Self {
            smoothed_us_8: 0,
            deviation_us_4: 0,
            largest_us_4: 0,
            variation_us: 0,
            round_end: 0,
            shortest: Shortest::new(),
        }
    }

    /// Takes a measured round trip. `una` and `nxt` are the sender's.
    pub fn take(&mut self, measured_us: i64, una: u64, nxt: u64) {
        if self.smoothed_us_8 == 0 {
            self.smoothed_us_8 = (measured_us * 8).max(1);
            self.deviation_us_4 = measured_us * 2;
            self.variation_us = self.deviation_us_4.max(LEAST_DEVIATION_US);
            self.largest_us_4 = self.variation_us;
            self.round_end = nxt;
            return;
        }
        let error_us = measured_us - (self.smoothed_us_8 >> 3);
        self.smoothed_us_8 = (self.smoothed_us_8 + error_us).max(1);
        let growth_us = error_us.abs() - (self.deviation_us_4 >> 2);
        self.deviation_us_4 += if error_us < 0 && growth_us > 0 {
            growth_us >> 3
        } else {
            growth_us
        };
        if self.deviation_us_4 > self.largest_us_4 {
            self.largest_us_4 = self.deviation_us_4;
            self.variation_us = self.variation_us.max(self.largest_us_4);
        }
        if una > self.round_end {
            if self.largest_us_4 < self.variation_us {
                self.variation_us -= (self.variation_us - self.largest_us_4) >> 2;
            }
            self.round_end = nxt;
            self.largest_us_4 = LEAST_DEVIATION_US;
        }
    }

    /// Remembers it if it is the shortest. A late acknowledgement says nothing about the shortest unless it is.
    pub fn take_shortest(&mut self, now_us: i64, measured_us: i64, maybe_delayed: bool) {
        if !maybe_delayed
            || self
                .shortest_us()
                .is_none_or(|shortest_us| measured_us <= shortest_us)
        {
            self.shortest.take(now_us, measured_us);
        }
    }

    /// The smoothed round trip, if one was measured.
    pub fn smoothed_us(&self) -> Option<i64> {
        (self.smoothed_us_8 > 0).then_some(self.smoothed_us_8 >> 3)
    }

    /// The shortest of the last five minutes.
    pub fn shortest_us(&self) -> Option<i64> {
        self.shortest.best[0].map(|(_, us)| us)
    }

    /// The timeout before any backing off.
    pub fn timeout_us(&self) -> i64 {
        (self.smoothed_us_8 >> 3) + self.variation_us
    }
}

/// A running minimum over a window, by the three best candidates for it: the best of the window, of what came after it, and
/// of what came after that.
#[derive(Debug, Clone)]
struct Shortest {
    /// When measured, and what.
    best: [Option<(i64, i64)>; 3],
}

impl Shortest {
    const fn new() -> Self {
        Self { best: [None; 3] }
    }

    fn take(&mut self, now_us: i64, us: i64) {
        let new = Some((now_us, us));
        let [Some(first), Some(second), Some(third)] = self.best else {
            self.best = [new; 3];
            return;
        };
        if us <= first.1 || now_us - third.0 > SHORTEST_OF_US {
            self.best = [new; 3];
            return;
        }
        if us <= second.1 {
            self.best = [Some(first), new, new];
        } else if us <= third.1 {
            self.best[2] = new;
        }
        self.age(now_us, new);
    }

    /// Lets the best go when it is too old, and takes a second best once a quarter of the window has passed without one.
    fn age(&mut self, now_us: i64, new: Option<(i64, i64)>) {
        let measured_us = |candidate: Option<(i64, i64)>| candidate.map_or(now_us, |(at_us, _)| at_us);
        let [first, second, third] = self.best;
        let age_us = now_us - measured_us(first);
        if age_us > SHORTEST_OF_US {
            self.best = [second, third, new];
            if now_us - measured_us(second) > SHORTEST_OF_US {
                self.best = [third, new, new];
            }
        } else if measured_us(second) == measured_us(first) && age_us > SHORTEST_OF_US / 4 {
            self.best = [first, new, new];
        } else if measured_us(third) == measured_us(second) && age_us > SHORTEST_OF_US / 2 {
            self.best[2] = new;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_measurement_makes_a_timeout_of_itself_and_200_ms() {
        let mut round_trip = RoundTrip::new();
        round_trip.take(40_000, 0, 1);
        assert_eq!(round_trip.smoothed_us(), Some(40_000));
        assert_eq!(round_trip.timeout_us(), 240_000);
    }

    #[test]
    fn the_smoothed_round_trip_takes_an_eighth_of_each_error() {
        let mut round_trip = RoundTrip::new();
        round_trip.take(40_000, 0, 1);
        round_trip.take(48_000, 2, 3);
        assert_eq!(round_trip.smoothed_us(), Some(41_000));
    }

    /// RFC 6298 would have it at 3/4 · 200 + 1/4 · 960 ms or more.
    #[test]
    fn a_round_trip_of_a_second_raises_the_timeout_and_later_ones_lower_it_by_a_quarter_each() {
        let mut round_trip = RoundTrip::new();
        round_trip.take(40_000, 0, 10);
        round_trip.take(1_000_000, 5, 10);
        // deviation 80 → 80 + 960 − 20 = 1020 ms in fourths.
        assert_eq!(round_trip.timeout_us(), 160_000 + 1_020_000);
        round_trip.take(160_000, 11, 20);
        round_trip.take(160_000, 21, 30);
        assert!(round_trip.timeout_us() < 160_000 + 1_020_000);
        assert!(round_trip.timeout_us() > 160_000 + 1_020_000 * 3 / 4);
    }

    #[test]
    fn the_shortest_is_forgotten_after_five_minutes() {
        let mut round_trip = RoundTrip::new();
        round_trip.take_shortest(0, 37_000, false);
        for second in 1..=299 {
            round_trip.take_shortest(second * 1_000_000, 40_000, false);
        }
        assert_eq!(round_trip.shortest_us(), Some(37_000));
        round_trip.take_shortest(301_000_000, 41_000, false);
        assert_eq!(round_trip.shortest_us(), Some(40_000));
    }

    #[test]
    fn an_acknowledgement_that_may_be_late_counts_only_as_the_shortest() {
        let mut round_trip = RoundTrip::new();
        round_trip.take_shortest(0, 40_000, true);
        round_trip.take_shortest(400_000_000, 80_000, true);
        assert_eq!(round_trip.shortest_us(), Some(40_000));
        round_trip.take_shortest(400_000_001, 39_000, true);
        assert_eq!(round_trip.shortest_us(), Some(39_000));
    }
}
