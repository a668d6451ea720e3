//! When the steps of a loop are due: absolute times, so that lateness never adds up. The main types are [`Schedule`] and
//! [`Tick`].

use record::settings::LateTicks;
use serde::{Deserialize, Serialize};

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

    /// The tick that begins now, when `pending` is the first step that was not done.
    ///
    /// Caught up, no step is left out: after a stall the missed ones follow at once, so that plant time does not fall behind
    /// the clock. Lost, they are an interval timer's (setitimer(2)): a signal that is pending already is not raised once
    /// more, so that of all ticks that fall due before a step begins one is done.
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

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    #[test]
    fn a_tick_in_time_is_its_own() {
        let schedule = Schedule {
            first_ns: 0,
            step_ns: MS,
            steps: 5,
        };
        assert_eq!(schedule.newest_due(3, 3 * MS), 3);
        assert_eq!(schedule.newest_due(3, 4 * MS - 1), 3);
        assert_eq!(schedule.newest_due(3, 4 * MS), 4);
        assert_eq!(schedule.newest_due(0, -1), 0);
    }
}
