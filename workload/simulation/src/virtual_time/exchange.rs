//! Two hosts that talk over one topic each way. The main type is [`Exchange`].

use std::{collections::VecDeque, time::Duration};

use oorandom::Rand64;
use record::settings::NetworkSettings;

use super::{
    jiffies::{DEBIAN_HZ, Jiffies},
    path::Path,
    tcp::{
        Counts, Read, SenderSettings, Stream,
        segment::{Ack, Data},
    },
};
use crate::link::Impairment;

/// The wheel's third level has ticks of 64 jiffies: clocks that differ by less than so many are different.
const CLOCK_PHASES: u64 = 64 * 1_000_000_000 / DEBIAN_HZ as u64;

/// Who sends and receives.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Peer {
    /// On `sta1`; it publishes commands.
    Controller,
    /// On `sta2`; it publishes states.
    Plant,
}

impl Peer {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Controller, Self::Plant];

    /// Its place in [`Self::ALL`].
    #[must_use]
    pub const fn index(self) -> usize {
        self as usize
    }

    /// Who it talks with.
    #[must_use]
    pub const fn other(self) -> Self {
        match self {
            Self::Controller => Self::Plant,
            Self::Plant => Self::Controller,
        }
    }
}

/// What the messages go through.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Conditions {
    /// Every link's every end.
    pub impairment: Impairment,
    /// Whether small segments wait (`TCP_NODELAY` is off).
    pub nagle: bool,
    /// How long a packet takes through both hosts' kernels and whatever carries it, beside what the links delay.
    pub stack_ns: i64,
    /// How long a program takes from a segment's arrival to having read it.
    pub reads_after_ns: i64,
}

impl Conditions {
    /// Links as the settings have them, Nagle on, an ideal platform.
    #[must_use]
    pub fn of(settings: &NetworkSettings) -> Self {
        Self {
            impairment: Impairment::from(&settings.link()),
            nagle: true,
            stack_ns: 0,
            reads_after_ns: 0,
        }
    }

    /// Every packet takes that long each way, and none is lost.
    #[must_use]
    pub fn fixed(one_way: Duration) -> Self {
        Self {
            impairment: Impairment::NONE,
            nagle: false,
            stack_ns: i64::try_from(one_way.as_nanos()).unwrap_or(i64::MAX / 8),
            reads_after_ns: 0,
        }
    }
}

/// A message that was read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Delivery<M> {
    /// Who read it.
    pub to: Peer,
    /// When it was sent.
    pub sent_ns: i64,
    /// When it was read.
    pub at_ns: i64,
    /// The message.
    pub message: M,
}

/// Two hosts, the links between them, and an established connection for each one's messages.
#[derive(Debug)]
pub struct Exchange<M> {
    conditions: Conditions,
    /// From each peer.
    paths: [Path<Packet>; 2],
    streams: [Stream<M>; 2],
    deliveries: VecDeque<Delivery<M>>,
}

/// What a host sends, with whose messages it is about.
#[derive(Debug, Clone, Copy)]
enum Packet {
    Data(Peer, Data),
    Ack(Peer, Ack),
}

impl<M> Exchange<M> {
    /// Nothing under way, at time zero. The same seed gives the same times.
    #[must_use]
    pub fn new(conditions: &Conditions, seed: u64) -> Self {
        let mut seeds = Rand64::new(u128::from(seed));
        let phase_ns = i64::try_from(seeds.rand_range(0..CLOCK_PHASES)).unwrap_or(0);
        let mut source = || Rand64::new((u128::from(seeds.rand_u64()) << 64) | u128::from(seeds.rand_u64()));
        let paths = [(); 2].map(|()| Path::new(conditions.impairment, source(), source()));
        let one_way_ns = 2 * i64::try_from(conditions.impairment.delay_ns).unwrap_or(i64::MAX / 8);
        let settings = SenderSettings {
            nagle: conditions.nagle,
            first_round_trip_ns: 2 * (one_way_ns + conditions.stack_ns),
            ..SenderSettings::default()
        };
        let jiffies = Jiffies::new(DEBIAN_HZ, phase_ns);
        Self {
            conditions: *conditions,
            paths,
            streams: [(); 2].map(|()| Stream::new(settings, jiffies, conditions.reads_after_ns)),
            deliveries: VecDeque::new(),
        }
    }

    /// A peer publishes a message of so many bytes, its length before it included. `now_ns` never goes back, and nothing that was due
    /// before is left (see [`Self::advance`]).
    pub fn send(&mut self, now_ns: i64, from: Peer, message: M, bytes: u64) {
        self.streams[from.index()].write(now_ns, message, bytes);
        self.put_on_wire(now_ns);
    }

    /// When something happens next; nothing if all that was sent has come and is acknowledged.
    #[must_use]
    pub fn next_ns(&self) -> Option<i64> {
        if let Some(delivery) = self.deliveries.front() {
            return Some(delivery.at_ns);
        }
        let stack_ns = self.conditions.stack_ns;
        let paths = self
            .paths
            .iter()
            .filter_map(|path| Some(path.next_ns()?.saturating_add(stack_ns)));
        let timers = self.streams.iter().filter_map(Stream::next_ns);
        paths.chain(timers).min()
    }

    /// Lets happen what is due, in order, until a message is read. Nothing if none is by then.
    pub fn advance(&mut self, until_ns: i64) -> Option<Delivery<M>> {
        while self.deliveries.is_empty() {
            let now_ns = self.next_ns().filter(|next_ns| *next_ns <= until_ns)?;
            self.receive(now_ns);
            for peer in Peer::ALL {
                let deliveries = &mut self.deliveries;
                self.streams[peer.index()].advance(now_ns, |read| {
                    let Read {
                        written_ns,
                        read_ns,
                        message,
                    } = read;
                    deliveries.push_back(Delivery {
                        to: peer.other(),
                        sent_ns: written_ns,
                        at_ns: read_ns,
                        message,
                    });
                });
            }
            self.put_on_wire(now_ns);
        }
        self.deliveries.pop_front()
    }

    /// What the senders did so far, in [`Peer::ALL`]'s order.
    #[must_use]
    pub fn counts(&self) -> [Counts; 2] {
        [self.streams[0].counts(), self.streams[1].counts()]
    }

    /// How many bytes a peer sent that are not acknowledged.
    #[must_use]
    pub fn unacknowledged_bytes(&self, from: Peer) -> u64 {
        self.streams[from.index()].unacknowledged_bytes()
    }

    fn receive(&mut self, now_ns: i64) {
        let left_links_ns = now_ns - self.conditions.stack_ns;
        if left_links_ns < 0 {
            return;
        }
        for path in &mut self.paths {
            while let Some(arrived) = path.advance(left_links_ns) {
                match arrived.packet {
                    Packet::Data(from, data) => self.streams[from.index()].receive_data(now_ns, &data),
                    Packet::Ack(of, ack) => self.streams[of.index()].receive_ack(now_ns, &ack),
                }
            }
        }
    }

    fn put_on_wire(&mut self, now_ns: i64) {
        for peer in Peer::ALL {
            let stream = &mut self.streams[peer.index()];
            while let Some(data) = stream.take_data() {
                self.paths[peer.index()].send(now_ns, data.frame_bytes(), Packet::Data(peer, data));
            }
            while let Some(ack) = stream.take_ack() {
                let from = peer.other();
                self.paths[from.index()].send(now_ns, ack.frame_bytes(), Packet::Ack(peer, ack));
            }
        }
    }
}

#[cfg(test)]
mod tests;
