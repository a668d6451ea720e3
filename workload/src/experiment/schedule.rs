//! When the steps of the two loops are due: absolute times, so that lateness never adds up. The main types are
//! [`Schedule`] and [`Tick`].

use std::sync::atomic::{AtomicBool, Ordering};

use crate::realtime::{monotonic_ns, sleep_until};

/// A loop's deadlines, on the monotonic clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Schedule {
    /// When step 0 is due.
    pub first_ns: i64,
    /// From one step to the next.
    pub step_ns: i64,
    /// How many there are.
    pub steps: u64,
}

/// One step that has begun.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Tick {
    /// Counts from 0.
    pub step: u64,
    /// When it was due, on the monotonic clock.
    pub due_ns: i64,
    /// When it began.
    pub began_ns: i64,
}

impl Tick {
    /// From due to begun.
    #[must_use]
    pub const fn lateness_ns(&self) -> i64 {
        self.began_ns - self.due_ns
    }
}

impl Schedule {
    /// When a step is due.
    #[must_use]
    pub fn due_ns(&self, step: u64) -> i64 {
        self.first_ns + self.step_ns * i64::try_from(step).unwrap_or(i64::MAX / self.step_ns.max(1))
    }

    /// Calls `body` at each step until all are done or it is told to stop. No step is ever left out: after a stall the
    /// missed ones follow at once, so that plant time does not fall behind the clock; how late each was is on record.
    pub fn follow(&self, stop: &AtomicBool, mut body: impl FnMut(Tick)) {
        for step in 0..self.steps {
            let due_ns = self.due_ns(step);
            sleep_until(due_ns);
            if stop.load(Ordering::Relaxed) {
                return;
            }
            body(Tick {
                step,
                due_ns,
                began_ns: monotonic_ns(),
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn schedule(first_ns: i64) -> Schedule {
        Schedule {
            first_ns,
            step_ns: 1_000_000,
            steps: 5,
        }
    }

    #[test]
    fn steps_missed_in_a_stall_follow_at_once_with_their_own_deadlines() {
        let first_ns = monotonic_ns() - 1_000_000_000;
        let mut ticks = Vec::new();
        schedule(first_ns).follow(&AtomicBool::new(false), |tick| ticks.push(tick));
        let due: Vec<i64> = ticks.iter().map(|tick| tick.due_ns - first_ns).collect();
        assert_eq!(due, [0, 1_000_000, 2_000_000, 3_000_000, 4_000_000]);
        assert!(ticks.iter().all(|tick| tick.lateness_ns() > 0));
    }

    #[test]
    fn no_step_begins_after_the_loop_was_told_to_stop() {
        let stop = AtomicBool::new(false);
        let mut done = 0;
        schedule(monotonic_ns()).follow(&stop, |_| {
            done += 1;
            stop.store(done == 2, Ordering::Relaxed);
        });
        assert_eq!(done, 2);
    }
}
