//! One direction of one TCP connection at its sender: what was retransmitted, and how long an acknowledgement took. The
//! main type is [`Connection`].

use std::collections::VecDeque;

use crate::packets::{Furthest, Passage, Segment, count_on};

/// Segments that nobody acknowledges are not kept beyond this many: the capture has only one direction.
const MOST: usize = 1 << 16;
/// The place of the first sequence number that is seen: what comes before it can still be counted.
const ORIGIN: u64 = 1 << 32;

/// What is under way of one direction of one connection.
#[derive(Debug, Default)]
pub(super) struct Connection {
    /// A place near those to come.
    near: Option<u64>,
    furthest: Furthest,
    unacknowledged: VecDeque<Unacknowledged>,
}

#[derive(Debug)]
struct Unacknowledged {
    begin: u64,
    end: u64,
    sent_unix_ns: i64,
    /// Whether some of it was sent more than once: nobody knows which of them an acknowledgement is for.
    is_ambiguous: bool,
}

/// A measured RTT: from when a segment left to when its acknowledgement came back, both at the sender's capture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Rtt {
    pub sent_unix_ns: i64,
    pub took_ns: i64,
}

impl Connection {
    /// A segment that opens a connection, or has data, leaves. Whether it is retransmitted; none if it has no data.
    pub fn send(&mut self, segment: &Segment<'_>, at_unix_ns: i64) -> Option<bool> {
        if segment.opens {
            *self = Self::default();
        }
        let sequence = match self.near {
            Some(near) => count_on(near, segment.sequence),
            None => ORIGIN + u64::from(segment.sequence),
        };
        let begin = sequence + u64::from(segment.opens);
        self.near = Some(self.near.map_or(begin, |near| near.max(begin)));
        if segment.payload_bytes == 0 {
            return None;
        }
        let end = begin + u64::from(segment.payload_bytes);
        let coming = self.furthest.pass(begin, end, segment.departure());
        let is_retransmitted = matches!(coming.passage_of(begin), Passage::Retransmitted | Passage::Late);
        if is_retransmitted {
            let overlapping = |sent: &&mut Unacknowledged| sent.begin < end && sent.end > begin;
            let sent_before = self.unacknowledged.iter_mut().filter(overlapping);
            sent_before.for_each(|sent| sent.is_ambiguous = true);
        } else {
            if self.unacknowledged.len() == MOST {
                self.unacknowledged.pop_front();
            }
            self.unacknowledged.push_back(Unacknowledged {
                begin,
                end,
                sent_unix_ns: at_unix_ns,
                is_ambiguous: false,
            });
        }
        Some(is_retransmitted)
    }

    /// An acknowledgement comes. The RTT of the last segment that it is for, unless some of what it is for was
    /// sent more than once (Karn and Partridge, *Improving Round-Trip Time Estimates in Reliable Transport Protocols*,
    /// 1987; RFC 6298, section 3): the segment may have arrived long before, and waited for what was lost ahead of it.
    pub fn acknowledge(&mut self, number: u32, at_unix_ns: i64) -> Option<Rtt> {
        let place = count_on(self.near?, number);
        let mut is_ambiguous = false;
        let mut last = None;
        while let Some(front) = self.unacknowledged.front().filter(|front| front.end <= place) {
            is_ambiguous |= front.is_ambiguous;
            last = Some(front.sent_unix_ns);
            self.unacknowledged.pop_front();
        }
        last.filter(|_| !is_ambiguous).map(|sent_unix_ns| Rtt {
            sent_unix_ns,
            took_ns: at_unix_ns - sent_unix_ns,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn segment(sequence: u32, payload_bytes: u32, clock: u32) -> Segment<'static> {
        Segment {
            source: "10.0.0.3:1".parse().unwrap(),
            destination: "10.0.0.2:2".parse().unwrap(),
            identification: 0,
            sequence,
            acknowledged: Some(1),
            opens: false,
            sent_clock: Some(clock),
            payload_bytes,
            payload: &[],
        }
    }

    #[test]
    fn an_acknowledgement_is_for_the_last_segment_that_it_covers() {
        let mut connection = Connection::default();
        assert_eq!(connection.send(&segment(100, 10, 1), 1_000), Some(false));
        assert_eq!(connection.send(&segment(110, 10, 2), 2_000), Some(false));
        let both = connection.acknowledge(120, 5_000);
        let expected = Rtt {
            sent_unix_ns: 2_000,
            took_ns: 3_000,
        };
        assert_eq!(both, Some(expected));
        assert_eq!(connection.acknowledge(120, 6_000), None, "it says nothing new");
    }

    #[test]
    fn a_retransmitted_segment_has_no_rtt() {
        let mut connection = Connection::default();
        connection.send(&segment(100, 10, 1), 1_000);
        connection.send(&segment(110, 10, 2), 2_000);
        assert_eq!(connection.send(&segment(100, 10, 250), 250_000), Some(true));
        assert_eq!(connection.acknowledge(120, 260_000), None);
        connection.send(&segment(120, 10, 270), 270_000);
        assert!(connection.acknowledge(130, 280_000).is_some());
    }

    #[test]
    fn sequence_numbers_wrap() {
        let mut connection = Connection::default();
        connection.send(&segment(u32::MAX - 4, 10, 1), 1_000);
        assert_eq!(connection.send(&segment(5, 10, 2), 2_000), Some(false));
        assert_eq!(connection.acknowledge(5, 3_000).unwrap().took_ns, 2_000);
        assert_eq!(connection.acknowledge(15, 3_500).unwrap().took_ns, 1_500);
    }

    #[test]
    fn a_connection_of_the_same_ports_begins_anew() {
        let mut connection = Connection::default();
        connection.send(&segment(5_000, 10, 1), 1_000);
        let syn = Segment {
            opens: true,
            ..segment(90, 0, 2)
        };
        assert_eq!(connection.send(&syn, 2_000), None);
        assert_eq!(connection.send(&segment(91, 10, 3), 3_000), Some(false));
    }

    #[test]
    fn memory_is_bounded_where_nothing_is_acknowledged() {
        let mut connection = Connection::default();
        for number in 0..2 * MOST as u32 {
            connection.send(&segment(number * 10, 10, number), i64::from(number));
        }
        assert_eq!(connection.unacknowledged.len(), MOST);
    }
}
