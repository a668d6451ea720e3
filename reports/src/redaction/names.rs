//! Names, found wherever they stand as words in a text. The main type is [`Names`].
//!
//! It is the automaton of Aho and Corasick (1975) over words in place of letters, for a name neither begins nor ends within a word. It reads a
//! text from its end, so that it knows at each word the longest name that begins there. The time goes with the length of the text alone: a run
//! may have thousands of hosts, and its maker may have named them so that each begins as the others.

use std::collections::{BTreeSet, HashMap, HashSet};

/// Names in lower case, with what belongs to each.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Names<T> {
    known: Vec<(String, T)>,
    /// A number for each word that a name has.
    words: HashMap<String, usize>,
    /// From a state, with a word, to the next state.
    steps: HashMap<(usize, usize), usize>,
    states: Vec<State>,
}

/// The state in which nothing of any name was read.
const START: usize = 0;

/// The last words of a name, which were read: the longest that a text has there.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct State {
    /// The name that these words are all of.
    name: Option<usize>,
    /// The state of fewer of these words, with which another name ends.
    fewer: usize,
    /// The first on the way of `fewer` that is all of a name; the start, if none is.
    next_name: usize,
}

/// How a state is reached, by which it is linked to that of fewer words.
struct Way {
    words: usize,
    from: usize,
    word: usize,
    to: usize,
}

impl<T> Default for Names<T> {
    fn default() -> Self {
        std::iter::empty().collect()
    }
}

impl<T> FromIterator<(String, T)> for Names<T> {
    fn from_iter<I: IntoIterator<Item = (String, T)>>(names: I) -> Self {
        let mut all = Self {
            known: names.into_iter().collect(),
            words: HashMap::new(),
            steps: HashMap::new(),
            states: vec![State::default()],
        };
        let mut ways = Vec::new();
        for (number, (name, _)) in all.known.iter().enumerate() {
            let mut at = START;
            for ((_, word), words) in words_from_the_end(name).zip(1..) {
                let new = all.words.len();
                let word = *all.words.entry(word.to_owned()).or_insert(new);
                let from = at;
                at = *all.steps.entry((from, word)).or_insert_with(|| {
                    let to = all.states.len();
                    all.states.push(State::default());
                    ways.push(Way {
                        words,
                        from,
                        word,
                        to,
                    });
                    to
                });
            }
            if let Some(state) = all.states.get_mut(at).filter(|_| at != START) {
                state.name = Some(number);
            }
        }
        // A state's link leads to one of fewer words, which has its own by then.
        ways.sort_by_key(|way| way.words);
        for way in ways {
            all.link(&way);
        }
        all
    }
}

impl<T> Names<T> {
    /// All of them, with what belongs to each.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &T)> {
        self.known.iter().map(|(name, other)| (name.as_str(), other))
    }

    /// From the end of a text to its beginning, each place at which names begin, and the longest of them.
    pub fn beginnings(&self, text: &str) -> impl Iterator<Item = (usize, &str, &T)> {
        self.read(text).filter_map(|(at, state)| {
            let state = self.state(state);
            let longest = state.name.or_else(|| self.state(state.next_name).name)?;
            let (name, other) = self.known.get(longest)?;
            Some((at, name.as_str(), other))
        })
    }

    /// All that stand in a text, those within others too.
    pub fn within(&self, text: &str) -> BTreeSet<&str> {
        let (mut found, mut seen) = (BTreeSet::new(), HashSet::new());
        for (_, mut at) in self.read(text) {
            // Where it was before, it went on to the same names.
            while at != START && seen.insert(at) {
                let state = self.state(at);
                let name = state.name.and_then(|name| self.known.get(name));
                found.extend(name.map(|(name, _)| name.as_str()));
                at = state.next_name;
            }
        }
        found
    }

    /// Each word of a text, the last one first: where it begins, and the state after it.
    fn read(&self, text: &str) -> impl Iterator<Item = (usize, usize)> {
        words_from_the_end(text).scan(START, |at, (begins, word)| {
            *at = self.words.get(word).map_or(START, |word| self.step(*at, *word));
            Some((begins, *at))
        })
    }

    fn step(&self, mut at: usize, word: usize) -> usize {
        loop {
            match self.steps.get(&(at, word)) {
                Some(next) => return *next,
                None if at == START => return START,
                None => at = self.state(at).fewer,
            }
        }
    }

    fn link(&mut self, way: &Way) {
        let fewer = match way.from {
            START => START,
            from => self.step(self.state(from).fewer, way.word),
        };
        let next_name = match self.state(fewer) {
            State { name: Some(_), .. } => fewer,
            State { next_name, .. } => next_name,
        };
        if let Some(state) = self.states.get_mut(way.to) {
            (state.fewer, state.next_name) = (fewer, next_name);
        }
    }

    fn state(&self, number: usize) -> State {
        self.states.get(number).copied().unwrap_or_default()
    }
}

