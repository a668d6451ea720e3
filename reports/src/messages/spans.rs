//! Stretches of a stream of bytes. The main type is [`Spans`].

/// What is left of one stretch `[begin, end)`, which is a message: disjoint ones, in order, which do not touch.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Spans(Vec<(u64, u64)>);

impl Spans {
    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.0.len()
    }

    /// Takes a stretch away; true if any of it was there.
    pub fn remove(&mut self, begin: u64, end: u64) -> bool {
        let first = self.0.partition_point(|(_, other_end)| *other_end <= begin);
        let after = self.0.partition_point(|(other_begin, _)| *other_begin < end);
        if begin >= end || first >= after {
            return false;
        }
        let touched = self.0.get(first..after).unwrap_or_default();
        let before = touched.first().map(|part| (part.0, begin));
        let behind = touched.last().map(|part| (end, part.1));
        let rest = [before, behind]
            .into_iter()
            .flatten()
            .filter(|(begin, end)| begin < end);
        self.0.splice(first..after, rest);
        true
    }

    /// Becomes one stretch.
    pub fn reset(&mut self, begin: u64, end: u64) {
        self.0.clear();
        self.0.extend((begin < end).then_some((begin, end)));
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn spans_are_a_set_of_numbers(removed: Vec<(u8, u8)>) {
            let mut spans = Spans::default();
            spans.reset(10, 240);
            let mut numbers: BTreeSet<u64> = (10..240).collect();
            for (a, b) in removed {
                let (begin, end) = (u64::from(a.min(b)), u64::from(a.max(b)));
                let before = numbers.len();
                (begin..end).for_each(|number| { numbers.remove(&number); });
                prop_assert_eq!(spans.remove(begin, end), numbers.len() < before);
            }
            let listed: BTreeSet<u64> = spans.0.iter().flat_map(|(begin, end)| *begin..*end).collect();
            prop_assert_eq!(&listed, &numbers);
            prop_assert!(spans.0.windows(2).all(|pair| pair[0].1 < pair[1].0), "{:?}", spans);
        }
    }
}
