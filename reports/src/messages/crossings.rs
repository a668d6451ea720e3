//! Segments as they pass one capture: in which order, and whether one was retransmitted. The main type is [`Crossings`].

use std::collections::{BTreeSet, VecDeque};

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
    /// In the order they passed.
    recent: VecDeque<Crossing>,
    /// How many passed before those.
    forgotten: u64,
    /// The places where they begin, each with the number of its segment, so that a message finds its own among many.
    places: BTreeSet<(u64, u64)>,
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
            self.forget_first();
        }
        self.places
            .insert((begin, self.forgotten + self.recent.len() as u64));
        self.recent.push_back(crossing);
        crossing
    }

    /// Those that carried some of `begin..end`, in the order they passed. Nobody will ask about what is before `begin`: so
    /// what is searched is what is found, however many segments there are.
    pub fn of(&mut self, begin: u64, end: u64) -> impl Iterator<Item = &Crossing> {
        let Self {
            recent,
            forgotten,
            places,
            ..
        } = self;
        let crossing_of = |number: u64| recent.get((number - *forgotten) as usize);
        let (mut numbers, mut over) = (Vec::new(), Vec::new());
        for (place, number) in places.range(..(end, 0)) {
            if crossing_of(*number).is_some_and(|crossing| crossing.end > begin) {
                numbers.push(*number);
            } else {
                over.push((*place, *number));
            }
        }
        for place in over {
            places.remove(&place);
        }
        numbers.sort_unstable();
        numbers.into_iter().filter_map(crossing_of)
    }

    /// Nobody will ask about what is before `begin`.
    pub fn forget_before(&mut self, begin: u64) {
        while self.recent.front().is_some_and(|crossing| crossing.end <= begin) {
            self.forget_first();
        }
    }

    /// Behind the last byte that has passed.
    pub fn furthest(&self) -> Option<u64> {
        self.furthest.end()
    }

    /// The memory that is held.
    pub fn held_bytes(&self) -> usize {
        self.recent.len() * size_of::<Crossing>() + self.places.len() * size_of::<(u64, u64)>()
    }

    fn forget_first(&mut self) {
        if let Some(first) = self.recent.pop_front() {
            self.places.remove(&(first.begin, self.forgotten));
            self.forgotten += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

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
        assert_eq!((crossings.recent.len(), crossings.places.len()), (MOST, MOST));
    }

    #[test]
    fn each_of_many_messages_finds_its_segments_among_many_at_once() {
        let mut crossings = Crossings::default();
        let untold = Departure {
            clock: None,
            identification: 0,
        };
        let many = MOST as u64 / 2;
        // The first one is far ahead: none of those behind it is forgotten before they all are.
        crossings.add(many * 10, many * 10 + 10, 0, untold);
        for number in 0..2 * many - 2 {
            let begin = number % many * 10;
            crossings.add(begin, begin + 10, number as i64, untold);
        }
        let began = std::time::Instant::now();
        for number in 0..many - 2 {
            let begin = number * 10;
            let times: Vec<i64> = crossings
                .of(begin, begin + 10)
                .map(|found| found.at_unix_ns)
                .collect();
            assert_eq!(times, [number as i64, (number + many) as i64]);
            crossings.forget_before(begin + 10);
        }
        // It takes a tenth of a second. To look at all of them for each message takes half a minute without optimisation.
        assert!(began.elapsed().as_secs() < 10, "{:?}", began.elapsed());
    }

    proptest! {
        #[test]
        fn those_found_are_those_that_overlap_in_the_order_they_passed(
            passed in prop::collection::vec((0_u64..200, 1_u64..30), 0..60),
            asked in prop::collection::btree_set(0_u64..20, 0..20),
        ) {
            let mut crossings = Crossings::default();
            for (number, (begin, length)) in passed.iter().enumerate() {
                let untold = Departure { clock: None, identification: 0 };
                crossings.add(*begin, begin + length, number as i64, untold);
            }
            for message in asked {
                let (begin, end) = (message * 10, message * 10 + 10);
                let found: Vec<i64> = crossings.of(begin, end).map(|crossing| crossing.at_unix_ns).collect();
                let overlapping = passed.iter().enumerate().filter(|(_, (from, length))| *from < end && from + length > begin);
                prop_assert_eq!(found, overlapping.map(|(number, _)| number as i64).collect::<Vec<_>>());
                if message % 3 == 0 {
                    crossings.forget_before(end);
                }
            }
        }
    }
}
