//! Both directions between controller and plant: each packet at its sender is found again at its receiver. The main type is
//! [`Directions`]; what it tells is a [`Passing`].

use std::collections::{HashMap, VecDeque};

use record::{topology::address_in_the_ball, virtual_host::VirtualHost};

use super::connection::{Connection, Rtt};
use crate::packets::{MOST_CONNECTIONS, SILENCE_NS, Segment, TooMuch, Topic};

/// A packet is not under way for longer: one that has not arrived by then is lost. Far beyond the queues of any network
/// that the experiment can be asked to run on.
const LONGEST_WAY_NS: i64 = 5_000_000_000;
/// What was sent this shortly before the captures end, and has not arrived, may still be under way.
const LAST_WAY_NS: i64 = 1_000_000_000;
/// More packets than this are not under way: the receiver's capture is not of the same network.
const MOST: usize = 1 << 18;
/// So much is kept of all connections of a direction, in segments: that of 32 of which nobody acknowledges anything.
const MOST_KEPT: usize = 1 << 21;
/// Connections that have gone silent are looked for no oftener.
const SWEEP_EVERY_NS: i64 = 1_000_000_000;

/// What became of a packet. Times are wall clock, nanoseconds since 1970.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Passing {
    /// It left.
    Sent {
        at_unix_ns: i64,
        /// Whether some of it had been sent before.
        is_retransmitted: bool,
    },
    /// It arrived.
    Arrived {
        sent_unix_ns: i64,
        one_way_ns: i64,
        /// Whether one that was sent later was there before (RFC 4737, section 3.3).
        is_reordered: bool,
        /// How much longer or shorter its way was than that of the one that arrived before it: the |D| of RFC 3550, section
        /// 6.4.1. None for the first.
        jitter_ns: Option<i64>,
        /// Since the arrival before it; none for the first.
        gap_ns: Option<i64>,
    },
    /// It did not arrive.
    Lost { sent_unix_ns: i64 },
    /// It arrived, and nobody saw it leave.
    Stray { at_unix_ns: i64 },
    /// It was acknowledged.
    Acknowledged { sent_unix_ns: i64, took_ns: i64 },
}

impl Passing {
    /// When the packet that it is about was sent, as far as that is known.
    pub const fn at_unix_ns(&self) -> i64 {
        match self {
            Self::Sent { at_unix_ns, .. } | Self::Stray { at_unix_ns } => *at_unix_ns,
            Self::Arrived { sent_unix_ns, .. }
            | Self::Lost { sent_unix_ns }
            | Self::Acknowledged { sent_unix_ns, .. } => *sent_unix_ns,
        }
    }
}

/// What the captures have told so far.
#[derive(Debug, Default)]
pub(super) struct Directions {
    /// In the order of [`Topic::ALL`].
    directions: [Direction; 2],
}

impl Directions {
    /// A segment in the capture of `host`; those of both captures come in the order of their stamps.
    ///
    /// # Errors
    /// If more is to be followed than any experiment has.
    pub fn take(
        &mut self,
        host: VirtualHost,
        segment: &Segment<'_>,
        at_unix_ns: i64,
        out: &mut impl FnMut(Topic, Passing),
    ) -> Result<(), TooMuch> {
        let ends = [*segment.source.ip(), *segment.destination.ip()];
        let is_of = |topic: &Topic| [topic.sender(), topic.receiver()].map(address_in_the_ball) == ends;
        let Some(topic) = Topic::ALL.into_iter().find(is_of) else {
            return Ok(());
        };
        let [state, command] = &mut self.directions;
        let (direction, back) = match topic {
            Topic::State => (state, command),
            Topic::Command => (command, state),
        };
        if host == topic.sender() {
            direction.send(segment, at_unix_ns, &mut |passing| out(topic, passing))?;
        } else if host == topic.receiver() {
            direction.receive(segment, at_unix_ns, &mut |passing| out(topic, passing));
            // What it acknowledges was sent by the host that it arrives at.
            let ports = (segment.destination.port(), segment.source.port());
            let acknowledged = segment
                .acknowledged
                .and_then(|number| back.connections.acknowledge(ports, number, at_unix_ns));
            if let Some(Rtt {
                sent_unix_ns,
                took_ns,
            }) = acknowledged
            {
                let passing = Passing::Acknowledged {
                    sent_unix_ns,
                    took_ns,
                };
                out(topic.back(), passing);
            }
        }
        Ok(())
    }

    /// Both captures have ended.
    pub fn finish(self, out: &mut impl FnMut(Topic, Passing)) {
        for (topic, direction) in Topic::ALL.into_iter().zip(self.directions) {
            direction.finish(&mut |passing| out(topic, passing));
        }
    }
}

/// By what a packet is known again. TCP counts the packets of a connection in IP's header, and its clock goes on between
/// two times that something is sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
struct Identity {
    ports: (u16, u16),
    sequence: u32,
    payload_bytes: u32,
    sent_clock: Option<u32>,
    identification: u16,
}

impl Identity {
    fn of(segment: &Segment<'_>) -> Self {
        Self {
            ports: (segment.source.port(), segment.destination.port()),
            sequence: segment.sequence,
            payload_bytes: segment.payload_bytes,
            sent_clock: segment.sent_clock,
            identification: segment.identification,
        }
    }
}

/// The connections of one direction that are followed, by their ports.
#[derive(Debug, Default)]
struct Connections {
    followed: HashMap<(u16, u16), Connection>,
    /// What is kept of all of them together.
    kept: usize,
    sweep_due_unix_ns: i64,
}

