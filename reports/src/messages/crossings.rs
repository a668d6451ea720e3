//! Segments as they pass one capture: in which order, and whether one was retransmitted. The main type is [`Crossings`].

use std::collections::VecDeque;

use captures::packets::{Coming, Departure, Furthest, Passage};

/// More than this many segments that nobody asks about any more are not kept: a direction whose acknowledgements the
/// capture does not have.
const MOST: usize = 1 << 16;

/// One segment at one capture. Places in the stream are counted without wrapping.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Crossing {
    /// Its first byte.
    pub begin: u64,
    /// Behind its last byte.
    pub end: u64,
    /// When, nanoseconds since 1970.
    pub at_unix_ns: i64,
    coming: Coming,
}

impl Crossing {
    /// How the part of the stream that begins at `begin` came with it.
    pub fn passage_of(&self, begin: u64) -> Passage {
        self.coming.passage_of(begin)
    }
}

/// The segments with data of one direction at one capture that somebody may still ask about.
#[derive(Debug, Default)]
pub(super) struct Crossings {
    recent: VecDeque<Crossing>,
    furthest: Furthest,
}

impl Crossings {
    /// A segment passes.
    pub fn add(&mut self, begin: u64, end: u64, at_unix_ns: i64, sent: Departure) -> Crossing {
        let crossing = Crossing {
            begin,
            end,
            at_unix_ns,
            coming: self.furthest.pass(begin, end, sent),
        };
        if self.recent.len() == MOST {
            self.recent.pop_front();
        }
        self.recent.push_back(crossing);
        crossing
    }

    /// Those that carried some of `begin..end`, in the order they passed.
    pub fn of(&self, begin: u64, end: u64) -> impl Iterator<Item = &Crossing> {
        let overlaps = move |crossing: &&Crossing| crossing.begin < end && crossing.end > begin;
        self.recent.iter().filter(overlaps)
    }

    /// Nobody will ask about what is before `begin`.
    pub fn forget_before(&mut self, begin: u64) {
        while self.recent.front().is_some_and(|crossing| crossing.end <= begin) {
            self.recent.pop_front();
        }
    }

    /// Behind the last byte that has passed.
    pub fn furthest(&self) -> Option<u64> {
        self.furthest.end()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_that_of_what_may_be_asked_about() {
        let mut crossings = Crossings::default();
        let untold = Departure {
            clock: None,
            identification: 0,
        };
        for number in 0..1000_u64 {
            crossings.add(number * 10, number * 10 + 10, 0, untold);
            crossings.forget_before(number * 10);
        }
        assert_eq!(crossings.recent.len(), 1);
        for number in 0..2 * MOST as u64 {
            crossings.add(number * 10, number * 10 + 10, 0, untold);
        }
        assert_eq!(crossings.recent.len(), MOST);
    }
}
