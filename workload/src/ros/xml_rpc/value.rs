//! What XML-RPC can carry. The main types are [`Value`] and [`Params`].

use std::collections::BTreeMap;

/// One value.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::ros) enum Value {
    Int(i32),
    Bool(bool),
    Double(f64),
    Text(String),
    /// Kept as it was written, since only the parameter server passes it on.
    DateTime(String),
    /// Kept as it was written, likewise.
    Base64(String),
    /// Python's extension.
    Nil,
    Array(Vec<Value>),
    Struct(BTreeMap<String, Value>),
}

/// A value of another kind than the method takes.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{what} should be {wanted}")]
pub(in crate::ros) struct ValueError {
    pub what: String,
    pub wanted: &'static str,
}

impl Value {
    pub fn as_text(&self) -> Option<&str> {
        match self {
            Self::Text(text) => Some(text),
            _ => None,
        }
    }

    pub fn as_array(&self) -> Option<&[Value]> {
        match self {
            Self::Array(values) => Some(values),
            _ => None,
        }
    }

    /// A list of texts, such as the addresses of publishers.
    pub fn as_texts(&self) -> Option<Vec<String>> {
        let values = self.as_array()?;
        values
            .iter()
            .map(|value| value.as_text().map(str::to_owned))
            .collect()
    }

    /// The empty struct, by which the parameter server says that there is nothing.
    pub const fn nothing() -> Self {
        Self::Struct(BTreeMap::new())
    }
}

impl From<i32> for Value {
    fn from(number: i32) -> Self {
        Self::Int(number)
    }
}

impl From<bool> for Value {
    fn from(truth: bool) -> Self {
        Self::Bool(truth)
    }
}

impl From<&str> for Value {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

impl From<String> for Value {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

impl<T: Into<Value>> From<Vec<T>> for Value {
    fn from(values: Vec<T>) -> Self {
        Self::Array(values.into_iter().map(Into::into).collect())
    }
}

/// The parameters of a call, taken by position.
#[derive(Debug, Clone, Copy)]
pub(in crate::ros) struct Params<'a>(pub &'a [Value]);

impl<'a> Params<'a> {
    pub fn value(self, position: usize, what: &str) -> Result<&'a Value, ValueError> {
        self.0.get(position).ok_or_else(|| ValueError {
            what: what.to_owned(),
            wanted: "given",
        })
    }

    pub fn text(self, position: usize, what: &str) -> Result<&'a str, ValueError> {
        let text = self.value(position, what)?.as_text();
        text.ok_or_else(|| ValueError {
            what: what.to_owned(),
            wanted: "a string",
        })
    }

    pub fn array(self, position: usize, what: &str) -> Result<&'a [Value], ValueError> {
        let array = self.value(position, what)?.as_array();
        array.ok_or_else(|| ValueError {
            what: what.to_owned(),
            wanted: "an array",
        })
    }

    pub fn texts(self, position: usize, what: &str) -> Result<Vec<String>, ValueError> {
        let texts = self.value(position, what)?.as_texts();
        texts.ok_or_else(|| ValueError {
            what: what.to_owned(),
            wanted: "an array of strings",
        })
    }
}
