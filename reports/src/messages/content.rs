//! The bytes of a stream from the first one that is not done with, as far as they are there. The main type is [`Content`].

use std::collections::BTreeMap;

use super::frames::{Found, FrameFinder};

/// More than this cannot be under way: the largest window that TCP has is 1 GiB, and that of Linux 6 MiB.
pub(super) const LARGEST_FLIGHT: u64 = 16 << 20;
/// How much that is done with is kept in front of a piece before it is moved.
const COMPACT_BYTES: usize = 64 << 10;
/// What a piece takes beside its bytes.
const PIECE_BYTES: usize = 96;

/// The bytes of a stream. What is missing takes no memory: a segment may be far ahead of the others.
#[derive(Debug, Default)]
pub(super) struct Content {
    /// The place of the first byte that is not done with; 0, which no byte has, until there is one.
    begin: u64,
    /// By where they begin; none is empty, and none has bytes of another. The first one may begin with what is done with.
    pieces: BTreeMap<u64, Vec<u8>>,
    /// The bytes of all of them.
    bytes: usize,
}

impl Content {
    /// Where it begins; none before any byte has been kept.
    pub fn begin(&self) -> Option<u64> {
        (self.begin > 0).then_some(self.begin)
    }

    /// The memory that is held.
    pub fn held_bytes(&self) -> usize {
        self.bytes + self.pieces.len() * PIECE_BYTES
    }

    /// Keeps what is new of a segment's bytes. The content may begin earlier than it did if nothing in between has been
    /// acknowledged.
    pub fn keep(&mut self, begin: u64, payload: &[u8], may_begin_here: bool) {
        if self.begin == 0 {
            self.begin = begin;
        }
        if begin < self.begin && may_begin_here && self.end() - begin <= LARGEST_FLIGHT {
            self.drop_done();
            self.begin = begin;
        }
        let mut from = begin.max(self.begin);
        let mut end = begin + payload.len() as u64;
        // The piece that its end is in stays as it is, however long that is.
        if let Some((start, bytes)) = self.pieces.range(..end).next_back()
            && start + bytes.len() as u64 >= end
        {
            end = *start;
        }
        if let Some((start, bytes)) = self.pieces.range(..from).next_back() {
            from = from.max(start + bytes.len() as u64);
        }
        if from >= end {
            return;
        }
        // The pieces that it has all of.
        while let Some((start, _)) = self.pieces.range(from..end).next() {
            let start = *start;
            self.remove(start);
        }
        let fresh = payload.get((from - begin) as usize..(end - begin) as usize);
        let fresh = fresh.unwrap_or_default();
        self.bytes += fresh.len();
        match self.pieces.range_mut(..from).next_back() {
            Some((start, bytes)) if start + bytes.len() as u64 == from => bytes.extend_from_slice(fresh),
            _ => drop(self.pieces.insert(from, fresh.to_vec())),
        }
    }

    /// Searches what is there before `end`, and passes over what is not. What is found is told with the place of the
    /// bytes that it was found in.
    pub fn take(&mut self, finder: &mut FrameFinder, end: u64, mut found: impl FnMut(u64, Found)) {
        while self.begin < end {
            self.join(end);
            let bytes = self.first_before(end);
            let begin = self.begin;
            let covered = begin + bytes.len() as u64;
            let searched = finder.search(bytes, |message| found(begin, message));
            if covered == end {
                self.pass(begin + searched as u64);
                return;
            }
            finder.lose_step();
            let next = self.pieces.range(covered..).next();
            let next = next.map_or(end, |(start, _)| end.min(*start));
            self.pass(next);
        }
    }

    /// Behind its last byte.
    fn end(&self) -> u64 {
        let last = self.pieces.last_key_value();
        last.map_or(self.begin, |(start, bytes)| start + bytes.len() as u64)
    }

    /// What is done with is not there, should it come again.
    fn drop_done(&mut self) {
        if let Some(first) = self
            .pieces
            .first_entry()
            .filter(|first| *first.key() < self.begin)
        {
            let (start, mut bytes) = first.remove_entry();
            let left = bytes.split_off((self.begin - start) as usize);
            self.bytes -= bytes.len();
            self.pieces.insert(self.begin, left);
        }
    }

    /// The pieces before `end` that go on where the first one ends become one with it.
    fn join(&mut self, end: u64) {
        while let Some((start, bytes)) = self.pieces.first_key_value()
            && let next = start + bytes.len() as u64
            && next < end
            && let Some(more) = self.pieces.remove(&next)
            && let Some(first) = self.pieces.first_entry()
        {
            first.into_mut().extend_from_slice(&more);
        }
    }

