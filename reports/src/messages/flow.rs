//! One direction of one TCP connection, seen at its sender and at its receiver: which messages it carried, and what
//! became of each on the way. The main type is [`Flow`].
//!
//! ```text
//! sender's capture    segments -> content, up to what is acknowledged -> messages
//!                     segments -> when each byte was first on the wire, retransmissions
//! receiver's capture  segments -> when each byte had arrived, duplicates, what was reordered
//! ```
//!
//! A stream is taken as far as the sender saw it acknowledged: by then every byte has passed its capture, whatever order
//! it came in, or was lost to the capture for good. So memory is that of what is under way (the connection's window),
//! however long the capture is. Sequence numbers are counted on without wrapping.

use std::collections::VecDeque;

use captures::packets::{Passage, Segment, Topic, count_on};
use record::settings::Messages;

use super::{
    content::{Content, LARGEST_FLIGHT},
    crossings::{Crossing, Crossings},
    frames::{FrameFinder, Label},
    spans::Spans,
};

/// How long after it was acknowledged a message waits for duplicates: longer than a packet can be under way.
const LINGER_NS: i64 = 5_000_000_000;
/// The place of the first sequence number that is seen: what comes before it can still be counted.
const ORIGIN: u64 = 1 << 32;

/// What became of one message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Delivery {
    /// What it says of itself.
    pub label: Label,
    /// When its last byte was first on the wire at the sender, nanoseconds since 1970.
    pub wire_out_unix_ns: Option<i64>,
    /// When all of it had arrived at the receiver.
    pub wire_in_unix_ns: Option<i64>,
    /// When all before it had arrived too, so that the receiver could have it.
    pub in_order_unix_ns: Option<i64>,
    /// Segments at the sender that carried some of it again.
    pub retransmissions: u32,
    /// Segments at the receiver with none of it that had not arrived before.
    pub duplicates: u32,
    /// Whether some of it arrived after a segment that was sent later.
    pub reordered: bool,
}

/// A message that may still see duplicates.
#[derive(Debug)]
struct Pending {
    begin: u64,
    end: u64,
    found_unix_ns: i64,
    /// What has not arrived.
    missing: Spans,
    delivery: Delivery,
}

/// One direction of one connection.
#[derive(Debug)]
pub(super) struct Flow {
    finder: FrameFinder,
    /// A sequence number near those to come, counted on.
    near: Option<u64>,
    /// Sequence number of its SYN, if that was captured.
    opened: Option<u32>,
    content: Content,
    sent: Crossings,
    arrived: Crossings,
    acknowledged: Option<u64>,
    pending: VecDeque<Pending>,
    /// How many stretches of them have not arrived.
    missing: usize,
    /// The latest arrival among the messages that were given out.
    in_order_unix_ns: i64,
    /// The last packet's stamp.
    last_unix_ns: i64,
}

impl Flow {
    pub fn new(topic: Topic, messages: Messages) -> Self {
        Self {
            finder: FrameFinder::new(topic, messages),
            near: None,
            opened: None,
            content: Content::default(),
            sent: Crossings::default(),
            arrived: Crossings::default(),
            acknowledged: None,
            pending: VecDeque::new(),
            missing: 0,
            in_order_unix_ns: i64::MIN,
            last_unix_ns: i64::MIN,
        }
    }

    /// Whether a segment opens another connection than this one, with the same ports.
    pub fn is_opened_anew_by(&self, segment: &Segment<'_>) -> bool {
        segment.opens && self.near.is_some() && self.opened != Some(segment.sequence)
    }

    /// Whether nothing has come for so long that nothing is going to.
    pub fn is_silent_since(&self, unix_ns: i64) -> bool {
        self.last_unix_ns < unix_ns && self.pending.is_empty()
    }

    /// A segment passes the sender's capture.
    pub fn sent(&mut self, segment: &Segment<'_>, at_unix_ns: i64) {
        let Some((begin, end)) = self.place(segment, at_unix_ns) else {
            return;
        };
        let crossing = self.sent.add(begin, end, at_unix_ns, segment.departure());
        if (self.content.begin()).is_some_and(|first| end > first + LARGEST_FLIGHT) {
            // Its acknowledgements are not in the capture.
            self.settle(end - LARGEST_FLIGHT / 2, at_unix_ns);
        }
        let may_begin_here = self.acknowledged.is_none_or(|acknowledged| begin >= acknowledged);
        self.content.keep(begin, segment.payload, may_begin_here);
        for pending in overlapping(&mut self.pending, &crossing) {
            pending.delivery.retransmissions += 1;
        }
    }

    /// A segment passes the receiver's capture.
    pub fn arrived(&mut self, segment: &Segment<'_>, at_unix_ns: i64) {
        let Some((begin, end)) = self.place(segment, at_unix_ns) else {
            return;
        };
        let crossing = self.arrived.add(begin, end, at_unix_ns, segment.departure());
        for pending in overlapping(&mut self.pending, &crossing) {
            self.missing -= pending.missing.count();
            pending.arrive(&crossing);
            self.missing += pending.missing.count();
        }
    }

