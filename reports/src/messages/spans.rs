//! Stretches of a stream of bytes. The main type is [`Spans`].

/// Disjoint stretches `[begin, end)`, in order; touching ones are one.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Spans(Vec<(u64, u64)>);

impl Spans {
    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// How far it is covered without a gap from `at` on; `at` itself if it is not covered at all.
    pub fn end_from(&self, at: u64) -> u64 {
        let around = self.0.iter().find(|(begin, end)| *begin <= at && at < *end);
        around.map_or(at, |(_, end)| *end)
    }

    /// Where the first stretch at or after `at` begins.
    pub fn begin_after(&self, at: u64) -> Option<u64> {
        let next = self.0.iter().find(|(_, end)| *end > at);
        next.map(|(begin, _)| (*begin).max(at))
    }

    /// Adds a stretch; true if any of it is new.
    pub fn add(&mut self, begin: u64, end: u64) -> bool {
        if begin >= end || self.end_from(begin) >= end {
            return false;
        }
        // Nearly always it goes on where the last one ends.
        if let Some(last) = self.0.last_mut().filter(|last| last.1 == begin) {
            last.1 = end;
            return true;
        }
        let first = self.0.partition_point(|(_, other_end)| *other_end < begin);
        let after = self.0.partition_point(|(other_begin, _)| *other_begin <= end);
        let touched = self.0.get(first..after).unwrap_or_default();
        let merged = touched.iter().fold((begin, end), |whole, part| {
            (whole.0.min(part.0), whole.1.max(part.1))
        });
        self.0.splice(first..after, [merged]);
        true
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
        self.add(begin, end);
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn spans_are_a_set_of_numbers(changes: Vec<(bool, u8, u8)>, at: u8) {
            let mut spans = Spans::default();
            let mut numbers = BTreeSet::new();
            for (add, a, b) in changes {
                let (begin, end) = (u64::from(a.min(b)), u64::from(a.max(b)));
                let before = numbers.len();
                if add {
                    numbers.extend(begin..end);
                    prop_assert_eq!(spans.add(begin, end), numbers.len() > before);
                } else {
                    (begin..end).for_each(|number| { numbers.remove(&number); });
                    prop_assert_eq!(spans.remove(begin, end), numbers.len() < before);
                }
            }
            let listed: BTreeSet<u64> = spans.0.iter().flat_map(|(begin, end)| *begin..*end).collect();
            prop_assert_eq!(&listed, &numbers);
            prop_assert!(spans.0.windows(2).all(|pair| pair[0].1 < pair[1].0), "{:?}", spans);
            let at = u64::from(at);
            let end = (at..).find(|number| !numbers.contains(number)).unwrap();
            prop_assert_eq!(spans.end_from(at), end);
            prop_assert_eq!(spans.begin_after(at), numbers.range(at..).next().copied());
        }
    }
}
