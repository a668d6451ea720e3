//! A value that knows where it stands in the text, and all it holds. The main type is [`Node`].

use std::collections::HashMap;

use serde_yaml::Value;

use super::source::{Span, Spanned};

/// A value and where it stands.
#[derive(Debug, Clone, PartialEq)]
pub struct Node {
    /// Where; for `key:` with nothing behind it, where the key stands.
    pub span: Span,
    pub content: Content,
}

/// What a node is.
#[derive(Debug, Clone, PartialEq)]
pub enum Content {
    /// Text, number, boolean or null.
    Scalar {
        /// As it is written, without quotes.
        text: String,
        /// What YAML makes of it; never a list or a mapping.
        value: Value,
    },
    /// A list.
    List(Vec<Node>),
    /// Keys with values, no key twice.
    Mapping(Vec<Entry>),
}

/// One key with its value.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// The key, as text.
    pub key: Spanned<String>,
    /// The value.
    pub value: Node,
}

impl Node {
    /// An empty mapping at a place.
    #[must_use]
    pub const fn empty_mapping(span: Span) -> Self {
        Self {
            span,
            content: Content::Mapping(Vec::new()),
        }
    }

    /// A value that stands nowhere.
    #[must_use]
    pub fn of_json(json: &serde_json::Value) -> Self {
        let scalar = |text: String, value| Content::Scalar { text, value };
        let content = match json {
            serde_json::Value::Array(items) => Content::List(items.iter().map(Self::of_json).collect()),
            serde_json::Value::Object(entries) => Content::Mapping(
                entries
                    .iter()
                    .map(|(key, value)| Entry {
                        key: Spanned::new(key.clone(), Span::default()),
                        value: Self::of_json(value),
                    })
                    .collect(),
            ),
            serde_json::Value::Null => scalar(String::new(), Value::Null),
            serde_json::Value::Bool(value) => scalar(value.to_string(), Value::Bool(*value)),
            serde_json::Value::String(text) => scalar(text.clone(), Value::String(text.clone())),
            number @ serde_json::Value::Number(_) => {
                let text = number.to_string();
                let value = serde_yaml::from_str(&text).unwrap_or(Value::Null);
                scalar(text, value)
            }
        };
        Self {
            span: Span::default(),
            content,
        }
    }

    /// The entries of a mapping; of anything else, none.
    #[must_use]
    pub fn entries(&self) -> &[Entry] {
        match &self.content {
            Content::Mapping(entries) => entries,
            _ => &[],
        }
    }

    /// The entry of a key in a mapping.
    #[must_use]
    pub fn entry(&self, key: &str) -> Option<&Entry> {
        self.entries().iter().find(|entry| entry.key.value == key)
    }

    /// The text of a scalar that is not null.
    #[must_use]
    pub fn text(&self) -> Option<&str> {
        match &self.content {
            Content::Scalar {
                value: Value::Null, ..
            } => None,
            Content::Scalar { text, .. } => Some(text),
            _ => None,
        }
    }

    /// Whether nothing is written, or `null` or `~`.
    #[must_use]
    pub fn is_null(&self) -> bool {
        matches!(
            &self.content,
            Content::Scalar {
                value: Value::Null,
                ..
            }
        )
    }

    /// What a person would call it.
    #[must_use]
    pub fn describe(&self) -> String {
        match &self.content {
            Content::Scalar {
                value: Value::Null, ..
            } => "nothing".to_owned(),
            Content::Scalar { text, value } => match value {
                Value::Bool(_) | Value::Number(_) => format!("`{text}`"),
                _ => format!("the text `{text}`"),
            },
            Content::List(_) => "a list".to_owned(),
            Content::Mapping(entries) if entries.is_empty() => "nothing".to_owned(),
            Content::Mapping(_) => "keys with values".to_owned(),
        }
    }

    /// The entry that a dotted path leads to.
    #[must_use]
    pub fn entry_at(&self, path: &str) -> Option<&Entry> {
        let (first, rest) = path.split_once('.').unwrap_or((path, ""));
        // An axis in `report.baseline` has dots in its name: a key that is all of the rest comes first.
        self.entry(path).or_else(|| {
            let entry = self.entry(first).filter(|_| !rest.is_empty())?;
            entry.value.entry_at(rest)
        })
    }

