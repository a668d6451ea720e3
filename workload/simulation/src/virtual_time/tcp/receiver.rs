//! The end of the connection that takes data: what it has, and when it says so. The main type is [`Receiver`].
//!
//! An acknowledgement goes at once while quick ones are left (the first 16 and those after a duplicate), when a hole is
//! filled or seen, and when the program has read everything and nothing was sent back lately: with a program that reads at
//! once, every segment of a small message is acknowledged as it arrives. Otherwise it waits 40 ms and more.

use std::collections::VecDeque;

use super::{
    round_trip::RoundTrip,
    segment::{Ack, BLOCKS, Data, Span},
    sender::{LARGEST_SEGMENT_BYTES, us},
};
use crate::virtual_time::jiffies::{Expiry, Jiffies};

/// `TCP_MSS_DEFAULT`, the first guess of the sender's segment size.
const FIRST_SEGMENT_BYTES: u64 = 536;
/// The time stamp option, which the kernel counts to the data where it looks for the segment size.
const OPTION_BYTES: u64 = 12;
/// `TCP_MAX_QUICKACKS`.
const QUICK_ACKS: u32 = 16;
/// `TCP_ATO_MIN` and `TCP_DELACK_MIN`; `TCP_DELACK_MAX`.
const LEAST_DELAY_US: i64 = 40_000;
const LONGEST_DELAY_US: i64 = 200_000;
/// `TCP_FASTRETRANS_THRESH`: so many acknowledgements of single segments in a row go at once.
const SINGLE_AT_ONCE: u32 = 3;
/// `net.ipv4.tcp_comp_sack_delay_ns` and how many are held back at most.
const SINGLE_DELAY_NS: i64 = 1_000_000;
const SINGLE_HELD: u32 = 44;
/// A duplicate beside four spans are remembered (`TCP_NUM_SACKS`).
const REMEMBERED: usize = 4;

/// The receiving end.
#[derive(Debug)]
pub(super) struct Receiver {
    jiffies: Jiffies,
    window: u64,
    round_trip_us: i64,
    timeout_jiffies: i64,
    /// All bytes below have come, and been acknowledged, and been read.
    pub next: u64,
    acked: u64,
    read: u64,
    /// What has come above, in the order of the bytes, and what of it is reported, the newest first.
    above: Vec<Span>,
    reported: Vec<Span>,
    duplicate: Option<Span>,
    /// What is echoed.
    stamp_ms: Option<i64>,
    /// `rcv_mss`: what the sender's full segments are taken to have.
    segment_bytes: u64,
    /// `last_seg_size`: of the segment before, if it was smaller and might have been a full one; else 0.
    last_bytes: u64,
    quick: u32,
    delay_jiffies: i64,
    last_data_jiffy: i64,
    /// An acknowledgement is owed, one at once, or one as soon as all is read.
    owed: bool,
    at_once: bool,
    when_read: bool,
    delayed: Option<Expiry>,
    single: Single,
    /// What was sent and not taken yet.
    pub outbox: VecDeque<Ack>,
}

/// Acknowledgements of single segments, beyond the first three, are held back for a moment.
#[derive(Debug, Default)]
struct Single {
    at: u64,
    in_a_row: u32,
    held: u32,
    fires_ns: Option<i64>,
}

impl Receiver {
    pub fn new(jiffies: Jiffies, window: u64, round_trip_ns: i64) -> Self {
        let round_trip_us = us(round_trip_ns);
        // Its own socket has measured the handshake, and sends nothing but a header.
        let mut measured = RoundTrip::new();
        measured.take(round_trip_us, 0, 0);
        Self {
            jiffies,
            window,
            round_trip_us,
            timeout_jiffies: jiffies.of_us(measured.timeout_us()),
            next: 0,
            acked: 0,
            read: 0,
            above: Vec::new(),
            reported: Vec::new(),
            duplicate: None,
            stamp_ms: None,
            segment_bytes: FIRST_SEGMENT_BYTES,
            last_bytes: 0,
            quick: 0,
            delay_jiffies: 0,
            last_data_jiffy: 0,
            owed: false,
            at_once: false,
            when_read: false,
            delayed: None,
            single: Single::default(),
            outbox: VecDeque::new(),
        }
    }

