//! How a [`Sender`] finds losses, recovers from them, and notices that it was wrong.

use super::{
    acknowledged::Seen,
    segment::Span,
    sender::{Alarm, LEAST_WAIT_US, REORDERING, Sender, State, count, us},
    transmission::Push,
};

/// What to send after an acknowledgement was dealt with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Resend {
    Nothing,
    /// What is lost.
    Lost,
    /// New data, to find out whether a timeout was spurious.
    New,
}

impl Sender {
    /// Marks what is lost by now; how long to wait for the others, if any (`tcp_rack_detect_loss`).
    pub fn find_losses(&mut self, now_ns: i64) -> Option<i64> {
        let window_us = self.reordering_window_us();
        let mut wait_us: Option<i64> = None;
        for index in 0..self.board.out() {
            let Some(segment) = self.board.segments.get(index) else {
                break;
            };
            let lost_already = segment.lost && !segment.resent;
            if segment.sacked || lost_already || segment.order() >= self.rack.newest {
                continue;
            }
            let left_us = self.rack.round_trip_us + window_us - (us(now_ns) - segment.sent_us);
            if left_us <= 0 {
                self.mark_lost(index);
            } else {
                wait_us = Some(wait_us.map_or(left_us, |wait_us| wait_us.max(left_us)));
            }
        }
        wait_us
    }

    /// `tcp_rack_reo_wnd`.
    fn reordering_window_us(&self) -> i64 {
        let sacked = u64::from(count(self.board.sacked()));
        if !self.reordering_seen && (self.state >= State::Recovery || sacked >= self.reordering) {
            return 0;
        }
        self.rack
            .window_us(self.round_trip.shortest_us(), self.round_trip.smoothed_us())
    }

    /// `tcp_mark_skb_lost`.
    fn mark_lost(&mut self, index: usize) {
        let Some(segment) = self.board.segments.get_mut(index) else {
            return;
        };
        if segment.sacked || (segment.lost && !segment.resent) {
            return;
        }
        segment.resent &= !segment.lost;
        segment.lost = true;
        self.losses += 1;
    }

    /// Looks for losses after something was delivered (`tcp_rack_mark_lost`, `tcp_identify_packet_loss`).
    pub fn look_for_losses(&mut self, now_ns: i64, seen: &mut Seen) {
        if self.board.out() == 0 || !self.rack.advanced {
            return;
        }
        self.rack.advanced = false;
        let resent = self.board.resent();
        if let Some(wait_us) = self.find_losses(now_ns) {
            let wait = self.jiffies.of_us(wait_us + LEAST_WAIT_US);
            self.set_alarm(now_ns, Alarm::Reordering, wait);
            seen.set_timer = false;
        }
        seen.lost_again |= self.board.resent() < resent;
    }

    /// A loss is sure (`tcp_enter_recovery`).
    pub fn enter_recovery(&mut self) {
        self.forget_stamp_if_nothing_again();
        self.mark_for_undo();
        self.congestion.threshold_before = self.congestion.current_threshold();
        self.begin_reduction();
        self.state = State::Recovery;
    }

    fn begin_reduction(&mut self) {
        self.high = self.nxt;
        self.probe = None;
        self.congestion.begin_reduction();
    }

    /// `tcp_init_undo`. Nothing sent again is not the same as all of it accounted for.
    fn mark_for_undo(&mut self) {
        self.undo.marker = Some(self.una);
        let resent = self.board.resent() + usize::from(self.probe.is_some_and(|probe| probe.again));
        self.undo.resent = u64::try_from(resent).ok().filter(|resent| *resent > 0);
    }

    /// A timeout (`tcp_enter_loss`).
    pub fn enter_loss(&mut self, now_ns: i64) {
        let fresh = self.state < State::Recovery;
        self.mark_timed_out(now_ns);
        if self.state <= State::Disorder
            || self.high <= self.una
            || (self.state == State::Loss && self.timeouts_in_row == 0)
        {
            let threshold = if self.is_reducing() {
                self.congestion.threshold
            } else {
                self.congestion.current_threshold()
            };
            self.congestion.remember_and_reduce(threshold);
            self.mark_for_undo();
        }
        self.congestion.forget();
        let in_flight = self.in_flight();
        self.congestion.collapse(in_flight, now_ns);
        if self.state <= State::Disorder && self.board.sacked() as u64 >= REORDERING {
            self.reordering = self.reordering.min(REORDERING);
        }
        self.state = State::Loss;
        self.high = self.nxt;
        self.probe = None;
        self.trying = fresh || self.timeouts_in_row > 0;
    }

