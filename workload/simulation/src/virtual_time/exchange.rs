//! Two hosts that talk over one topic each way. The main type is [`Exchange`].

use std::{collections::VecDeque, time::Duration};

use oorandom::Rand64;
use record::{platform_model::Quantiles, settings::NetworkSettings};

use super::{
    jiffies::{DEBIAN_HZ, Jiffies},
    path::{Passes, Path},
    tcp::{
        Counts, Read, Reader, SenderSettings, Stream,
        segment::{Ack, Data},
    },
};
use crate::{link::Impairment, stalls::Stalls};

/// The wheel's third level has ticks of 64 jiffies: clocks that differ by less than so many are different.
const CLOCK_PHASES: u64 = 64 * 1_000_000_000 / DEBIAN_HZ as u64;

const MILLISECOND_NS: i64 = 1_000_000;

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
#[derive(Debug, Clone, PartialEq)]
pub struct Conditions {
    /// Every link's every end.
    pub impairment: Impairment,
    /// Whether small segments wait (`TCP_NODELAY` is off).
    pub nagle: bool,
    /// How long a packet takes through both hosts' kernels and whatever carries it, beside what the links delay.
    pub stack_ns: i64,
    /// How long a program takes from a segment's arrival to having read it.
    pub reading: Quantiles,
}

impl Conditions {
    /// Links as the settings have them, Nagle on, an ideal platform.
    #[must_use]
    pub fn of(settings: &NetworkSettings) -> Self {
        Self {
            impairment: Impairment::from(&settings.link()),
            nagle: true,
            stack_ns: 0,
            reading: Quantiles::default(),
        }
    }

    /// Every packet takes that long each way, and none is lost.
    #[must_use]
    pub fn fixed(one_way: Duration) -> Self {
        Self {
            impairment: Impairment::NONE,
            nagle: false,
            stack_ns: i64::try_from(one_way.as_nanos()).unwrap_or(i64::MAX / 8),
            reading: Quantiles::default(),
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
    /// Packets so far.
    packets: u64,
    /// The newest clock that came with an acknowledgement to each peer.
    clocks_ms: [Option<i64>; 2],
    /// What captures have, if there are any, until it is taken.
    heard: Option<VecDeque<Heard>>,
}

/// What a host sends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Packet {
    /// Counts the packets of both hosts, from 0: one that is sent again has another.
    pub number: u64,
    /// Whose messages it is about.
    pub of: Peer,
    /// When it was sent.
    pub sent_ns: i64,
    /// The newest clock of the other host that the sender had (RFC 7323, TSecr).
    pub echo_ms: Option<i64>,
    /// What is in it.
    pub segment: Segment,
}

/// What is in a packet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Segment {
    /// Bytes of messages.
    Data(Data),
    /// That some have come.
    Ack(Ack),
}

impl Packet {
    /// Who sent it.
    #[must_use]
    pub const fn from(&self) -> Peer {
        match self.segment {
            Segment::Data(_) => self.of,
            Segment::Ack(_) => self.of.other(),
        }
    }

    fn frame_bytes(&self) -> usize {
        match &self.segment {
            Segment::Data(data) => data.frame_bytes(),
            Segment::Ack(ack) => ack.frame_bytes(),
        }
    }
}

/// A packet that left a host or came to it, as a capture there has it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Heard {
    /// Where.
    pub at: Peer,
    /// When.
    pub at_ns: i64,
    /// The packet.
    pub packet: Packet,
}

impl<M> Exchange<M> {
    /// Nothing under way, at time zero. The same seed gives the same times.
    #[must_use]
    pub fn new(conditions: &Conditions, seed: u64) -> Self {
        Self::on(conditions, seed, &Stalls::none())
    }

    /// The same between programs on a machine that stands still now and then.
    #[must_use]
    pub fn on(conditions: &Conditions, seed: u64, stalls: &Stalls) -> Self {
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
        let readers = [(); 2].map(|()| Reader {
            after: conditions.reading.clone(),
            chance: source(),
            stalls: stalls.clone(),
        });
        Self {
            conditions: conditions.clone(),
            paths,
            streams: readers.map(|reader| Stream::new(settings, jiffies, reader)),
            deliveries: VecDeque::new(),
            packets: 0,
            clocks_ms: [None; 2],
            heard: None,
        }
    }

    /// Keeps each packet that leaves a host or comes to one, for [`Self::take_heard`].
    pub fn listen(&mut self) {
        self.heard = Some(VecDeque::new());
    }

    /// The next packet that left a host or came to one, in order of time.
    pub fn take_heard(&mut self) -> Option<Heard> {
        self.heard.as_mut()?.pop_front()
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

    /// What went through the ends of the links on the way from each peer, in [`Peer::ALL`]'s order.
    #[must_use]
    pub fn passes(&self) -> [Passes; 2] {
        self.paths.each_ref().map(Path::passes)
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
                let packet = arrived.packet;
                if let Some(heard) = &mut self.heard {
                    heard.push_back(Heard {
                        at: packet.from().other(),
                        at_ns: now_ns,
                        packet,
                    });
                }
                let stream = &mut self.streams[packet.of.index()];
                match packet.segment {
                    Segment::Data(data) => stream.receive_data(now_ns, &data),
                    Segment::Ack(ack) => {
                        self.clocks_ms[packet.of.index()] = Some(packet.sent_ns / MILLISECOND_NS);
                        stream.receive_ack(now_ns, &ack);
                    }
                }
            }
        }
    }

    fn put_on_wire(&mut self, now_ns: i64) {
        for of in Peer::ALL {
            while let Some(data) = self.streams[of.index()].take_data() {
                let echo_ms = self.clocks_ms[of.index()];
                self.send_packet(now_ns, of, echo_ms, Segment::Data(data));
            }
            while let Some(ack) = self.streams[of.index()].take_ack() {
                self.send_packet(now_ns, of, ack.echo_ms, Segment::Ack(ack));
            }
        }
    }

    fn send_packet(&mut self, now_ns: i64, of: Peer, echo_ms: Option<i64>, segment: Segment) {
        let packet = Packet {
            number: self.packets,
            of,
            sent_ns: now_ns,
            echo_ms,
            segment,
        };
        self.packets += 1;
        let from = packet.from();
        if let Some(heard) = &mut self.heard {
            heard.push_back(Heard {
                at: from,
                at_ns: now_ns,
                packet,
            });
        }
        self.paths[from.index()].send(now_ns, packet.frame_bytes(), packet);
    }
}

#[cfg(test)]
mod tests;
