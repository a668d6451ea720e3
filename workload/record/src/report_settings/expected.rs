//! What a metric is expected to be, so that the first night can fail. The main type is [`Expectation`].

use std::{collections::BTreeMap, fmt};

use serde::{Deserialize, Deserializer, Serialize, de};

use crate::{
    quantity::{Fraction, Length},
    run_directory::PlannedScenario,
};

/// The key of a scenario's host among the values that say which scenarios are meant.
pub const HOST: &str = "host";

/// What the mean of a metric over a scenario's windows is expected to be.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Expectation {
    /// The scenarios that are meant: those with these values of axes, or of `host`; all when left out.
    #[serde(rename = "for", default, skip_serializing_if = "BTreeMap::is_empty")]
    pub scenarios: BTreeMap<String, String>,
    /// What is expected: of the ball's error a length such as `120mm`, of another metric a number in its unit.
    pub value: Amount,
    /// By how much less it may be: a share of the value such as `5%`, or an amount like it; as little as it likes when left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub below: Option<Tolerance>,
    /// By how much more it may be.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub above: Option<Tolerance>,
}

impl Expectation {
    /// Whether it is of this scenario.
    #[must_use]
    pub fn is_of(&self, scenario: &PlannedScenario) -> bool {
        self.scenarios.iter().all(|(key, value)| match key.as_str() {
            HOST => scenario.hosts().any(|host| host == value),
            axis => scenario.axis(axis).as_ref() == Some(value),
        })
    }

    /// The smallest and the largest mean that are as expected, in the unit of the metric's files.
    #[must_use]
    pub fn limits(&self) -> [Option<f64>; 2] {
        let value = self.value.in_unit();
        [
            self.below.map(|below| value - below.of(value)),
            self.above.map(|above| value + above.of(value)),
        ]
    }
}

/// A value of a metric.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(untagged)]
pub enum Amount {
    /// Of the ball's error.
    Length(Length),
    /// Of a metric of a user's experiment, in its unit.
    Number(f64),
}

impl Amount {
    /// In the unit of the metric's files: metres, or the metric's own.
    #[must_use]
    pub fn in_unit(self) -> f64 {
        match self {
            Self::Length(length) => length.metres(),
            Self::Number(number) => number,
        }
    }
}

impl fmt::Display for Amount {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Length(length) => write!(formatter, "{length}"),
            Self::Number(number) => write!(formatter, "{number}"),
        }
    }
}

/// How far from what is expected a value may be.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(untagged)]
pub enum Tolerance {
    /// A share of what is expected.
    Share(Fraction),
    /// As much.
    Amount(Amount),
}

impl Tolerance {
    fn of(self, value: f64) -> f64 {
        match self {
            Self::Share(share) => value.abs() * share.probability(),
            Self::Amount(amount) => amount.in_unit(),
        }
    }
}

/// A number, or a text with a unit: an untagged enum would not say what is wrong with the text.
struct NumberOrText<T>(fn(f64) -> Result<T, String>, fn(&str) -> Result<T, String>);

impl<T> de::Visitor<'_> for NumberOrText<T> {
    type Value = T;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("a length such as `120mm`, or a number in the metric's unit")
    }

    fn visit_f64<E: de::Error>(self, number: f64) -> Result<T, E> {
        (self.0)(number).map_err(E::custom)
    }

    fn visit_i64<E: de::Error>(self, number: i64) -> Result<T, E> {
        self.visit_f64(number as f64)
    }

    fn visit_u64<E: de::Error>(self, number: u64) -> Result<T, E> {
        self.visit_f64(number as f64)
    }

    fn visit_str<E: de::Error>(self, text: &str) -> Result<T, E> {
        (self.1)(text).map_err(E::custom)
    }
}

fn amount(number: f64) -> Result<Amount, String> {
    match number.is_finite() {
        true => Ok(Amount::Number(number)),
        false => Err(format!("{number} is no number that can be expected")),
    }
}

fn length(text: &str) -> Result<Amount, String> {
    text.parse()
        .map(Amount::Length)
        .map_err(|error: crate::quantity::QuantityError| error.to_string())
}

impl<'de> Deserialize<'de> for Amount {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(NumberOrText(amount, length))
    }
}

