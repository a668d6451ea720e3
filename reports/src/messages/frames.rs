//! Finds the experiment's messages in a stream of TCPROS that a capture may have begun, or lost, in the midst of. The
//! main type is [`FrameFinder`].
//!
//! A message is a length of 32 bits and a `std_msgs/Float64MultiArray`, whose own lengths must agree with it, or a
//! `std_msgs/String` of the author's form. Where the finder does not know where a message begins, it takes the first place at
//! which one is whole: by chance bytes agree with each other in so many places next to never.

use record::settings::Messages;
use simulation::message::{CommandMessage, StateMessage};

use captures::packets::Topic;

/// What a message says of itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Label {
    /// The publisher's number; 0 where messages carry none.
    pub seq: u64,
    /// When the publisher's step began, on the experiment's clock.
    pub stamp_ns: i64,
}

/// A message in a stream: at `begin..end` of the bytes that were searched.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Found {
    pub begin: usize,
    pub end: usize,
    pub label: Label,
}

const PREFIX: usize = 4;
/// Ours have at most 300 bytes; those of others, without the names of the fields, fewer. A definite bound keeps a length
/// that lies from being waited for.
const LONGEST: usize = 4096;

/// Searches one direction of one connection.
#[derive(Debug)]
pub(super) struct FrameFinder {
    topic: Topic,
    messages: Messages,
    /// Whether the next byte is known to begin a frame.
    in_step: bool,
}

impl FrameFinder {
    pub fn new(topic: Topic, messages: Messages) -> Self {
        Self {
            topic,
            messages,
            in_step: false,
        }
    }

    /// Bytes are missing before the ones that come next.
    pub fn lose_step(&mut self) {
        self.in_step = false;
    }

    /// Gives each message in `bytes` to `found`. What is left at the end belongs to a message that is not whole yet: it
    /// has to be the beginning of what is searched next. Returns how many bytes are done with.
    pub fn search(&mut self, bytes: &[u8], mut found: impl FnMut(Found)) -> usize {
        let mut at = 0;
        // Where a message may begin, if no whole one shows that it does not.
        let mut perhaps = None;
        while let Some((length, rest)) = bytes.get(at..).and_then(<[u8]>::split_first_chunk::<PREFIX>) {
            let length = u32::from_le_bytes(*length) as usize;
            let frame = rest.get(..length);
            if let Some(label) = frame.and_then(|frame| self.label(frame)) {
                let end = at + PREFIX + length;
                found(Found {
                    begin: at,
                    end,
                    label,
                });
                self.in_step = true;
                perhaps = None;
                at = end;
                continue;
            }
            if frame.is_none() && length <= LONGEST {
                if self.in_step {
                    return at;
                }
                if self.may_begin(rest, length) {
                    perhaps.get_or_insert(at);
                }
            }
            // Where one is due there may be another frame than ours, such as the connection's header.
            self.in_step = false;
            at += 1;
        }
        perhaps.unwrap_or(at)
    }

    fn label(&self, message: &[u8]) -> Option<Label> {
        let (seq, stamp_ns) = match self.topic {
            Topic::State => {
                let state = StateMessage::decode(self.messages, message)?;
                (state.seq, state.stamp_ns)
            }
            Topic::Command => {
                let command = CommandMessage::decode(self.messages, message)?;
                (command.seq, command.stamp_ns)
            }
        };
        Some(Label { seq, stamp_ns })
    }

    /// Whether what there is of a frame can be the beginning of one of ours, so that waiting for the rest is worth it.
    fn may_begin(&self, rest: &[u8], length: usize) -> bool {
        let values = match (self.messages, self.topic) {
            (Messages::Text, _) => return may_begin_text(rest, length),
            (Messages::Positions, Topic::State) => StateMessage::POSITIONS.len(),
            (Messages::Rates, Topic::State) => StateMessage::FIELDS.len(),
            (_, Topic::Command) => CommandMessage::FIELDS.len(),
        };
        // Dimensions, offset, count, values; each dimension adds its label's length, size and stride.
        let least = 12 + 8 * values;
        match rest.first_chunk::<4>() {
            Some(dimensions) => u32::from_le_bytes(*dimensions) as usize * 12 + least <= length,
            None => length >= least,
        }
    }
}

