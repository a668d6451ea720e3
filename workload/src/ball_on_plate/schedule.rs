//! How a loop keeps its [`Schedule`] on the real clock. The function is [`follow`].

use std::sync::atomic::{AtomicBool, Ordering};

use record::settings::{LateTicks, Waiting};
use simulation::schedule::{Schedule, Tick};

use crate::realtime::{monotonic_ns, sleep_until};

/// How a loop keeps its schedule.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Pace {
    /// What becomes of steps that fall due while an earlier one has not ended.
    pub late_ticks: LateTicks,
    /// How the loop waits.
    pub waiting: Waiting,
}

/// Calls `body` at each step until all are done or it is told to stop. How late each was is on record.
pub fn follow(schedule: &Schedule, pace: Pace, stop: &AtomicBool, mut body: impl FnMut(Tick)) {
    let mut next = 0;
    while next < schedule.steps {
        let due_ns = schedule.due_ns(next);
        match pace.waiting {
            Waiting::Sleep => sleep_until(due_ns),
            Waiting::Spin => spin_until(due_ns, stop),
        }
        if stop.load(Ordering::Relaxed) {
            return;
        }
        let tick = schedule.tick(pace.late_ticks, next, monotonic_ns());
        if tick.step < schedule.steps {
            body(tick);
        }
        next = tick.step.saturating_add(1);
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
        follow(schedule, pace, &AtomicBool::new(false), |tick| ticks.push(tick));
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
    fn no_step_begins_after_the_loop_was_told_to_stop() {
        let stop = AtomicBool::new(false);
        let mut done = 0;
        follow(&schedule(monotonic_ns()), CAUGHT_UP, &stop, |_| {
            done += 1;
            stop.store(done == 2, Ordering::Relaxed);
        });
        assert_eq!(done, 2);
    }
}