    /// What the first piece has between the beginning and `end`.
    fn first_before(&self, end: u64) -> &[u8] {
        let Some((start, bytes)) = self.pieces.first_key_value() else {
            return &[];
        };
        let Some(done) = self.begin.checked_sub(*start) else {
            return &[];
        };
        let until = bytes.len().min((end - start) as usize);
        bytes.get(done as usize..until).unwrap_or_default()
    }

    /// What is before `begin` is done with.
    fn pass(&mut self, begin: u64) {
        self.begin = begin;
        while let Some((start, bytes)) = self.pieces.first_key_value() {
            let start = *start;
            if start + bytes.len() as u64 <= begin {
                self.remove(start);
                continue;
            }
            let done = begin.saturating_sub(start) as usize;
            // Half of a piece at least, so that no byte is moved more than once for each that is done with.
            if done > COMPACT_BYTES && done > bytes.len() / 2 {
                self.drop_done();
            }
            return;
        }
    }

    fn remove(&mut self, start: u64) {
        let removed = self.pieces.remove(&start);
        self.bytes -= removed.map_or(0, |bytes| bytes.len());
    }
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use captures::packets::Topic;
    use proptest::prelude::*;
    use record::settings::Messages;

    use super::*;

    fn finder() -> FrameFinder {
        FrameFinder::new(Topic::Command, Messages::Rates)
    }

    #[test]
    fn what_is_missing_takes_no_memory() {
        let mut content = Content::default();
        content.keep(1 << 32, b"x", true);
        content.keep((1 << 32) + LARGEST_FLIGHT - 1, b"x", true);
        assert!(content.held_bytes() < 1000, "{}", content.held_bytes());
    }

    #[test]
    fn nothing_is_kept_of_what_is_further_behind_than_can_be_under_way() {
        let mut content = Content::default();
        let mut at = 1 << 32;
        content.keep(at, b"x", true);
        for _ in 0..100 {
            at -= LARGEST_FLIGHT / 2;
            content.keep(at, b"x", true);
        }
        assert_eq!(content.begin(), Some((1 << 32) - LARGEST_FLIGHT / 2));
    }

    #[test]
    fn many_pieces_in_any_order_are_kept_and_taken_in_time() {
        let began = Instant::now();
        let mut content = Content::default();
        let many = 200_000_u64;
        for number in 0..many {
            // Odd places from behind, so that no two of them touch, and each is kept before all that are there.
            content.keep((1 << 32) + 2 * (many - number), b"x", true);
        }
        content.take(&mut finder(), u64::MAX >> 1, |_, found| panic!("{found:?}"));
        assert_eq!(content.held_bytes(), 0);
        // It takes a second without optimisation. Where each moves the others, it takes minutes.
        assert!(began.elapsed().as_secs() < 15, "{:?}", began.elapsed());
    }

    proptest! {
        #[test]
        fn what_is_searched_is_what_was_kept_whatever_order_it_came_in(
            segments in prop::collection::vec((0_usize..600, 1_usize..200, 0_usize..800), 1..80),
        ) {
            let bytes: Vec<u8> = (0..800_usize).map(|at| (at * 31 % 251) as u8).collect();
            let origin = 1_u64 << 32;
            let mut content = Content::default();
            let mut kept = vec![false; bytes.len()];
            content.keep(origin, &bytes[..1], true);
            kept[0] = true;
            let mut begin = 0;
            for (from, length, taken) in segments {
                content.keep(origin + from as u64, &bytes[from..from + length], false);
                kept[from.max(begin)..(from + length).max(begin)].fill(true);
                // Half of the time, something is done with.
                if taken % 2 == 0 && taken > begin {
                    content.pass(origin + taken as u64);
                    begin = taken;
                }
                content.join(origin + 800);
                let there: usize = content.pieces.values().map(Vec::len).sum();
                prop_assert_eq!(content.bytes, there);
                let mut found = vec![false; bytes.len()];
                for (start, piece) in &content.pieces {
                    let at = (start - origin) as usize;
                    prop_assert_eq!(&bytes[at..at + piece.len()], &piece[..]);
                    let places = at.max(begin)..at + piece.len();
                    prop_assert!(found[places.clone()].iter().all(|found| !found), "a byte is in two pieces");
                    found[places].fill(true);
                }
                prop_assert_eq!(&found[begin..], &kept[begin..]);
            }
        }
    }
}
