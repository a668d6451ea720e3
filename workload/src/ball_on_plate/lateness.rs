//! How late the steps of a loop began. The main type is [`Lateness`].

use record::window::LoopRecord;

/// The times from due to begun of one loop's steps in one window. All are kept, so that percentiles are exact.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Lateness {
    values_ns: Vec<i64>,
    missed: u64,
}

impl Lateness {
    /// Room for as many steps.
    #[must_use]
    pub fn with_capacity(steps: u64) -> Self {
        Self {
            values_ns: Vec::with_capacity(usize::try_from(steps).unwrap_or(0)),
            missed: 0,
        }
    }

    /// One more step.
    pub fn add(&mut self, lateness_ns: i64, step_ns: i64) {
        self.values_ns.push(lateness_ns);
        self.missed += u64::from(lateness_ns >= step_ns);
    }

    /// Steps so far.
    #[must_use]
    pub fn steps(&self) -> u64 {
        self.values_ns.len() as u64
    }

    /// Steps so far that began a whole step or more late.
    #[must_use]
    pub fn missed(&self) -> u64 {
        self.missed
    }

    /// What the window's record says of the loop.
    #[must_use]
    pub fn into_record(mut self, step_ns: i64) -> LoopRecord {
        self.values_ns.sort_unstable();
        let sorted = self.values_ns;
        let count = sorted.len();
        let at = |share: f64| {
            let rank = (share * count as f64).ceil() as usize;
            sorted.get(rank.saturating_sub(1)).copied().unwrap_or(0)
        };
        let sum: f64 = sorted.iter().map(|ns| *ns as f64).sum();
        LoopRecord {
            steps: count as u64,
            lost_ticks: 0,
            missed_deadlines: self.missed,
            late_steps: sorted.iter().filter(|ns| **ns > step_ns / 10).count() as u64,
            lateness_mean_ns: if count == 0 { 0.0 } else { sum / count as f64 },
            lateness_p50_ns: at(0.5),
            lateness_p99_ns: at(0.99),
            lateness_p999_ns: at(0.999),
            lateness_max_ns: sorted.last().copied().unwrap_or(0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP_NS: i64 = 1000;

    #[test]
    fn percentiles_are_values_that_occurred() {
        let mut lateness = Lateness::default();
        (1..=1000).rev().for_each(|ns| lateness.add(ns, STEP_NS));
        let record = lateness.into_record(STEP_NS);
        assert_eq!(
            (
                record.lateness_p50_ns,
                record.lateness_p99_ns,
                record.lateness_p999_ns,
                record.lateness_max_ns
            ),
            (500, 990, 999, 1000)
        );
        assert_eq!(record.lateness_mean_ns, 500.5);
        assert_eq!(
            (record.steps, record.late_steps, record.missed_deadlines),
            (1000, 900, 1)
        );
    }

    #[test]
    fn a_loop_without_steps_was_not_late() {
        assert_eq!(Lateness::default().into_record(STEP_NS), LoopRecord::default());
    }
}