impl Connections {
    /// A segment leaves, as [`Connection::send`].
    fn send(
        &mut self,
        ports: (u16, u16),
        segment: &Segment<'_>,
        at_unix_ns: i64,
    ) -> Result<Option<bool>, TooMuch> {
        // Each direction may have half of them.
        let is_full = self.followed.len() >= MOST_CONNECTIONS / 2;
        if is_full && !self.followed.contains_key(&ports) {
            self.make_room(at_unix_ns)?;
        }
        let connection = self.followed.entry(ports).or_default();
        let kept = connection.kept();
        let is_retransmitted = connection.send(segment, at_unix_ns);
        self.kept = self.kept - kept + connection.kept();
        if self.kept > MOST_KEPT {
            return Err(TooMuch::UnderWay);
        }
        Ok(is_retransmitted)
    }

    /// An acknowledgement comes, as [`Connection::acknowledge`].
    fn acknowledge(&mut self, ports: (u16, u16), number: u32, at_unix_ns: i64) -> Option<Rtt> {
        let connection = self.followed.get_mut(&ports)?;
        let kept = connection.kept();
        let rtt = connection.acknowledge(number, at_unix_ns);
        self.kept = self.kept - kept + connection.kept();
        rtt
    }

    /// Forgets the connections that have gone silent.
    fn make_room(&mut self, now_unix_ns: i64) -> Result<(), TooMuch> {
        if now_unix_ns >= self.sweep_due_unix_ns {
            self.sweep_due_unix_ns = now_unix_ns + SWEEP_EVERY_NS;
            self.followed
                .retain(|_, connection| !connection.is_silent_since(now_unix_ns - SILENCE_NS));
            self.kept = self.followed.values().map(Connection::kept).sum();
        }
        if self.followed.len() >= MOST_CONNECTIONS / 2 {
            return Err(TooMuch::Connections);
        }
        Ok(())
    }
}

/// One direction, all connections.
#[derive(Debug, Default)]
struct Direction {
    connections: Connections,
    /// When each packet that has not arrived was sent, and as the how many-th.
    under_way: HashMap<Identity, (i64, u64)>,
    /// The same in the order in which they were sent; some have arrived since.
    departures: VecDeque<(Identity, i64, u64)>,
    sent: u64,
    /// The largest number of a packet that has arrived.
    latest: Option<u64>,
    /// When the last one arrived, and how long it had been under way.
    last: Option<(i64, i64)>,
    last_unix_ns: i64,
}

impl Direction {
    fn send(
        &mut self,
        segment: &Segment<'_>,
        at_unix_ns: i64,
        out: &mut impl FnMut(Passing),
    ) -> Result<(), TooMuch> {
        self.last_unix_ns = at_unix_ns;
        self.lose(at_unix_ns.saturating_sub(LONGEST_WAY_NS), out);
        if segment.payload_bytes == 0 && !segment.opens {
            return Ok(());
        }
        let ports = (segment.source.port(), segment.destination.port());
        let Some(is_retransmitted) = self.connections.send(ports, segment, at_unix_ns)? else {
            return Ok(());
        };
        let identity = Identity::of(segment);
        self.sent += 1;
        let twin = self.under_way.insert(identity, (at_unix_ns, self.sent));
        self.departures.push_back((identity, at_unix_ns, self.sent));
        out(Passing::Sent {
            at_unix_ns,
            is_retransmitted,
        });
        // The network itself doubled it before the capture: one of them cannot be known again.
        if let Some((sent_unix_ns, _)) = twin {
            out(Passing::Lost { sent_unix_ns });
        }
        Ok(())
    }

    fn receive(&mut self, segment: &Segment<'_>, at_unix_ns: i64, out: &mut impl FnMut(Passing)) {
        if segment.payload_bytes == 0 {
            return;
        }
        self.last_unix_ns = at_unix_ns;
        let Some((sent_unix_ns, number)) = self.under_way.remove(&Identity::of(segment)) else {
            out(Passing::Stray { at_unix_ns });
            return;
        };
        let one_way_ns = at_unix_ns - sent_unix_ns;
        let before = self.last.replace((at_unix_ns, one_way_ns));
        let is_reordered = self.latest.is_some_and(|latest| number < latest);
        self.latest = self.latest.max(Some(number));
        out(Passing::Arrived {
            sent_unix_ns,
            one_way_ns,
            is_reordered,
            jitter_ns: before.map(|(_, way_ns)| (one_way_ns - way_ns).abs()),
            gap_ns: before.map(|(arrived_unix_ns, _)| at_unix_ns - arrived_unix_ns),
        });
    }

    /// Packets that were sent before a time and have not arrived are lost, and the earliest of more than [`MOST`].
    fn lose(&mut self, before_unix_ns: i64, out: &mut impl FnMut(Passing)) {
        while let Some((identity, sent_unix_ns, number)) = self.departures.front().copied()
            && (sent_unix_ns < before_unix_ns || self.departures.len() > MOST)
        {
            self.departures.pop_front();
            // Not if it has arrived, or another one of the same identity was sent later.
            if self.under_way.get(&identity).is_some_and(|sent| sent.1 == number) {
                self.under_way.remove(&identity);
                out(Passing::Lost { sent_unix_ns });
            }
        }
    }

    /// Both captures end here.
    fn finish(mut self, out: &mut impl FnMut(Passing)) {
        self.lose(self.last_unix_ns.saturating_sub(LAST_WAY_NS), out);
    }
}

#[cfg(test)]
mod tests;