    /// Where the node stands that a dotted path leads to, or the longest part of the path that stands anywhere: of what
    /// holds others the key, which is what a person looks for. Items of lists are named by their places, from 0.
    #[must_use]
    pub fn locate(&self, path: &str) -> Option<Span> {
        let prefixes = path
            .match_indices('.')
            .map(|(at, _)| path.get(..at).unwrap_or(path));
        let prefixes: Vec<_> = prefixes.chain(std::iter::once(path)).collect();
        let mut spans = prefixes.iter().rev().filter_map(|prefix| self.span_at(prefix));
        spans.find(|span| *span != Span::default())
    }

    /// Whether what a dotted path leads to is written.
    #[must_use]
    pub fn stands(&self, path: &str) -> bool {
        self.span_at(path).is_some_and(|span| span != Span::default())
    }

    fn span_at(&self, path: &str) -> Option<Span> {
        if let Some(entry) = self.entry_at(path) {
            return Some(match entry.value.text() {
                Some(_) => entry.value.span,
                None => entry.key.span,
            });
        }
        // The longest part that is an entry has a list, of which the next word is an item's place.
        let (list, rest) = path
            .match_indices('.')
            .rev()
            .filter_map(|(at, _)| Some((self.entry_at(path.get(..at)?)?, path.get(at + 1..)?)))
            .next()?;
        let Content::List(items) = &list.value.content else {
            return None;
        };
        let (place, rest) = rest.split_once('.').unwrap_or((rest, ""));
        let item = items.get(place.parse::<usize>().ok()?)?;
        match rest {
            "" => Some(item.span),
            rest => item.span_at(rest),
        }
    }

    /// Puts a node where a dotted path leads, making the mappings on the way.
    pub fn insert(&mut self, path: &str, key_span: Span, value: Node) {
        let (key, rest) = path
            .split_once('.')
            .map_or((path, None), |(key, rest)| (key, Some(rest)));
        if !matches!(self.content, Content::Mapping(_)) {
            self.content = Content::Mapping(Vec::new());
        }
        let Content::Mapping(entries) = &mut self.content else {
            return;
        };
        let entry = match entries.iter().position(|entry| entry.key.value == key) {
            Some(at) => entries.get_mut(at),
            None => {
                entries.push(Entry {
                    key: Spanned::new(key.to_owned(), key_span),
                    value: Node::empty_mapping(key_span),
                });
                entries.last_mut()
            }
        };
        if let Some(entry) = entry {
            match rest {
                Some(rest) => entry.value.insert(rest, key_span, value),
                None => {
                    entry.key.span = key_span;
                    entry.value = value;
                }
            }
        }
    }

    /// Lays `over` on top: mappings are merged key by key, everything else is replaced.
    pub fn overlay(&mut self, over: &Node) {
        match (&mut self.content, &over.content) {
            (Content::Mapping(entries), Content::Mapping(overs)) => {
                // A file may have ten thousand keys, none of them right.
                let known: HashMap<String, usize> = (0..)
                    .zip(entries.iter())
                    .map(|(at, entry)| (entry.key.value.clone(), at))
                    .collect();
                for over in overs {
                    let at = known.get(&over.key.value);
                    match at.and_then(|at| entries.get_mut(*at)) {
                        Some(entry) => {
                            entry.key.span = over.key.span;
                            entry.value.overlay(&over.value);
                        }
                        None => entries.push(over.clone()),
                    }
                }
            }
            _ => *self = over.clone(),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::matrix_file::{source::Source, yaml};

    fn tree(text: &str) -> Node {
        yaml::parse(&Arc::new(Source::new("f.yaml", text))).unwrap()
    }

    #[test]
    fn an_overlay_replaces_what_it_names_and_keeps_the_rest() {
        let mut root = tree("a: {b: 1, c: [1, 2]}\nd: 1\n");
        root.overlay(&tree("a: {c: [3]}\ne: 2\n"));
        let a = &root.entry("a").unwrap().value;
        assert_eq!(a.entry("b").unwrap().value.text(), Some("1"));
        assert!(matches!(&a.entry("c").unwrap().value.content, Content::List(items) if items.len() == 1));
        assert!(root.entry("d").is_some() && root.entry("e").is_some());
    }

    #[test]
    fn a_path_is_located_as_far_as_it_goes() {
        let text = "report:\n  baseline: {network.loss: 1%}\n  alpha: 0.1\n";
        let root = tree(text);
        let at = |path| root.locate(path).map(|span| &text[span.range()]);
        assert_eq!(at("report.alpha"), Some("0.1"));
        assert_eq!(at("report.baseline.network.loss"), Some("1%"));
        assert_eq!(at("report.baseline.os"), Some("baseline"));
        assert_eq!(at("report.figures"), Some("report"));
        assert_eq!(at("workload.window"), None);
    }
}
