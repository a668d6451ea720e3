//! Letters and slugs: the names of scenarios. The main functions are [`letter`] and [`slugs`].

use std::collections::{HashMap, HashSet};

pub use record::run_directory::letter;
use sha2::{Digest, Sha256};

use crate::matrix_file::Role;

/// Longest slug: with a run's name and an attempt's number around it, it is still a container's name and a path.
pub const SLUG_LENGTH: usize = 60;
/// Hexadecimal digits of the hash that tells apart what would be the same.
const HASH_LENGTH: usize = 8;

/// One slug for each scenario, given as pairs of axis and value: unique, `[a-z0-9-]`, at most [`SLUG_LENGTH`] long, with
/// a letter or digit at both ends.
///
/// Hardware, OS and virtualization stand for themselves; of other axes the last part of the name goes in front, as in
/// `x86-64-debian-12-native-loss-1pct`. What is cut, or would be the same as another, gets the beginning of a SHA-256
/// of the pairs at its end, so that a scenario's slug does not depend on its place in the file.
#[must_use]
pub fn slugs(scenarios: &[Vec<(String, String)>]) -> Vec<String> {
    let plain: Vec<String> = scenarios.iter().map(|axes| plain_slug(axes)).collect();
    let hashed: Vec<String> = std::iter::zip(scenarios, &plain)
        .map(|(axes, slug)| with_hash(axes, slug))
        .collect();
    let mut count: HashMap<&str, usize> = HashMap::new();
    for slug in &plain {
        *count.entry(slug).or_default() += 1;
    }
    // A plain slug could look like one with a hash: then it gets one too.
    let with_hashes: HashSet<&str> = hashed.iter().map(String::as_str).collect();
    std::iter::zip(&plain, &hashed)
        .map(|(slug, hashed)| {
            let unusable = slug.is_empty() || slug.len() > SLUG_LENGTH;
            let shared = count.get(slug.as_str()).is_some_and(|count| *count > 1);
            if unusable || shared || with_hashes.contains(slug.as_str()) {
                hashed.clone()
            } else {
                slug.clone()
            }
        })
        .collect()
}

fn plain_slug(axes: &[(String, String)]) -> String {
    let mut words = Vec::new();
    for (axis, value) in axes {
        if !matches!(
            Role::of(axis),
            Ok(Role::Hardware | Role::Os | Role::Virtualization)
        ) {
            words.push(axis.rsplit('.').next().unwrap_or(axis).to_owned());
        }
        words.push(value.replace('%', "pct"));
    }
    let mut slug = String::new();
    for c in words.join("-").chars() {
        if c.is_ascii_alphanumeric() {
            slug.push(c.to_ascii_lowercase());
        } else if !slug.is_empty() && !slug.ends_with('-') {
            slug.push('-');
        }
    }
    slug.trim_end_matches('-').to_owned()
}

fn with_hash(axes: &[(String, String)], slug: &str) -> String {
    let mut hash = Sha256::new();
    for (axis, value) in axes {
        // Lengths go in, so that no two lists of pairs give the same bytes.
        for text in [axis, value] {
            hash.update((text.len() as u64).to_le_bytes());
            hash.update(text.as_bytes());
        }
    }
    let digest = hash.finalize();
    let hash: String = digest
        .iter()
        .take(HASH_LENGTH / 2)
        .map(|byte| format!("{byte:02x}"))
        .collect();
    let kept = slug.get(..SLUG_LENGTH - HASH_LENGTH - 1).unwrap_or(slug);
    match kept.trim_end_matches('-') {
        "" => format!("scenario-{hash}"),
        kept => format!("{kept}-{hash}"),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rstest::rstest;

    use super::*;

    fn axes(pairs: &[(&str, &str)]) -> Vec<(String, String)> {
        let owned = |(axis, value): &(&str, &str)| ((*axis).to_owned(), (*value).to_owned());
        pairs.iter().map(owned).collect()
    }

    #[rstest]
    #[case(0, "a")]
    #[case(8, "i")]
    #[case(25, "z")]
    #[case(26, "aa")]
    #[case(51, "az")]
    #[case(52, "ba")]
    #[case(701, "zz")]
    #[case(702, "aaa")]
    fn letters_go_on_after_z(#[case] index: usize, #[case] expected: &str) {
        assert_eq!(letter(index), expected);
    }

    #[rstest]
    #[case(&[("hardware", "i686"), ("os", "ubuntu"), ("virtualization", "native")], "i686-ubuntu-native")]
    #[case(&[("hardware", "x86_64"), ("os", "debian-12"), ("network.loss", "1%")], "x86-64-debian-12-loss-1pct")]
    #[case(&[("os", "Ubuntu 22.10"), ("fruit", "../../etc")], "ubuntu-22-10-fruit-etc")]
    fn a_slug_reads_like_its_scenario(#[case] pairs: &[(&str, &str)], #[case] expected: &str) {
        assert_eq!(slugs(&[axes(pairs)]), [expected]);
    }

    #[test]
    fn values_that_differ_only_in_what_a_file_name_cannot_hold_stay_apart() {
        let slugs = slugs(&[
            axes(&[("os", "a/b")]),
            axes(&[("os", "a b")]),
            axes(&[("os", "c")]),
        ]);
        assert!(slugs[0].starts_with("a-b-") && slugs[1].starts_with("a-b-") && slugs[0] != slugs[1]);
        assert_eq!(slugs[2], "c");
    }

    #[test]
    fn a_scenario_without_a_latin_letter_has_a_slug_still() {
        assert!(slugs(&[axes(&[("os", "日本")])])[0].starts_with("scenario-"));
    }

    proptest! {
        #[test]
        fn letters_can_be_read_back(index in 0_usize..1_000_000) {
            let read = letter(index).bytes().fold(0, |sum, byte| sum * 26 + usize::from(byte - b'a') + 1) - 1;
            prop_assert_eq!(read, index);
        }

        #[test]
        fn slugs_are_unique_and_safe(values in prop::collection::hash_set("\\PC{0,90}|[a-c./ %]{1,3}", 1..40)) {
            let scenarios: Vec<_> = values.iter().map(|value| axes(&[("os", value)])).collect();
            let slugs = slugs(&scenarios);
            prop_assert_eq!(slugs.iter().collect::<HashSet<_>>().len(), slugs.len());
            for slug in &slugs {
                prop_assert!(!slug.is_empty() && slug.len() <= SLUG_LENGTH, "{}", slug);
                prop_assert!(!slug.starts_with('-') && !slug.ends_with('-'), "{}", slug);
                prop_assert!(slug.bytes().all(|b| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'-'));
            }
        }
    }
}