    /// A segment arrives (`tcp_data_queue`).
    pub fn receive(&mut self, now_ns: i64, data: &Data) {
        let span = data.span;
        if span.end > self.next + self.window {
            return;
        }
        if span.begin <= self.acked {
            self.stamp_ms = self.stamp_ms.max(Some(data.stamp_ms));
        }
        self.owed = true;
        if span.end <= self.next {
            self.duplicate = Some(span);
            self.acknowledge_quickly();
        } else if span.begin <= self.next {
            if span.begin < self.next {
                self.duplicate = Some(Span {
                    begin: span.begin,
                    end: self.next,
                });
            }
            self.take(now_ns, span);
        } else {
            self.keep(span);
        }
        self.acknowledge(now_ns);
    }

    /// The program reads all there is (`tcp_cleanup_rbuf`).
    pub fn read(&mut self) {
        let something = self.read < self.next;
        self.read = self.next;
        let much = self.next - self.acked > self.segment_bytes;
        if self.owed && (much || (something && self.when_read)) {
            self.send();
        }
    }

    /// Whether there is something to read.
    pub fn is_readable(&self) -> bool {
        self.read < self.next
    }

    /// When a timer fires.
    pub fn next_ns(&self) -> Option<i64> {
        let delayed_ns = self.delayed.map(|expiry| expiry.fires_ns);
        delayed_ns.into_iter().chain(self.single.fires_ns).min()
    }

    /// Does what the timers are set for, if it is time.
    pub fn advance(&mut self, now_ns: i64) {
        let is_due = |fires_ns: Option<i64>| fires_ns.is_some_and(|fires_ns| fires_ns <= now_ns);
        if is_due(self.single.fires_ns) {
            self.send();
        } else if is_due(self.delayed.map(|expiry| expiry.fires_ns)) {
            // `tcp_delack_timer_handler`: the program did not read in time, and may have longer the next time.
            self.delayed = None;
            self.delay_jiffies = (self.delay_jiffies * 2).min(self.timeout_jiffies);
            self.send();
        }
    }

    /// What was waited for has come, and maybe with it what came before.
    fn take(&mut self, now_ns: i64, span: Span) {
        self.note_data(now_ns, span.end - self.next);
        self.next = span.end;
        let holes = !self.above.is_empty();
        while let Some(span) = self.above.first().copied().filter(|span| span.begin <= self.next) {
            self.next = self.next.max(span.end);
            self.above.remove(0);
        }
        let next = self.next;
        self.reported.retain(|span| span.end > next);
        self.at_once |= holes && self.above.is_empty();
    }

    /// How large full segments are (`tcp_measure_rcv_mss`), and whether this one is acknowledged once it is read: one that is smaller is,
    /// and a full one if it ends a write (PSH), which one of the largest size is taken not to do. Two smaller ones in a row that
    /// are of one size are taken for full ones from then on, and the second waits for its acknowledgement.
    fn measure_segment(&mut self, bytes: u64) {
        let before = std::mem::take(&mut self.last_bytes);
        if bytes >= self.segment_bytes {
            self.segment_bytes = bytes.min(LARGEST_SEGMENT_BYTES);
            self.when_read |= bytes < LARGEST_SEGMENT_BYTES;
            return;
        }
        if bytes + OPTION_BYTES >= FIRST_SEGMENT_BYTES {
            self.last_bytes = bytes;
            if bytes == before {
                self.segment_bytes = bytes;
                return;
            }
        }
        self.when_read = true;
    }

    /// How soon the next is to be expected (`tcp_event_data_recv`).
    fn note_data(&mut self, now_ns: i64, bytes: u64) {
        self.measure_segment(bytes);
        let jiffy = self.jiffies.count(now_ns);
        let least = self.jiffies.of_us(LEAST_DELAY_US);
        let since = jiffy - self.last_data_jiffy;
        if self.delay_jiffies == 0 {
            self.grant_quick();
            self.delay_jiffies = least;
        } else if since <= least / 2 {
            self.delay_jiffies = self.delay_jiffies / 2 + least / 2;
        } else if since < self.delay_jiffies {
            self.delay_jiffies = (self.delay_jiffies / 2 + since).min(self.timeout_jiffies);
        } else if since > self.timeout_jiffies {
            self.grant_quick();
        }
        self.last_data_jiffy = jiffy;
    }

    /// `tcp_incr_quickack`.
    fn grant_quick(&mut self) {
        let fitting = u32::try_from(self.window / (2 * self.segment_bytes)).unwrap_or(u32::MAX);
        self.quick = self.quick.max(fitting.clamp(2, QUICK_ACKS));
    }

    /// `tcp_enter_quickack_mode`.
    fn acknowledge_quickly(&mut self) {
        self.grant_quick();
        self.delay_jiffies = self.jiffies.of_us(LEAST_DELAY_US);
    }

