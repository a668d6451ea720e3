//! One pass through a link's end, as Mininet's `TCLink` sets it up: HTB with a netem child. Pure, in virtual time.
//! The main type is [`LinkEnd`].
//!
//! A link has two ends, each of which delays, loses and limits what leaves through it: a packet from one host to
//! another passes the host's end of its own link and the switch's end of the other's. What a pass does, in the
//! kernel's order (Linux, `net/sched/sch_netem.c` and `net/sched/sch_htb.c`):
//!
//! 1. `netem_enqueue` draws the loss first (`loss_event`): a lost packet takes no place and no time.
//! 2. A packet that finds `limit` packets waiting is dropped.
//! 3. Its time to send is now plus a delay, uniform on [delay − jitter, delay + jitter) (`tabledist` without a table).
//! 4. The queue is sorted by that time, first come first served at equal ones (`tfifo_enqueue`): packets closer
//!    together than twice the jitter can overtake each other.
//! 5. HTB takes the first packet whose time has come (`netem_dequeue`), as soon as its token bucket is not in debt
//!    (`htb_class_mode`), and charges the Ethernet frame's length to the bucket (`htb_charge_class`), which may put it
//!    in debt by less than one packet.
//!
//! Mininet asks for `rate 10Mbit burst 15k` and nothing else, so that `ceil` is the rate and `cburst` what `tc` makes
//! it: 1600 bytes and what the rate gives in a nanosecond. HTB has a bucket for each and sends only if neither is in
//! debt. Both fill and empty alike, so the shallower one decides: the burst is 1600 bytes and not 15k.
//!
//! One difference remains: a sender's TCP learns that a packet was dropped at 2 when the queue is in its own kernel.
//! Here it does not, as with the switch's end in Mininet.

use std::collections::VecDeque;

use oorandom::Rand64;
use record::topology::Link;

/// The depth of HTB's bucket that decides: `tc`'s default for `cburst`, its assumed MTU.
const BURST_BYTES: u64 = 1600;

/// What one end of a link does to packets.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Impairment {
    /// Mean delay.
    pub delay_ns: u64,
    /// The delay is uniform on [delay − jitter, delay + jitter).
    pub jitter_ns: u64,
    /// Probability that a packet is lost, each independently.
    pub loss: f64,
    /// Rate at which packets leave.
    pub bits_per_second: u64,
    /// How many packets may wait.
    pub limit: usize,
}

impl Impairment {
    /// A link that carries everything at once.
    pub const NONE: Self = Self {
        delay_ns: 0,
        jitter_ns: 0,
        loss: 0.0,
        bits_per_second: u64::MAX,
        limit: usize::MAX,
    };
}

impl From<&Link> for Impairment {
    fn from(link: &Link) -> Self {
        Self {
            delay_ns: link.delay.as_nanos(),
            jitter_ns: link.jitter.as_nanos(),
            loss: link.loss.probability(),
            bits_per_second: link.bandwidth.bits_per_second(),
            limit: usize::try_from(link.limit_packets).unwrap_or(usize::MAX),
        }
    }
}

/// One end of a link, with the packets that wait in it.
#[derive(Debug)]
pub struct LinkEnd<P> {
    impairment: Impairment,
    /// In the order of leaving. A packet's place is looked for from the end, as `tfifo_enqueue` does: few overtake others, and those only a
    /// few. A heap would copy each packet several times.
    queue: VecDeque<Waiting<P>>,
    bucket: TokenBucket,
    random: Rand64,
}

/// A packet that was not admitted, handed back.
#[derive(Debug, PartialEq, Eq)]
pub enum Refused<P> {
    /// Lost as the impairment asks.
    Lost(P),
    /// The queue was full.
    Overflowed(P),
}

/// A packet that leaves.
#[derive(Debug, PartialEq, Eq)]
pub struct Released<P> {
    /// When it was due to leave.
    pub due_ns: u64,
    /// The packet.
    pub packet: P,
}

impl<P> LinkEnd<P> {
    /// An idle end, its bucket full.
    #[must_use]
    pub fn new(impairment: Impairment, random: Rand64) -> Self {
        Self {
            impairment,
            // Of ordinary traffic. Room for all of the limit would be gone through in a circle, and be in no processor's cache.
            queue: VecDeque::with_capacity(impairment.limit.min(64)),
            bucket: TokenBucket::full(impairment.bits_per_second),
            random,
        }
    }

