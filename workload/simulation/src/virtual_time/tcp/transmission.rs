//! What a [`Sender`] sends: new data, what was lost, and probes.

use super::{
    round_trip::LEAST_DEVIATION_US,
    scoreboard::Sent,
    segment::{Data, Span},
    sender::{Alarm, FIRST_TIMEOUT_US, LEAST_WAIT_US, Probe, Sender, State, count, stamp_ms, us},
};

/// What holds new data back.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Push {
    /// Nagle, where it is on, and the congestion window.
    Ordinary,
    /// The congestion window alone (F-RTO).
    WithoutNagle,
    /// Nothing, for one segment (a probe).
    Probe,
}

impl Sender {
    /// Sends what may be sent (`__tcp_push_pending_frames`).
    pub fn push(&mut self, now_ns: i64) {
        if self.nxt < self.written {
            self.send_new(now_ns, Push::Ordinary);
        }
    }

    /// Sends new data as long as nothing holds it back (`tcp_write_xmit`); whether there was any.
    pub fn send_new(&mut self, now_ns: i64, push: Push) -> bool {
        let mut sent = 0;
        while self.nxt < self.written {
            if self.in_flight() >= self.congestion.window && push != Push::Probe {
                break;
            }
            let bytes = (self.written - self.nxt).min(self.settings.largest_segment);
            if self.nxt + bytes > self.una + self.settings.receive_window {
                break;
            }
            if push == Push::Ordinary && self.must_wait(bytes) {
                break;
            }
            self.send_segment(now_ns, bytes);
            sent += 1;
            if push == Push::Probe {
                break;
            }
        }
        let limited = self.in_flight() >= self.congestion.window;
        if sent > 0 || limited {
            self.validate_window(now_ns, limited);
        }
        if sent > 0 {
            if self.is_reducing() {
                self.congestion.count_sent(sent);
            }
            if push != Push::Probe {
                self.schedule_probe(now_ns, self.until_timeout_us(now_ns));
            }
        }
        sent > 0
    }

    /// Nagle in Minshall's variant: a small segment waits while another small one is unacknowledged.
    fn must_wait(&self, bytes: u64) -> bool {
        self.settings.nagle
            && bytes < self.settings.largest_segment
            && self.board.out() > 0
            && self.small_end > self.una
    }

    /// `tcp_event_new_data_sent`.
    fn send_segment(&mut self, now_ns: i64, bytes: u64) {
        let first = self.board.out() == 0;
        let span = Span {
            begin: self.nxt,
            end: self.nxt + bytes,
        };
        self.board.segments.push_back(Sent {
            span,
            sent_us: us(now_ns),
            stamp_ms: stamp_ms(now_ns),
            delivered_before: Some(self.delivered),
            sacked: false,
            lost: false,
            resent: false,
            ever_resent: false,
        });
        self.nxt = span.end;
        self.counts.sent += 1;
        self.put_on_wire(now_ns, span);
        if first || self.awaits(Alarm::Probe) {
            self.set_timeout(now_ns);
        }
        if bytes < self.settings.largest_segment {
            self.small_end = span.end;
        }
    }

    fn put_on_wire(&mut self, now_ns: i64, span: Span) {
        self.last_sent_ns = now_ns;
        self.outbox.push_back(Data {
            span,
            stamp_ms: stamp_ms(now_ns),
        });
    }

    /// Sends a segment again, joined with those behind it that fit (`__tcp_retransmit_skb`).
    fn send_again(&mut self, now_ns: i64, index: usize) {
        self.join_following(index);
        let (una, delivered) = (self.una, self.delivered);
        let Some(segment) = self.board.segments.get_mut(index) else {
            return;
        };
        // An acknowledgement may end within a joined segment.
        segment.span.begin = segment.span.begin.max(una);
        segment.sent_us = us(now_ns);
        segment.stamp_ms = stamp_ms(now_ns);
        segment.delivered_before = Some(delivered);
        segment.ever_resent = true;
        let span = segment.span;
        self.resent += 1;
        self.put_on_wire(now_ns, span);
    }

    /// `tcp_retrans_try_collapse`, `net.ipv4.tcp_retrans_collapse`: whether they are lost is not asked.
    fn join_following(&mut self, index: usize) {
        let room = self.settings.largest_segment;
        let window_end = self.una + self.settings.receive_window;
        while let Some([first, second]) = self.pair(index) {
            let joined = Span {
                begin: first.span.begin,
                end: second.span.end,
            };
            if first.sacked || second.sacked || joined.len() > room || joined.end > window_end {
                return;
            }
            let ever_resent = second.ever_resent;
            self.board.segments.remove(index + 1);
            if let Some(segment) = self.board.segments.get_mut(index) {
                segment.span = joined;
                segment.ever_resent |= ever_resent;
            }
        }
    }

