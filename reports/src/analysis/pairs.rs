//! Values of pairs of scenarios, found by the letters of the two. A sweep has ten thousands of pairs, and each of half a million
//! comparisons asks for its own. The type is [`Pairs`].

use std::{collections::HashMap, ops::Deref};

/// What is known of a pair of scenarios, or of one with itself.
pub trait OfPair {
    /// The letters of the two.
    fn letters(&self) -> (&str, &str);
}

/// A list of pairs, each in it once. It is read as a slice.
#[derive(Debug, Clone, PartialEq)]
pub struct Pairs<T> {
    list: Vec<T>,
    /// The number of each letter.
    numbers: HashMap<String, usize>,
    /// A row and a column for each letter: the place in the list.
    places: Vec<Option<u32>>,
}

impl<T: OfPair> Pairs<T> {
    /// In that order.
    #[must_use]
    pub fn new(list: Vec<T>) -> Self {
        let mut numbers: HashMap<String, usize> = HashMap::new();
        let mut number = |letter: &str| match numbers.get(letter) {
            Some(known) => *known,
            None => {
                let next = numbers.len();
                numbers.insert(letter.to_owned(), next);
                next
            }
        };
        let mut pairs: Vec<[usize; 2]> = Vec::with_capacity(list.len());
        // Those of one scenario stand together.
        let mut last: Option<(&str, usize)> = None;
        for item in &list {
            let (a, b) = item.letters();
            let first = match last {
                Some((known, number)) if known == a => number,
                _ => number(a),
            };
            last = Some((a, first));
            pairs.push([first, number(b)]);
        }
        let letters = numbers.len();
        let mut places = vec![None; letters * letters];
        for ([a, b], place) in pairs.into_iter().zip(0..) {
            for at in [a * letters + b, b * letters + a] {
                places[at] = Some(place);
            }
        }
        Self {
            list,
            numbers,
            places,
        }
    }

    /// That of two scenarios, in either order.
    #[must_use]
    pub fn find(&self, a: &str, b: &str) -> Option<&T> {
        let row = self.numbers.get(a)? * self.numbers.len();
        let place = self.places.get(row + self.numbers.get(b)?)?;
        self.list.get((*place)? as usize)
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