    /// From now on does this to packets; those that wait leave as they were to. Losses and delays are drawn from where
    /// the source of randomness is, which an unimpaired end has not touched.
    pub fn impair(&mut self, impairment: Impairment) {
        self.impairment = impairment;
        self.bucket = TokenBucket::full(impairment.bits_per_second);
    }

    /// Offers a packet whose Ethernet frame has so many bytes. `now_ns` never goes back.
    ///
    /// # Errors
    /// The packet, if it is lost or the queue is full.
    pub fn offer(&mut self, now_ns: u64, bytes: usize, packet: P) -> Result<(), Refused<P>> {
        // Nothing is drawn where nothing can be lost, as in netem.
        if self.impairment.loss > 0.0 && self.random.rand_float() < self.impairment.loss {
            return Err(Refused::Lost(packet));
        }
        if self.queue.len() >= self.impairment.limit {
            return Err(Refused::Overflowed(packet));
        }
        let time_to_send_ns = now_ns.saturating_add(self.delay_ns());
        let is_before = |waiting: &Waiting<P>| waiting.time_to_send_ns <= time_to_send_ns;
        let place = self.queue.iter().rposition(is_before).map_or(0, |at| at + 1);
        self.queue.insert(
            place,
            Waiting {
                time_to_send_ns,
                bytes,
                packet,
            },
        );
        Ok(())
    }

    /// When the next packet leaves; none if none waits.
    #[must_use]
    pub fn next_due_ns(&self) -> Option<u64> {
        let first = self.queue.front()?;
        Some(first.time_to_send_ns.max(self.bucket.ready_ns()))
    }

    /// Takes the next packet if it is due.
    pub fn release(&mut self, now_ns: u64) -> Option<Released<P>> {
        let due_ns = self.next_due_ns().filter(|due_ns| *due_ns <= now_ns)?;
        let first = self.queue.pop_front()?;
        self.bucket.charge(due_ns, first.bytes);
        Some(Released {
            due_ns,
            packet: first.packet,
        })
    }

    /// How many packets wait.
    #[must_use]
    pub fn waiting(&self) -> usize {
        self.queue.len()
    }

    fn delay_ns(&mut self) -> u64 {
        let Impairment {
            delay_ns, jitter_ns, ..
        } = self.impairment;
        if jitter_ns == 0 {
            return delay_ns;
        }
        let drawn_ns = self.random.rand_range(0..jitter_ns.saturating_mul(2));
        // netem sends at once what would be sent in the past.
        delay_ns.saturating_add(drawn_ns).saturating_sub(jitter_ns)
    }
}

/// A packet in the queue.
#[derive(Debug)]
struct Waiting<P> {
    time_to_send_ns: u64,
    bytes: usize,
    packet: P,
}

/// HTB's bucket, which holds time: the tokens of a byte are the nanoseconds that it takes at the rate.
#[derive(Debug)]
struct TokenBucket {
    bits_per_second: u64,
    depth_ns: i64,
    tokens_ns: i64,
    charged_ns: u64,
}

impl TokenBucket {
    fn full(bits_per_second: u64) -> Self {
        let depth_bytes = BURST_BYTES + bits_per_second / 8_000_000_000;
        let depth_ns = duration_ns(depth_bytes, bits_per_second);
        Self {
            bits_per_second,
            depth_ns,
            tokens_ns: depth_ns,
            charged_ns: 0,
        }
    }

    /// When it is out of debt.
    fn ready_ns(&self) -> u64 {
        let debt_ns = self.tokens_ns.min(0).unsigned_abs();
        self.charged_ns.saturating_add(debt_ns)
    }

    fn charge(&mut self, now_ns: u64, bytes: usize) {
        let passed_ns = i64::try_from(now_ns.saturating_sub(self.charged_ns)).unwrap_or(i64::MAX);
        let tokens_ns = self.tokens_ns.saturating_add(passed_ns).min(self.depth_ns);
        self.tokens_ns = tokens_ns.saturating_sub(duration_ns(bytes as u64, self.bits_per_second));
        self.charged_ns = now_ns;
    }
}

/// What so many bytes take at a rate.
fn duration_ns(bytes: u64, bits_per_second: u64) -> i64 {
    // No frame has 2 GiB, so that it fits: a division of 128 bits takes ten times as long.
    let ns = bytes.saturating_mul(8_000_000_000) / bits_per_second.max(1);
    i64::try_from(ns).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests;
