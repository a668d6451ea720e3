//! All connections between controller and plant, from the packets of their two captures in the order of their stamps.
//! The main type is [`Exchange`].

use std::{
    collections::{BTreeMap, btree_map::Entry},
    net::Ipv4Addr,
};

use captures::packets::{MOST_CONNECTIONS, Packet, SILENCE_NS, Segment, TooMuch, Topic};
use record::{settings::Messages, topology::address_in_the_ball, virtual_host::VirtualHost};

use super::flow::{Delivery, Flow};

/// How often connections that have gone silent are looked for.
const SWEEP_EVERY_NS: i64 = 1_000_000_000;
/// So much memory is held of all connections together: that of a dozen of which nobody acknowledges anything.
const MOST_HELD_BYTES: usize = 256 << 20;

/// One direction of one connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(super) struct Ports {
    /// Who sends, and so what it may carry.
    pub topic: Topic,
    /// The sender's port.
    pub from: u16,
    /// The receiver's port.
    pub to: u16,
}

impl Ports {
    fn of(segment: &Segment<'_>) -> Option<Self> {
        let topic = Topic::ALL
            .into_iter()
            .find(|topic| [topic.sender(), topic.receiver()].map(address_in_the_ball) == ends(segment))?;
        Some(Self {
            topic,
            from: segment.source.port(),
            to: segment.destination.port(),
        })
    }

    /// The other direction.
    fn back(self) -> Self {
        Self {
            topic: self.topic.back(),
            from: self.to,
            to: self.from,
        }
    }
}

fn ends(segment: &Segment<'_>) -> [Ipv4Addr; 2] {
    [*segment.source.ip(), *segment.destination.ip()]
}

/// What the captures have told so far.
#[derive(Debug)]
pub(super) struct Exchange {
    messages: Messages,
    /// In an order, so that the rows of a table are in the same order each time.
    flows: BTreeMap<Ports, Flow>,
    /// The memory of all of them.
    held_bytes: usize,
    sweep_due_unix_ns: i64,
}

impl Exchange {
    /// For messages of that form.
    pub fn of(messages: Messages) -> Self {
        Self {
            messages,
            flows: BTreeMap::new(),
            held_bytes: 0,
            sweep_due_unix_ns: 0,
        }
    }

    /// A packet in the capture of `host`; the packets of both captures come in the order of their stamps.
    ///
    /// # Errors
    /// If more is to be followed than any experiment has.
    pub fn take(
        &mut self,
        host: VirtualHost,
        packet: &Packet<'_>,
        out: &mut impl FnMut(Ports, Delivery),
    ) -> Result<(), TooMuch> {
        let now_unix_ns = packet.stamp_unix_ns;
        if now_unix_ns >= self.sweep_due_unix_ns {
            self.sweep_due_unix_ns = now_unix_ns + SWEEP_EVERY_NS;
            self.sweep(now_unix_ns, out);
        }
        let Some(segment) = Segment::parse(packet) else {
            return Ok(());
        };
        let Some(ports) = Ports::of(&segment) else {
            return Ok(());
        };
        if segment.opens
            && self
                .flows
                .get(&ports)
                .is_some_and(|flow| flow.is_opened_anew_by(&segment))
        {
            self.end(ports, out);
        }
        if segment.payload_bytes > 0 || segment.opens {
            let is_full = self.flows.len() >= MOST_CONNECTIONS;
            let flow = match self.flows.entry(ports) {
                Entry::Occupied(followed) => followed.into_mut(),
                Entry::Vacant(_) if is_full => return Err(TooMuch::Connections),
                Entry::Vacant(place) => {
                    let flow = Flow::new(ports.topic, self.messages);
                    self.held_bytes += flow.held_bytes();
                    place.insert(flow)
                }
            };
            self.held_bytes -= flow.held_bytes();
            if host == ports.topic.sender() {
                flow.sent(&segment, now_unix_ns);
            } else {
                flow.arrived(&segment, now_unix_ns);
            }
            self.held_bytes += flow.held_bytes();
        }
        let back = ports.back();
        if let Some(number) = segment.acknowledged.filter(|_| host == back.topic.sender())
            && let Some(flow) = self.flows.get_mut(&back)
        {
            self.held_bytes -= flow.held_bytes();
            flow.acknowledge(number, now_unix_ns);
            flow.retire(now_unix_ns, |delivery| out(back, delivery));
            self.held_bytes += flow.held_bytes();
        }
        if self.held_bytes > MOST_HELD_BYTES {
            return Err(TooMuch::UnderWay);
        }
        Ok(())
    }

    /// Both captures have ended.
    pub fn finish(mut self, out: &mut impl FnMut(Ports, Delivery)) {
        let ports: Vec<Ports> = self.flows.keys().copied().collect();
        for ports in ports {
            self.end(ports, out);
        }
    }

    fn end(&mut self, ports: Ports, out: &mut impl FnMut(Ports, Delivery)) {
        if let Some(flow) = self.flows.remove(&ports) {
            self.held_bytes -= flow.held_bytes();
            flow.finish(|delivery| out(ports, delivery));
        }
    }

    fn sweep(&mut self, now_unix_ns: i64, out: &mut impl FnMut(Ports, Delivery)) {
        self.flows.retain(|ports, flow| {
            flow.retire(now_unix_ns, |delivery| out(*ports, delivery));
            !flow.is_silent_since(now_unix_ns - SILENCE_NS)
        });
        self.held_bytes = self.flows.values().map(Flow::held_bytes).sum();
    }
}

#[cfg(test)]
mod tests;
