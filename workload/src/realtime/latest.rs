//! A value that one thread replaces and another reads, neither ever waiting for the other. The main types are
//! [`LatestWriter`] and [`LatestReader`].
//!
//! A lock would let the ordinary thread that holds it keep the real-time one waiting; a plain seqlock would let a
//! real-time reader spin for ever on a writer that it preempted. Here the writer fills a slot that no reader has been
//! pointed to, and points to it when it is whole: a reader succeeds at once unless the writer has gone round all other
//! slots meanwhile, which means that the writer runs. The orderings are those of Boehm, *Can seqlocks get along with
//! programming language memory models?* (MSPC 2012).

use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering, fence},
};

const SLOTS: usize = 4;

#[derive(Debug)]
struct Shared<const N: usize> {
    slots: [[AtomicU64; N]; SLOTS],
    /// Values published so far; the newest is in slot `published % SLOTS`.
    published: AtomicU64,
}

/// The one end that replaces the value.
#[derive(Debug)]
pub struct LatestWriter<const N: usize>(Arc<Shared<N>>);

/// The end that reads it.
#[derive(Debug, Clone)]
pub struct LatestReader<const N: usize>(Arc<Shared<N>>);

/// Both ends of a value of `N` words.
#[must_use]
pub fn latest<const N: usize>() -> (LatestWriter<N>, LatestReader<N>) {
    let shared = Arc::new(Shared {
        slots: std::array::from_fn(|_| std::array::from_fn(|_| AtomicU64::new(0))),
        published: AtomicU64::new(0),
    });
    (LatestWriter(shared.clone()), LatestReader(shared))
}

impl<const N: usize> Shared<N> {
    fn slot(&self, number: u64) -> &[AtomicU64; N] {
        let [first, second, third, fourth] = &self.slots;
        match number % SLOTS as u64 {
            0 => first,
            1 => second,
            2 => third,
            _ => fourth,
        }
    }
}

impl<const N: usize> LatestWriter<N> {
    /// Replaces the value. `&mut` since two writers would fill the same slot.
    pub fn publish(&mut self, words: &[u64; N]) {
        let number = self.0.published.load(Ordering::Relaxed) + 1;
        // A reader that sees a word of this value also sees that the value before it was published.
        fence(Ordering::Release);
        for (place, word) in self.0.slot(number).iter().zip(words) {
            place.store(*word, Ordering::Relaxed);
        }
        self.0.published.store(number, Ordering::Release);
    }
}

impl<const N: usize> LatestReader<N> {
    /// The newest whole value, if there was one yet.
    #[must_use]
    pub fn read(&self) -> Option<[u64; N]> {
        loop {
            let number = self.0.published.load(Ordering::Acquire);
            if number == 0 {
                return None;
            }
            let mut words = [0; N];
            for (word, place) in words.iter_mut().zip(self.0.slot(number)) {
                *word = place.load(Ordering::Relaxed);
            }
            fence(Ordering::Acquire);
            let now = self.0.published.load(Ordering::Relaxed);
            // The writer may be filling the slot of `now + 1`: ours, if that is SLOTS ahead of `number`.
            if now - number < SLOTS as u64 - 1 {
                return Some(words);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::thread;

    use super::*;

    #[test]
    fn there_is_no_value_before_the_first() {
        let (_writer, reader) = latest::<3>();
        assert_eq!(reader.read(), None);
    }

    #[test]
    fn the_newest_value_is_read_as_often_as_wanted() {
        let (mut writer, reader) = latest();
        for value in 1..=10 {
            writer.publish(&[value, value + 1]);
            assert_eq!(reader.read(), Some([value, value + 1]));
            assert_eq!(reader.read(), Some([value, value + 1]));
        }
    }

    #[test]
    fn a_value_is_never_torn_and_never_goes_back() {
        let (mut writer, reader) = latest::<8>();
        const LAST: u64 = 200_000;
        thread::scope(|scope| {
            scope.spawn(move || (1..=LAST).for_each(|value| writer.publish(&[value; 8])));
            let mut before = 0;
            while before < LAST {
                let Some(words) = reader.read() else { continue };
                assert!(words.iter().all(|word| *word == words[0]), "{words:?}");
                assert!(words[0] >= before);
                before = words[0];
            }
        });
    }
}
