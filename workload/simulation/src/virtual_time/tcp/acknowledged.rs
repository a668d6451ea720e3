//! What an acknowledgement does to a [`Sender`] (`tcp_ack`).

use super::{
    recovery::Resend,
    segment::{Ack, Span},
    sender::{REORDERING, Sender, State, count, stamp_ms, us},
};

/// What an acknowledgement says (Linux's `FLAG_*`).
#[derive(Debug, Default)]
pub(super) struct Seen {
    /// It acknowledges bytes that none did.
    pub advanced: bool,
    /// Whole segments were acknowledged below.
    pub delivered: bool,
    /// Segments were acknowledged selectively.
    pub sacked: bool,
    /// It reports a duplicate.
    pub duplicate: bool,
    /// That of the last probe.
    pub duplicate_of_probe: bool,
    /// Something that was sent once, before the recovery, was delivered.
    pub original_delivered: bool,
    /// Something that was sent again was acknowledged below.
    pub resent_delivered: bool,
    /// The one small segment that it is for may have waited for company.
    pub maybe_delayed: bool,
    /// What was sent again is lost again.
    pub lost_again: bool,
    /// The timer has to be set anew.
    pub set_timer: bool,
    pub echo_ms: Option<i64>,
    /// The lowest byte that was delivered late without having been sent again.
    late: Option<u64>,
    /// When the first and the last of the segments were sent that were sent once and are acknowledged now.
    sacked_sent_us: Option<(i64, i64)>,
    acked_sent_us: Option<(i64, i64)>,
    /// How many segments had been delivered when the newest of the acknowledged ones was sent, and its place in the
    /// order of sending.
    prior_delivered: Option<(u64, (i64, u64))>,
}

impl Seen {
    /// It says nothing new.
    pub fn is_duplicate(&self) -> bool {
        !self.advanced && !self.delivered && !self.duplicate
    }

    /// `tcp_ack_is_dubious` without the state.
    fn is_dubious(&self) -> bool {
        !(self.advanced || self.delivered) || self.sacked || self.duplicate
    }

    /// `tcp_rate_skb_delivered`.
    fn sample(&mut self, delivered_before: Option<u64>, order: (i64, u64)) {
        let newer = self.prior_delivered.is_none_or(|(_, newest)| order > newest);
        if let (Some(delivered), true) = (delivered_before, newer) {
            self.prior_delivered = Some((delivered, order));
        }
    }

    fn note_late(&mut self, begin: u64) {
        self.late = Some(self.late.map_or(begin, |late| late.min(begin)));
    }
}

fn span_of(sent_us: Option<(i64, i64)>, new_us: i64) -> Option<(i64, i64)> {
    Some((sent_us.map_or(new_us, |(first_us, _)| first_us), new_us))
}

impl Sender {
    /// Deals with an acknowledgement and sends what may be sent then.
    pub fn receive(&mut self, now_ns: i64, ack: &Ack) {
        if ack.next > self.nxt {
            return;
        }
        if ack.next < self.una {
            self.receive_old(now_ns, ack);
        } else {
            self.receive_new(now_ns, ack);
        }
        self.push(now_ns);
    }

    /// One that was overtaken: what it says of single segments still counts.
    fn receive_old(&mut self, now_ns: i64, ack: &Ack) {
        if ack.spans().next().is_none() {
            return;
        }
        let mut seen = Seen {
            echo_ms: ack.echo_ms,
            ..Seen::default()
        };
        let prior_una = self.una;
        self.tag(now_ns, ack, prior_una, &mut seen);
        let resend = self.react(now_ns, prior_una, &mut seen);
        self.recover(now_ns, resend);
    }

