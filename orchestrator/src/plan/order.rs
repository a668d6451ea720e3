//! The order in which scenarios run: shuffled, so that nothing that drifts with time (a warming machine, a busier
//! network) falls together with an axis. The main function is [`shuffled`].
//!
//! The order follows from the seed alone and stays the same in every version: SplitMix64 (Steele, Lea and Flood, *Fast
//! splittable pseudorandom number generators*, 2014) drives Durstenfeld's shuffle from the last place down, with draws
//! rejected that would favour a place. Libraries reserve the right to change theirs.

use std::collections::BTreeMap;

use clap::ValueEnum;
use record::run_directory::PlannedScenario;

/// How scenarios are put in order. Those of one host run one after another in this order, whatever others do.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum)]
pub enum Order {
    /// All shuffled.
    #[default]
    Randomised,
    /// Those of one host and virtualization next to each other; the blocks are shuffled, and each in itself.
    Blocked,
}

impl Order {
    /// Its name on the command line and in the manifest.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Randomised => "randomised",
            Self::Blocked => "blocked",
        }
    }

    /// The letters of scenarios in the order of each round, the first of which is that of the seed itself. A round has the
    /// scenarios that have an environment in it.
    #[must_use]
    pub fn rounds(self, scenarios: &[&PlannedScenario], seed: u64) -> Vec<Vec<String>> {
        let most = scenarios.iter().map(|it| it.settings.environments).max();
        let of_round = |round: u32| {
            let in_it = scenarios.iter().filter(|it| round <= it.settings.environments);
            self.arrange(&in_it.copied().collect::<Vec<_>>(), seed_of_round(seed, round))
        };
        (1..=most.unwrap_or(0)).map(of_round).collect()
    }

    /// The letters of scenarios in the order of a seed.
    #[must_use]
    pub fn arrange(self, scenarios: &[&PlannedScenario], seed: u64) -> Vec<String> {
        let letter = |scenario: &&PlannedScenario| scenario.id.clone();
        let shuffled = shuffled(scenarios.iter().map(letter).collect(), seed);
        match self {
            Self::Randomised => shuffled,
            Self::Blocked => {
                // A block is where the first of its scenarios came to be.
                let mut blocks: BTreeMap<_, usize> = BTreeMap::new();
                let mut placed: Vec<(usize, String)> = Vec::new();
                for (place, letter) in shuffled.into_iter().enumerate() {
                    let scenario = scenarios.iter().find(|it| it.id == letter);
                    let block = scenario.map(|it| (it.host.clone(), it.provider()));
                    placed.push((*blocks.entry(block).or_insert(place), letter));
                }
                // A stable sort keeps the order within a block.
                placed.sort_by_key(|(block, _)| *block);
                placed.into_iter().map(|(_, letter)| letter).collect()
            }
        }
    }
}

/// The seed of a round's order. It is drawn, since SplitMix64's seeds that differ by its increment give each other's numbers.
fn seed_of_round(seed: u64, round: u32) -> u64 {
    match round {
        0 | 1 => seed,
        round => SplitMix64(seed.wrapping_add(u64::from(round))).next(),
    }
}

/// The numbers of a seed.
struct SplitMix64(u64);

impl SplitMix64 {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// Any number below `bound` with equal probability; `bound` is not 0.
    fn below(&mut self, bound: u64) -> u64 {
        // What is left after whole multiples of the bound would favour small numbers.
        let uneven = (u64::MAX % bound + 1) % bound;
        loop {
            let drawn = self.next();
            if drawn <= u64::MAX - uneven {
                return drawn % bound;
            }
        }
    }
}

/// The items in the order of a seed.
#[must_use]
pub fn shuffled<T>(mut items: Vec<T>, seed: u64) -> Vec<T> {
    let mut numbers = SplitMix64(seed);
    for place in (1..items.len()).rev() {
        let other = numbers.below(place as u64 + 1) as usize;
        items.swap(place, other);
    }
    items
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_numbers_are_those_of_the_reference_implementation() {
        // As printed for seed 1234567 by Vigna's splitmix64.c.
        let mut numbers = SplitMix64(1_234_567);
        let first: Vec<u64> = (0..3).map(|_| numbers.next()).collect();
        assert_eq!(
            first,
            [
                6_457_827_717_110_365_317,
                3_203_168_211_198_807_973,
                9_817_491_932_198_370_423
            ]
        );
    }

    #[test]
    fn a_seed_has_one_order_for_ever() {
        let letters = || ('a'..='i').collect::<Vec<_>>();
        assert_eq!(shuffled(letters(), 1), shuffled(letters(), 1));
        assert_ne!(shuffled(letters(), 1), shuffled(letters(), 2));
        assert_eq!(shuffled(letters(), 1).iter().collect::<String>(), "cedagibhf");
    }

    #[test]
    fn every_order_is_as_likely_as_any_other() {
        let mut counts = std::collections::HashMap::new();
        for seed in 0..6000 {
            *counts.entry(shuffled(vec![0, 1, 2], seed)).or_insert(0) += 1;
        }
        assert_eq!(counts.len(), 6);
        assert!(
            counts.values().all(|count| (850..1150).contains(count)),
            "{counts:?}"
        );
    }
}
