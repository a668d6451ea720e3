//! The way from one host to another: its own end of its link, the switch, and the switch's end of the other's link. The
//! main type is [`Path`].
//!
//! The ends are those that impair real packets ([`LinkEnd`]). As in `workload/src/network/star.rs`, a packet's second
//! pass begins when its first was due to end. The switch takes no time.

use oorandom::Rand64;
use record::window::PassRecord;

use crate::link::{Impairment, LinkEnd, Refused};

/// What an end has done that nothing went through. In virtual time a packet leaves when it is due.
pub const NOTHING_PASSED: PassRecord = PassRecord {
    offered: 0,
    lost: 0,
    overflowed: Some(0),
    delivered: 0,
    lateness_mean_ns: Some(0.0),
    lateness_max_of_run_ns: Some(0),
};

/// What went through the two ends so far.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Passes {
    /// Through the sender's own end of its link.
    pub up: PassRecord,
    /// Through the switch's end of the receiver's.
    pub down: PassRecord,
}

/// Two link ends in a row.
#[derive(Debug)]
pub struct Path<P> {
    passes: Passes,
    up: LinkEnd<Framed<P>>,
    down: LinkEnd<Framed<P>>,
}

#[derive(Debug)]
struct Framed<P> {
    bytes: usize,
    packet: P,
}

/// A packet that came out.
#[derive(Debug, PartialEq, Eq)]
pub struct Arrived<P> {
    /// The virtual time, in nanoseconds since the beginning.
    pub at_ns: i64,
    /// The packet.
    pub packet: P,
}

impl<P> Path<P> {
    /// An idle path, whose ends draw losses and delays each from a source of its own.
    #[must_use]
    pub fn new(impairment: Impairment, up: Rand64, down: Rand64) -> Self {
        Self {
            passes: Passes {
                up: NOTHING_PASSED,
                down: NOTHING_PASSED,
            },
            up: LinkEnd::new(impairment, up),
            down: LinkEnd::new(impairment, down),
        }
    }

    /// Sends a packet in an Ethernet frame of so many bytes. Whether it is lost, nobody learns.
    pub fn send(&mut self, now_ns: i64, bytes: usize, packet: P) {
        let refused = self.up.offer(unsigned(now_ns), bytes, Framed { bytes, packet });
        count(&mut self.passes.up, refused.err().as_ref());
    }

    /// What went through both ends so far.
    #[must_use]
    pub const fn passes(&self) -> Passes {
        self.passes
    }

    /// When something happens next.
    #[must_use]
    pub fn next_ns(&self) -> Option<i64> {
        let next_ns = [self.up.next_due_ns(), self.down.next_due_ns()]
            .into_iter()
            .flatten()
            .min()?;
        Some(signed(next_ns))
    }

    /// Does what is due; the packet that comes out by then, if one does. Ask until there is none.
    pub fn advance(&mut self, now_ns: i64) -> Option<Arrived<P>> {
        while let Some(passed) = self.up.release(unsigned(now_ns)) {
            let Framed { bytes, .. } = passed.packet;
            self.passes.up.delivered += 1;
            let refused = self.down.offer(passed.due_ns, bytes, passed.packet);
            count(&mut self.passes.down, refused.err().as_ref());
        }
        let arrived = self.down.release(unsigned(now_ns))?;
        self.passes.down.delivered += 1;
        Some(Arrived {
            at_ns: signed(arrived.due_ns),
            packet: arrived.packet.packet,
        })
    }
}

fn count<P>(pass: &mut PassRecord, refused: Option<&Refused<P>>) {
    pass.offered += 1;
    match refused {
        None => {}
        Some(Refused::Lost(_)) => pass.lost += 1,
        Some(Refused::Overflowed(_)) => pass.overflowed = pass.overflowed.map(|packets| packets + 1),
    }
}

/// Virtual time begins at zero.
fn unsigned(ns: i64) -> u64 {
    u64::try_from(ns).unwrap_or(0)
}

fn signed(ns: u64) -> i64 {
    i64::try_from(ns).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    fn path(impairment: Impairment) -> Path<u32> {
        Path::new(impairment, Rand64::new(1), Rand64::new(2))
    }

    #[test]
    fn a_packet_takes_the_delay_of_both_ends() {
        let mut path = path(Impairment {
            delay_ns: 10_000_000,
            ..Impairment::NONE
        });
        path.send(5 * MS, 100, 7);
        assert_eq!(path.next_ns(), Some(15 * MS));
        assert_eq!(path.advance(15 * MS), None);
        assert_eq!(path.next_ns(), Some(25 * MS));
        assert_eq!(
            path.advance(25 * MS),
            Some(Arrived {
                at_ns: 25 * MS,
                packet: 7
            })
        );
        assert_eq!(path.next_ns(), None);
    }

    #[test]
    fn two_ends_of_one_percent_lose_two_in_a_hundred() {
        let mut path = path(Impairment {
            loss: 0.01,
            ..Impairment::NONE
        });
        let sent = 200_000;
        let mut came = 0;
        for number in 0..sent {
            path.send(i64::from(number), 100, number);
            came += u32::from(path.advance(i64::from(number)).is_some());
        }
        let Passes { up, down } = path.passes();
        assert_eq!((up.offered, down.delivered), (u64::from(sent), u64::from(came)));
        assert_eq!(
            (up.delivered + up.lost, down.delivered + down.lost),
            (up.offered, down.offered)
        );
        let lost = 1.0 - f64::from(came) / f64::from(sent);
        // 1 − 0.99², five standard deviations either side.
        assert!(
            (lost - 0.0199).abs() < 5.0 * (0.0199_f64 / f64::from(sent)).sqrt(),
            "{lost}"
        );
    }
}
