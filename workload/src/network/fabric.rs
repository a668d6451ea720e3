//! Hosts, switches and the links between them, in virtual time: pure. The main type is [`Fabric`].
//!
//! Who drives it says what time it is: the emulator the monotonic clock, a simulation whatever it likes. A packet's
//! next pass begins when its last was due to end and not when somebody came to look, so that the lateness of the
//! driver does not add up along the way.

use std::sync::Arc;

use oorandom::Rand64;
use record::{
    topology::Topology,
    virtual_host::VirtualHost,
    window::{LinkRecord, PassRecord},
};
use simulation::link::{Impairment, LinkEnd, Refused, Released};

use super::{
    release_lateness::ReleaseLateness,
    switch::{Forward, Switch},
};

/// How many frames the pool has to begin with; it grows to what waits at once and stays there.
const POOL_FRAMES: usize = 256;

/// A frame's room: the MTU, the Ethernet header and a VLAN tag.
pub const FRAME_BYTES: usize = 1518;

/// All links, each as a pass up, towards the first switch, and a pass down; and the switches.
#[derive(Debug)]
pub struct Fabric {
    /// Of link N, in [`Topology::links`]' order, the pass up is 2N and the pass down 2N + 1; those of the hosts come first.
    passes: Vec<Pass>,
    /// Whose links they are.
    names: Vec<VirtualHost>,
    switches: Vec<SwitchPorts>,
    /// What each link is to do once it is impaired.
    impairments: Vec<Impairment>,
    release_lateness: Arc<ReleaseLateness>,
    pool: Vec<Vec<u8>>,
}

/// A switch, and the passes that leave it, by which it names its ports.
#[derive(Debug, Default)]
struct SwitchPorts {
    switch: Switch<usize>,
    ports: Vec<usize>,
}

/// Where a pass ends.
#[derive(Debug, Clone, Copy)]
enum End {
    /// At the host in that position.
    Host(usize),
    /// At the switch in that position.
    Switch(usize),
}

/// One direction of a link, with its counts.
#[derive(Debug)]
struct Pass {
    to: End,
    end: LinkEnd<Vec<u8>>,
    offered: u64,
    lost: u64,
    overflowed: u64,
    delivered: u64,
    lateness_total_ns: u64,
    lateness_max_ns: u64,
}

/// Takes the frames that reach a host.
pub trait Delivery {
    /// Hands the frame to the host in that position. It was due at `due_ns`.
    ///
    /// Returns the time at which it was done, or nothing if the host did not take it: it then counts as overflowed.
    fn deliver(&mut self, host: usize, due_ns: u64, frame: &[u8]) -> Option<u64>;
}

impl Fabric {
    /// Idle links that carry everything at once, and switches that know no address. The same seed gives the same losses and
    /// delays to the same packets.
    #[must_use]
    pub fn new(topology: &Topology, seed: u64) -> Self {
        let (names, links): (Vec<_>, Vec<_>) = topology.links().unzip();
        let mut seeds = Rand64::new(u128::from(seed));
        let mut own_seed = || (u128::from(seeds.rand_u64()) << 64) | u128::from(seeds.rand_u64());
        let mut switches: Vec<SwitchPorts> =
            topology.switches.iter().map(|_| SwitchPorts::default()).collect();
        // The passes up of all hosts draw their seeds first, then those down, as they always have: a seed of an old run gives that
        // run's losses.
        let of_hosts = topology.hosts.len();
        let ups: Vec<u128> = (0..of_hosts).map(|_| own_seed()).collect();
        let downs: Vec<u128> = (0..of_hosts).map(|_| own_seed()).collect();
        let mut passes = Vec::with_capacity(2 * links.len());
        let mut connect = |upper: usize, lower: End, up_seed, down_seed| {
            let up = passes.len();
            passes.push(Pass::new(End::Switch(upper), up_seed));
            passes.push(Pass::new(lower, down_seed));
            if let Some(switch) = switches.get_mut(upper) {
                switch.ports.push(up + 1);
            }
            if let End::Switch(lower) = lower {
                if let Some(switch) = switches.get_mut(lower) {
                    switch.ports.push(up);
                }
            }
        };
        for (position, host) in topology.hosts.iter().enumerate() {
            let seeds = (ups.get(position), downs.get(position));
            if let (Some(up), Some(down)) = seeds {
                connect(host.switch, End::Host(position), *up, *down);
            }
        }
        for (position, switch) in topology.switches.iter().enumerate() {
            if let Some((upper, _)) = switch.uplink {
                connect(upper, End::Switch(position), own_seed(), own_seed());
            }
        }
        Self {
            passes,
            names,
            switches,
            impairments: links.iter().map(Impairment::from).collect(),
            release_lateness: Arc::default(),
            pool: (0..POOL_FRAMES)
                .map(|_| Vec::with_capacity(FRAME_BYTES))
                .collect(),
        }
    }

    /// From now on every link delays, loses and limits as the topology has it.
    pub fn impair(&mut self) {
        for (passes, impairment) in self.passes.chunks_mut(2).zip(&self.impairments) {
            for pass in passes {
                pass.end.impair(*impairment);
            }
        }
    }

    /// The host in that position sends a frame. `now_ns` never goes back.
    pub fn send(&mut self, now_ns: u64, from: usize, frame: &[u8]) {
        let frame = pooled_copy(&mut self.pool, frame);
        offer(&mut self.passes, &mut self.pool, 2 * from, now_ns, frame);
    }