    /// Keeps what is above a hole (`tcp_data_queue_ofo`).
    fn keep(&mut self, span: Span) {
        if let Some(known) = self.above.iter().find(|known| known.contains(&span)) {
            self.duplicate = Some(span);
            let known = *known;
            self.report(known);
            return;
        }
        let touches = |other: &Span| other.begin <= span.end && span.begin <= other.end;
        let mut joined = span;
        for other in self.above.iter().filter(|other| touches(other)) {
            joined.begin = joined.begin.min(other.begin);
            joined.end = joined.end.max(other.end);
        }
        self.above.retain(|other| !touches(other));
        let place = self.above.partition_point(|other| other.begin < joined.begin);
        self.above.insert(place, joined);
        self.report(joined);
    }

    fn report(&mut self, span: Span) {
        self.reported.retain(|other| !span.contains(other));
        self.reported.insert(0, span);
        self.reported.truncate(REMEMBERED);
    }

    /// Now, or later (`__tcp_ack_snd_check`).
    fn acknowledge(&mut self, now_ns: i64) {
        let much = self.next - self.acked > self.segment_bytes && !self.is_readable();
        if much || self.quick > 0 || self.at_once {
            self.send();
        } else if self.above.is_empty() {
            self.delay(now_ns);
        } else {
            self.hold_single(now_ns);
        }
    }

    /// `tcp_send_delayed_ack`.
    fn delay(&mut self, now_ns: i64) {
        let least = self.jiffies.of_us(LEAST_DELAY_US);
        let mut delay = self.delay_jiffies;
        if delay > least {
            let round_trip = self.jiffies.of_us(self.round_trip_us).max(least);
            delay = delay.min(round_trip);
        }
        // `icsk_delack_max`.
        delay = delay.min(self.jiffies.of_us(LONGEST_DELAY_US));
        let expiry = self.jiffies.after(now_ns, delay);
        if let Some(set) = self.delayed {
            if set.jiffy <= self.jiffies.count(now_ns) + delay / 4 {
                self.send();
                return;
            }
            if expiry.jiffy >= set.jiffy {
                return;
            }
        }
        self.delayed = Some(expiry);
    }

    fn hold_single(&mut self, now_ns: i64) {
        if self.single.at != self.next {
            self.single.at = self.next;
            self.single.in_a_row = 0;
        }
        if self.single.held >= SINGLE_HELD || self.single.in_a_row < SINGLE_AT_ONCE {
            self.single.in_a_row += u32::from(self.single.in_a_row < SINGLE_AT_ONCE);
            self.send();
            return;
        }
        self.single.held += 1;
        let delay_ns = (self.round_trip_us * 1000 / 20).min(SINGLE_DELAY_NS);
        self.single.fires_ns.get_or_insert(now_ns + delay_ns);
    }

