//! Where the settings stand that a person wrote. The main type is [`Places`].

use std::sync::Arc;

use super::{
    source::{Source, Span},
    tree::{Content, Node},
};

/// A text and what stands where in it.
#[derive(Clone, Copy)]
pub(crate) struct Places<'a> {
    /// The text.
    pub(crate) source: &'a Arc<Source>,
    pub(super) tree: &'a Node,
}

impl Places<'_> {
    /// Where a dotted path stands, or the longest part of it that does; else the beginning.
    pub(crate) fn of(&self, path: &str) -> Span {
        self.tree.locate(path).unwrap_or_default()
    }

    /// Where the key stands that a dotted path leads to, or the longest part of it that does; else the beginning.
    pub(crate) fn of_key(&self, path: &str) -> Span {
        let key = self.tree.entry_at(path).map(|entry| entry.key.span);
        key.unwrap_or_else(|| self.of(path))
    }

    /// Where a text stands in the lists that a dotted path leads to; else where the path does.
    pub(crate) fn of_item(&self, path: &str, text: &str) -> Span {
        let entry = self.tree.entry_at(path);
        let item = entry.and_then(|entry| item(&entry.value, text));
        item.unwrap_or_else(|| self.of(path))
    }
}

fn item(node: &Node, text: &str) -> Option<Span> {
    match &node.content {
        Content::List(items) => items.iter().find_map(|it| item(it, text)),
        _ => (node.text() == Some(text)).then_some(node.span),
    }
}