    fn receive_new(&mut self, now_ns: i64, ack: &Ack) {
        let prior_una = self.una;
        let (delivered, losses) = (self.delivered, self.losses);
        let highest_before = self.board.highest_sacked().unwrap_or(self.una);
        let sacked_before = self.board.sacked();
        let mut seen = Seen {
            advanced: ack.next > prior_una,
            echo_ms: ack.echo_ms,
            ..Seen::default()
        };
        if seen.advanced {
            self.timeouts_in_row = 0;
            self.una = ack.next;
        }
        let nothing_out = self.board.out() == 0;
        self.tag(now_ns, ack, prior_una, &mut seen);
        if nothing_out {
            if seen.duplicate {
                self.react(now_ns, prior_una, &mut seen);
            }
            self.end_probe(now_ns, ack.next, &seen);
            return;
        }
        self.clear_acknowledged(now_ns, &mut seen, highest_before);
        self.measure(now_ns, prior_una, sacked_before, delivered, &mut seen);
        let prior_delivered = seen.prior_delivered.map(|(delivered, _)| delivered);
        self.rack.adapt(prior_delivered, self.delivered);
        self.end_probe(now_ns, ack.next, &seen);
        let mut resend = Resend::Nothing;
        if seen.is_dubious() || self.state != State::Open {
            resend = self.react(now_ns, prior_una, &mut seen);
        }
        if seen.set_timer && !self.schedule_probe(now_ns, self.jiffies.in_us(self.timeout_jiffies)) {
            self.set_timeout(now_ns);
        }
        let newly_delivered = count(usize::try_from(self.delivered - delivered).unwrap_or(0));
        self.control_window(now_ns, newly_delivered, self.losses > losses, &seen);
        self.recover(now_ns, resend);
    }

    /// `tcp_cong_control`.
    fn control_window(&mut self, now_ns: i64, delivered: u32, lost_now: bool, seen: &Seen) {
        if self.is_reducing() {
            let in_flight = self.in_flight();
            self.congestion
                .reduce(delivered, in_flight, seen.advanced && !lost_now);
        } else if seen.delivered || (self.reordering > REORDERING && seen.sacked) {
            let shortest_us = self.round_trip.shortest_us().unwrap_or(0);
            self.congestion.grow(now_ns, delivered, shortest_us);
        }
    }

    /// Tags what is acknowledged selectively (`tcp_sacktag_write_queue`).
    fn tag(&mut self, now_ns: i64, ack: &Ack, prior_una: u64, seen: &mut Seen) {
        let duplicate = self.reported_duplicate(ack, prior_una, seen);
        for (number, span) in ack.spans().enumerate() {
            let is_duplicate = number == 0 && duplicate.is_some();
            if span.end <= prior_una || span.end > self.nxt || (span.begin <= self.una && !is_duplicate) {
                continue;
            }
            for index in 0..self.board.out() {
                self.tag_segment(now_ns, index, span, is_duplicate, seen);
            }
        }
        if let Some(late) = seen.late {
            if self.state != State::Loss || self.undo.marker.is_some() {
                self.note_reordering(late);
            }
        }
        seen.late = None;
    }

    /// The duplicate that the first block reports, if it does (`tcp_check_dsack`, `tcp_dsack_seen`).
    fn reported_duplicate(&mut self, ack: &Ack, prior_una: u64, seen: &mut Seen) -> Option<Span> {
        let mut spans = ack.spans();
        let first = spans.next()?;
        let within_second = spans.next().is_some_and(|second| second.contains(&first));
        if first.begin >= ack.next && !within_second {
            return None;
        }
        seen.duplicate_of_probe |= self.probe.is_some_and(|probe| probe.high == first.end)
            && first.len() <= self.settings.largest_segment;
        self.duplicates += first.len().div_ceil(self.settings.largest_segment).max(1);
        if self.duplicates > self.resent {
            return None;
        }
        if self.reordering_seen && !seen.duplicate_of_probe {
            self.rack.see_duplicate();
        }
        seen.duplicate = true;
        self.delivered += 1;
        let of_recovery = self.undo.marker.is_some_and(|marker| first.end > marker) && first.end <= prior_una;
        if of_recovery {
            self.undo.resent = self.undo.resent.map(|resent| resent.saturating_sub(1));
        }
        Some(first)
    }

