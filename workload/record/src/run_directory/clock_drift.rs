//! How a machine's clock went beside the one of the machine that ran `matrix`. The main type is [`ClockDrift`].

use serde::{Deserialize, Serialize};

/// The least that is remarked on, as a part of the time: the clocks of two good machines differ by a ten-thousandth of it,
/// the paper's periods by less than a hundredth.
const REMARKABLE: f64 = 0.01;

/// How much further, or less far, a clock went while windows were measured by it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ClockDrift {
    /// Between the two readings, by the clock of the machine that ran `matrix`, in seconds.
    pub seconds: f64,
    /// How much further it went in that time, in milliseconds; negative when it went less far.
    pub drift_ms: f64,
    /// By how much that may be wrong, in milliseconds: reading a clock over a network takes a while.
    pub within_ms: f64,
}

impl ClockDrift {
    /// Its name among an environment's facts.
    pub const FACT: &str = "clock";

    /// That the clock went at another speed than the world, in words; none where it did not, or where that cannot be told.
    #[must_use]
    pub fn remark(&self) -> Option<String> {
        let drift_s = self.drift_ms.abs() / 1e3;
        let told = drift_s > self.within_ms / 1e3 && drift_s > self.seconds * REMARKABLE;
        told.then(|| {
            format!(
                "its clock went {:.1} s in {:.1} s of the clock of the machine that ran `matrix`: what was measured \
                 by it took longer or shorter in the world than it says",
                self.seconds + self.drift_ms / 1e3,
                self.seconds
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    #[rstest]
    #[case::nearly_stood_still(40.0, -36_000.0, 4.0, Some("its clock went 4.0 s in 40.0 s"))]
    #[case::ran_ahead(10.0, 1_000.0, 4.0, Some("its clock went 11.0 s in 10.0 s"))]
    #[case::a_good_clock(6000.0, 60.0, 4.0, None)]
    #[case::no_more_than_reading_it_takes(2.0, 30.0, 40.0, None)]
    #[case::no_time_went_by(0.0, 3.0, 4.0, None)]
    fn a_clock_of_another_speed_is_remarked_on(
        #[case] seconds: f64,
        #[case] drift_ms: f64,
        #[case] within_ms: f64,
        #[case] says: Option<&str>,
    ) {
        let drift = ClockDrift {
            seconds,
            drift_ms,
            within_ms,
        };
        let remark = drift.remark();
        assert_eq!(remark.is_some(), says.is_some(), "{remark:?}");
        assert!(remark.unwrap_or_default().starts_with(says.unwrap_or_default()));
    }
}
