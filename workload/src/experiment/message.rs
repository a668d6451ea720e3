//! What the two topics carry, as rows of doubles: `/state` from plant to controller, `/command` back. The main types
//! are [`StateMessage`] and [`CommandMessage`].
//!
//! Stamps are seconds on the experiment's clock, as ROS people expect them; a double keeps the nanosecond for 52 days.

use crate::plant::AxisState;

/// The topic of the plant's state.
pub const STATE_TOPIC: &str = "/state";
/// The topic of the controller's command.
pub const COMMAND_TOPIC: &str = "/command";

/// The plant's state at one of its ticks.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct StateMessage {
    /// Counts the plant's ticks, from 1.
    pub seq: u64,
    /// When the tick was begun, on the experiment's clock.
    pub stamp_ns: i64,
    /// `[x, y]`.
    pub axes: [AxisState; 2],
}

impl StateMessage {
    /// Names of the values, in order.
    pub const FIELDS: [&str; 10] = [
        "seq",
        "stamp_s",
        "x_m",
        "x_rate_m_s",
        "angle_x_rad",
        "angle_x_rate_rad_s",
        "y_m",
        "y_rate_m_s",
        "angle_y_rad",
        "angle_y_rate_rad_s",
    ];

    /// As the values of a message.
    #[must_use]
    pub fn to_values(self) -> [f64; 10] {
        let [x, y] = self.axes;
        [
            self.seq as f64,
            seconds(self.stamp_ns),
            x.position_m,
            x.speed_m_s,
            x.angle_rad,
            x.angle_rate_rad_s,
            y.position_m,
            y.speed_m_s,
            y.angle_rad,
            y.angle_rate_rad_s,
        ]
    }

    /// From the values of a message.
    #[must_use]
    pub fn from_values(values: [f64; 10]) -> Self {
        let [
            seq,
            stamp_s,
            x_m,
            x_rate,
            x_angle,
            x_angle_rate,
            y_m,
            y_rate,
            y_angle,
            y_angle_rate,
        ] = values;
        let axis = |position_m, speed_m_s, angle_rad, angle_rate_rad_s| AxisState {
            position_m,
            speed_m_s,
            angle_rad,
            angle_rate_rad_s,
        };
        Self {
            seq: seq as u64,
            stamp_ns: nanoseconds(stamp_s),
            axes: [
                axis(x_m, x_rate, x_angle, x_angle_rate),
                axis(y_m, y_rate, y_angle, y_angle_rate),
            ],
        }
    }
}

/// The controller's command at one of its ticks.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct CommandMessage {
    /// Counts the controller's ticks, from 1.
    pub seq: u64,
    /// When the tick was begun, on the experiment's clock.
    pub stamp_ns: i64,
    /// `[x, y]`.
    pub voltage_v: [f64; 2],
}

impl CommandMessage {
    /// Names of the values, in order.
    pub const FIELDS: [&str; 4] = ["seq", "stamp_s", "x_v", "y_v"];

    /// As the values of a message.
    #[must_use]
    pub fn to_values(self) -> [f64; 4] {
        let [x_v, y_v] = self.voltage_v;
        [self.seq as f64, seconds(self.stamp_ns), x_v, y_v]
    }

    /// From the values of a message.
    #[must_use]
    pub fn from_values([seq, stamp_s, x_v, y_v]: [f64; 4]) -> Self {
        Self {
            seq: seq as u64,
            stamp_ns: nanoseconds(stamp_s),
            voltage_v: [x_v, y_v],
        }
    }
}

fn seconds(ns: i64) -> f64 {
    ns as f64 / 1e9
}

fn nanoseconds(s: f64) -> i64 {
    (s * 1e9).round() as i64
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn a_state_arrives_as_it_was_sent(seq in 0_u64..1 << 50, stamp_ns in -1_000_000_000_i64..1 << 51, values: [f64; 4]) {
            let [position_m, speed_m_s, angle_rad, angle_rate_rad_s] = values;
            prop_assume!(values.iter().all(|value| !value.is_nan()));
            let axis = AxisState { position_m, speed_m_s, angle_rad, angle_rate_rad_s };
            let sent = StateMessage { seq, stamp_ns, axes: [axis, AxisState::default()] };
            prop_assert_eq!(StateMessage::from_values(sent.to_values()), sent);
        }

        #[test]
        fn a_command_arrives_as_it_was_sent(seq in 0_u64..1 << 50, stamp_ns in 0_i64..1 << 51, x in -1e3..1e3, y in -1e3..1e3) {
            let sent = CommandMessage { seq, stamp_ns, voltage_v: [x, y] };
            prop_assert_eq!(CommandMessage::from_values(sent.to_values()), sent);
        }
    }
}
