//! The newest message at its receiver, from the thread that receives to the loop that uses it, and the plant's newest state
//! from its loop to the thread that answers commands. The main functions are [`states`] and [`commands`]: each gives the
//! thread's end and the reader for the loop.

use record::settings::Messages;
use simulation::message::{CommandMessage, StateMessage};

use crate::realtime::{
    latest::{LatestReader, LatestWriter, latest},
    monotonic_ns,
};

const STATE_WORDS: usize = StateMessage::FIELDS.len() + 1;
const COMMAND_WORDS: usize = CommandMessage::FIELDS.len();

/// Keeps the newest state.
#[derive(Debug)]
pub struct StateWriter {
    values: LatestWriter<STATE_WORDS>,
}

/// Reads the newest state.
#[derive(Debug)]
pub struct StateReader {
    values: LatestReader<STATE_WORDS>,
}

/// Keeps the newest command.
#[derive(Debug)]
pub struct CommandWriter {
    values: LatestWriter<COMMAND_WORDS>,
}

/// Reads the newest command.
#[derive(Debug)]
pub struct CommandReader {
    values: LatestReader<COMMAND_WORDS>,
}

/// A place for the newest state.
#[must_use]
pub fn states() -> (StateWriter, StateReader) {
    let (writer, reader) = latest();
    (StateWriter { values: writer }, StateReader { values: reader })
}

/// A place for the newest command.
#[must_use]
pub fn commands() -> (CommandWriter, CommandReader) {
    let (writer, reader) = latest();
    (CommandWriter { values: writer }, CommandReader { values: reader })
}

impl StateWriter {
    /// Keeps a state that was received at that time on the monotonic clock.
    pub fn keep(&mut self, state: &StateMessage, received_ns: i64) {
        let mut words = [0; STATE_WORDS];
        let values = state.to_values().into_iter().map(f64::to_bits);
        words
            .iter_mut()
            .zip(values.chain([received_ns as u64]))
            .for_each(|(word, value)| *word = value);
        self.values.publish(&words);
    }

    /// Keeps each state that arrives as a message. One that is none is passed over: it cannot be ours.
    pub fn receive(mut self, messages: Messages) -> impl FnMut(&[u8]) + Send + 'static {
        let mut received = 0;
        move |message: &[u8]| {
            let received_ns = monotonic_ns();
            if let Some(mut state) = StateMessage::decode(messages, message) {
                received += 1;
                if messages == Messages::Text {
                    state.seq = received;
                }
                self.keep(&state, received_ns);
            }
        }
    }
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

impl CommandWriter {
    /// Keeps a command.
    pub fn keep(&mut self, command: &CommandMessage) {
        self.values.publish(&command.to_values().map(f64::to_bits));
    }

    /// Keeps each command that arrives as a message.
    pub fn receive(mut self, messages: Messages) -> impl FnMut(&[u8]) + Send + 'static {
        move |message: &[u8]| {
            if let Some(command) = CommandMessage::decode(messages, message) {
                self.keep(&command);
            }
        }
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

#[cfg(test)]
mod tests {
    use simulation::message::StateEncoder;

    use super::*;

    fn receive_three(messages: Messages) -> (StateMessage, i64) {
        let (writer, reader) = states();
        let mut receive = writer.receive(messages);
        assert_eq!(reader.read(), None);
        let mut encoder = StateEncoder::new(messages);
        for seq in 5..=7 {
            let message = StateMessage {
                seq,
                stamp_ns: 7_000,
                ..StateMessage::default()
            };
            receive(encoder.encode(&message));
        }
        reader.read().unwrap()
    }

    #[test]
    fn a_loop_reads_the_newest_state_and_when_it_came() {
        let before_ns = monotonic_ns();
        let (state, received_ns) = receive_three(Messages::Rates);
        assert_eq!((state.seq, state.stamp_ns), (7, 7_000));
        assert!(received_ns >= before_ns);
    }

    #[test]
    fn texts_without_a_number_are_counted_by_their_receiver() {
        let (state, _) = receive_three(Messages::Text);
        assert_eq!((state.seq, state.stamp_ns), (3, 7_000));
    }

    #[test]
    fn a_message_of_another_kind_is_passed_over() {
        let (writer, reader) = states();
        writer.receive(Messages::Rates)(b"[0.1 0.2 0.3 0.4 0.5]");
        assert_eq!(reader.read(), None);
    }
}
