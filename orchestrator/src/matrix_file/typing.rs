//! Tree -> values of the types that own them, with all that is wrong in one go. The main function is [`read`].
//!
//! It is a serde deserializer over [`Node`], so that an error knows its node without a detour over paths, and knows
//! what it is about (which key, which values there are) without taking a message apart. serde stops at the first error:
//! the entry that caused it is left out and the rest is read again, until nothing is wrong any more.

mod reader;

use std::{collections::HashSet, fmt, sync::Arc};

use reader::Reader;
use record::report_settings::ReportSettings;
use serde::de::{self, DeserializeOwned, Expected, Unexpected};

use super::{
    diagnostic::{Code, Diagnostic, Diagnostics},
    source::{Source, Span},
    spelling::{list, propose},
    tree::Node,
};

/// Errors that are looked for in one section: each of them takes another reading of it, and nobody mends more at a time.
const ERRORS: usize = 40;

/// Reads a node as `T`.
///
/// # Errors
/// All that is wrong with it, each at its place.
pub fn read<T: DeserializeOwned>(source: &Arc<Source>, node: &Node) -> Result<T, Diagnostics> {
    let mut left_out = HashSet::new();
    let mut found = Diagnostics::new();
    loop {
        let error = match T::deserialize(Reader::new(node, &left_out)) {
            Ok(value) if found.is_empty() => return Ok(value),
            Ok(_) => return Err(found),
            Err(error) => error,
        };
        let cause = error.entry;
        if !error.follows {
            found.push(error.into_diagnostic(source, node.span));
        }
        match cause {
            Some(_) if left_out.len() >= ERRORS => {
                let message = format!(
                    "more than {ERRORS} mistakes are in one section, and the rest of it was not looked at"
                );
                let error = Diagnostic::error(source, Code::TooLarge, node.span, message);
                found.push(error.help("mend those that are listed, then check the file again"));
                return Err(found);
            }
            Some(entry) if left_out.insert(entry) => {}
            _ => return Err(found),
        }
    }
}

/// What is wrong, and with which node.
#[derive(Debug)]
struct TypeError {
    wrong: Wrong,
    /// The innermost node it is about.
    span: Option<Span>,
    /// The key of the innermost entry it is in.
    entry: Option<Span>,
    /// Whether it is there only because an entry was left out.
    follows: bool,
}

#[derive(Debug)]
enum Wrong {
    UnknownKey {
        key: String,
        known: &'static [&'static str],
    },
    UnknownValue {
        value: String,
        known: &'static [&'static str],
    },
    MissingKey(&'static str),
    Type {
        found: String,
        wanted: String,
    },
    /// One more value in a list than belongs there.
    TooMany,
    Other(String),
}

impl From<Wrong> for TypeError {
    fn from(wrong: Wrong) -> Self {
        Self {
            wrong,
            span: None,
            entry: None,
            follows: false,
        }
    }
}

impl TypeError {
    fn at(mut self, span: Span) -> Self {
        self.span.get_or_insert(span);
        self
    }

    fn within(mut self, entry: Span) -> Self {
        self.entry.get_or_insert(entry);
        self
    }

    fn into_diagnostic(self, source: &Arc<Source>, section: Span) -> Diagnostic {
        let span = self.span.unwrap_or(section);
        let error = |code, message: String| Diagnostic::error(source, code, span, message);
        match self.wrong {
            Wrong::UnknownKey { key, known } => {
                error(Code::UnknownKey, format!("there is no key `{key}` here"))
                    .label("unknown key")
                    .help(if key == "<<" {
                        "YAML 1.2 has no merge keys: repeat the keys, or write a profile".to_owned()
                    } else {
                        propose(&key, without_former_names(known))
                    })
            }
            Wrong::UnknownValue { value, known } => error(
                Code::UnknownValue,
                format!("`{value}` is not one of {}", list(known.iter().copied())),
            )
            .label("unknown value")
            .help(propose(&value, known.iter().copied())),
            Wrong::MissingKey(key) => error(Code::MissingKey, format!("the key `{key}` is missing"))
                .label(format!("has no `{key}`"))
                .help(format!("add `{key}: …`")),
            Wrong::Type { found, wanted } => {
                // A user who writes a shell's line is shown how a list is written.
                let help = match found
                    .strip_prefix("the text `")
                    .and_then(|text| text.strip_suffix('`'))
                {
                    Some(words) if wanted == "a list" => {
                        let words: Vec<&str> = words.split_whitespace().collect();
                        format!("write a list, such as `[{}]`", words.join(", "))
                    }
                    _ => format!("write {wanted}"),
                };
                error(Code::WrongType, belongs_here(&wanted, &found)).help(help)
            }
            Wrong::TooMany => error(Code::WrongType, "there is one value too many here".to_owned())
                .help("take it out of the list, or begin another list"),
            // What quantities say of themselves is `what is wrong: what to write`.
            Wrong::Other(message) => match message.split_once(": ") {
                Some((what, help)) => error(Code::InvalidValue, what.to_owned()).help(help),
                None => error(Code::InvalidValue, message),
            },
        }
    }
}

/// That something else belongs where something stands.
pub fn belongs_here(wanted: &str, found: &str) -> String {
    let belongs = if wanted.starts_with("keys") {
        "belong"
    } else {
        "belongs"
    };
    format!("{wanted} {belongs} here, not {found}")
}

impl fmt::Display for TypeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}", self.wrong)
    }
}

impl std::error::Error for TypeError {}