    /// `tcp_sacktag_one`.
    fn tag_segment(&mut self, now_ns: i64, index: usize, span: Span, is_duplicate: bool, seen: &mut Seen) {
        let highest = self.board.highest_sacked().unwrap_or(self.una);
        let Some(segment) = self.board.segments.get_mut(index) else {
            return;
        };
        if !span.contains(&segment.span) {
            return;
        }
        if is_duplicate && segment.ever_resent {
            if self.undo.marker.is_some_and(|marker| segment.span.end > marker) {
                self.undo.resent = self.undo.resent.map(|resent| resent.saturating_sub(1));
            }
            if segment.sacked {
                seen.note_late(segment.span.begin);
            }
        }
        if segment.span.end <= self.una {
            return;
        }
        if !segment.sacked {
            let (order, ever_resent) = (segment.order(), segment.ever_resent);
            if !segment.resent && !ever_resent {
                if segment.span.begin < highest {
                    seen.note_late(segment.span.begin);
                }
                seen.original_delivered |= segment.span.end <= self.high;
                seen.sacked_sent_us = span_of(seen.sacked_sent_us, segment.sent_us);
            }
            // What was not thought lost may still be under way a second time.
            segment.resent &= !segment.lost;
            segment.lost = false;
            segment.sacked = true;
            seen.sacked = true;
            seen.sample(segment.delivered_before.take(), order);
            self.delivered += 1;
            let shortest_us = self.round_trip.shortest_us();
            self.rack.deliver(us(now_ns), order, ever_resent, shortest_us);
        }
        if is_duplicate {
            segment.resent = false;
        }
    }

    /// Takes off what is acknowledged below (`tcp_clean_rtx_queue`).
    fn clear_acknowledged(&mut self, now_ns: i64, seen: &mut Seen, highest_before: u64) {
        let shortest_us = self.round_trip.shortest_us();
        let mut lowest_original = self.nxt;
        while let Some(segment) = self.board.segments.front() {
            if segment.span.end > self.una {
                break;
            }
            if segment.ever_resent {
                seen.resent_delivered = true;
            } else if !segment.sacked {
                seen.acked_sent_us = span_of(seen.acked_sent_us, segment.sent_us);
                lowest_original = lowest_original.min(segment.span.begin);
                seen.original_delivered |= segment.span.end <= self.high;
            }
            seen.sample(segment.delivered_before, segment.order());
            if !segment.sacked {
                self.delivered += 1;
                let before_resending =
                    segment.ever_resent && seen.echo_ms.is_some_and(|echo_ms| echo_ms < segment.stamp_ms);
                if !before_resending {
                    self.rack
                        .deliver(us(now_ns), segment.order(), segment.ever_resent, shortest_us);
                }
            }
            seen.delivered = true;
            self.board.segments.pop_front();
        }
        seen.set_timer = seen.delivered;
        if seen.delivered && lowest_original < highest_before {
            // A hole was filled by what was only late.
            self.note_reordering(lowest_original);
        }
    }

    /// Measures the round trip, by what was sent once or else by the echoed time stamp (`tcp_ack_update_rtt`).
    fn measure(
        &mut self,
        now_ns: i64,
        prior_una: u64,
        sacked_before: usize,
        delivered: u64,
        seen: &mut Seen,
    ) {
        let now_us = us(now_ns);
        let acked = seen.acked_sent_us.filter(|_| !seen.resent_delivered);
        let mut first_us = acked.map(|(first_us, _)| now_us - first_us);
        let mut last_us = acked.map(|(_, last_us)| now_us - last_us);
        let alone = self.delivered == delivered + 1 && !seen.sacked && !seen.duplicate;
        let prior = seen.prior_delivered.map(|(prior_delivered, _)| prior_delivered);
        seen.maybe_delayed = acked.is_some()
            && alone
            && sacked_before == 0
            && self.una - prior_una < self.settings.largest_segment
            && prior.is_some_and(|prior| prior + 1 == self.delivered);
        let sacked_us = seen.sacked_sent_us.map(|(first_us, _)| now_us - first_us);
        if let Some((_, sacked_last_us)) = seen.sacked_sent_us {
            first_us = first_us.or(sacked_us);
            last_us = Some(now_us - sacked_last_us);
        }
        if first_us.is_none() && seen.delivered {
            let by_stamp = seen
                .echo_ms
                .map(|echo_ms| (stamp_ms(now_ns) - echo_ms).max(1) * 1000);
            (first_us, last_us) = (by_stamp, by_stamp);
        }
        let (Some(first_us), Some(last_us)) = (first_us, last_us) else {
            return;
        };
        self.round_trip
            .take_shortest(now_us, last_us.max(1), seen.maybe_delayed);
        self.take_round_trip(first_us);
        // A selective acknowledgement of what was sent after the oldest says nothing about the oldest.
        if let (false, Some(head), Some(sacked_us)) = (seen.delivered, self.board.segments.front(), sacked_us)
        {
            seen.set_timer |= sacked_us > now_us - head.sent_us;
        }
    }
}