impl<'de> Deserialize<'de> for Tolerance {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let number = |number: f64| match number >= 0.0 {
            true => amount(number).map(Self::Amount),
            false => Err(format!("{number} is no distance: write one of 0 or more")),
        };
        let text = |text: &str| match text.contains('%') {
            true => text
                .parse()
                .map(Self::Share)
                .map_err(|error: crate::quantity::QuantityError| error.to_string()),
            false => length(text).map(Self::Amount),
        };
        deserializer.deserialize_any(NumberOrText(number, text))
    }
}

/// What is expected of each metric, by its name: of several entries for a scenario the first counts.
pub type Expectations = BTreeMap<String, Several>;

/// One, or a list.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(transparent)]
#[cfg_attr(feature = "schema", schemars(with = "OneOrMany"))]
pub struct Several(pub Vec<Expectation>);

/// How it is written.
#[cfg(feature = "schema")]
#[derive(serde::Deserialize, schemars::JsonSchema)]
#[expect(dead_code, reason = "the schema is made of it, and a visitor reads it")]
#[serde(untagged)]
enum OneOrMany {
    /// Of all scenarios that it names.
    One(Expectation),
    /// The first of them that is of a scenario counts.
    Many(Vec<Expectation>),
}

impl<'de> Deserialize<'de> for Several {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Visitor;

        impl<'de> de::Visitor<'de> for Visitor {
            type Value = Vec<Expectation>;

            fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
                formatter.write_str("what is expected, as in `{value: 120mm, above: 5%}`, or a list of it")
            }

            fn visit_map<M: de::MapAccess<'de>>(self, map: M) -> Result<Self::Value, M::Error> {
                Expectation::deserialize(de::value::MapAccessDeserializer::new(map)).map(|one| vec![one])
            }

            fn visit_seq<S: de::SeqAccess<'de>>(self, list: S) -> Result<Self::Value, S::Error> {
                Vec::deserialize(de::value::SeqAccessDeserializer::new(list))
            }
        }

        deserializer.deserialize_any(Visitor).map(Self)
    }
}

#[cfg(test)]
mod tests {
    use rstest::rstest;
    use serde_json::{Value, json};

    use super::*;

    fn read(written: Value) -> Result<Several, String> {
        serde_json::from_value(written).map_err(|error| error.to_string())
    }

    #[test]
    fn one_is_a_list_of_one_and_each_is_written_as_it_is_read() {
        let one = json!({"value": "115mm", "below": "20%", "above": "3mm"});
        let read_one = read(one.clone()).unwrap();
        assert_eq!(serde_json::to_value(&read_one).unwrap(), json!([one]));
        let many =
            json!([{"for": {"host": "lab"}, "value": 2.5, "above": 0.5}, {"value": -2.0, "below": "10%"}]);
        let read_many = read(many.clone()).unwrap();
        assert_eq!(serde_json::to_value(&read_many).unwrap(), many);
        let limits: Vec<_> = [&read_one, &read_many]
            .iter()
            .flat_map(|it| it.0.iter().map(Expectation::limits))
            .map(|limits| limits.map(|limit| limit.map(|limit| (limit * 1e6).round() / 1e6)))
            .collect();
        assert_eq!(
            limits,
            [[Some(0.092), Some(0.118)], [None, Some(3.0)], [Some(-2.2), None]]
        );
    }

    #[rstest]
    #[case(json!({"value": "120", "above": "5%"}), "`120` has no unit")]
    #[case(json!({"value": "120mm", "above": "5"}), "`5` has no unit")]
    #[case(json!({"value": "120mm", "above": -1}), "no distance")]
    #[case(json!({"value": "120mm", "over": "5%"}), "unknown field `over`")]
    #[case(json!({"above": "5%"}), "missing field `value`")]
    #[case(json!({"value": [1], "above": "5%"}), "a number in the metric's unit")]
    #[case(json!("120mm"), "or a list of it")]
    fn what_cannot_be_expected_is_refused_with_what_to_write(#[case] written: Value, #[case] says: &str) {
        let error = read(written).unwrap_err();
        assert!(error.contains(says), "{error}");
    }
}
