//! The serde deserializer over a tree. The main type is [`Reader`].

use std::collections::HashSet;

use serde::{
    de::{
        self, DeserializeSeed, Deserializer, EnumAccess, IntoDeserializer, MapAccess, SeqAccess,
        VariantAccess, Visitor, value::StrDeserializer,
    },
    forward_to_deserialize_any,
};
use serde_yaml::Value;

use super::{TypeError, Wrong};
use crate::matrix_file::{
    source::Span,
    spelling::list,
    tree::{Content, Entry, Node},
};

/// Reads a node, without the entries that were found wrong before.
#[derive(Clone, Copy)]
pub(super) struct Reader<'a> {
    node: &'a Node,
    left_out: &'a HashSet<Span>,
}

impl<'a> Reader<'a> {
    /// Reads `node` without the entries whose keys stand at the places `left_out`.
    pub(super) const fn new(node: &'a Node, left_out: &'a HashSet<Span>) -> Self {
        Self { node, left_out }
    }

    fn of(self, node: &'a Node) -> Self {
        Self { node, ..self }
    }

    fn visit<'de, V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, TypeError> {
        let visited = match &self.node.content {
            Content::Scalar { text, value } => visit_scalar(text, value, visitor),
            Content::List(items) => self.visit_list(items, visitor),
            Content::Mapping(entries) => visitor
                .visit_map(Entries {
                    reader: self,
                    entries: entries.iter(),
                    value: None,
                })
                .map_err(|error| self.mark_what_follows(error)),
        };
        visited.map_err(|error| error.at(self.node.span))
    }

    fn visit_list<'de, V: Visitor<'de>>(self, items: &[Node], visitor: V) -> Result<V::Value, TypeError> {
        let mut items = Items {
            reader: self,
            items: items.iter(),
        };
        let visited = visitor.visit_seq(&mut items)?;
        match items.items.next() {
            None => Ok(visited),
            Some(more) => Err(TypeError::from(Wrong::TooMany).at(more.span)),
        }
    }

    /// A key that is missing because it was left out is no error of its own.
    fn mark_what_follows(self, mut error: TypeError) -> TypeError {
        if let (Wrong::MissingKey(key), None) = (&error.wrong, error.span) {
            let entry = self.node.entry(key);
            error.follows = entry.is_some_and(|entry| self.left_out.contains(&entry.key.span));
        }
        error
    }
}

fn visit_scalar<'de, V: Visitor<'de>>(text: &str, value: &Value, visitor: V) -> Result<V::Value, TypeError> {
    match value {
        Value::Null => visitor.visit_unit(),
        Value::Bool(value) => visitor.visit_bool(*value),
        Value::Number(number) => match (number.as_u64(), number.as_i64(), number.as_f64()) {
            (Some(number), _, _) => visitor.visit_u64(number),
            (_, Some(number), _) => visitor.visit_i64(number),
            (_, _, Some(number)) => visitor.visit_f64(number),
            _ => visitor.visit_str(text),
        },
        _ => visitor.visit_str(text),
    }
}

impl<'de> Deserializer<'de> for Reader<'_> {
    type Error = TypeError;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, TypeError> {
        self.visit(visitor)
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, TypeError> {
        if self.node.is_null() {
            visitor.visit_none()
        } else {
            visitor.visit_some(self)
        }
    }

    // Where text is wanted, `22.10` is text.
    fn deserialize_str<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, TypeError> {
        match self.node.text() {
            Some(text) => visitor
                .visit_str(text)
                .map_err(|error: TypeError| error.at(self.node.span)),
            None => self.visit(visitor),
        }
    }

    fn deserialize_string<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, TypeError> {
        self.deserialize_str(visitor)
    }

    // A section with nothing in it is one without settings.
    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, TypeError> {
        if self.node.is_null() {
            let empty = Node::empty_mapping(self.node.span);
            return self.of(&empty).visit(visitor);
        }
        self.visit(visitor)
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        visitor: V,
    ) -> Result<V::Value, TypeError> {
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _: &'static str,
        variants: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, TypeError> {
        let variant = match &self.node.content {
            Content::Scalar { text, .. } if self.node.text().is_some() => Variant {
                reader: self,
                name: text,
                name_span: self.node.span,
                value: None,
            },
            Content::Mapping(entries) => match entries.as_slice() {
                [entry] => Variant {
                    reader: self,
                    name: &entry.key.value,
                    name_span: entry.key.span,
                    value: Some(&entry.value),
                },
                _ => return Err(self.not_a_variant(variants)),
            },
            _ => return Err(self.not_a_variant(variants)),
        };
        visitor
            .visit_enum(variant)
            .map_err(|error| error.at(self.node.span))
    }

    forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char bytes byte_buf unit unit_struct seq tuple
        tuple_struct map identifier ignored_any
    }
}

