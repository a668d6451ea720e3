//! One direction of one TCP connection at its sender: what was retransmitted, and how long an acknowledgement took. The
//! main type is [`Connection`].

use std::collections::{BTreeMap, VecDeque};

use crate::packets::{Furthest, Passage, Segment, count_on};

/// Segments that nobody acknowledges are not kept beyond this many: the capture has only one direction. The largest window of
/// Linux, 6 MiB, is some 4300 segments of Ethernet; smaller ones take the room of some 800 bytes each of its buffer of 4 MiB.
const MOST: usize = 1 << 16;
/// The place of the first sequence number that is seen: what comes before it can still be counted.
const ORIGIN: u64 = 1 << 32;

/// What is under way of one direction of one connection.
#[derive(Debug, Default)]
pub(super) struct Connection {
    /// A place near those to come.
    near: Option<u64>,
    furthest: Furthest,
    /// In the order in which they were sent.
    unacknowledged: VecDeque<Unacknowledged>,
    /// How many were sent before those.
    passed: u64,
    repeated: Repeated,
    /// When something was last sent or acknowledged.
    last_unix_ns: i64,
}

#[derive(Debug)]
struct Unacknowledged {
    begin: u64,
    end: u64,
    sent_unix_ns: i64,
}

/// What was sent more than once: nobody knows which of the times an acknowledgement is for.
#[derive(Debug, Default)]
struct Repeated {
    /// Disjoint stretches by where they begin, with their end and how many segments had been sent when they were sent again.
    stretches: BTreeMap<u64, (u64, u64)>,
    /// At how many those that say nothing any more are looked for.
    sweep_at: usize,
}

impl Repeated {
    /// A stretch is sent again, after so many segments.
    fn add(&mut self, begin: u64, end: u64, after: u64) {
        self.cut(begin);
        self.cut(end);
        while let Some((within, _)) = self.stretches.range(begin..end).next() {
            let within = *within;
            self.stretches.remove(&within);
        }
        self.stretches.insert(begin, (end, after));
    }

    /// Makes two of the stretch that goes over a place.
    fn cut(&mut self, place: u64) {
        if let Some((_, stretch)) = self.stretches.range_mut(..place).next_back()
            && stretch.0 > place
        {
            let behind = *stretch;
            stretch.0 = place;
            self.stretches.insert(place, behind);
        }
    }

    /// Whether some of the number-th segment was sent again after it, when the segments before it are forgotten: what was sent
    /// again before this one says nothing of those to come either.
    fn has_some_of(&mut self, begin: u64, end: u64, number: u64) -> bool {
        while let Some((from, (to, after))) = self.stretches.range(..end).next_back()
            && *to > begin
        {
            if *after > number {
                return true;
            }
            let from = *from;
            self.stretches.remove(&from);
        }
        false
    }

    /// Forgets what was sent again before the number-th segment, whenever there is twice as much as was left the last time.
    fn sweep(&mut self, number: u64) {
        if self.stretches.len() > self.sweep_at {
            self.stretches.retain(|_, (_, after)| *after > number);
            self.sweep_at = 2 * self.stretches.len() + 16;
        }
    }
}

/// A measured RTT: from when a segment left to when its acknowledgement came back, both at the sender's capture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Rtt {
    pub sent_unix_ns: i64,
    pub took_ns: i64,
}

impl Connection {
    /// How much is kept of it: places of memory of the same size.
    pub fn kept(&self) -> usize {
        self.unacknowledged.len() + self.repeated.stretches.len()
    }

    /// Whether nothing has come for so long that nothing is going to.
    pub const fn is_silent_since(&self, unix_ns: i64) -> bool {
        self.last_unix_ns < unix_ns
    }

