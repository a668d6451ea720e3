//! One argument of a command, with placeholders: `--seed={window.seed}`. The main type is [`Argument`].

use std::{collections::BTreeMap, fmt};

use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error as _};

use crate::{
    topology::{self, Topology},
    virtual_host::VirtualHost,
};

/// An argument is no longer: the kernel takes 128 KiB (`MAX_ARG_STRLEN`).
pub(super) const LONGEST: usize = 32 << 10;

/// An argument, as it is written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Argument {
    written: String,
    parts: Vec<Part>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
enum Part {
    Text(String),
    Placeholder(Placeholder),
}

/// What stands for a value.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Placeholder {
    /// `{parameters.NAME}`: the parameter's value in the scenario.
    Parameter(String),
    /// `{window.number}`: the window's number, from 1.
    WindowNumber,
    /// `{window.seed}`: [`super::seed_of`] the window.
    WindowSeed,
    /// `{hosts.NAME.address}`: the address of a virtual host.
    HostAddress(VirtualHost),
    /// `{window.folder}`: the folder, absolute and empty, into which the command writes what the metrics are read from.
    WindowFolder,
}

/// What placeholders of a window stand for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WindowValues<'a> {
    /// Its number, from 1.
    pub number: u32,
    /// Its folder, absolute.
    pub folder: &'a str,
}

/// What placeholders stand for.
#[derive(Debug, Clone, Copy)]
pub struct Values<'a> {
    /// The scenario's parameters.
    pub parameters: &'a BTreeMap<String, String>,
    /// The network of the command, if it has one.
    pub topology: Option<&'a Topology>,
    /// The window, if the command is run in one.
    pub window: Option<WindowValues<'a>>,
}

const PARAMETERS: &str = "parameters.";
const HOSTS: &str = "hosts.";
const ADDRESS: &str = ".address";

impl Placeholder {
    /// Those that stand for one thing each, and what a parameter looks like.
    const KNOWN: &str = "`{window.number}`, `{window.seed}`, `{window.folder}`, `{parameters.NAME}` and `{hosts.NAME.address}`";

    fn named(name: &str) -> Option<Self> {
        match name {
            "window.number" => Some(Self::WindowNumber),
            "window.seed" => Some(Self::WindowSeed),
            "window.folder" => Some(Self::WindowFolder),
            _ => match name.strip_prefix(HOSTS) {
                Some(host) => host.strip_suffix(ADDRESS)?.parse().ok().map(Self::HostAddress),
                None => name
                    .strip_prefix(PARAMETERS)
                    .filter(|name| is_parameter(name))
                    .map(|name| Self::Parameter(name.to_owned())),
            },
        }
    }
}

impl fmt::Display for Placeholder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Parameter(name) => write!(f, "{{{PARAMETERS}{name}}}"),
            Self::HostAddress(host) => write!(f, "{{{HOSTS}{host}{ADDRESS}}}"),
            Self::WindowNumber => f.write_str("{window.number}"),
            Self::WindowSeed => f.write_str("{window.seed}"),
            Self::WindowFolder => f.write_str("{window.folder}"),
        }
    }
}

/// Whether a parameter can have that name, which is also an axis' and part of a placeholder.
pub(super) fn is_parameter(name: &str) -> bool {
    let mut bytes = name.bytes();
    bytes.next().is_some_and(|first| first.is_ascii_alphabetic())
        && bytes.all(|byte| byte.is_ascii_alphanumeric() || b"_-".contains(&byte))
        && name.len() <= 60
}

/// What a parameter's value may be in a matrix file.
#[cfg(feature = "schema")]
#[derive(schemars::JsonSchema)]
#[serde(untagged)]
#[expect(dead_code, reason = "it stands for the schema alone")]
pub(super) enum Scalar {
    Text(String),
    Number(f64),
    Switch(bool),
}

/// What is wrong with an argument, as `what: what to write`.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(super) enum ArgumentError {
    #[error("`{{{}}}` is no placeholder: there are {known}, and `{{{{` is a brace", cut(.0), known = Placeholder::KNOWN)]
    Unknown(String),
    #[error("`{0}` has a brace without its other half: write `{{{{` for `{{` and `}}}}` for `}}`")]
    Unpaired(String),
    #[error("an argument cannot have a byte that is 0: take it out")]
    Zero,
    #[error("an argument of {0} bytes is too long: put it into a file that the command reads")]
    Long(usize),
}

/// What may be a whole program in one argument.
fn cut(name: &str) -> String {
    const SHOWN: usize = 40;
    let mut shown: String = name.chars().take(SHOWN).collect();
    if shown.len() < name.len() {
        shown.push('…');
    }
    shown
}

