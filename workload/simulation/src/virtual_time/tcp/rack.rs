//! Which segment was delivered that was sent last, and how long others sent before it are waited for: RACK (RFC 8985, 6;
//! `net/ipv4/tcp_recovery.c`). The main type is [`Rack`].

/// `TCP_RACK_RECOVERY_THRESH`.
const PERSISTS_FOR_RECOVERIES: u32 = 16;

/// The newest delivery and the reordering window.
#[derive(Debug, Clone)]
pub(super) struct Rack {
    /// When the newest delivered segment was sent, and where it ends.
    pub newest: (i64, u64),
    /// The round trip of the segment delivered last.
    pub round_trip_us: i64,
    /// Something was delivered since losses were last looked for.
    pub advanced: bool,
    /// The window in quarters of the shortest round trip.
    steps: i64,
    /// How many more recoveries the steps outlast.
    pub persists: u32,
    duplicate_seen: bool,
    delivered_at_step: u64,
}

impl Rack {
    pub fn new() -> Self {
        Self {
            newest: (0, 0),
            round_trip_us: 0,
            advanced: false,
            steps: 1,
            persists: 0,
            duplicate_seen: false,
            delivered_at_step: 0,
        }
    }

    /// A segment was delivered (`tcp_rack_advance`). One that was sent more than once within the shortest round trip
    /// says nothing: the acknowledgement may be for the first.
    pub fn deliver(&mut self, now_us: i64, sent: (i64, u64), ever_resent: bool, shortest_us: Option<i64>) {
        let round_trip_us = now_us - sent.0;
        if ever_resent && shortest_us.is_none_or(|shortest_us| round_trip_us < shortest_us) {
            return;
        }
        self.advanced = true;
        self.round_trip_us = round_trip_us;
        self.newest = self.newest.max(sent);
    }

    /// The reordering window once reordering was seen, or before recovery (`tcp_rack_reo_wnd`).
    pub fn window_us(&self, shortest_us: Option<i64>, smoothed_us: Option<i64>) -> i64 {
        let quarters_us = shortest_us.map_or(i64::MAX, |shortest_us| (shortest_us >> 2) * self.steps);
        quarters_us.min(smoothed_us.unwrap_or(0))
    }

    /// A duplicate arrived that reordering may be the cause of.
    pub fn see_duplicate(&mut self) {
        self.duplicate_seen = true;
    }

    /// A recovery was undone because of duplicates (`tcp_try_undo_dsack`).
    pub fn persist_longer(&mut self) {
        self.persists = PERSISTS_FOR_RECOVERIES.min(self.persists + 1);
    }

    /// Widens the window once a round trip after duplicates (`tcp_rack_update_reo_wnd`). `prior_delivered` is how many
    /// segments had been delivered when the newest acknowledged one was sent.
    pub fn adapt(&mut self, prior_delivered: Option<u64>, delivered: u64) {
        let Some(prior_delivered) = prior_delivered else {
            return;
        };
        if prior_delivered < self.delivered_at_step {
            self.duplicate_seen = false;
        }
        if self.duplicate_seen {
            self.steps = (self.steps + 1).min(0xff);
            self.duplicate_seen = false;
            self.delivered_at_step = delivered;
            self.persists = PERSISTS_FOR_RECOVERIES;
        } else if self.persists == 0 {
            self.steps = 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_window_is_a_quarter_of_the_shortest_round_trip_and_the_smoothed_one_at_most() {
        let mut rack = Rack::new();
        assert_eq!(rack.window_us(Some(40_000), Some(41_000)), 10_000);
        for delivered in 1..10 {
            rack.see_duplicate();
            rack.adapt(Some(delivered), delivered);
        }
        assert_eq!(rack.window_us(Some(40_000), Some(41_000)), 41_000);
    }

    #[test]
    fn duplicates_within_one_round_trip_widen_the_window_once() {
        let mut rack = Rack::new();
        rack.see_duplicate();
        rack.adapt(Some(5), 10);
        rack.see_duplicate();
        rack.adapt(Some(9), 12);
        assert_eq!(rack.window_us(Some(40_000), Some(100_000)), 20_000);
        rack.see_duplicate();
        rack.adapt(Some(10), 13);
        assert_eq!(rack.window_us(Some(40_000), Some(100_000)), 30_000);
    }

    #[test]
    fn a_segment_sent_twice_within_the_shortest_round_trip_proves_nothing() {
        let mut rack = Rack::new();
        rack.deliver(50_000, (20_000, 9), true, Some(40_000));
        assert!(!rack.advanced);
        rack.deliver(60_000, (20_000, 9), true, Some(40_000));
        assert_eq!((rack.advanced, rack.newest), (true, (20_000, 9)));
    }
}