/// The text's own length is four bytes less than the message's.
fn may_begin_text(rest: &[u8], length: usize) -> bool {
    match rest.first_chunk::<4>() {
        Some(text) => Some(u32::from_le_bytes(*text) as usize) == length.checked_sub(4),
        None => length > 4,
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use simulation::{message::CommandEncoder, ros::float64_multi_array::Encoder};

    use super::*;

    fn command(seq: u64) -> Vec<u8> {
        let message = CommandMessage {
            seq,
            stamp_ns: seq as i64 * 20_000_000,
            voltage_v: [0.5, -0.25],
        };
        let mut encoder = Encoder::new(CommandMessage::FIELDS);
        let message = encoder.encode(&message.to_values());
        [&(message.len() as u32).to_le_bytes(), message].concat()
    }

    /// Hands over the stream in pieces, as acknowledgements would.
    fn search(stream: &[u8], pieces: &[usize]) -> Vec<u64> {
        let mut finder = FrameFinder::new(Topic::Command, Messages::Rates);
        let mut found = Vec::new();
        let (mut begin, mut end) = (0, 0);
        for piece in pieces.iter().copied().chain([stream.len()]) {
            end = (end + piece).min(stream.len());
            begin += finder.search(&stream[begin..end], |message| found.push(message.label.seq));
        }
        found
    }

    #[test]
    fn messages_are_found_after_a_connection_header() {
        let header = b"\x1f\0\0\0\x1b\0\0\0callerid=/controller-number-1";
        let stream = [&header[..], &command(1), &command(2)].concat();
        assert_eq!(search(&stream, &[]), [1, 2]);
    }

    #[test]
    fn texts_are_found_by_their_stamps_wherever_the_capture_begins() {
        let mut encoder = CommandEncoder::new(Messages::Text);
        let mut frame = |seq: i64| {
            let message = encoder.encode(&CommandMessage {
                stamp_ns: seq * 20_000_000,
                ..CommandMessage::default()
            });
            [&(message.len() as u32).to_le_bytes(), message].concat()
        };
        let stream = [frame(1), frame(2), frame(3)].concat();
        for skipped in 0..stream.len() / 3 {
            let mut found = Vec::new();
            let mut finder = FrameFinder::new(Topic::Command, Messages::Text);
            let done = finder.search(&stream[skipped..], |message| found.push(message.label));
            let all = [20_000_000, 40_000_000, 60_000_000].map(|stamp_ns| Label { seq: 0, stamp_ns });
            assert_eq!(found, all[usize::from(skipped > 0)..], "{skipped}");
            assert_eq!(skipped + done, stream.len());
        }
    }

    #[test]
    fn a_stream_that_is_something_else_has_none_and_leaves_little() {
        let text = b"POST /RPC2 HTTP/1.1\r\nHost: h1:11311\r\n\r\n<?xml version=\"1.0\"?>".repeat(200);
        let mut finder = FrameFinder::new(Topic::State, Messages::Rates);
        let done = finder.search(&text, |found| panic!("{found:?}"));
        assert!(text.len() - done < LONGEST + PREFIX);
    }

    #[test]
    fn a_message_of_rospy_without_names_is_found() {
        let values: Vec<u8> = [3.0_f64, 0.06, 0.5, -0.25]
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect();
        let message = [&44_u32.to_le_bytes()[..], &[0; 8], &4_u32.to_le_bytes(), &values].concat();
        assert_eq!(search(&message, &[]), [3]);
    }

    proptest! {
        #[test]
        fn from_wherever_a_capture_begins_every_whole_message_is_found(
            count in 1_u64..6, skipped in 0_usize..400, pieces in prop::collection::vec(0_usize..300, 0..12)
        ) {
            let messages: Vec<Vec<u8>> = (1..=count).map(command).collect();
            let stream = messages.concat();
            let skipped = skipped.min(stream.len());
            let length = messages[0].len();
            let whole: Vec<u64> = (1..=count).filter(|seq| (*seq as usize - 1) * length >= skipped).collect();
            prop_assert_eq!(search(&stream[skipped..], &pieces), whole);
        }

        #[test]
        fn after_a_loss_it_finds_its_step_again(lost in 1_usize..400) {
            let messages: Vec<Vec<u8>> = (1..=8).map(command).collect();
            let stream = messages.concat();
            let length = messages[0].len();
            let mut finder = FrameFinder::new(Topic::Command, Messages::Rates);
            let mut found = Vec::new();
            finder.search(&stream[..length], |message| found.push(message.label.seq));
            finder.lose_step();
            finder.search(&stream[length + lost..], |message| found.push(message.label.seq));
            let whole: Vec<u64> = (1..=8).filter(|seq| *seq == 1 || (*seq as usize - 1) * length >= length + lost).collect();
            prop_assert_eq!(found, whole);
        }

        #[test]
        fn no_bytes_make_it_panic(bytes: Vec<u8>) {
            prop_assert!(FrameFinder::new(Topic::State, Messages::Rates).search(&bytes, |_| ()) <= bytes.len());
        }
    }
}
