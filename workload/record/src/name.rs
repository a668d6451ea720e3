//! Names that become names of files, of containers and words of commands: of runs, scenarios, environments and hosts. What is
//! read from a record is checked as it is read, by `#[serde(deserialize_with = "name")]`.

use std::collections::BTreeMap;

use serde::{Deserialize, Deserializer, de::Error as _};

/// A file's name has 255 bytes at most, and ours get words around them.
pub const LONGEST: usize = 230;

/// Whether a name is one component of a path, one word in a shell, and no option.
#[must_use]
pub fn is_name(text: &str) -> bool {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"._-".contains(&byte);
    text.len() <= LONGEST
        && text
            .bytes()
            .next()
            .is_some_and(|first| first.is_ascii_alphanumeric() || first == b'_')
        && text.bytes().all(plain)
}

/// Reads a name.
///
/// # Errors
/// When it is none.
pub fn name<'de, D: Deserializer<'de>>(from: D) -> Result<String, D::Error> {
    let text = String::deserialize(from)?;
    match is_name(&text) {
        true => Ok(text),
        false => Err(D::Error::custom(not_a_name(&text))),
    }
}

/// Reads a name that may be missing.
///
/// # Errors
/// When it is there and none.
pub fn name_if_any<'de, D: Deserializer<'de>>(from: D) -> Result<Option<String>, D::Error> {
    match Option::<String>::deserialize(from)? {
        Some(text) if !is_name(&text) => Err(D::Error::custom(not_a_name(&text))),
        name => Ok(name),
    }
}

/// Reads a list of names.
///
/// # Errors
/// When one of them is none.
pub fn names<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<String>, D::Error> {
    let all = Vec::<String>::deserialize(from)?;
    match all.iter().find(|text| !is_name(text)) {
        Some(text) => Err(D::Error::custom(not_a_name(text))),
        None => Ok(all),
    }
}

/// Reads what has a name each.
///
/// # Errors
/// When one of them has none.
pub fn by_name<'de, T: Deserialize<'de>, D: Deserializer<'de>>(
    from: D,
) -> Result<BTreeMap<String, T>, D::Error> {
    let all = BTreeMap::<String, T>::deserialize(from)?;
    match all.keys().find(|key| !is_name(key)) {
        Some(key) => Err(D::Error::custom(not_a_name(key))),
        None => Ok(all),
    }
}

fn not_a_name(text: &str) -> String {
    let shown: String = text.chars().take(60).collect();
    format!(
        "`{}` is no name: letters, digits, `-`, `_` and `.`, neither `.` nor `-` first, at most {LONGEST}",
        shown.escape_debug()
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[rstest::rstest]
    #[case("matrix-20261123-035357-2d7d-x86-64-debian-12-native-1", true)]
    #[case("lab_1.example.org", true)]
    #[case("_lab", true)]
    #[case("", false)]
    #[case(".", false)]
    #[case("..", false)]
    #[case("../x", false)]
    #[case("/etc/passwd", false)]
    #[case("a/b", false)]
    #[case("-rf", false)]
    #[case("a b", false)]
    #[case("a\nb", false)]
    #[case("a\0", false)]
    #[case("é", false)]
    fn a_name_is_one_component_one_word_and_no_option(#[case] text: &str, #[case] is: bool) {
        assert_eq!(is_name(text), is);
        let json = serde_json::to_string(text).unwrap();
        assert_eq!(name(&mut serde_json::Deserializer::from_str(&json)).is_ok(), is);
        let map = format!("{{{json}: 1}}");
        let read = by_name::<u8, _>(&mut serde_json::Deserializer::from_str(&map));
        assert_eq!(read.is_ok(), is);
    }

    #[test]
    fn the_longest_name_still_fits_a_file_system() {
        assert!(is_name(&"a".repeat(LONGEST)));
        assert!(!is_name(&"a".repeat(LONGEST + 1)));
    }
}
