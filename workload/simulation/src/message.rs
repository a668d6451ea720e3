//! What the two topics carry, from plant to controller and back, in each of the forms of [`Messages`]. The main types are
//! [`StateMessage`] and [`CommandMessage`], and their writers [`StateEncoder`] and [`CommandEncoder`].
//!
//! Rows of doubles carry stamps as seconds on the experiment's clock, as ROS people expect them; a double keeps the nanosecond
//! for 52 days. The author's texts are in [`text`].

mod text;

pub use text::stamp_in_text;

use record::{plant_log::PlantRow, settings::Messages};

use crate::{
    plant::AxisState,
    ros::{
        float64_multi_array::{self, Encoder, decode},
        message_type::MessageType,
        string,
    },
    schedule::Tick,
};

/// A topic and what it carries.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Topic {
    /// The topic's name, with its slash.
    pub name: &'static str,
    /// Its type.
    pub message_type: MessageType,
}

impl Topic {
    /// The topic of the plant's state.
    #[must_use]
    pub const fn of_states(messages: Messages) -> Self {
        Self::of(messages, "/plant_state", "/state")
    }

    /// The topic of the controller's command.
    #[must_use]
    pub const fn of_commands(messages: Messages) -> Self {
        Self::of(messages, "/control_action", "/command")
    }

    const fn of(messages: Messages, of_text: &'static str, of_rows: &'static str) -> Self {
        match messages {
            Messages::Text => Self {
                name: of_text,
                message_type: string::MESSAGE_TYPE,
            },
            Messages::Positions | Messages::Rates => Self {
                name: of_rows,
                message_type: float64_multi_array::MESSAGE_TYPE,
            },
        }
    }
}

/// The plant's state at one of its ticks.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct StateMessage {
    /// Counts the plant's ticks, from 1. A text does not carry it: its receiver counts what it receives.
    pub seq: u64,
    /// When the tick was begun, on the experiment's clock; of an answer, the stamp of the command that it answers.
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

    /// Names of the values where rates are not among them, in order.
    pub const POSITIONS: [&str; 6] = ["seq", "stamp_s", "x_m", "angle_x_rad", "y_m", "angle_y_rad"];

    /// The same without rates.
    #[must_use]
    pub fn to_positions(self) -> [f64; 6] {
        let [seq, stamp_s, x_m, _, x_angle, _, y_m, _, y_angle, _] = self.to_values();
        [seq, stamp_s, x_m, x_angle, y_m, y_angle]
    }

    /// The row of `plant.csv` of the tick that it is the state of, with the command that was in force.
    #[must_use]
    pub fn row(&self, tick: &Tick, zero_ns: i64, command: &CommandMessage) -> PlantRow {
        let [x, y] = self.axes;
        PlantRow {
            step: tick.step,
            scheduled_ns: tick.due_ns - zero_ns,
            actual_ns: self.stamp_ns,
            x_m: x.position_m,
            y_m: y.position_m,
            angle_x_rad: x.angle_rad,
            angle_y_rad: y.angle_rad,
            command_stamp_ns: command.stamp_ns,
            command_x_v: command.voltage_v[0],
            command_y_v: command.voltage_v[1],
        }
    }

    /// From the values of a message without rates.
    #[must_use]
    pub fn from_positions([seq, stamp_s, x_m, x_angle, y_m, y_angle]: [f64; 6]) -> Self {
        Self::from_values([seq, stamp_s, x_m, 0.0, x_angle, 0.0, y_m, 0.0, y_angle, 0.0])
    }

    /// Reads a message. None for one that is of another kind, or has a value that is no number. A text has no number: its
    /// `seq` is 0.
    #[must_use]
    pub fn decode(messages: Messages, message: &[u8]) -> Option<Self> {
        match messages {
            Messages::Text => text::read_state(string::decode(message)?),
            Messages::Positions => finite(message).map(Self::from_positions),
            Messages::Rates => finite(message).map(Self::from_values),
        }
    }

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
    /// Reads a message, as [`StateMessage::decode`] does.
    #[must_use]
    pub fn decode(messages: Messages, message: &[u8]) -> Option<Self> {
        match messages {
            Messages::Text => text::read_command(string::decode(message)?),
            Messages::Positions | Messages::Rates => finite(message).map(Self::from_values),
        }
    }

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

