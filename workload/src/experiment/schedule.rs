//! When the steps of the two loops are due: absolute times, so that lateness never adds up. The main types are
//! [`Schedule`], [`Pace`] and [`Tick`].

use std::sync::atomic::{AtomicBool, Ordering};

use record::settings::{LateTicks, Waiting};
use serde::{Deserialize, Serialize};

use crate::realtime::{monotonic_ns, sleep_until};

/// A loop's deadlines, on the monotonic clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Schedule {
    /// When step 0 is due.
    pub first_ns: i64,
    /// From one step to the next.
    pub step_ns: i64,
    /// How many there are.
    pub steps: u64,
}

/// How a loop keeps its schedule.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Pace {
    /// What becomes of steps that fall due while an earlier one has not ended.
    pub late_ticks: LateTicks,
    /// How the loop waits.
    pub waiting: Waiting,
}

/// One step that has begun.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Tick {
    /// Counts from 0. Where ticks are lost, it is the newest that was due.
    pub step: u64,
    /// When it was due, on the monotonic clock; where ticks before it were lost, when the first of them was due.
    pub due_ns: i64,
    /// When it began.
    pub began_ns: i64,
}

impl Schedule {
    /// When a step is due.
    #[must_use]
    pub fn due_ns(&self, step: u64) -> i64 {
        self.first_ns + self.step_ns * i64::try_from(step).unwrap_or(i64::MAX / self.step_ns.max(1))
    }

    /// Calls `body` at each step until all are done or it is told to stop. How late each was is on record.
    ///
    /// Caught up, no step is left out: after a stall the missed ones follow at once, so that plant time does not fall behind
    /// the clock. Lost, they are an interval timer's (setitimer(2)): a signal that is pending already is not raised once
    /// more, so that of all ticks that fall due before a step begins one is done.
    pub fn follow(&self, pace: Pace, stop: &AtomicBool, mut body: impl FnMut(Tick)) {
        let mut next = 0;
        while next < self.steps {
            let due_ns = self.due_ns(next);
            match pace.waiting {
                Waiting::Sleep => sleep_until(due_ns),
                Waiting::Spin => spin_until(due_ns, stop),
            }
            if stop.load(Ordering::Relaxed) {
                return;
            }
            let tick = self.tick(pace.late_ticks, next, monotonic_ns());
            if tick.step < self.steps {
                body(tick);
            }
            next = tick.step.saturating_add(1);
        }
    }

    /// The tick that begins now, when `pending` is the first step that was not done.
    #[must_use]
    pub fn tick(&self, late_ticks: LateTicks, pending: u64, began_ns: i64) -> Tick {
        Tick {
            step: match late_ticks {
                LateTicks::CaughtUp => pending,
                LateTicks::Lost => self.newest_due(pending, began_ns),
            },
            due_ns: self.due_ns(pending),
            began_ns,
        }
    }

    /// The newest step that is due by then, at least `pending`.
    fn newest_due(&self, pending: u64, now_ns: i64) -> u64 {
        let due = (now_ns - self.first_ns).div_euclid(self.step_ns.max(1));
        u64::try_from(due).unwrap_or(0).max(pending)
    }
}

/// Looks at the clock until it shows that time, or it is told to stop.
fn spin_until(due_ns: i64, stop: &AtomicBool) {
    while monotonic_ns() < due_ns && !stop.load(Ordering::Relaxed) {
        std::hint::spin_loop();
    }
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    const MS: i64 = 1_000_000;

    const CAUGHT_UP: Pace = Pace {
        late_ticks: LateTicks::CaughtUp,
        waiting: Waiting::Sleep,
    };

    fn schedule(first_ns: i64) -> Schedule {
        Schedule {
            first_ns,
            step_ns: MS,
            steps: 5,
        }
    }

    fn ticks(schedule: &Schedule, pace: Pace) -> Vec<Tick> {
        let mut ticks = Vec::new();
        schedule.follow(pace, &AtomicBool::new(false), |tick| ticks.push(tick));
        ticks
    }

    #[test]
    fn steps_missed_in_a_stall_follow_at_once_with_their_own_deadlines() {
        let first_ns = monotonic_ns() - 1000 * MS;
        let ticks = ticks(&schedule(first_ns), CAUGHT_UP);
        let due: Vec<i64> = ticks.iter().map(|tick| tick.due_ns - first_ns).collect();
        assert_eq!(due, [0, MS, 2 * MS, 3 * MS, 4 * MS]);
        assert!(ticks.iter().all(|tick| tick.began_ns > tick.due_ns));
    }

    #[rstest]
    #[case::sleeping(Waiting::Sleep)]
    #[case::spinning(Waiting::Spin)]
    fn of_ticks_that_fall_due_together_an_interval_timer_does_one(#[case] waiting: Waiting) {
        // An hour a step: the third is due, whatever else this machine does.
        let step_ns = 3_600_000 * MS;
        let first_ns = monotonic_ns() - 2 * step_ns - MS;
        let late = Schedule {
            first_ns,
            step_ns,
            steps: 3,
        };
        let pace = Pace {
            late_ticks: LateTicks::Lost,
            waiting,
        };
        let ticks = ticks(&late, pace);
        assert_eq!(ticks.len(), 1);
        assert_eq!((ticks[0].step, ticks[0].due_ns), (2, first_ns));
    }

    #[test]
    fn ticks_that_are_lost_at_the_end_are_not_done() {
        let pace = Pace {
            late_ticks: LateTicks::Lost,
            waiting: Waiting::Sleep,
        };
        assert_eq!(ticks(&schedule(monotonic_ns() - 1000 * MS), pace), []);
    }

    #[test]
    fn a_tick_in_time_is_its_own() {
        let schedule = schedule(0);
        assert_eq!(schedule.newest_due(3, 3 * MS), 3);
        assert_eq!(schedule.newest_due(3, 4 * MS - 1), 3);
        assert_eq!(schedule.newest_due(3, 4 * MS), 4);
        assert_eq!(schedule.newest_due(0, -1), 0);
    }

    #[test]
    fn no_step_begins_after_the_loop_was_told_to_stop() {
        let stop = AtomicBool::new(false);
        let mut done = 0;
        schedule(monotonic_ns()).follow(CAUGHT_UP, &stop, |_| {
            done += 1;
            stop.store(done == 2, Ordering::Relaxed);
        });
        assert_eq!(done, 2);
    }
}