    /// The oldest is lost, and of the others what was sent long enough ago (`tcp_timeout_mark_lost`).
    fn mark_timed_out(&mut self, now_ns: i64) {
        for index in 0..self.board.out() {
            let recent =
                self.board.segments.get(index).is_some_and(|segment| {
                    index > 0 && self.rack.round_trip_us > us(now_ns) - segment.sent_us
                });
            if !recent {
                self.mark_lost(index);
            }
        }
    }

    /// What an unusual acknowledgement, or any while not all is well, does to the state (`tcp_fastretrans_alert`).
    pub fn react(&mut self, now_ns: i64, prior_una: u64, seen: &mut Seen) -> Resend {
        if self.state == State::Open {
            self.undo.first_stamp_ms = None;
        } else if self.state == State::Recovery && self.una >= self.high {
            self.end_recovery(now_ns, seen);
        }
        match self.state {
            State::Recovery => {
                if seen.advanced && self.undo_partly(now_ns, prior_una, seen) {
                    return Resend::Nothing;
                }
                if self.undo_by_duplicates(now_ns) {
                    self.settle();
                }
                self.look_for_losses(now_ns, seen);
                if self.state != State::Recovery {
                    if self.board.lost() == 0 {
                        return Resend::Nothing;
                    }
                    self.enter_recovery();
                }
                return Resend::Lost;
            }
            State::Loss => {
                let resend = self.go_on_after_timeout(now_ns, seen);
                self.look_for_losses(now_ns, seen);
                if self.state != State::Open && !seen.lost_again {
                    return resend;
                }
            }
            State::Open | State::Disorder => {}
        }
        if self.state <= State::Disorder {
            self.undo_by_duplicates(now_ns);
        }
        self.look_for_losses(now_ns, seen);
        if self.board.lost() == 0 {
            self.settle();
            return Resend::Nothing;
        }
        self.enter_recovery();
        Resend::Lost
    }

    /// All that was sent before recovery is acknowledged.
    fn end_recovery(&mut self, now_ns: i64, seen: &Seen) {
        self.undo_recovery(now_ns, seen);
        if self.undo.marker.is_some() {
            self.congestion.end_reduction(now_ns);
        }
    }

    /// Undoes it if it was a mistake, and ends it anyway (`tcp_try_undo_recovery`).
    fn undo_recovery(&mut self, now_ns: i64, seen: &Seen) {
        if self.may_undo(seen) {
            self.undo_reduction(now_ns);
        } else {
            self.rack.persists = self.rack.persists.saturating_sub(1);
        }
        self.state = State::Open;
    }

    /// An acknowledgement while recovering from a timeout (`tcp_process_loss`), with F-RTO.
    fn go_on_after_timeout(&mut self, now_ns: i64, seen: &Seen) -> Resend {
        let recovered = self.una >= self.high;
        if seen.advanced && self.may_undo(seen) {
            self.undo_timeout(now_ns);
            return Resend::Nothing;
        }
        if self.trying {
            if seen.original_delivered {
                self.undo_timeout(now_ns);
                return Resend::Nothing;
            }
            if self.nxt > self.high {
                if seen.sacked || seen.is_duplicate() {
                    self.trying = false;
                }
            } else if seen.advanced && !recovered {
                self.high = self.nxt;
                if self.nxt < self.written && self.una + self.settings.receive_window > self.nxt {
                    return Resend::New;
                }
                self.trying = false;
            }
        }
        if recovered {
            self.undo_recovery(now_ns, seen);
            return Resend::Nothing;
        }
        Resend::Lost
    }

    /// The timeout was spurious: nothing is lost (`tcp_try_undo_loss`).
    fn undo_timeout(&mut self, now_ns: i64) {
        self.forget_losses();
        self.undo_reduction(now_ns);
        self.timeouts_in_row = 0;
        self.state = State::Open;
    }