    /// When something happens next; nothing if no packet is under way.
    #[must_use]
    pub fn next_due_ns(&self) -> Option<u64> {
        self.passes.iter().filter_map(|pass| pass.end.next_due_ns()).min()
    }

    /// Does what is due at or before `now_ns`, in the order in which it was due.
    pub fn advance(&mut self, now_ns: u64, delivery: &mut impl Delivery) {
        while let Some(due_ns) = self.next_due_ns().filter(|due_ns| *due_ns <= now_ns) {
            for position in 0..self.passes.len() {
                self.end_pass_if_due(due_ns, now_ns, position, delivery);
            }
        }
    }

    /// Writes down what went through the links, in [`Topology::links`]' order.
    pub fn record_links(&self, into: &mut Vec<LinkRecord>) {
        into.clear();
        let links = self.names.iter().zip(self.passes.chunks(2));
        into.extend(links.filter_map(|(host, passes)| match passes {
            [up, down] => Some(LinkRecord {
                host: *host,
                up: up.record(),
                down: down.record(),
            }),
            _ => None,
        }));
    }

    /// How late packets leave the passes, all of them together.
    #[must_use]
    pub fn release_lateness(&self) -> Arc<ReleaseLateness> {
        Arc::clone(&self.release_lateness)
    }

    /// Passes on what has come to a switch, and hands a host what has come to it.
    fn end_pass_if_due(&mut self, due_ns: u64, now_ns: u64, position: usize, delivery: &mut impl Delivery) {
        let Some(pass) = self.passes.get_mut(position) else {
            return;
        };
        let Some(Released {
            due_ns,
            packet: frame,
        }) = pass.end.release(due_ns)
        else {
            return;
        };
        match pass.to {
            End::Host(host) => {
                match delivery.deliver(host, due_ns, &frame) {
                    Some(done_ns) => {
                        pass.count_delivery(done_ns.saturating_sub(due_ns), &self.release_lateness);
                    }
                    None => pass.overflowed += 1,
                }
                self.pool.push(frame);
            }
            End::Switch(switch) => {
                pass.count_delivery(now_ns.saturating_sub(due_ns), &self.release_lateness);
                // The other pass of the link is the port that the frame came in at.
                self.forward(switch, position ^ 1, due_ns, frame);
            }
        }
    }

    fn forward(&mut self, at: usize, from: usize, due_ns: u64, frame: Vec<u8>) {
        let Some(SwitchPorts { switch, ports }) = self.switches.get_mut(at) else {
            return;
        };
        match switch.forward(from, &frame) {
            Forward::To(port) => offer(&mut self.passes, &mut self.pool, port, due_ns, frame),
            Forward::Flood => {
                for port in ports.iter().copied().filter(|port| *port != from) {
                    let copy = pooled_copy(&mut self.pool, &frame);
                    offer(&mut self.passes, &mut self.pool, port, due_ns, copy);
                }
                self.pool.push(frame);
            }
            Forward::Nowhere => self.pool.push(frame),
        }
    }
}

/// Offers a frame to a pass; a refused one goes back to the pool.
fn offer(passes: &mut [Pass], pool: &mut Vec<Vec<u8>>, to: usize, now_ns: u64, frame: Vec<u8>) {
    if let Some(pass) = passes.get_mut(to) {
        pool.extend(pass.offer(now_ns, frame));
    }
}

impl Pass {
    fn new(to: End, seed: u128) -> Self {
        Self {
            to,
            end: LinkEnd::new(Impairment::NONE, Rand64::new(seed)),
            offered: 0,
            lost: 0,
            overflowed: 0,
            delivered: 0,
            lateness_total_ns: 0,
            lateness_max_ns: 0,
        }
    }

    /// Counts and offers a frame; a refused one comes back.
    fn offer(&mut self, now_ns: u64, frame: Vec<u8>) -> Option<Vec<u8>> {
        self.offered += 1;
        match self.end.offer(now_ns, frame.len(), frame) {
            Ok(()) => None,
            Err(Refused::Lost(frame)) => {
                self.lost += 1;
                Some(frame)
            }
            Err(Refused::Overflowed(frame)) => {
                self.overflowed += 1;
                Some(frame)
            }
        }
    }

    fn count_delivery(&mut self, lateness_ns: u64, all: &ReleaseLateness) {
        all.count(lateness_ns);
        self.delivered += 1;
        self.lateness_total_ns = self.lateness_total_ns.saturating_add(lateness_ns);
        self.lateness_max_ns = self.lateness_max_ns.max(lateness_ns);
    }

    fn record(&self) -> PassRecord {
        PassRecord {
            offered: self.offered,
            lost: self.lost,
            overflowed: Some(self.overflowed),
            delivered: self.delivered,
            lateness_mean_ns: Some(self.lateness_total_ns as f64 / self.delivered.max(1) as f64),
            lateness_max_of_run_ns: Some(self.lateness_max_ns),
        }
    }
}

/// A copy of the frame in a buffer of the pool, or in a new one while the pool still grows.
fn pooled_copy(pool: &mut Vec<Vec<u8>>, frame: &[u8]) -> Vec<u8> {
    let mut copy = pool.pop().unwrap_or_else(|| Vec::with_capacity(FRAME_BYTES));
    copy.clear();
    copy.extend_from_slice(frame);
    copy
}

#[cfg(test)]
mod tests;
