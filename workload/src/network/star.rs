//! The three hosts' links and the switch between them, in virtual time: pure. The main type is [`Star`].
//!
//! Who drives it says what time it is: the emulator the monotonic clock, a simulation whatever it likes. A packet's
//! second pass begins when its first was due to end and not when somebody came to look, so that the lateness of the
//! driver does not add up along the way.

use std::sync::Arc;

use oorandom::Rand64;
use record::{
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

/// Three links and a switch.
#[derive(Debug)]
pub struct Star {
    /// From each host to the switch.
    up: [Pass; 3],
    /// From the switch to each host.
    down: [Pass; 3],
    switch: Switch<VirtualHost>,
    release_lateness: Arc<ReleaseLateness>,
    pool: Vec<Vec<u8>>,
}

/// One direction of a link, with its counts.
#[derive(Debug)]
struct Pass {
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
    /// Hands the frame to the host. It was due at `due_ns`.
    ///
    /// Returns the time at which it was done, or nothing if the host did not take it: it then counts as overflowed.
    fn deliver(&mut self, host: VirtualHost, due_ns: u64, frame: &[u8]) -> Option<u64>;
}

impl Star {
    /// Idle links, and a switch that knows no address. The same seed gives the same losses and delays to the same
    /// packets.
    #[must_use]
    pub fn new(impairment: Impairment, seed: u64) -> Self {
        let mut seeds = Rand64::new(u128::from(seed));
        let mut pass = || {
            let own_seed = (u128::from(seeds.rand_u64()) << 64) | u128::from(seeds.rand_u64());
            Pass::new(LinkEnd::new(impairment, Rand64::new(own_seed)))
        };
        Self {
            up: [pass(), pass(), pass()],
            down: [pass(), pass(), pass()],
            switch: Switch::new(),
            release_lateness: Arc::default(),
            pool: (0..POOL_FRAMES)
                .map(|_| Vec::with_capacity(FRAME_BYTES))
                .collect(),
        }
    }

    /// From now on every pass through a link's end does this to packets.
    pub fn impair(&mut self, impairment: Impairment) {
        for pass in self.up.iter_mut().chain(&mut self.down) {
            pass.end.impair(impairment);
        }
    }

    /// A host sends a frame. `now_ns` never goes back.
    pub fn send(&mut self, now_ns: u64, from: VirtualHost, frame: &[u8]) {
        let frame = pooled_copy(&mut self.pool, frame);
        if let Some(refused) = self.up[from.index()].offer(now_ns, frame) {
            self.pool.push(refused);
        }
    }

    /// When something happens next; nothing if no packet is under way.
    #[must_use]
    pub fn next_due_ns(&self) -> Option<u64> {
        self.up
            .iter()
            .chain(&self.down)
            .filter_map(|pass| pass.end.next_due_ns())
            .min()
    }

    /// Does what is due at or before `now_ns`, in the order in which it was due.
    pub fn advance(&mut self, now_ns: u64, delivery: &mut impl Delivery) {
        while let Some(due_ns) = self.next_due_ns().filter(|due_ns| *due_ns <= now_ns) {
            for host in VirtualHost::ALL {
                self.switch_if_due(due_ns, now_ns, host);
                self.deliver_if_due(due_ns, host, delivery);
            }
        }
    }

    /// What went through the links, in [`VirtualHost::ALL`]'s order.
    #[must_use]
    pub fn links(&self) -> [LinkRecord; 3] {
        VirtualHost::ALL.map(|host| LinkRecord {
            host,
            up: self.up[host.index()].record(),
            down: self.down[host.index()].record(),
        })
    }

    /// How late packets leave the passes, all of them together.
    #[must_use]
    pub fn release_lateness(&self) -> Arc<ReleaseLateness> {
        Arc::clone(&self.release_lateness)
    }

    /// Passes on what has come from the host's link.
    fn switch_if_due(&mut self, due_ns: u64, now_ns: u64, from: VirtualHost) {
        let pass = &mut self.up[from.index()];
        let Some(Released {
            due_ns,
            packet: frame,
        }) = pass.end.release(due_ns)
        else {
            return;
        };
        pass.count_delivery(now_ns.saturating_sub(due_ns), &self.release_lateness);
        match self.switch.forward(from, &frame) {
            Forward::To(to) => {
                if let Some(refused) = self.down[to.index()].offer(due_ns, frame) {
                    self.pool.push(refused);
                }
            }
            Forward::Flood => {
                for to in VirtualHost::ALL.into_iter().filter(|to| *to != from) {
                    let copy = pooled_copy(&mut self.pool, &frame);
                    if let Some(refused) = self.down[to.index()].offer(due_ns, copy) {
                        self.pool.push(refused);
                    }
                }
                self.pool.push(frame);
            }
            Forward::Nowhere => self.pool.push(frame),
        }
    }

    /// Hands the host what has come to it.
    fn deliver_if_due(&mut self, due_ns: u64, host: VirtualHost, delivery: &mut impl Delivery) {
        let pass = &mut self.down[host.index()];
        let Some(Released {
            due_ns,
            packet: frame,
        }) = pass.end.release(due_ns)
        else {
            return;
        };
        match delivery.deliver(host, due_ns, &frame) {
            Some(done_ns) => {
                pass.count_delivery(done_ns.saturating_sub(due_ns), &self.release_lateness);
            }
            None => pass.overflowed += 1,
        }
        self.pool.push(frame);
    }
}

impl Pass {
    fn new(end: LinkEnd<Vec<u8>>) -> Self {
        Self {
            end,
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