impl Argument {
    fn parse(written: &str) -> Result<Self, ArgumentError> {
        if written.contains('\0') {
            return Err(ArgumentError::Zero);
        }
        if written.len() > LONGEST {
            return Err(ArgumentError::Long(written.len()));
        }
        let unpaired = || ArgumentError::Unpaired(written.to_owned());
        let mut parts = Vec::new();
        let mut text = String::new();
        let mut rest = written;
        while let Some(at) = rest.find(['{', '}']) {
            let (before, brace) = rest.split_at(at);
            text.push_str(before);
            if let Some(after) = brace.strip_prefix("{{") {
                text.push('{');
                rest = after;
            } else if let Some(after) = brace.strip_prefix("}}") {
                text.push('}');
                rest = after;
            } else {
                let (name, after) = brace
                    .strip_prefix('{')
                    .and_then(|inner| inner.split_once('}'))
                    .ok_or_else(unpaired)?;
                let placeholder =
                    Placeholder::named(name).ok_or_else(|| ArgumentError::Unknown(name.to_owned()))?;
                if !text.is_empty() {
                    parts.push(Part::Text(std::mem::take(&mut text)));
                }
                parts.push(Part::Placeholder(placeholder));
                rest = after;
            }
        }
        text.push_str(rest);
        if !text.is_empty() {
            parts.push(Part::Text(text));
        }
        Ok(Self {
            written: written.to_owned(),
            parts,
        })
    }

    /// The placeholders in it.
    pub fn placeholders(&self) -> impl Iterator<Item = &Placeholder> {
        self.parts.iter().filter_map(|part| match part {
            Part::Placeholder(placeholder) => Some(placeholder),
            Part::Text(_) => None,
        })
    }

    /// The argument with values in place of placeholders. What has none stays as it is written: settings without problems have all.
    #[must_use]
    pub fn filled(&self, values: Values<'_>) -> String {
        let value = |placeholder: &Placeholder| match (placeholder, values.window) {
            (Placeholder::Parameter(name), _) => values.parameters.get(name).cloned(),
            (Placeholder::HostAddress(host), _) => {
                let position = values.topology.and_then(|topology| topology.position(*host));
                position.map(|position| topology::address(position).to_string())
            }
            (_, None) => None,
            (Placeholder::WindowNumber, Some(window)) => Some(window.number.to_string()),
            (Placeholder::WindowSeed, Some(window)) => Some(super::seed_of(window.number).to_string()),
            (Placeholder::WindowFolder, Some(window)) => Some(window.folder.to_owned()),
        };
        let parts = self.parts.iter().map(|part| match part {
            Part::Text(text) => text.clone(),
            Part::Placeholder(placeholder) => value(placeholder).unwrap_or_else(|| placeholder.to_string()),
        });
        parts.collect()
    }
}

impl fmt::Display for Argument {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.written)
    }
}

impl Serialize for Argument {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&self.written)
    }
}

impl<'de> Deserialize<'de> for Argument {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Self::parse(&String::deserialize(deserializer)?).map_err(D::Error::custom)
    }
}

#[cfg(feature = "schema")]
impl schemars::JsonSchema for Argument {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "Argument".into()
    }

    fn json_schema(generator: &mut schemars::SchemaGenerator) -> schemars::Schema {
        generator.subschema_for::<Scalar>()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rstest::rstest;

    use super::*;

    fn filled(written: &str) -> String {
        let parameters = BTreeMap::from([("steps".to_owned(), "5e3".to_owned())]);
        let window = WindowValues {
            number: 7,
            folder: "/w {1}",
        };
        Argument::parse(written).unwrap().filled(Values {
            parameters: &parameters,
            topology: None,
            window: Some(window),
        })
    }

    #[rstest]
    #[case("", "")]
    #[case("plain text", "plain text")]
    #[case("{parameters.steps}", "5e3")]
    #[case("--n={window.number}:{parameters.steps};", "--n=7:5e3;")]
    #[case("{window.folder}/out", "/w {1}/out")]
    #[case("{{window.number}} }}{{", "{window.number} }{")]
    #[case("$(reboot) `x` ; ü", "$(reboot) `x` ; ü")]
    fn placeholders_are_filled_and_all_else_stays(#[case] written: &str, #[case] expected: &str) {
        assert_eq!(filled(written), expected);
        assert_eq!(Argument::parse(written).unwrap().to_string(), written);
    }

    #[rstest]
    #[case("{seed}", "`{seed}` is no placeholder: there are ")]
    #[case("{}", "`{}` is no placeholder")]
    #[case("{parameters.}", "`{parameters.}` is no placeholder")]
    #[case("{parameters.a b}", "`{parameters.a b}` is no placeholder")]
    #[case(
        "{window.seed",
        "`{window.seed` has a brace without its other half: write `{{` for `{` and `}}` for `}`"
    )]
    #[case("a } b", "`a } b` has a brace without its other half")]
    #[case("a\0b", "an argument cannot have a byte that is 0")]
    fn what_is_no_argument_says_what_to_write(#[case] written: &str, #[case] words: &str) {
        let error = Argument::parse(written).unwrap_err().to_string();
        assert!(error.starts_with(words), "{error}");
    }

    proptest! {
        #[test]
        fn a_text_with_its_braces_doubled_stays_that_text(text in "[^\0]{0,40}") {
            let doubled = text.replace('{', "{{").replace('}', "}}");
            prop_assert_eq!(filled(&doubled), text);
        }

        #[test]
        fn whatever_is_written_is_an_argument_or_an_error(text in ".{0,60}") {
            if let Ok(argument) = Argument::parse(&text) {
                prop_assert_eq!(argument.to_string(), text);
            }
        }
    }
}
