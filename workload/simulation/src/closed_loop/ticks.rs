//! The ticks of a loop in virtual time. The main types are [`Ticks`] and [`Stalls`].

use std::time::Duration;

use oorandom::Rand64;
use record::settings::LateTicks;

use crate::schedule::{Schedule, Tick};

/// What a platform does to a loop: some ticks begin late.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Stalls {
    /// The share of ticks that do, each independently.
    pub share: f64,
    /// By how much.
    pub length: Duration,
}

/// A loop's schedule as a real loop follows it (`workload/src/experiment/schedule.rs`), for ever.
#[derive(Debug)]
pub(super) struct Ticks {
    schedule: Schedule,
    late_ticks: LateTicks,
    stalls: Stalls,
    chance: Rand64,
    next: Tick,
}

impl Ticks {
    pub fn new(schedule: Schedule, late_ticks: LateTicks, stalls: Stalls, chance: Rand64) -> Self {
        let mut ticks = Self {
            schedule,
            late_ticks,
            stalls,
            chance,
            next: Tick::default(),
        };
        ticks.prepare(0, i64::MIN);
        ticks
    }

    /// When the next one begins.
    pub const fn next_ns(&self) -> i64 {
        self.next.began_ns
    }

    /// The next one, which takes no time.
    pub fn take(&mut self) -> Tick {
        let tick = self.next;
        self.prepare(tick.step + 1, tick.began_ns);
        tick
    }

    fn prepare(&mut self, pending: u64, not_before_ns: i64) {
        let stalled = self.stalls.share > 0.0 && self.chance.rand_float() < self.stalls.share;
        let length = if stalled {
            self.stalls.length
        } else {
            Duration::ZERO
        };
        let length_ns = i64::try_from(length.as_nanos()).unwrap_or(i64::MAX / 8);
        let began_ns = (self.schedule.due_ns(pending) + length_ns).max(not_before_ns);
        self.next = self.schedule.tick(self.late_ticks, pending, began_ns);
    }
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    const MS: i64 = 1_000_000;

    fn ticks(late_ticks: LateTicks, share: f64, length_ms: u64) -> Ticks {
        let schedule = Schedule {
            first_ns: 0,
            step_ns: 20 * MS,
            steps: u64::MAX,
        };
        let stalls = Stalls {
            share,
            length: Duration::from_millis(length_ms),
        };
        Ticks::new(schedule, late_ticks, stalls, Rand64::new(1))
    }

    #[rstest]
    #[case::lost(LateTicks::Lost, [(2, 50), (5, 110), (8, 170)])]
    #[case::caught_up(LateTicks::CaughtUp, [(0, 50), (1, 70), (2, 90)])]
    fn ticks_that_are_all_late_by_two_and_a_half_steps(
        #[case] late_ticks: LateTicks,
        #[case] expected: [(u64, i64); 3],
    ) {
        let mut ticks = ticks(late_ticks, 1.0, 50);
        let taken = [(); 3].map(|()| ticks.take());
        assert_eq!(taken.map(|tick| (tick.step, tick.began_ns / MS)), expected);
    }

    #[test]
    fn after_a_stall_what_is_caught_up_follows_at_once_and_in_order() {
        let mut ticks = ticks(LateTicks::CaughtUp, 0.05, 100);
        let taken: Vec<Tick> = (0..2000).map(|_| ticks.take()).collect();
        assert!(taken.iter().zip(0..).all(|(tick, step)| tick.step == step));
        assert!(taken.is_sorted_by_key(|tick| tick.began_ns));
        assert!(taken.iter().all(|tick| tick.began_ns - tick.due_ns <= 100 * MS));
        let at_once = taken
            .windows(2)
            .filter(|pair| pair[0].began_ns == pair[1].began_ns);
        assert!(at_once.count() > 200);
    }

    #[test]
    fn the_share_of_ticks_that_begin_late_is_that_which_was_asked_for() {
        let mut ticks = ticks(LateTicks::Lost, 0.1, 5);
        let late = (0..20_000).filter(|_| {
            let tick = ticks.take();
            tick.began_ns > tick.due_ns
        });
        // Five standard deviations either side.
        assert!((1788..2212).contains(&late.count()));
    }
}
