//! What was sent and is not acknowledged, and what is thought of it. The main type is [`Scoreboard`].
//!
//! Each segment may be selectively acknowledged, thought lost, and under way again (Linux's tags S, L and R). Segments in
//! flight are those sent, without the acknowledged and the lost, and with those sent again (`tcp_packets_in_flight`).

use std::collections::VecDeque;

use super::segment::Span;

/// A segment that was sent.
#[derive(Debug, Clone)]
pub(super) struct Sent {
    pub span: Span,
    /// When it was sent last.
    pub sent_us: i64,
    /// The time stamp that it then had.
    pub stamp_ms: i64,
    /// How many segments had been delivered by then; forgotten once it was acknowledged selectively.
    pub delivered_before: Option<u64>,
    pub sacked: bool,
    pub lost: bool,
    /// It was sent again for being lost, and that is still under way.
    pub resent: bool,
    pub ever_resent: bool,
}

impl Sent {
    /// The order of sending, the end of the segment telling apart what was sent at once (`tcp_skb_sent_after`).
    pub fn order(&self) -> (i64, u64) {
        (self.sent_us, self.span.end)
    }
}

/// The retransmission queue, in the order of the bytes.
#[derive(Debug, Default)]
pub(super) struct Scoreboard {
    pub segments: VecDeque<Sent>,
}

impl Scoreboard {
    /// How many segments were sent and are not acknowledged below.
    pub fn out(&self) -> usize {
        self.segments.len()
    }

    pub fn sacked(&self) -> usize {
        self.count(|segment| segment.sacked)
    }

    pub fn lost(&self) -> usize {
        self.count(|segment| segment.lost)
    }

    pub fn resent(&self) -> usize {
        self.count(|segment| segment.resent)
    }

    pub fn in_flight(&self) -> usize {
        let (mut left, mut again) = (0, 0);
        for segment in &self.segments {
            left += usize::from(segment.sacked) + usize::from(segment.lost);
            again += usize::from(segment.resent);
        }
        (self.out() + again).saturating_sub(left)
    }

    /// The end of the highest segment that was acknowledged selectively (`tcp_highest_sack_seq`).
    pub fn highest_sacked(&self) -> Option<u64> {
        let highest = self.segments.iter().rev().find(|segment| segment.sacked);
        highest.map(|segment| segment.span.end)
    }

    fn count(&self, of: impl Fn(&Sent) -> bool) -> usize {
        self.segments.iter().filter(|segment| of(segment)).count()
    }
}
