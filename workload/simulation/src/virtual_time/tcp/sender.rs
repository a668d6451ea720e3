//! The end of the connection that has data to send: its state and its timers. The main type is [`Sender`].
//!
//! The state machine is Linux's (`tcp_fastretrans_alert`): open, disorder once something is selectively acknowledged or sent
//! again, recovery once a loss is sure, loss after a timeout. What is sent is in the module `transmission`, what an
//! acknowledgement does in `acknowledged`, what follows for the state in `recovery`.

use std::collections::VecDeque;

use super::{
    congestion::{Congestion, SendingState},
    rack::Rack,
    round_trip::RoundTrip,
    scoreboard::Scoreboard,
    segment::Data,
};
use crate::virtual_time::jiffies::{Expiry, Jiffies};

/// `TCP_TIMEOUT_INIT`, before a round trip was measured.
pub(super) const FIRST_TIMEOUT_US: i64 = 1_000_000;
/// `TCP_TIMEOUT_MIN_US` (two jiffies before Linux 6.6 and 6.1.60).
pub(super) const LEAST_WAIT_US: i64 = 2000;
/// `TCP_RTO_MAX`.
const LONGEST_TIMEOUT_US: i64 = 120_000_000;
/// `TCP_FASTRETRANS_THRESH`, `net.ipv4.tcp_reordering`.
pub(super) const REORDERING: u64 = 3;

/// Bytes of the largest segment: Ethernet's 1500 without 40 of headers and 12 of the time stamp.
pub(super) const LARGEST_SEGMENT_BYTES: u64 = 1448;

/// What a sender is made with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SenderSettings {
    /// Small segments wait while one is unacknowledged; `TCP_NODELAY` switches this off.
    pub nagle: bool,
    /// Bytes of the largest segment.
    pub largest_segment: u64,
    /// Bytes that the receiver takes.
    pub receive_window: u64,
    /// The round trip that the handshake measured.
    pub first_round_trip_ns: i64,
}

impl Default for SenderSettings {
    fn default() -> Self {
        Self {
            nagle: true,
            largest_segment: LARGEST_SEGMENT_BYTES,
            receive_window: 64_240,
            first_round_trip_ns: 0,
        }
    }
}

/// What a sender has done so far.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    /// Segments sent for the first time.
    pub sent: u64,
    /// Lost segments sent again because later ones were acknowledged.
    pub fast: u64,
    /// Tail loss probes, with new data or old.
    pub probes: u64,
    /// Those with old data.
    pub probes_again: u64,
    /// Timeouts.
    pub timeouts: u64,
    /// Segments sent again after a timeout.
    pub after_timeout: u64,
    /// Recoveries that were undone as mistaken.
    pub undone: u64,
}

/// How things stand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum State {
    Open,
    Disorder,
    Recovery,
    Loss,
}

/// What the one timer of a sender is set for (`icsk_pending`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Alarm {
    /// The reordering window is over.
    Reordering,
    /// The tail may be lost.
    Probe,
    /// Nothing was heard for too long.
    Timeout,
}

/// What is remembered to find out later that a recovery was a mistake.
#[derive(Debug, Clone, Default)]
pub(super) struct Undo {
    /// The recovery began with this byte unacknowledged.
    pub marker: Option<u64>,
    /// Segments sent again of which no duplicate was reported; none if none was sent.
    pub resent: Option<u64>,
    /// The time stamp of the first.
    pub first_stamp_ms: Option<i64>,
}

/// A tail loss probe that is not answered yet.
#[derive(Debug, Clone, Copy)]
pub(super) struct Probe {
    /// The end of what had been sent.
    pub high: u64,
    /// It had old data.
    pub again: bool,
}

/// The sending end.
#[derive(Debug)]
pub(super) struct Sender {
    pub settings: SenderSettings,
    pub jiffies: Jiffies,
    /// The first unacknowledged byte, the first that was not sent, and the end of what the program wrote.
    pub una: u64,
    pub nxt: u64,
    pub written: u64,
    /// The end of the last small segment.
    pub small_end: u64,
    pub board: Scoreboard,
    pub round_trip: RoundTrip,
    pub rack: Rack,
    pub congestion: Congestion,
    pub state: State,
    /// Recovery ends when this byte is acknowledged.
    pub high: u64,
    pub undo: Undo,
    pub probe: Option<Probe>,
    /// The timeout may be spurious and is being tried (F-RTO).
    pub trying: bool,
    /// Timeouts in a row.
    pub timeouts_in_row: u32,
    pub timeout_jiffies: i64,
    pub alarm: Option<(Alarm, Expiry)>,
    /// How far apart reordered segments were, in segments, and whether any were.
    pub reordering: u64,
    pub reordering_seen: bool,
    /// Segments delivered and lost in all.
    pub delivered: u64,
    pub losses: u64,
    pub duplicates: u64,
    pub resent: u64,
    pub last_sent_ns: i64,
    pub counts: Counts,
    /// What was sent and not taken yet.
    pub outbox: VecDeque<Data>,
}