    /// `tcp_send_ack`.
    fn send(&mut self) {
        let mut blocks = [None; BLOCKS];
        let spans = self
            .duplicate
            .take()
            .into_iter()
            .chain(self.reported.iter().copied());
        for (block, span) in blocks.iter_mut().zip(spans) {
            *block = Some(span);
        }
        self.outbox.push_back(Ack {
            next: self.next,
            blocks,
            echo_ms: self.stamp_ms,
        });
        if self.owed && self.quick > 0 {
            self.quick -= 1;
            if self.quick == 0 {
                self.delay_jiffies = self.jiffies.of_us(LEAST_DELAY_US);
            }
        }
        self.acked = self.next;
        self.owed = false;
        self.at_once = false;
        self.when_read = false;
        self.delayed = None;
        self.single.held = 0;
        self.single.fires_ns = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::virtual_time::jiffies::DEBIAN_HZ;

    const MS: i64 = 1_000_000;

    fn receiver() -> Receiver {
        Receiver::new(Jiffies::new(DEBIAN_HZ, 0), 64_240, 40 * MS)
    }

    fn data(begin: u64, end: u64, stamp_ms: i64) -> Data {
        Data {
            span: Span { begin, end },
            stamp_ms,
        }
    }

    fn acks(receiver: &mut Receiver) -> Vec<Ack> {
        receiver.outbox.drain(..).collect()
    }

    /// After the quick ones.
    fn settled() -> Receiver {
        let mut receiver = receiver();
        for number in 0..20 {
            let now_ns = i64::try_from(number).unwrap() * 20 * MS;
            receiver.receive(now_ns, &data(number * 10, number * 10 + 10, now_ns / MS));
            receiver.read();
        }
        assert_eq!(acks(&mut receiver).len(), 20);
        receiver
    }

    #[test]
    fn a_program_that_reads_at_once_acknowledges_every_message_at_once() {
        let mut receiver = settled();
        receiver.receive(400 * MS, &data(200, 210, 400));
        assert_eq!(acks(&mut receiver), []);
        receiver.read();
        assert_eq!(acks(&mut receiver).len(), 1);
        assert_eq!(receiver.next_ns(), None);
    }

    #[test]
    fn what_waited_through_a_stall_is_acknowledged_when_it_is_read_unless_it_fills_its_segment() {
        let mut receiver = settled();
        receiver.receive(400 * MS, &data(200, 1000, 400));
        receiver.read();
        assert_eq!(acks(&mut receiver).len(), 1);
        receiver.receive(420 * MS, &data(1000, 1000 + LARGEST_SEGMENT_BYTES, 420));
        receiver.read();
        assert_eq!(acks(&mut receiver), []);
    }

    // The kernel on a round trip of 200 ms, with nothing lost: ten messages wait for an acknowledgement, now and then eleven.
    #[test]
    fn of_two_large_segments_of_one_size_after_a_larger_one_the_second_waits_for_its_acknowledgement() {
        let mut receiver = settled();
        let mut next = 200;
        let mut arrives = |receiver: &mut Receiver, number: i64, bytes: u64| {
            receiver.receive((400 + 200 * number) * MS, &data(next, next + bytes, 400));
            receiver.read();
            next += bytes;
            acks(receiver).len()
        };
        let counts: Vec<usize> = (0..)
            .zip([726, 660, 660])
            .map(|(number, bytes)| arrives(&mut receiver, number, bytes))
            .collect();
        assert_eq!(counts, [1, 1, 0]);
        // It waits 40 ms or more, and 660 bytes are a full segment from then on.
        assert!(receiver.next_ns().is_some_and(|fires_ns| fires_ns >= 840 * MS));
        receiver.advance(i64::MAX);
        assert_eq!(acks(&mut receiver).len(), 1);
        assert_eq!(arrives(&mut receiver, 3, 660), 1);
    }

    #[test]
    fn a_program_that_does_not_read_lets_the_kernel_acknowledge_after_40_ms() {
        let mut receiver = settled();
        receiver.receive(400 * MS, &data(200, 210, 400));
        assert_eq!(receiver.next_ns(), Some(444 * MS));
        receiver.advance(444 * MS);
        assert_eq!(acks(&mut receiver).len(), 1);
    }

    #[test]
    fn a_hole_is_reported_at_once_and_its_filling_too() {
        let mut receiver = settled();
        receiver.receive(400 * MS, &data(210, 220, 400));
        receiver.receive(420 * MS, &data(230, 240, 420));
        let reports: Vec<Vec<Span>> = acks(&mut receiver)
            .iter()
            .map(|ack| ack.spans().collect())
            .collect();
        let (low, high) = (Span { begin: 210, end: 220 }, Span { begin: 230, end: 240 });
        assert_eq!(reports, [vec![low], vec![high, low]]);
        receiver.receive(440 * MS, &data(200, 210, 390));
        receiver.read();
        let filled = acks(&mut receiver);
        assert_eq!(filled.last().map(|ack| ack.next), Some(220));
        assert_eq!(filled.last().and_then(|ack| ack.blocks[0]), Some(high));
    }

    #[test]
    fn what_comes_twice_is_reported_as_a_duplicate() {
        let mut receiver = settled();
        receiver.receive(400 * MS, &data(190, 200, 380));
        let reported = acks(&mut receiver);
        assert_eq!(reported[0].next, 200);
        assert_eq!(reported[0].blocks[0], Some(Span { begin: 190, end: 200 }));
    }

    #[test]
    fn after_a_hole_the_stamp_of_the_last_in_order_is_echoed() {
        let mut receiver = settled();
        receiver.receive(400 * MS, &data(210, 220, 400));
        assert_eq!(acks(&mut receiver)[0].echo_ms, Some(380));
    }

    #[test]
    fn from_the_fourth_on_reports_of_one_hole_wait_a_millisecond() {
        let mut receiver = settled();
        for number in 0..5_u64 {
            receiver.receive(400 * MS, &data(210 + 20 * number, 220 + 20 * number, 400));
        }
        assert_eq!(acks(&mut receiver).len(), 3);
        assert_eq!(receiver.next_ns(), Some(401 * MS));
        receiver.advance(401 * MS);
        assert_eq!(acks(&mut receiver).len(), 1);
    }
}