/// Writes states into a buffer that is made beforehand.
#[derive(Debug, Clone)]
pub enum StateEncoder {
    /// The author's text.
    Text(Vec<u8>),
    /// Positions and angles.
    Positions(Encoder<6>),
    /// The rates too.
    Rates(Encoder<10>),
}

impl StateEncoder {
    /// For messages of that form.
    #[must_use]
    pub fn new(messages: Messages) -> Self {
        match messages {
            Messages::Text => Self::Text(Vec::with_capacity(text::MOST_BYTES)),
            Messages::Positions => Self::Positions(Encoder::new(StateMessage::POSITIONS)),
            Messages::Rates => Self::Rates(Encoder::new(StateMessage::FIELDS)),
        }
    }

    /// The message. Does not allocate.
    pub fn encode(&mut self, state: &StateMessage) -> &[u8] {
        match self {
            Self::Text(buffer) => {
                string::encode(buffer, |out| text::write_state(out, state));
                buffer
            }
            Self::Positions(encoder) => encoder.encode(&state.to_positions()),
            Self::Rates(encoder) => encoder.encode(&state.to_values()),
        }
    }
}

/// Writes commands into a buffer that is made beforehand.
#[derive(Debug, Clone)]
pub enum CommandEncoder {
    /// The author's text.
    Text(Vec<u8>),
    /// A row of doubles.
    Row(Encoder<4>),
}

impl CommandEncoder {
    /// For messages of that form.
    #[must_use]
    pub fn new(messages: Messages) -> Self {
        match messages {
            Messages::Text => Self::Text(Vec::with_capacity(text::MOST_BYTES)),
            Messages::Positions | Messages::Rates => Self::Row(Encoder::new(CommandMessage::FIELDS)),
        }
    }

    /// The message. Does not allocate.
    pub fn encode(&mut self, command: &CommandMessage) -> &[u8] {
        match self {
            Self::Text(buffer) => {
                string::encode(buffer, |out| text::write_command(out, command));
                buffer
            }
            Self::Row(encoder) => encoder.encode(&command.to_values()),
        }
    }
}

