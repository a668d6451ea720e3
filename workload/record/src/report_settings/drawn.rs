//! Which pairs of scenarios are drawn, and of which windows: the entries of `report.figures`. The main type is
//! [`DrawnPair`].

use std::{fmt, str::FromStr};

use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

/// Two scenarios to draw beside each other.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(expecting = "a pair of scenarios such as `[b, h]`")]
pub struct DrawnPair(pub DrawnScenario, pub DrawnScenario);

impl DrawnPair {
    /// Both of them.
    pub fn sides(&self) -> [&DrawnScenario; 2] {
        [&self.0, &self.1]
    }
}

/// A scenario to draw and, where it is named, which of its windows: `b`, `b/2`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DrawnScenario {
    /// Its letter or slug; neither has a `/`.
    pub name: String,
    /// The window, from 1.
    pub window: Option<u32>,
}

/// A text that names no window.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` names no window: write a scenario and a window's number from 1 up, such as `b/2`")]
pub struct NoWindow(String);

impl FromStr for DrawnScenario {
    type Err = NoWindow;

    fn from_str(text: &str) -> Result<Self, NoWindow> {
        let (name, window) = match text.split_once('/') {
            None => (text, None),
            Some((name, number)) => match number.parse() {
                Ok(window @ 1..) if !name.is_empty() => (name, Some(window)),
                _ => return Err(NoWindow(text.to_owned())),
            },
        };
        Ok(Self {
            name: name.to_owned(),
            window,
        })
    }
}

impl fmt::Display for DrawnScenario {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.name)?;
        match self.window {
            None => Ok(()),
            Some(window) => write!(f, "/{window}"),
        }
    }
}

impl Serialize for DrawnScenario {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for DrawnScenario {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?
            .parse()
            .map_err(de::Error::custom)
    }
}

#[cfg(feature = "schema")]
impl schemars::JsonSchema for DrawnScenario {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "DrawnScenario".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        schemars::json_schema!({
            "description": "A scenario's letter or slug; with a window of it, such as `b/2`.",
            "type": "string",
            "pattern": "^[^/]+(/[1-9][0-9]*)?$",
        })
    }
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    #[test]
    fn it_reads_back_as_it_is_written_with_windows_and_without() {
        for text in [r#"["b","h"]"#, r#"["b/2","x86-64-debian-12-native/10"]"#] {
            let pair: DrawnPair = serde_json::from_str(text).unwrap();
            assert_eq!(serde_json::to_string(&pair).unwrap(), text);
        }
    }

    #[rstest]
    #[case("b/0")]
    #[case("b/")]
    #[case("/1")]
    #[case("b/two")]
    #[case("b/1/2")]
    #[case("b/99999999999")]
    fn what_names_no_window_is_refused_with_what_to_write(#[case] text: &str) {
        let error = text.parse::<DrawnScenario>().unwrap_err().to_string();
        assert!(
            error.contains(text) && error.ends_with("such as `b/2`"),
            "{error}"
        );
    }
}
