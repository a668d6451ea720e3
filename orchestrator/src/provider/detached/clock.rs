//! The clock of the machine that measures, held against the one of this machine. The main type is [`ClockReading`].
//!
//! A virtual machine that does not get the processor can go slower than the world, its clock and its windows with it, and
//! nothing inside of it notices. Two readings from outside do.

use std::time::{Duration, Instant, SystemTime};

use record::{detached, run_directory::ClockDrift};

use super::AgentClient;
use crate::provider::ProviderError;

/// What a machine's clock said once.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClockReading {
    /// In nanoseconds since 1970-01-01, by its clock.
    there_ns: u64,
    /// By ours, how far its clock was ahead, in milliseconds.
    pub ahead_ms: f64,
    /// By how much that may be wrong: half of the time that asking took, in milliseconds.
    pub within_ms: f64,
    /// The middle of the time that asking took, by a clock that nobody sets.
    at: Instant,
}

impl ClockReading {
    /// Asks a host, which also says what it is.
    ///
    /// # Errors
    /// When it cannot be asked.
    pub async fn of(agent: &AgentClient) -> Result<(Self, detached::Host), ProviderError> {
        // What is to be timed is the question and not the way to it.
        agent.deployed().await?;
        let (asked, here) = (Instant::now(), SystemTime::now());
        let said = agent.platform().await?;
        let half = asked.elapsed() / 2;
        let here_ns = (here + half)
            .duration_since(SystemTime::UNIX_EPOCH)
            .unwrap_or_default()
            .as_nanos();
        let reading = Self {
            there_ns: said.now_ns,
            // As f64, nanoseconds since 1970 are good to a few hundred of them.
            ahead_ms: (said.now_ns as f64 - here_ns as f64) / 1e6,
            within_ms: milliseconds(half),
            at: asked + half,
        };
        Ok((reading, said))
    }

    /// How far the clock went between this reading and a later one, beside ours.
    #[must_use]
    pub fn drift_until(&self, later: &Self) -> ClockDrift {
        let here_ms = milliseconds(later.at.saturating_duration_since(self.at));
        // A clock that was put back went less than nothing.
        let there_ms = (i128::from(later.there_ns) - i128::from(self.there_ns)) as f64 / 1e6;
        ClockDrift {
            seconds: here_ms / 1e3,
            drift_ms: there_ms - here_ms,
            within_ms: self.within_ms + later.within_ms,
        }
    }
}

fn milliseconds(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reading(at: Instant, there: Duration) -> ClockReading {
        ClockReading {
            there_ns: u64::try_from(there.as_nanos()).unwrap(),
            ahead_ms: 0.0,
            within_ms: 2.0,
            at,
        }
    }

    #[test]
    fn a_clock_that_went_4_seconds_in_40_fell_36_behind() {
        let begun = Instant::now();
        let before = reading(begun, Duration::from_secs(1000));
        let after = reading(begun + Duration::from_secs(40), Duration::from_secs(1004));
        let drift = before.drift_until(&after);
        assert_eq!(
            (drift.seconds, drift.drift_ms, drift.within_ms),
            (40.0, -36_000.0, 4.0)
        );
    }

    #[test]
    fn a_clock_that_was_put_back_went_less_than_nothing() {
        let begun = Instant::now();
        let before = reading(begun, Duration::from_secs(1000));
        let after = reading(begun + Duration::from_secs(1), Duration::from_secs(990));
        assert_eq!(before.drift_until(&after).drift_ms, -11_000.0);
    }
}