/// The values of a row. None for one that is of another kind, or has a value that is no number: a plant that was given one
/// voltage of infinity never comes back from it.
fn finite<const N: usize>(message: &[u8]) -> Option<[f64; N]> {
    let values = decode::<N>(message).ok()?;
    values.iter().all(|value| value.is_finite()).then_some(values)
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
    use rstest::rstest;

    use super::*;

    const ALL: [Messages; 3] = [Messages::Text, Messages::Positions, Messages::Rates];

    fn state_over_the_wire(messages: Messages, sent: &StateMessage) -> Option<StateMessage> {
        StateMessage::decode(messages, StateEncoder::new(messages).encode(sent))
    }

    fn command_over_the_wire(messages: Messages, sent: &CommandMessage) -> Option<CommandMessage> {
        CommandMessage::decode(messages, CommandEncoder::new(messages).encode(sent))
    }

    fn state(position_m: f64, angle_rad: f64) -> AxisState {
        AxisState {
            position_m,
            angle_rad,
            ..AxisState::default()
        }
    }

    #[test]
    fn a_text_has_the_authors_form_and_four_decimals() {
        let sent = StateMessage {
            seq: 9,
            stamp_ns: 1_234_567_890,
            axes: [state(0.123_46, -1.000_04), state(-2.5, 0.907_15)],
        };
        let mut encoder = StateEncoder::new(Messages::Text);
        let text = b"[0.1235 -2.5000 -1.0000 0.9072 1.234568]";
        assert_eq!(&encoder.encode(&sent)[4..], text);
        let received = state_over_the_wire(Messages::Text, &sent).unwrap();
        assert_eq!((received.seq, received.stamp_ns), (0, 1_234_568_000));
        assert_eq!(received.axes, [state(0.1235, -1.0), state(-2.5, 0.9072)]);
    }

    #[test]
    fn a_command_in_text_has_the_authors_form_and_four_decimals() {
        let sent = CommandMessage {
            seq: 9,
            stamp_ns: 40_000_000,
            voltage_v: [12.345_67, -0.5],
        };
        let mut encoder = CommandEncoder::new(Messages::Text);
        let text = b"/u?&value0=12.3457&value1=-0.5000&time=0.040000&access=8783392&]";
        assert_eq!(&encoder.encode(&sent)[4..], text);
        let received = command_over_the_wire(Messages::Text, &sent).unwrap();
        assert_eq!((received.seq, received.stamp_ns), (0, 40_000_000));
        assert_eq!(received.voltage_v, [12.3457, -0.5]);
    }

    #[rstest]
    #[case(f64::NAN)]
    #[case(f64::NEG_INFINITY)]
    fn a_value_that_is_no_number_is_no_message(#[case] value: f64) {
        for messages in ALL {
            let command = CommandMessage {
                voltage_v: [value, 4.0],
                ..CommandMessage::default()
            };
            assert_eq!(command_over_the_wire(messages, &command), None, "{messages:?}");
            let state = StateMessage {
                axes: [state(value, 0.0), AxisState::default()],
                ..StateMessage::default()
            };
            assert_eq!(state_over_the_wire(messages, &state), None, "{messages:?}");
        }
    }

    proptest! {
        #[test]
        fn a_state_arrives_as_it_was_sent(seq in 0_u64..1 << 50, stamp_ns in -1_000_000_000_i64..1 << 51, values: [f64; 4]) {
            let [position_m, speed_m_s, angle_rad, angle_rate_rad_s] = values;
            prop_assume!(values.iter().all(|value| value.is_finite()));
            let axis = AxisState { position_m, speed_m_s, angle_rad, angle_rate_rad_s };
            let sent = StateMessage { seq, stamp_ns, axes: [axis, AxisState::default()] };
            prop_assert_eq!(state_over_the_wire(Messages::Rates, &sent), Some(sent));
            let without_rates = StateMessage { axes: [state(position_m, angle_rad), AxisState::default()], ..sent };
            prop_assert_eq!(state_over_the_wire(Messages::Positions, &sent), Some(without_rates));
        }

        #[test]
        fn a_command_arrives_as_it_was_sent(seq in 0_u64..1 << 50, stamp_ns in 0_i64..1 << 51, x in -1e3..1e3, y in -1e3..1e3) {
            let sent = CommandMessage { seq, stamp_ns, voltage_v: [x, y] };
            prop_assert_eq!(command_over_the_wire(Messages::Rates, &sent), Some(sent));
            let text = command_over_the_wire(Messages::Text, &sent).unwrap();
            prop_assert!((text.voltage_v[0] - x).abs() <= 0.5e-4 + 1e-9 && (text.stamp_ns - stamp_ns).abs() <= 501);
        }

        #[test]
        fn nothing_that_a_stranger_sends_makes_a_reader_panic(bytes: Vec<u8>, text in "[\\[\\] 0-9.&=/u?e-]{0,80}") {
            let mut message = Vec::new();
            string::encode(&mut message, |out| out.extend_from_slice(text.as_bytes()));
            for messages in ALL {
                for message in [&bytes, &message] {
                    let _ = StateMessage::decode(messages, message);
                    let _ = CommandMessage::decode(messages, message);
                }
            }
        }
    }
}
