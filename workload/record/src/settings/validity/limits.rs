//! The two limits of a rule. The main type is [`Limits`].

use std::{fmt, marker::PhantomData};

use serde::{
    Deserialize, Deserializer, Serialize, Serializer,
    de::{self, IntoDeserializer},
};

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

    pub(super) fn suspect(above: T) -> Self {
        Self {
            suspect: Limit::Above(above),
            invalid: Limit::Never,
        }
    }

    pub(in crate::settings) fn both(suspect: T, invalid: T) -> Self {
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
    pub(super) fn are_crossed(&self) -> bool {
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
    use super::*;

    #[test]
    fn a_value_at_its_limit_is_not_above_it() {
        assert_eq!(Limit::Above(5).exceeded_by(&5), None);
        assert_eq!(Limit::Above(5).exceeded_by(&6), Some(&5));
        assert_eq!(Limit::Never.exceeded_by(&u64::MAX), None);
    }
}
