//! From where on a window is suspect or invalid: the `validity:` section of the settings. The main type is
//! [`ValiditySettings`]; docs/validity.md says where the defaults come from.

use std::{fmt, marker::PhantomData};

use serde::{
    Deserialize, Deserializer, Serialize, Serializer,
    de::{self, IntoDeserializer},
};

use crate::quantity::{Bytes, Fraction, TimeSpan};

/// What each rule allows. A window above a `suspect` limit counts and is marked, one above an `invalid` limit is kept
/// and never counts. What is missing from a window makes it invalid whatever is written here.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct ValiditySettings {
    /// Share of a loop's steps that began a whole step late or more.
    pub missed_deadlines: Limits<Fraction>,
    /// How late 99 % of a loop's steps began at most, as a share of a step.
    pub lateness: Limits<Fraction>,
    /// The longest time without a control step, in steps.
    pub gap_steps: Limits<u32>,
    /// How late the emulator let 99 % of the packets go at most.
    pub release_lateness: Limits<TimeSpan>,
    /// By how much the wall clock was set, either way.
    pub clock_step: Limits<TimeSpan>,
    /// Share of a capture's packets that the kernel dropped.
    pub capture_dropped: Limits<Fraction>,
    /// Share of the processors' time that a hypervisor gave to others.
    pub steal: Limits<Fraction>,
    /// Share of the window in which a quota of the control group held the workload up.
    pub throttled: Limits<Fraction>,
    /// How often a processor slowed down since it was too hot.
    pub thermal_throttles: Limits<u64>,
    /// Share of the processors' time that others on the machine used.
    pub other_load: Limits<Fraction>,
    /// Share of the window in which something on the machine waited for memory.
    pub memory_pressure: Limits<Fraction>,
    /// Pages of the workload that had to be read from a disk.
    pub major_faults: Limits<u64>,
    /// What the machine swapped, in and out.
    pub swapped: Limits<Bytes>,
}

impl Default for ValiditySettings {
    fn default() -> Self {
        let percent = Fraction::from_percent;
        Self {
            missed_deadlines: Limits::both(percent(0.1), percent(5.0)),
            lateness: Limits::suspect(percent(10.0)),
            gap_steps: Limits::both(5, 50),
            release_lateness: Limits::both(TimeSpan::from_millis(1), TimeSpan::from_millis(10)),
            clock_step: Limits::suspect(TimeSpan::from_millis(1)),
            capture_dropped: Limits::suspect(percent(0.0)),
            steal: Limits::suspect(percent(1.0)),
            throttled: Limits::suspect(percent(0.1)),
            thermal_throttles: Limits::suspect(0),
            other_load: Limits::suspect(percent(10.0)),
            memory_pressure: Limits::suspect(percent(1.0)),
            major_faults: Limits::suspect(10),
            swapped: Limits::suspect(Bytes::new(1 << 20)),
        }
    }
}

impl ValiditySettings {
    /// The rules whose `invalid` limit lies below their `suspect` limit, by the dotted path of the former.
    #[must_use]
    pub fn crossed(&self) -> Vec<&'static str> {
        let rules = [
            (
                "validity.missed_deadlines.invalid",
                self.missed_deadlines.are_crossed(),
            ),
            ("validity.lateness.invalid", self.lateness.are_crossed()),
            ("validity.gap_steps.invalid", self.gap_steps.are_crossed()),
            (
                "validity.release_lateness.invalid",
                self.release_lateness.are_crossed(),
            ),
            ("validity.clock_step.invalid", self.clock_step.are_crossed()),
            (
                "validity.capture_dropped.invalid",
                self.capture_dropped.are_crossed(),
            ),
            ("validity.steal.invalid", self.steal.are_crossed()),
            ("validity.throttled.invalid", self.throttled.are_crossed()),
            (
                "validity.thermal_throttles.invalid",
                self.thermal_throttles.are_crossed(),
            ),
            ("validity.other_load.invalid", self.other_load.are_crossed()),
            (
                "validity.memory_pressure.invalid",
                self.memory_pressure.are_crossed(),
            ),
            ("validity.major_faults.invalid", self.major_faults.are_crossed()),
            ("validity.swapped.invalid", self.swapped.are_crossed()),
        ];
        rules
            .into_iter()
            .filter_map(|(path, crossed)| crossed.then_some(path))
            .collect()
    }
}

/// The two limits of one rule. Both are to be written, so that neither is forgotten.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Limits<T> {
    /// Above it a window is suspect.
    pub suspect: Limit<T>,
    /// Above it a window is invalid.
    pub invalid: Limit<T>,
}

impl<T> Limits<T> {
    /// No limits.
    pub const NEVER: Self = Self {
        suspect: Limit::Never,
        invalid: Limit::Never,
    };

    fn suspect(above: T) -> Self {
        Self {
            suspect: Limit::Above(above),
            invalid: Limit::Never,
        }
    }

    pub(super) fn both(suspect: T, invalid: T) -> Self {
        Self {
            suspect: Limit::Above(suspect),
            invalid: Limit::Above(invalid),
        }
    }

