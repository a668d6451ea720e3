//! Places in a TCP stream that are counted without wrapping, and how a segment comes by its place: as the next one,
//! retransmitted, or reordered. The main type is [`Furthest`].

/// Behind the last byte of a stream that has passed a capture.
#[derive(Debug, Default)]
pub struct Furthest {
    /// With what tells when the segment that brought it was sent.
    passed: Option<(u64, Departure)>,
}

/// What tells which of two segments of a connection was sent later.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Departure {
    /// The sender's clock of RFC 7323, in milliseconds with Linux.
    pub clock: Option<u32>,
    /// IP's number of the packet: Linux counts the packets of a connection.
    pub identification: u16,
}

/// How a segment came.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Coming {
    /// From here on its bytes lie beyond all that had passed before.
    fresh_from: u64,
    order: Order,
}

/// How a segment came whose bytes are not beyond all that had passed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Order {
    /// It was sent after the one that is ahead of it: a retransmission, at least as far as its sender knows.
    Retransmitted,
    /// It was sent before the one that is ahead of it.
    Reordered,
    /// It has no clock.
    Untold,
}

/// How a part of the stream came with a segment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Passage {
    /// As the next one.
    InOrder,
    /// Once more, in a retransmission.
    Retransmitted,
    /// After a part that was sent later.
    Reordered,
    /// Late, for one of the two reasons.
    Late,
}

impl Furthest {
    /// A segment with `begin..end` of the stream passes, sent then.
    pub fn pass(&mut self, begin: u64, end: u64, sent: Departure) -> Coming {
        let coming = match self.passed {
            Some((furthest, ahead)) if begin < furthest => Coming {
                fresh_from: furthest,
                order: order(sent, ahead),
            },
            _ => Coming {
                fresh_from: begin,
                order: Order::Untold,
            },
        };
        if self.passed.is_none_or(|(furthest, _)| end > furthest) {
            self.passed = Some((end, sent));
        }
        coming
    }

    /// Where that is; none before anything has passed.
    pub fn end(&self) -> Option<u64> {
        self.passed.map(|(end, _)| end)
    }
}

impl Coming {
    /// How the part of the stream that begins at `begin` came.
    pub fn passage_of(&self, begin: u64) -> Passage {
        match self.order {
            _ if begin >= self.fresh_from => Passage::InOrder,
            Order::Retransmitted => Passage::Retransmitted,
            Order::Reordered => Passage::Reordered,
            Order::Untold => Passage::Late,
        }
    }
}

/// Of two segments within a tick of the clock, the one with the later number was sent later: a segment that is retransmitted
/// as the third duplicate acknowledgement comes may follow a new one at once. Where packets have no numbers they are alike,
/// and a segment out of order is treated as reordered.
fn order(sent: Departure, ahead: Departure) -> Order {
    let Some((clock, clock_ahead)) = sent.clock.zip(ahead.clock) else {
        return Order::Untold;
    };
    let ticks = clock.wrapping_sub(clock_ahead).cast_signed();
    let packets = sent
        .identification
        .wrapping_sub(ahead.identification)
        .cast_signed();
    if ticks > 0 || (ticks == 0 && packets > 0) {
        Order::Retransmitted
    } else {
        Order::Reordered
    }
}

/// The place nearest to `near` that has this sequence number.
pub fn count_on(near: u64, sequence: u32) -> u64 {
    let forward = sequence.wrapping_sub(near as u32).cast_signed();
    near.saturating_add_signed(forward.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(clock: u32) -> Departure {
        Departure {
            clock: Some(clock),
            identification: 0,
        }
    }

    const UNTOLD: Departure = Departure {
        clock: None,
        identification: 9,
    };

    #[test]
    fn a_later_clock_marks_a_retransmitted_segment_and_an_earlier_one_a_reordered_segment() {
        let mut furthest = Furthest::default();
        assert_eq!(furthest.pass(0, 10, at(100)).passage_of(0), Passage::InOrder);
        furthest.pass(20, 30, at(140));
        assert_eq!(furthest.pass(10, 20, at(120)).passage_of(10), Passage::Reordered);
        assert_eq!(
            furthest.pass(10, 20, at(360)).passage_of(10),
            Passage::Retransmitted
        );
        assert_eq!(furthest.pass(10, 20, UNTOLD).passage_of(10), Passage::Late);
        assert_eq!(furthest.end(), Some(30));
    }

    #[test]
    fn within_a_tick_the_packets_numbers_tell() {
        let mut furthest = Furthest::default();
        let numbered = |identification| Departure {
            identification,
            ..at(100)
        };
        furthest.pass(20, 30, numbered(u16::MAX));
        assert_eq!(
            furthest.pass(0, 10, numbered(2)).passage_of(0),
            Passage::Retransmitted
        );
        assert_eq!(
            furthest.pass(10, 20, numbered(u16::MAX - 1)).passage_of(10),
            Passage::Reordered
        );
    }

    #[test]
    fn the_clock_may_wrap() {
        let mut furthest = Furthest::default();
        furthest.pass(10, 20, at(u32::MAX - 5));
        assert_eq!(furthest.pass(0, 10, at(30)).passage_of(0), Passage::Retransmitted);
    }

    #[test]
    fn new_bytes_at_the_end_of_a_retransmitted_segment_are_in_order() {
        let mut furthest = Furthest::default();
        furthest.pass(0, 10, at(100));
        let both = furthest.pass(0, 20, at(300));
        assert_eq!(
            (both.passage_of(0), both.passage_of(10)),
            (Passage::Retransmitted, Passage::InOrder)
        );
    }

    #[test]
    fn places_are_counted_on_over_the_end_of_the_sequence_numbers() {
        let near = (3 << 32) - 10;
        assert_eq!(count_on(near, 5), (3 << 32) + 5);
        assert_eq!(count_on((3 << 32) + 5, u32::MAX), (3 << 32) - 1);
    }
}