impl Sender {
    /// Of a connection that is established, at time zero.
    pub fn new(settings: SenderSettings, jiffies: Jiffies) -> Self {
        let mut sender = Self {
            settings,
            jiffies,
            una: 0,
            nxt: 0,
            written: 0,
            small_end: 0,
            board: Scoreboard::default(),
            round_trip: RoundTrip::new(),
            rack: Rack::new(),
            congestion: Congestion::new(jiffies),
            state: State::Open,
            high: 0,
            undo: Undo::default(),
            probe: None,
            trying: false,
            timeouts_in_row: 0,
            timeout_jiffies: jiffies.of_us(FIRST_TIMEOUT_US),
            alarm: None,
            reordering: REORDERING,
            reordering_seen: false,
            delivered: 1,
            losses: 0,
            duplicates: 0,
            resent: 0,
            last_sent_ns: 0,
            counts: Counts::default(),
            outbox: VecDeque::new(),
        };
        let first_us = us(settings.first_round_trip_ns);
        if first_us > 0 {
            sender.round_trip.take_shortest(0, first_us, false);
            sender.take_round_trip(first_us);
        }
        sender
    }

    /// The program writes.
    pub fn write(&mut self, now_ns: i64, bytes: u64) {
        if self.board.out() == 0 {
            self.restart_after_idle(now_ns);
        }
        self.written += bytes;
        self.push(now_ns);
    }

    /// When the timer fires.
    pub fn next_ns(&self) -> Option<i64> {
        self.alarm.map(|(_, expiry)| expiry.fires_ns)
    }

    /// Does what the timer is set for, if it is time (`tcp_write_timer_handler`).
    pub fn advance(&mut self, now_ns: i64) {
        let Some((alarm, expiry)) = self.alarm else {
            return;
        };
        if expiry.fires_ns > now_ns {
            return;
        }
        match alarm {
            Alarm::Reordering => self.end_reordering_wait(now_ns),
            Alarm::Probe => self.send_probe(now_ns),
            Alarm::Timeout => {
                self.alarm = None;
                self.time_out(now_ns);
            }
        }
    }

    /// Takes a measured round trip into the timeout (`tcp_set_rto`); it ends any backing off.
    pub fn take_round_trip(&mut self, measured_us: i64) {
        self.round_trip.take(measured_us, self.una, self.nxt);
        let timeout_us = self.round_trip.timeout_us().min(LONGEST_TIMEOUT_US);
        self.timeout_jiffies = self.jiffies.of_us(timeout_us);
    }

    /// Doubles the timeout.
    pub fn back_off(&mut self) {
        let longest = self.jiffies.of_us(LONGEST_TIMEOUT_US);
        self.timeout_jiffies = (self.timeout_jiffies * 2).min(longest);
    }

    /// Whether the timer is set for that.
    pub fn awaits(&self, alarm: Alarm) -> bool {
        self.alarm.is_some_and(|(set, _)| set == alarm)
    }

    /// Sets the timer.
    pub fn set_alarm(&mut self, now_ns: i64, alarm: Alarm, jiffies: i64) {
        self.alarm = Some((alarm, self.jiffies.after(now_ns, jiffies)));
    }

    /// How long it is until the oldest segment's timeout (`tcp_rto_delta_us`).
    pub fn until_timeout_us(&self, now_ns: i64) -> i64 {
        let sent_us = self
            .board
            .segments
            .front()
            .map_or(us(now_ns), |segment| segment.sent_us);
        sent_us + self.jiffies.in_us(self.timeout_jiffies) - us(now_ns)
    }

    /// Sets the timer for the timeout, from now on or, if a shorter one was set in its place, from the oldest segment
    /// on (`tcp_rearm_rto`).
    pub fn set_timeout(&mut self, now_ns: i64) {
        if self.board.out() == 0 {
            self.alarm = None;
            return;
        }
        let shorter = self.awaits(Alarm::Reordering) || self.awaits(Alarm::Probe);
        let jiffies = if shorter {
            self.jiffies.of_us(self.until_timeout_us(now_ns).max(1))
        } else {
            self.timeout_jiffies
        };
        self.set_alarm(now_ns, Alarm::Timeout, jiffies);
    }

    /// Whether the window is being reduced in steps (`tcp_in_cwnd_reduction`).
    pub fn is_reducing(&self) -> bool {
        self.state == State::Recovery
    }

    /// In segments.
    pub fn in_flight(&self) -> u32 {
        count(self.board.in_flight())
    }

    /// Whether the window is full is known to who has just sent.
    pub fn validate_window(&mut self, now_ns: i64, limited: bool) {
        self.congestion.validate(&SendingState {
            now_ns,
            una: self.una,
            nxt: self.nxt,
            out: count(self.board.out()),
            limited,
            open: self.state == State::Open,
            timeout_jiffies: self.timeout_jiffies,
        });
    }

    /// `tcp_slow_start_after_idle_check`.
    fn restart_after_idle(&mut self, now_ns: i64) {
        let idle = self.jiffies.count(now_ns) - self.jiffies.count(self.last_sent_ns);
        if idle > self.timeout_jiffies {
            self.congestion.restart(now_ns, idle, self.timeout_jiffies);
        }
    }
}

/// The clock that segments are stamped with for measuring.
pub(super) const fn us(ns: i64) -> i64 {
    ns.div_euclid(1000)
}

/// The clock of the time stamp option (`TCP_TS_HZ`).
pub(super) const fn stamp_ms(ns: i64) -> i64 {
    ns.div_euclid(1_000_000)
}

pub(super) fn count(segments: usize) -> u32 {
    u32::try_from(segments).unwrap_or(u32::MAX)
}
