//! What a night has of a scenario beside its numbers, kept as text: a value that takes two bytes there takes up to 256 as a [`Value`], and a
//! history has it of each night. It is read where two nights are compared. The main type is [`Compact`].

use std::{fmt, marker::PhantomData};

use record::run_directory::EnvironmentRecord;
use serde::{
    Deserialize, Deserializer, Serialize, Serializer,
    de::{DeserializeOwned, DeserializeSeed, Error as _, MapAccess, SeqAccess, Visitor},
    ser::Error as _,
};
use serde_json::{Map, Value};

/// Values of what was asked for of a scenario, or of what its platform was: either has some two hundred.
const MOST_VALUES: usize = 1 << 13;

/// Something as its JSON.
#[derive(Clone, PartialEq, Eq)]
pub struct Compact<T> {
    text: Box<str>,
    of: PhantomData<fn() -> T>,
}

impl<T: Serialize> Compact<T> {
    /// Of plain data, which can always be written as JSON.
    #[must_use]
    pub fn of(it: &T) -> Self {
        Self {
            text: serde_json::to_string(it).unwrap_or_default().into(),
            of: PhantomData,
        }
    }
}

impl Compact<Value> {
    /// What it is.
    #[must_use]
    pub fn read(&self) -> Value {
        serde_json::from_str(&self.text).unwrap_or_default()
    }
}

impl Compact<EnvironmentRecord> {
    /// What it is; none is not to be found here, since only such a record is kept as one.
    #[must_use]
    pub fn read(&self) -> Option<EnvironmentRecord> {
        serde_json::from_str(&self.text).ok()
    }
}

impl<T> fmt::Debug for Compact<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl<T> Serialize for Compact<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let value: Value = serde_json::from_str(&self.text).map_err(S::Error::custom)?;
        value.serialize(serializer)
    }
}

impl<'de, T: Serialize + DeserializeOwned> Deserialize<'de> for Compact<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let mut left = MOST_VALUES;
        let value = Bounded(&mut left).deserialize(deserializer)?;
        let it: T = serde_json::from_value(value).map_err(D::Error::custom)?;
        Ok(Self::of(&it))
    }
}

/// Reads a value of so many in all, and no further.
struct Bounded<'a>(&'a mut usize);

impl<'de> DeserializeSeed<'de> for Bounded<'_> {
    type Value = Value;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Value, D::Error> {
        *self.0 = self.0.checked_sub(1).ok_or_else(|| {
            D::Error::custom(format!(
                "a scenario has more than {MOST_VALUES} values, which none of matrix has"
            ))
        })?;
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Bounded<'_> {
    type Value = Value;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("any JSON value")
    }

    fn visit_unit<E>(self) -> Result<Value, E> {
        Ok(Value::Null)
    }

    fn visit_bool<E>(self, it: bool) -> Result<Value, E> {
        Ok(it.into())
    }

    fn visit_i64<E>(self, it: i64) -> Result<Value, E> {
        Ok(it.into())
    }

    fn visit_u64<E>(self, it: u64) -> Result<Value, E> {
        Ok(it.into())
    }

    fn visit_f64<E>(self, it: f64) -> Result<Value, E> {
        Ok(it.into())
    }

    fn visit_str<E>(self, it: &str) -> Result<Value, E> {
        Ok(it.into())
    }

    fn visit_string<E>(self, it: String) -> Result<Value, E> {
        Ok(it.into())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Value, A::Error> {
        let mut values = Vec::new();
        while let Some(value) = list.next_element_seed(Bounded(self.0))? {
            values.push(value);
        }
        Ok(values.into())
    }

    fn visit_map<A: MapAccess<'de>>(self, mut fields: A) -> Result<Value, A::Error> {
        let mut values = Map::new();
        while let Some(name) = fields.next_key()? {
            values.insert(name, fields.next_value_seed(Bounded(self.0))?);
        }
        Ok(values.into())
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn what_is_kept_is_written_as_it_was_read() {
        let text = r#"{"b":[1,-2,0.1,1e300,null,true,"µ\n"],"a":{}}"#;
        let kept: Compact<Value> = serde_json::from_str(text).unwrap();
        assert_eq!(kept.read(), serde_json::from_str::<Value>(text).unwrap());
        assert_eq!(
            serde_json::to_string(&kept).unwrap(),
            serde_json::to_string(&kept.read()).unwrap()
        );
        assert_eq!(kept, Compact::of(&kept.read()));
    }

    #[test]
    fn more_values_than_any_scenario_has_are_read_no_further() {
        let read = |count: usize| {
            serde_json::from_value::<Compact<Value>>(json!({"zz": vec![json!({"": 0}); count]}))
        };
        read(4_000).unwrap();
        let error = read(5_000).unwrap_err();
        assert!(error.to_string().contains("values"), "{error}");
    }
}
