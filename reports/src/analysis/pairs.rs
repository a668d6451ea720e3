//! Values of pairs of scenarios, found by the letters of the two. A sweep has ten thousands of pairs, and each of half a million
//! comparisons asks for its own. The type is [`Pairs`].

use std::{collections::BTreeMap, ops::Deref};

/// What is known of a pair of scenarios, or of one with itself.
pub trait OfPair {
    /// The letters of the two.
    fn letters(&self) -> (&str, &str);
}

/// A list of pairs, each in it once. It is read as a slice.
#[derive(Debug, Clone, PartialEq)]
pub struct Pairs<T> {
    list: Vec<T>,
    /// The place in the list, by one letter and the other, in both orders.
    places: BTreeMap<String, BTreeMap<String, usize>>,
}

impl<T: OfPair> Pairs<T> {
    /// In that order.
    #[must_use]
    pub fn new(list: Vec<T>) -> Self {
        let mut places: BTreeMap<String, BTreeMap<String, usize>> = BTreeMap::new();
        for (place, item) in list.iter().enumerate() {
            let (a, b) = item.letters();
            for (one, other) in [(a, b), (b, a)] {
                let of_one = places.entry(one.to_owned()).or_default();
                of_one.insert(other.to_owned(), place);
            }
        }
        Self { list, places }
    }

    /// That of two scenarios, in either order.
    #[must_use]
    pub fn find(&self, a: &str, b: &str) -> Option<&T> {
        let place = self.places.get(a)?.get(b)?;
        self.list.get(*place)
    }
}

impl<T> Deref for Pairs<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        &self.list
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    impl OfPair for (&str, &str, u32) {
        fn letters(&self) -> (&str, &str) {
            (self.0, self.1)
        }
    }

    #[test]
    fn a_pair_is_found_in_either_order_and_one_with_itself() {
        let pairs = Pairs::new(vec![("b", "a", 1), ("b", "b", 2), ("c", "b", 3)]);
        let found = |a, b| pairs.find(a, b).map(|pair| pair.2);
        assert_eq!((found("a", "b"), found("b", "a")), (Some(1), Some(1)));
        assert_eq!((found("b", "b"), found("b", "c")), (Some(2), Some(3)));
        assert_eq!(
            (found("a", "a"), found("a", "c"), found("x", "a")),
            (None, None, None)
        );
        assert_eq!(pairs.iter().map(|pair| pair.2).collect::<Vec<_>>(), [1, 2, 3]);
    }
}
