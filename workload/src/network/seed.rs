//! A seed where the settings give none. The function is [`random_seed`].

use std::hash::{BuildHasher, Hasher, RandomState};

/// The standard library's only source of randomness: the keys of a new hash map are drawn by the operating system. 53
/// bits of it, which every reader of JSON keeps exactly, so that a recorded seed can be used again.
pub fn random_seed() -> u64 {
    RandomState::new().build_hasher().finish() >> 11
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn networks_without_a_seed_differ() {
        assert_ne!(random_seed(), random_seed());
    }

    #[test]
    fn a_drawn_seed_is_exact_as_a_number_of_javascript() {
        let most = (0..1000).map(|_| random_seed()).max().unwrap();
        assert!((1 << 50..1 << 53).contains(&most), "{most}");
    }
}