    /// The sender's capture sees how far the receiver has got.
    pub fn acknowledge(&mut self, number: u32, at_unix_ns: i64) {
        // Before any data there is nothing to be counted on from.
        let Some(near) = self.near else { return };
        let acknowledged = count_on(near, number);
        if self.acknowledged.is_none_or(|before| acknowledged > before) {
            self.acknowledged = Some(acknowledged);
            self.settle(acknowledged, at_unix_ns);
        }
    }

    /// Gives out the messages that no duplicate can come of any more.
    pub fn retire(&mut self, now_unix_ns: i64, mut out: impl FnMut(Delivery)) {
        while let Some(front) = self
            .pending
            .front()
            .filter(|front| front.found_unix_ns.saturating_add(LINGER_NS) <= now_unix_ns)
        {
            self.missing -= front.missing.count();
            let mut delivery = front.delivery.clone();
            if let Some(arrived) = delivery.wire_in_unix_ns {
                self.in_order_unix_ns = self.in_order_unix_ns.max(arrived);
                delivery.in_order_unix_ns = Some(self.in_order_unix_ns);
            }
            self.pending.pop_front();
            out(delivery);
        }
    }

    /// Gives out all that is left: the captures end here.
    pub fn finish(mut self, out: impl FnMut(Delivery)) {
        if let Some(furthest) = self.sent.furthest() {
            self.settle(furthest, self.last_unix_ns);
        }
        self.retire(i64::MAX, out);
    }

    /// The memory that is held for what is under way.
    pub fn held_bytes(&self) -> usize {
        let messages = self.pending.len() * size_of::<Pending>() + self.missing * size_of::<(u64, u64)>();
        size_of::<Self>()
            + self.content.held_bytes()
            + self.sent.held_bytes()
            + self.arrived.held_bytes()
            + messages
    }

    /// Where a segment's payload is in the stream; none if it has none.
    fn place(&mut self, segment: &Segment<'_>, at_unix_ns: i64) -> Option<(u64, u64)> {
        self.last_unix_ns = at_unix_ns;
        let sequence = match self.near {
            Some(near) => count_on(near, segment.sequence),
            None => ORIGIN + u64::from(segment.sequence),
        };
        let begin = sequence + u64::from(segment.opens);
        if segment.opens {
            self.opened = Some(segment.sequence);
        } else if segment.payload_bytes == 0 && self.near.is_none() {
            return None;
        }
        self.near = Some(self.near.map_or(begin, |near| near.max(begin)));
        (segment.payload_bytes > 0).then(|| (begin, begin + u64::from(segment.payload_bytes)))
    }

    /// Takes the stream up to `end`.
    fn settle(&mut self, end: u64, now_unix_ns: i64) {
        let Self {
            finder,
            content,
            sent,
            arrived,
            pending,
            missing,
            ..
        } = self;
        content.take(finder, end, |begin, found| {
            let (begin, end) = (begin + found.begin as u64, begin + found.end as u64);
            let mut message = Pending {
                begin,
                end,
                found_unix_ns: now_unix_ns,
                missing: Spans::default(),
                delivery: Delivery {
                    label: found.label,
                    wire_out_unix_ns: None,
                    wire_in_unix_ns: None,
                    in_order_unix_ns: None,
                    retransmissions: 0,
                    duplicates: 0,
                    reordered: false,
                },
            };
            message.missing.reset(begin, end);
            sent.of(begin, end).for_each(|crossing| message.leave(crossing));
            message.missing.reset(begin, end);
            arrived
                .of(begin, end)
                .for_each(|crossing| message.arrive(crossing));
            *missing += message.missing.count();
            pending.push_back(message);
        });
        if let Some(begin) = content.begin() {
            sent.forget_before(begin);
            arrived.forget_before(begin);
        }
    }
}

impl Pending {
    /// A segment with some of it passes the sender's capture, while `missing` is what has not left.
    fn leave(&mut self, crossing: &Crossing) {
        let fresh = self
            .missing
            .remove(crossing.begin.max(self.begin), crossing.end.min(self.end));
        let retransmitted = crossing.passage_of(self.begin) == Passage::Retransmitted;
        self.delivery.retransmissions += u32::from(!fresh || retransmitted);
        if fresh {
            self.delivery.wire_out_unix_ns = Some(crossing.at_unix_ns);
        }
    }

    /// A segment with some of it passes the receiver's capture.
    fn arrive(&mut self, crossing: &Crossing) {
        if !self
            .missing
            .remove(crossing.begin.max(self.begin), crossing.end.min(self.end))
        {
            self.delivery.duplicates += 1;
            return;
        }
        self.delivery.reordered |= match crossing.passage_of(self.begin) {
            Passage::InOrder | Passage::Retransmitted => false,
            Passage::Reordered => true,
            Passage::Late => self.delivery.retransmissions == 0,
        };
        if self.missing.is_empty() {
            self.delivery.wire_in_unix_ns = Some(crossing.at_unix_ns);
        }
    }
}

/// The messages among these, which are in the stream's order, that a segment has some of.
fn overlapping<'a>(
    pending: &'a mut VecDeque<Pending>,
    crossing: &Crossing,
) -> impl Iterator<Item = &'a mut Pending> {
    let Crossing { begin, end, .. } = *crossing;
    let first = pending.partition_point(|message| message.end <= begin);
    let after = pending.partition_point(|message| message.begin < end);
    pending.range_mut(first..after.max(first))
}
