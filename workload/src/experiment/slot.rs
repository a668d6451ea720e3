//! The newest message at its receiver, from the thread that receives to the loop that uses it. The main functions are
//! [`states`] and [`commands`]: each gives a subscription's callback and the reader for the loop.

use super::message::{CommandMessage, StateMessage};
use crate::{
    realtime::{
        latest::{LatestReader, latest},
        monotonic_ns,
    },
    ros::float64_multi_array::decode,
};

const STATE_WORDS: usize = StateMessage::FIELDS.len();
const COMMAND_WORDS: usize = CommandMessage::FIELDS.len();

/// Reads the newest state.
#[derive(Debug)]
pub struct StateReader {
    values: LatestReader<{ STATE_WORDS + 1 }>,
}

/// Reads the newest command.
#[derive(Debug)]
pub struct CommandReader {
    values: LatestReader<COMMAND_WORDS>,
}

impl StateReader {
    /// The newest state and when it was received, on the monotonic clock.
    #[must_use]
    pub fn read(&self) -> Option<(StateMessage, i64)> {
        let [values @ .., received_ns] = self.values.read()?;
        Some((
            StateMessage::from_values(values.map(f64::from_bits)),
            received_ns as i64,
        ))
    }
}

impl CommandReader {
    /// The newest command.
    #[must_use]
    pub fn read(&self) -> Option<CommandMessage> {
        Some(CommandMessage::from_values(
            self.values.read()?.map(f64::from_bits),
        ))
    }
}

/// The values of a message. None for one that is of another kind, or has a value that is no number: a plant that was
/// given one voltage of infinity never comes back from it.
fn finite<const N: usize>(message: &[u8]) -> Option<[f64; N]> {
    let values = decode::<N>(message).ok()?;
    values.iter().all(|value| value.is_finite()).then_some(values)
}

/// For the topic of states. A message that is none is passed over: it cannot be ours.
pub fn states() -> (impl FnMut(&[u8]) + Send + 'static, StateReader) {
    let (mut writer, values) = latest::<{ STATE_WORDS + 1 }>();
    let receive = move |message: &[u8]| {
        let received_ns = monotonic_ns();
        if let Some(values) = finite::<STATE_WORDS>(message) {
            let mut words = [0; STATE_WORDS + 1];
            let sources = values
                .iter()
                .map(|value| value.to_bits())
                .chain([received_ns as u64]);
            words
                .iter_mut()
                .zip(sources)
                .for_each(|(word, source)| *word = source);
            writer.publish(&words);
        }
    };
    (receive, StateReader { values })
}

/// For the topic of commands.
pub fn commands() -> (impl FnMut(&[u8]) + Send + 'static, CommandReader) {
    let (mut writer, values) = latest::<COMMAND_WORDS>();
    let receive = move |message: &[u8]| {
        if let Some(values) = finite::<COMMAND_WORDS>(message) {
            writer.publish(&values.map(f64::to_bits));
        }
    };
    (receive, CommandReader { values })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ros::float64_multi_array::Encoder;

    #[test]
    fn a_loop_reads_the_newest_state_and_when_it_came() {
        let (mut receive, reader) = states();
        assert_eq!(reader.read(), None);
        let before_ns = monotonic_ns();
        let mut encoder = Encoder::new(StateMessage::FIELDS);
        for seq in 1..=3 {
            let message = StateMessage {
                seq,
                stamp_ns: 7,
                ..StateMessage::default()
            };
            receive(encoder.encode(&message.to_values()));
        }
        let (state, received_ns) = reader.read().unwrap();
        assert_eq!((state.seq, state.stamp_ns), (3, 7));
        assert!(received_ns >= before_ns);
    }

    #[test]
    fn a_message_of_another_kind_is_passed_over() {
        let (mut receive, reader) = commands();
        receive(Encoder::new(["seq"]).encode(&[1.0]));
        assert_eq!(reader.read(), None);
    }

    #[rstest::rstest]
    #[case(f64::NAN)]
    #[case(f64::NEG_INFINITY)]
    fn a_value_that_is_no_number_does_not_reach_a_loop(#[case] value: f64) {
        let (mut receive, reader) = commands();
        let mut encoder = Encoder::new(CommandMessage::FIELDS);
        receive(encoder.encode(&[1.0, 0.02, 3.0, 4.0]));
        receive(encoder.encode(&[2.0, 0.04, value, 4.0]));
        assert_eq!(reader.read().unwrap().seq, 1);
    }
}