    fn pair(&self, index: usize) -> Option<[&Sent; 2]> {
        let segments = &self.board.segments;
        Some([segments.get(index)?, segments.get(index + 1)?])
    }

    /// Sends a lost segment again (`tcp_retransmit_skb`).
    pub fn resend(&mut self, now_ns: i64, index: usize) {
        self.send_again(now_ns, index);
        if let Some(segment) = self.board.segments.get_mut(index) {
            segment.resent = true;
        }
        self.undo.first_stamp_ms.get_or_insert(stamp_ms(now_ns));
        self.undo.resent = Some(self.undo.resent.unwrap_or(0) + 1);
        match self.state {
            State::Loss => self.counts.after_timeout += 1,
            _ => self.counts.fast += 1,
        }
    }

    /// Sends again what is lost, as far as the window goes (`tcp_xmit_retransmit_queue`).
    pub fn resend_lost(&mut self, now_ns: i64) {
        let mut head_went = false;
        let mut index = 0;
        while let Some(segment) = self.board.segments.get(index) {
            let (lost, resent) = (segment.lost, segment.resent);
            if self.in_flight() >= self.congestion.window || self.board.resent() >= self.board.lost() {
                break;
            }
            if lost && !resent {
                self.resend(now_ns, index);
                if self.is_reducing() {
                    self.congestion.count_sent(1);
                }
                head_went |= index == 0;
            }
            index += 1;
        }
        if head_went && !self.awaits(Alarm::Reordering) {
            self.set_alarm(now_ns, Alarm::Timeout, self.timeout_jiffies);
        }
    }

    /// Sets the timer for a probe: after two round trips, and 200 ms more if the one segment's acknowledgement may be
    /// delayed, but no later than the timeout (`tcp_schedule_loss_probe`). Whether it did.
    pub fn schedule_probe(&mut self, now_ns: i64, until_timeout_us: i64) -> bool {
        if self.board.out() == 0 || self.state != State::Open {
            return false;
        }
        let wait = match self.round_trip.smoothed_us() {
            Some(smoothed_us) if self.board.out() == 1 => {
                self.jiffies.of_us(2 * smoothed_us + LEAST_DEVIATION_US)
            }
            Some(smoothed_us) => self.jiffies.of_us(2 * smoothed_us + LEAST_WAIT_US),
            None => self.jiffies.of_us(FIRST_TIMEOUT_US),
        };
        let wait = if until_timeout_us > 0 {
            wait.min(self.jiffies.of_us(until_timeout_us))
        } else {
            wait
        };
        self.set_alarm(now_ns, Alarm::Probe, wait);
        true
    }

    /// The tail may be lost: sends new data, or the last segment again (`tcp_send_loss_probe`).
    pub fn send_probe(&mut self, now_ns: i64) {
        if self.probe.is_none() {
            let window_end = self.una + self.settings.receive_window;
            let bytes = (self.written - self.nxt).min(self.settings.largest_segment);
            let again = bytes == 0;
            let sent = if again {
                let last = self.board.out().saturating_sub(1);
                self.send_again(now_ns, last);
                true
            } else {
                self.nxt + bytes <= window_end && self.send_new(now_ns, Push::Probe)
            };
            if sent {
                self.probe = Some(Probe {
                    high: self.nxt,
                    again,
                });
                self.counts.probes += 1;
                self.counts.probes_again += u64::from(again);
                self.alarm = None;
            }
        }
        self.set_timeout(now_ns);
    }

    /// Nothing was heard (`tcp_retransmit_timer`).
    pub fn time_out(&mut self, now_ns: i64) {
        if self.board.out() == 0 {
            return;
        }
        self.enter_loss(now_ns);
        self.timeouts_in_row += 1;
        self.counts.timeouts += 1;
        self.resend(now_ns, 0);
        self.back_off();
        self.set_alarm(now_ns, Alarm::Timeout, self.timeout_jiffies);
    }

    /// The window for reordering is over: what is not delivered is lost (`tcp_rack_reo_timeout`).
    pub fn end_reordering_wait(&mut self, now_ns: i64) {
        let losses = self.losses;
        self.find_losses(now_ns);
        if self.losses > losses {
            if self.state != State::Recovery {
                self.enter_recovery();
                let in_flight = count(self.board.in_flight());
                self.congestion.reduce(1, in_flight, false);
            }
            self.resend_lost(now_ns);
        }
        if !self.awaits(Alarm::Timeout) {
            self.set_timeout(now_ns);
        }
    }
}
