//! Segments as they pass one capture: in which order, and whether one was sent again. The main type is [`Crossings`].

use std::collections::VecDeque;

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
    /// From here on its bytes lie beyond all that had passed before.
    fresh_from: u64,
    order: Order,
}

/// How a segment came whose bytes are not beyond all that had passed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Order {
    /// It was sent after the one that is ahead of it: again, at least as far as its sender knows.
    Again,
    /// It was sent before the one that is ahead of it.
    Overtaken,
    /// There is no clock in it.
    Untold,
}

/// How a part of the stream came with a crossing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Passage {
    /// As the next one.
    InOrder,
    /// Sent again.
    Again,
    /// Overtaken by a later one.
    Overtaken,
    /// Late, for one of the two reasons.
    Late,
}

impl Crossing {
    /// How the part of the stream that begins at `begin` came with it.
    pub fn passage_of(&self, begin: u64) -> Passage {
        match self.order {
            _ if begin >= self.fresh_from => Passage::InOrder,
            Order::Again => Passage::Again,
            Order::Overtaken => Passage::Overtaken,
            Order::Untold => Passage::Late,
        }
    }
}

/// The segments with data of one direction at one capture that somebody may still ask about.
#[derive(Debug, Default)]
pub(super) struct Crossings {
    recent: VecDeque<Crossing>,
    /// Behind the last byte that has passed, and the clock of the segment that brought it.
    furthest: Option<(u64, Option<u32>)>,
}

impl Crossings {
    /// A segment passes.
    pub fn add(&mut self, begin: u64, end: u64, at_unix_ns: i64, clock: Option<u32>) -> Crossing {
        let (fresh_from, order) = match self.furthest {
            Some((furthest, ahead)) if begin < furthest => (furthest, order(clock, ahead)),
            _ => (begin, Order::Untold),
        };
        if self.furthest.is_none_or(|(furthest, _)| end > furthest) {
            self.furthest = Some((end, clock));
        }
        let crossing = Crossing {
            begin,
            end,
            at_unix_ns,
            fresh_from,
            order,
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
        self.furthest.map(|(end, _)| end)
    }
}

/// TCP's clock ticks every millisecond in Linux. Segments of the same tick are taken for overtaken: one is not sent again
/// within a millisecond.
fn order(clock: Option<u32>, ahead: Option<u32>) -> Order {
    match clock.zip(ahead) {
        Some((clock, ahead)) if clock.wrapping_sub(ahead).cast_signed() > 0 => Order::Again,
        Some(_) => Order::Overtaken,
        None => Order::Untold,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tcps_clock_tells_what_was_sent_again_from_what_was_overtaken() {
        let mut crossings = Crossings::default();
        assert_eq!(crossings.add(0, 10, 1, Some(100)).passage_of(0), Passage::InOrder);
        crossings.add(20, 30, 2, Some(140));
        assert_eq!(
            crossings.add(10, 20, 3, Some(120)).passage_of(10),
            Passage::Overtaken
        );
        assert_eq!(crossings.add(10, 20, 4, Some(360)).passage_of(10), Passage::Again);
        assert_eq!(crossings.add(10, 20, 4, None).passage_of(10), Passage::Late);
    }

    #[test]
    fn the_clock_may_wrap() {
        let mut crossings = Crossings::default();
        crossings.add(10, 20, 1, Some(u32::MAX - 5));
        assert_eq!(crossings.add(0, 10, 2, Some(30)).passage_of(0), Passage::Again);
    }

    #[test]
    fn what_follows_in_a_segment_that_was_sent_again_is_in_order() {
        let mut crossings = Crossings::default();
        crossings.add(0, 10, 1, Some(100));
        let both = crossings.add(0, 20, 2, Some(300));
        assert_eq!(
            (both.passage_of(0), both.passage_of(10)),
            (Passage::Again, Passage::InOrder)
        );
    }

    #[test]
    fn memory_is_that_of_what_may_be_asked_about() {
        let mut crossings = Crossings::default();
        for number in 0..1000_u64 {
            crossings.add(number * 10, number * 10 + 10, 0, None);
            crossings.forget_before(number * 10);
        }
        assert_eq!(crossings.recent.len(), 1);
        for number in 0..2 * MOST as u64 {
            crossings.add(number * 10, number * 10 + 10, 0, None);
        }
        assert_eq!(crossings.recent.len(), MOST);
    }
}