    /// A segment that opens a connection, or has data, leaves. Whether it is retransmitted; none if it has no data.
    pub fn send(&mut self, segment: &Segment<'_>, at_unix_ns: i64) -> Option<bool> {
        if segment.opens {
            *self = Self::default();
        }
        self.last_unix_ns = at_unix_ns;
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
            let sent = self.passed + self.unacknowledged.len() as u64;
            self.repeated.sweep(self.passed);
            self.repeated.add(begin, end, sent);
        } else {
            if self.unacknowledged.len() == MOST {
                self.unacknowledged.pop_front();
                self.passed += 1;
            }
            self.unacknowledged.push_back(Unacknowledged {
                begin,
                end,
                sent_unix_ns: at_unix_ns,
            });
        }
        Some(is_retransmitted)
    }

    /// An acknowledgement comes. The RTT of the last segment that it is for, unless some of what it is for was
    /// sent more than once (Karn and Partridge, *Improving Round-Trip Time Estimates in Reliable Transport Protocols*,
    /// 1987; RFC 6298, section 3): the segment may have arrived long before, and waited for what was lost ahead of it.
    pub fn acknowledge(&mut self, number: u32, at_unix_ns: i64) -> Option<Rtt> {
        self.last_unix_ns = at_unix_ns;
        let place = count_on(self.near?, number);
        let mut is_ambiguous = false;
        let mut last = None;
        while let Some(front) = self.unacknowledged.front().filter(|front| front.end <= place) {
            is_ambiguous |= self.repeated.has_some_of(front.begin, front.end, self.passed);
            last = Some(front.sent_unix_ns);
            self.unacknowledged.pop_front();
            self.passed += 1;
        }
        last.filter(|_| !is_ambiguous).map(|sent_unix_ns| Rtt {
            sent_unix_ns,
            took_ns: at_unix_ns - sent_unix_ns,
        })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

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
    fn what_is_retransmitted_among_many_is_found_at_once() {
        let began = std::time::Instant::now();
        let mut connection = Connection::default();
        let many = MOST as u32;
        for number in 0..many {
            connection.send(&segment(number * 10, 10, 1), i64::from(number));
        }
        for number in 0..4 * many {
            let place = number.wrapping_mul(7919) % many;
            let is_retransmitted = connection.send(&segment(place * 10, 10, 2), 1_000_000);
            assert_eq!(is_retransmitted, Some(true));
        }
        assert_eq!(connection.repeated.stretches.len(), MOST);
        connection.send(&segment(many * 10, 10, 3), 2_000_000);
        assert_eq!(connection.acknowledge(many * 10, 3_000_000), None);
        assert!(connection.acknowledge(many * 10 + 10, 3_000_000).is_some());
        // It takes a tenth of a second. To look at each that is not acknowledged takes ten seconds and more.
        assert!(began.elapsed().as_secs() < 4, "{:?}", began.elapsed());
    }

    #[test]
    fn what_was_sent_again_is_forgotten_with_what_it_is_about() {
        let mut connection = Connection::default();
        for number in 0..100_000_u32 {
            connection.send(&segment(number * 10, 10, number * 20), 1_000);
            connection.send(&segment(number * 10, 10, number * 20 + 10), 1_000);
            // One is always under way.
            connection.acknowledge(number * 10, 2_000);
        }
        let left = connection.repeated.stretches.len();
        assert!(left < 40, "{left}");
    }

    /// What was under way as it was looked through before: each that is not acknowledged.
    #[derive(Default)]
    struct Model(Vec<(u64, u64, i64, bool)>);

    impl Model {
        fn send(&mut self, begin: u64, end: u64, at: i64, is_retransmitted: bool) {
            if is_retransmitted {
                let overlapping = self.0.iter_mut().filter(|sent| sent.0 < end && sent.1 > begin);
                overlapping.for_each(|sent| sent.3 = true);
            } else {
                self.0.push((begin, end, at, false));
            }
        }

        fn acknowledge(&mut self, place: u64) -> Option<i64> {
            let covered = self.0.iter().take_while(|sent| sent.1 <= place).count();
            let covered: Vec<_> = self.0.drain(..covered).collect();
            let is_ambiguous = covered.iter().any(|sent| sent.3);
            covered.last().filter(|_| !is_ambiguous).map(|sent| sent.2)
        }
    }

    proptest! {
        /// Clocks that go back make segments that were overtaken, and the same clock such that were doubled.
        #[test]
        fn an_rtt_is_that_of_a_segment_that_was_sent_once(
            course in prop::collection::vec((0_u32..60, 1_u32..12, 0_u32..60, prop::option::of(0_u32..80)), 1..120),
            origin in prop::sample::select(vec![100_u32, u32::MAX - 30]),
        ) {
            let (mut connection, mut model) = (Connection::default(), Model::default());
            connection.send(&segment(origin, 1, 30), 0);
            model.send(0, 1, 0, false);
            for (at, (from, length, clock, acknowledged)) in (1..).zip(course) {
                let sent = segment(origin.wrapping_add(from), length, clock);
                let is_retransmitted = connection.send(&sent, at).unwrap();
                model.send(from.into(), u64::from(from + length), at, is_retransmitted);
                if let Some(place) = acknowledged {
                    let found = connection.acknowledge(origin.wrapping_add(place), 1_000);
                    prop_assert_eq!(found.map(|rtt| rtt.sent_unix_ns), model.acknowledge(place.into()));
                }
            }
        }
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