    /// The same limits in another unit.
    pub fn map<U>(self, convert: impl Fn(T) -> U) -> Limits<U> {
        let convert = |limit| match limit {
            Limit::Above(value) => Limit::Above(convert(value)),
            Limit::Never => Limit::Never,
        };
        Limits {
            suspect: convert(self.suspect),
            invalid: convert(self.invalid),
        }
    }
}

impl<T: PartialOrd> Limits<T> {
    fn are_crossed(&self) -> bool {
        matches!((&self.suspect, &self.invalid), (Limit::Above(suspect), Limit::Above(invalid)) if invalid < suspect)
    }
}

/// A value, or `never`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Limit<T> {
    /// What is above it is too much; it is not yet too much itself.
    Above(T),
    /// Nothing is too much.
    Never,
}

const NEVER: &str = "never";

impl<T: PartialOrd> Limit<T> {
    /// The limit, if the value is above it.
    pub fn exceeded_by(&self, value: &T) -> Option<&T> {
        match self {
            Self::Above(limit) if value > limit => Some(limit),
            _ => None,
        }
    }
}

impl<T: Serialize> Serialize for Limit<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Above(value) => value.serialize(serializer),
            Self::Never => serializer.serialize_str(NEVER),
        }
    }
}

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Limit<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        /// What is not the word is read as the value, so that its own errors are said.
        struct Visitor<T>(PhantomData<T>);
        impl<'de, T: Deserialize<'de>> de::Visitor<'de> for Visitor<T> {
            type Value = Limit<T>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "a limit or `{NEVER}`")
            }

            fn visit_str<E: de::Error>(self, text: &str) -> Result<Limit<T>, E> {
                match text {
                    NEVER => Ok(Limit::Never),
                    _ => T::deserialize(text.into_deserializer()).map(Limit::Above),
                }
            }

            fn visit_i64<E: de::Error>(self, number: i64) -> Result<Limit<T>, E> {
                T::deserialize(number.into_deserializer()).map(Limit::Above)
            }

            fn visit_u64<E: de::Error>(self, number: u64) -> Result<Limit<T>, E> {
                T::deserialize(number.into_deserializer()).map(Limit::Above)
            }

            fn visit_f64<E: de::Error>(self, number: f64) -> Result<Limit<T>, E> {
                T::deserialize(number.into_deserializer()).map(Limit::Above)
            }
        }
        deserializer.deserialize_any(Visitor(PhantomData))
    }
}

#[cfg(feature = "schema")]
impl<T: schemars::JsonSchema> schemars::JsonSchema for Limit<T> {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        format!("LimitOf{}", T::schema_name()).into()
    }

    fn json_schema(generator: &mut schemars::SchemaGenerator) -> schemars::Schema {
        let value = generator.subschema_for::<T>();
        schemars::json_schema!({
            "description": "What is above it is too much; `never` for no limit.",
            "anyOf": [value, {"const": NEVER}],
        })
    }
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    #[test]
    fn a_rule_is_written_with_both_limits_and_the_others_keep_theirs() {
        let text =
            r#"{"steal": {"suspect": "3%", "invalid": "never"}, "gap_steps": {"suspect": 7, "invalid": 9}}"#;
        let settings: ValiditySettings = serde_json::from_str(text).unwrap();
        assert_eq!(settings.steal, Limits::suspect(Fraction::from_percent(3.0)));
        assert_eq!(settings.gap_steps, Limits::both(7, 9));
        assert_eq!(settings.swapped, ValiditySettings::default().swapped);
    }

    #[test]
    fn limits_read_back_as_they_were_written() {
        let settings = ValiditySettings::default();
        let text = serde_json::to_string(&settings).unwrap();
        assert!(
            text.contains(r#""clock_step":{"suspect":"1ms","invalid":"never"}"#),
            "{text}"
        );
        assert_eq!(serde_json::from_str::<ValiditySettings>(&text).unwrap(), settings);
    }

    #[rstest]
    #[case::no_unit(r#"{"clock_step": {"suspect": 5, "invalid": "never"}}"#, "has no unit")]
    #[case::one_forgotten(r#"{"steal": {"suspect": "3%"}}"#, "missing field `invalid`")]
    #[case::no_number(r#"{"gap_steps": {"suspect": "often", "invalid": "never"}}"#, "invalid type")]
    fn what_is_no_limit_is_refused_in_the_values_own_words(#[case] text: &str, #[case] words: &str) {
        let error = serde_json::from_str::<ValiditySettings>(text)
            .unwrap_err()
            .to_string();
        assert!(error.contains(words), "{error}");
    }

    #[test]
    fn a_value_at_its_limit_is_not_above_it() {
        assert_eq!(Limit::Above(5).exceeded_by(&5), None);
        assert_eq!(Limit::Above(5).exceeded_by(&6), Some(&5));
        assert_eq!(Limit::Never.exceeded_by(&u64::MAX), None);
    }

    #[test]
    fn limits_the_wrong_way_round_are_found() {
        assert_eq!(ValiditySettings::default().crossed(), Vec::<&str>::new());
        let settings = ValiditySettings {
            gap_steps: Limits::both(9, 7),
            ..ValiditySettings::default()
        };
        assert_eq!(settings.crossed(), ["validity.gap_steps.invalid"]);
    }
}