impl de::Error for TypeError {
    fn custom<T: fmt::Display>(message: T) -> Self {
        Wrong::Other(message.to_string()).into()
    }

    fn invalid_type(found: Unexpected<'_>, wanted: &dyn Expected) -> Self {
        Wrong::Type {
            found: spell_found(&found),
            wanted: spell_wanted(&wanted.to_string()),
        }
        .into()
    }

    fn invalid_value(found: Unexpected<'_>, wanted: &dyn Expected) -> Self {
        Self::invalid_type(found, wanted)
    }

    fn invalid_length(length: usize, wanted: &dyn Expected) -> Self {
        Wrong::Type {
            found: format!("a list of {length}"),
            wanted: spell_wanted(&wanted.to_string()),
        }
        .into()
    }

    fn unknown_field(key: &str, known: &'static [&'static str]) -> Self {
        Wrong::UnknownKey {
            key: key.to_owned(),
            known,
        }
        .into()
    }

    fn unknown_variant(value: &str, known: &'static [&'static str]) -> Self {
        Wrong::UnknownValue {
            value: value.to_owned(),
            known,
        }
        .into()
    }

    fn missing_field(key: &'static str) -> Self {
        Wrong::MissingKey(key).into()
    }
}

/// Keys without the names that settings had in earlier versions, which serde lists too.
fn without_former_names(known: &'static [&'static str]) -> impl Iterator<Item = &'static str> + Clone {
    known.iter().copied().filter(move |key| {
        !ReportSettings::RENAMED
            .iter()
            .any(|(former, own)| former == key && known.contains(own))
    })
}

fn spell_found(found: &Unexpected<'_>) -> String {
    match found {
        Unexpected::Bool(value) => format!("`{value}`"),
        Unexpected::Unsigned(value) => format!("`{value}`"),
        Unexpected::Signed(value) => format!("`{value}`"),
        Unexpected::Float(value) => format!("`{value}`"),
        Unexpected::Str(text) => format!("the text `{text}`"),
        Unexpected::Unit | Unexpected::Option => "nothing".to_owned(),
        Unexpected::Seq => "a list".to_owned(),
        Unexpected::Map | Unexpected::StructVariant => "keys with values".to_owned(),
        other => other.to_string(),
    }
}

/// serde names Rust's types; a person who writes YAML knows none of them.
fn spell_wanted(wanted: &str) -> String {
    let spelled = match wanted {
        "u8" | "u16" | "u32" | "u64" | "usize" => "a whole number from 0 up",
        "i8" | "i16" | "i32" | "i64" | "isize" => "a whole number",
        "f32" | "f64" => "a number",
        "a boolean" => "`true` or `false`",
        "a string" => "a text",
        "a sequence" => "a list",
        "a map" => "keys with values",
        other if other.starts_with("struct ") => "keys with values",
        other if other.starts_with("a tuple of size ") || other.starts_with("tuple of ") => {
            "a list of that many"
        }
        other => other,
    };
    spelled.to_owned()
}

#[cfg(test)]
mod tests {
    use record::settings::Settings;

    use super::*;
    use crate::matrix_file::yaml;

    fn read_settings(text: &str) -> Result<Settings, Vec<(Code, String, String)>> {
        let source = Arc::new(Source::new("f.yaml", text));
        read(&source, &yaml::parse(&source).unwrap()).map_err(|found| {
            let told = |d: &Diagnostic| {
                (
                    d.code,
                    text[d.span().range()].to_owned(),
                    d.help.clone().unwrap_or_default(),
                )
            };
            found.iter().map(told).collect()
        })
    }

    #[test]
    fn settings_that_are_left_out_have_the_papers_values() {
        let settings = read_settings("network: {delay: 20ms}\ncapture:\n").unwrap();
        assert_eq!(settings.network.delay.to_string(), "20ms");
        assert_eq!(settings.network.loss, Settings::default().network.loss);
    }

    #[test]
    fn all_mistakes_are_found_in_one_go_each_at_its_place() {
        let found = read_settings(
            "windows: many\nnetwork:\n  delay: 10\n  los: 1%\n  jitter: 1Hz\ncontrol:\n  angle: {kp: 1, kd: x}\n",
        )
        .unwrap_err();
        let expected = [
            (Code::WrongType, "many", "write a whole number from 0 up"),
            (
                Code::InvalidValue,
                "10",
                "write a duration as `10s` or `10ms`; the units are `ns`, `us`, `ms`, `s`, `min`, `h`",
            ),
            (Code::UnknownKey, "los", "did you mean `loss`?"),
            (
                Code::InvalidValue,
                "1Hz",
                "use `ns`, `us`, `ms`, `s`, `min`, `h`, as in `10ms`",
            ),
            (Code::WrongType, "x", "write a number"),
        ];
        let found: Vec<_> = found
            .iter()
            .map(|(code, at, help)| (*code, at.as_str(), help.as_str()))
            .collect();
        assert_eq!(found, expected);
    }

    #[test]
    fn a_key_that_must_be_there_is_asked_for() {
        let found = read_settings("control:\n  angle: {kp: 1}\n").unwrap_err();
        assert_eq!(
            found,
            [(Code::MissingKey, "{kp: 1}".to_owned(), "add `kd: …`".to_owned())]
        );
    }

    #[test]
    fn a_misspelt_word_is_asked_about() {
        let found = read_settings("network: {backend: userpsace}\n").unwrap_err();
        assert_eq!(found[0].0, Code::UnknownValue);
        assert_eq!(found[0].2, "did you mean `userspace`?");
    }
}