/// The words of a text, each with the place at which it begins: letters and digits that stand together, and every other character by itself.
fn words_from_the_end(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let mut rest = text;
    std::iter::from_fn(move || {
        let last = rest.chars().next_back()?;
        let begins = match last.is_alphanumeric() {
            true => rest.trim_end_matches(char::is_alphanumeric).len(),
            false => rest.len() - last.len_utf8(),
        };
        let (before, word) = rest.split_at(begins);
        rest = before;
        Some((begins, word))
    })
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, Instant};

    use proptest::prelude::*;

    use super::*;

    fn names(names: &[String]) -> Names<()> {
        names.iter().map(|name| (name.clone(), ())).collect()
    }

    /// Those with which a text goes on at a place, none of them a part of a longer word, each tried by itself.
    fn tried<'a>(names: &'a [String], text: &str, at: usize) -> Vec<&'a str> {
        let (before, rest) = text.split_at(at);
        let joins = |edge: Option<char>, beside: Option<char>| {
            edge.is_some_and(char::is_alphanumeric) && beside.is_some_and(char::is_alphanumeric)
        };
        let stands = |name: &&String| {
            let after = rest.strip_prefix(name.as_str());
            after.is_some_and(|after| {
                !joins(name.chars().next(), before.chars().next_back())
                    && !joins(name.chars().next_back(), after.chars().next())
            })
        };
        names.iter().filter(stands).map(String::as_str).collect()
    }

    proptest! {
        #[test]
        fn names_are_found_as_if_each_was_tried_everywhere(
            known in prop::collection::btree_set("[ab./é-]{1,5}", 0..12),
            text in "[ab./é -]{0,60}",
        ) {
            let known: Vec<String> = known.into_iter().collect();
            let names = names(&known);
            let places = || text.char_indices().map(|(at, _)| (at, tried(&known, &text, at)));
            let longest = |(at, found): (usize, Vec<&str>)| {
                let name = found.into_iter().max_by_key(|name| name.len())?;
                Some((at, name.to_owned()))
            };
            let expected: Vec<_> = places().filter_map(longest).collect();
            let mut found: Vec<_> = names.beginnings(&text).map(|(at, name, ())| (at, name.to_owned())).collect();
            found.reverse();
            prop_assert_eq!(found, expected);
            let expected: BTreeSet<&str> = places().flat_map(|(_, found)| found).collect();
            prop_assert_eq!(names.within(&text), expected);
        }
    }

    /// Names that begin and end as the others do, in a text that goes on as all of them.
    #[test]
    fn names_that_are_made_to_be_slow_are_not() {
        let started = Instant::now();
        for unit in ["a", "-", "a-"] {
            let known: Vec<String> = (1..1000).map(|length| unit.repeat(length)).collect();
            let names = names(&known);
            let text = unit.repeat(300_000);
            assert!(names.beginnings(&text).count() <= 600_000);
            assert!(names.within(&text).len() <= known.len());
        }
        // Generous, for a busy machine: each tried everywhere, they take hours.
        assert!(
            started.elapsed() < Duration::from_secs(60),
            "{:?}",
            started.elapsed()
        );
    }
}