impl Reader<'_> {
    fn not_a_variant(self, variants: &[&str]) -> TypeError {
        TypeError::from(Wrong::Type {
            found: self.node.describe(),
            wanted: format!("one of {}", list(variants.iter().copied())),
        })
        .at(self.node.span)
    }
}

struct Items<'a> {
    reader: Reader<'a>,
    items: std::slice::Iter<'a, Node>,
}

impl<'de> SeqAccess<'de> for Items<'_> {
    type Error = TypeError;

    fn next_element_seed<T: DeserializeSeed<'de>>(&mut self, seed: T) -> Result<Option<T::Value>, TypeError> {
        self.items
            .next()
            .map(|item| {
                seed.deserialize(self.reader.of(item))
                    .map_err(|error| error.at(item.span))
            })
            .transpose()
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.items.len())
    }
}

struct Entries<'a> {
    reader: Reader<'a>,
    entries: std::slice::Iter<'a, Entry>,
    value: Option<&'a Entry>,
}

impl<'de> MapAccess<'de> for Entries<'_> {
    type Error = TypeError;

    fn next_key_seed<K: DeserializeSeed<'de>>(&mut self, seed: K) -> Result<Option<K::Value>, TypeError> {
        let left_out = self.reader.left_out;
        let Some(entry) = self.entries.find(|entry| !left_out.contains(&entry.key.span)) else {
            return Ok(None);
        };
        self.value = Some(entry);
        let key: StrDeserializer<'_, TypeError> = entry.key.value.as_str().into_deserializer();
        seed.deserialize(key)
            .map(Some)
            .map_err(|error| error.at(entry.key.span).within(entry.key.span))
    }

    fn next_value_seed<V: DeserializeSeed<'de>>(&mut self, seed: V) -> Result<V::Value, TypeError> {
        let Some(entry) = self.value.take() else {
            return Err(de::Error::custom("a value was asked for before its key"));
        };
        seed.deserialize(self.reader.of(&entry.value))
            .map_err(|error| error.at(entry.value.span).within(entry.key.span))
    }
}

struct Variant<'a> {
    reader: Reader<'a>,
    name: &'a str,
    name_span: Span,
    value: Option<&'a Node>,
}

impl<'de, 'a> EnumAccess<'de> for Variant<'a> {
    type Error = TypeError;
    type Variant = VariantBody<'a>;

    fn variant_seed<V: DeserializeSeed<'de>>(
        self,
        seed: V,
    ) -> Result<(V::Value, VariantBody<'a>), TypeError> {
        let name: StrDeserializer<'_, TypeError> = self.name.into_deserializer();
        let variant = seed.deserialize(name).map_err(|error| error.at(self.name_span))?;
        let body = VariantBody {
            reader: self.reader,
            value: self.value,
        };
        Ok((variant, body))
    }
}

struct VariantBody<'a> {
    reader: Reader<'a>,
    value: Option<&'a Node>,
}

impl VariantBody<'_> {
    fn wrong<T>(&self, wanted: &str) -> Result<T, TypeError> {
        let node = self.value.unwrap_or(self.reader.node);
        let wrong = Wrong::Type {
            found: node.describe(),
            wanted: wanted.to_owned(),
        };
        Err(TypeError::from(wrong).at(node.span))
    }
}

impl<'de> VariantAccess<'de> for VariantBody<'_> {
    type Error = TypeError;

    fn unit_variant(self) -> Result<(), TypeError> {
        match self.value {
            None => Ok(()),
            Some(value) if value.is_null() => Ok(()),
            Some(_) => self.wrong("the word alone"),
        }
    }

    fn newtype_variant_seed<T: DeserializeSeed<'de>>(self, seed: T) -> Result<T::Value, TypeError> {
        match self.value {
            Some(value) => seed.deserialize(self.reader.of(value)),
            None => self.wrong("the word with a value behind it"),
        }
    }

    fn tuple_variant<V: Visitor<'de>>(self, _: usize, visitor: V) -> Result<V::Value, TypeError> {
        match self.value {
            Some(value) => self.reader.of(value).visit(visitor),
            None => self.wrong("the word with a list behind it"),
        }
    }

    fn struct_variant<V: Visitor<'de>>(
        self,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, TypeError> {
        match self.value {
            Some(value) => self.reader.of(value).visit(visitor),
            None => self.wrong("the word with keys and values behind it"),
        }
    }
}