    /// A hole was filled by what was only late (`tcp_try_undo_partial`). Whether there is nothing more to do.
    fn undo_partly(&mut self, now_ns: i64, prior_una: u64, seen: &Seen) -> bool {
        if self.undo.marker.is_none() || !self.was_only_late(seen) {
            return false;
        }
        self.note_reordering(prior_una);
        if self.board.resent() > 0 {
            return true;
        }
        self.forget_stamp_if_nothing_again();
        self.forget_losses();
        self.undo_reduction(now_ns);
        self.keep_open();
        false
    }

    /// All that was sent again came twice (`tcp_try_undo_dsack`).
    fn undo_by_duplicates(&mut self, now_ns: i64) -> bool {
        let all_twice = self.undo.marker.is_some() && self.undo.resent == Some(0);
        if all_twice {
            self.rack.persist_longer();
            self.undo_reduction(now_ns);
        }
        all_twice
    }

    /// `tcp_may_undo`.
    fn may_undo(&self, seen: &Seen) -> bool {
        self.undo.marker.is_some() && (self.undo.resent == Some(0) || self.was_only_late(seen))
    }

    /// Nothing was sent again, or the acknowledgement is for what was sent before that (`tcp_packet_delayed`).
    fn was_only_late(&self, seen: &Seen) -> bool {
        self.undo
            .first_stamp_ms
            .is_none_or(|first_ms| seen.echo_ms.is_some_and(|echo_ms| echo_ms < first_ms))
    }

    fn undo_reduction(&mut self, now_ns: i64) {
        self.congestion.undo(now_ns);
        self.undo.marker = None;
        self.rack.advanced = true;
        self.counts.undone += 1;
    }

    fn forget_losses(&mut self) {
        for segment in &mut self.board.segments {
            segment.lost = false;
        }
    }

    /// Nothing is lost: open, or disorder while something is odd (`tcp_try_to_open`).
    fn settle(&mut self) {
        self.forget_stamp_if_nothing_again();
        self.keep_open();
    }

    /// `tcp_try_keep_open`.
    pub fn keep_open(&mut self) {
        let odd = self.board.sacked() + self.board.lost() > 0 || self.is_anything_again();
        let state = if odd { State::Disorder } else { State::Open };
        if self.state != state {
            self.state = state;
            self.high = self.nxt;
        }
    }

    fn forget_stamp_if_nothing_again(&mut self) {
        if !self.is_anything_again() {
            self.undo.first_stamp_ms = None;
        }
    }

    /// `tcp_any_retrans_done`.
    fn is_anything_again(&self) -> bool {
        let head_again = self.board.segments.front().is_some_and(|head| head.ever_resent);
        self.board.resent() > 0 || head_again
    }

    /// A segment was delivered after later ones: how far apart they were (`tcp_check_sack_reordering`).
    pub fn note_reordering(&mut self, late: u64) {
        let highest = self.board.highest_sacked().unwrap_or(self.una);
        if late >= highest {
            return;
        }
        let apart = Span {
            begin: late,
            end: highest,
        };
        let segments = apart.len().div_ceil(self.settings.largest_segment);
        // `net.ipv4.tcp_max_reordering`
        self.reordering = self.reordering.max(segments).min(300);
        self.reordering_seen = true;
    }

    /// Ends the episode of a probe (`tcp_process_tlp_ack`).
    pub fn end_probe(&mut self, now_ns: i64, next: u64, seen: &Seen) {
        let Some(probe) = self.probe.filter(|probe| next >= probe.high) else {
            return;
        };
        if !probe.again || seen.duplicate_of_probe {
            self.probe = None;
        } else if next > probe.high {
            // The probe repaired a loss that no acknowledgement told of.
            self.begin_reduction();
            self.congestion.end_reduction(now_ns);
            self.keep_open();
        } else if !seen.advanced && !seen.delivered && !seen.sacked {
            self.probe = None;
        }
    }

    /// `tcp_xmit_recovery`.
    pub fn recover(&mut self, now_ns: i64, resend: Resend) {
        match resend {
            Resend::Nothing => {}
            Resend::Lost => self.resend_lost(now_ns),
            Resend::New => {
                self.send_new(now_ns, Push::WithoutNagle);
                if self.nxt <= self.high {
                    self.trying = false;
                    self.resend_lost(now_ns);
                }
            }
        }
    }
}
