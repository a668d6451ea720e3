//! YAML text -> a tree of [`Node`]s. The main function is [`parse`].
//!
//! Built from the events of `saphyr-parser` (YAML 1.2, no unsafe code) with a stack of its own, so that no input, however
//! nested, can exhaust the thread's stack. What a plain scalar means is `serde_yaml`'s decision. Anchors and aliases
//! work, within [`NODES`] nodes after expansion, so that a bomb of aliases is an error and not a full memory.

use std::{
    collections::{HashMap, hash_map::Entry as Slot},
    sync::Arc,
};

use saphyr_parser::{Event, Parser, ScalarStyle, ScanError};
use serde_yaml::Value;

use super::{
    diagnostic::{Code, Diagnostic, Diagnostics},
    source::{Source, Span, Spanned},
    tree::{Content, Entry, Node},
};

/// Longest text that is read: a matrix file of a thousand scenarios has some 50 kB.
pub const BYTES: usize = 1 << 20;
/// Deepest nesting.
const DEPTH: usize = 64;
/// Most nodes, with aliases expanded.
const NODES: usize = 50_000;

/// Reads one document.
///
/// # Errors
/// What stops the reading: no YAML, too deep, several documents; and every key that stands twice.
pub fn parse(source: &Arc<Source>) -> Result<Node, Diagnostics> {
    let (tree, twice) = parse_with_keys_twice(source)?;
    twice.unless_errors(tree).map(|(tree, _)| tree)
}

/// Reads one document, for which every other mistake in it is to be found too: of a key that stands twice the tree has
/// the first, and a diagnostic is beside it.
///
/// # Errors
/// What stops the reading: no YAML, too deep, several documents.
pub fn parse_with_keys_twice(source: &Arc<Source>) -> Result<(Node, Diagnostics), Diagnostics> {
    let mut builder = Builder::new(source);
    for event in Parser::new_from_str(source.text()) {
        let (event, span) = match event {
            Ok(event) => event,
            Err(error) => return Err(builder.fail(not_yaml(source, &builder.offsets, &error))),
        };
        let span = builder.offsets.span(span);
        if let Err(diagnostic) = builder.take(event, span) {
            return Err(builder.fail(*diagnostic));
        }
    }
    builder.finish()
}

/// The scanner counts characters, we count bytes.
struct Offsets(Vec<usize>);

impl Offsets {
    fn new(text: &str) -> Self {
        Self(
            text.char_indices()
                .map(|(at, _)| at)
                .chain(std::iter::once(text.len()))
                .collect(),
        )
    }

    fn byte(&self, character: usize) -> usize {
        self.0
            .get(character)
            .or(self.0.last())
            .copied()
            .unwrap_or_default()
    }

    fn span(&self, span: saphyr_parser::Span) -> Span {
        Span {
            start: self.byte(span.start.index()),
            end: self.byte(span.end.index()),
        }
    }
}

/// A list or mapping whose end has not come yet.
struct Open {
    start: usize,
    end: usize,
    anchor: usize,
    kind: OpenKind,
}

enum OpenKind {
    List(Vec<Node>),
    Mapping {
        entries: Vec<Entry>,
        key: Option<Spanned<String>>,
        seen: HashMap<String, Span>,
    },
}

struct Builder<'a> {
    source: &'a Arc<Source>,
    offsets: Offsets,
    stack: Vec<Open>,
    anchors: HashMap<usize, (Node, usize)>,
    nodes: usize,
    documents: usize,
    root: Option<Node>,
    problems: Diagnostics,
}

/// Boxed since it is large and rare.
type Taken = Result<(), Box<Diagnostic>>;

impl<'a> Builder<'a> {
    fn new(source: &'a Arc<Source>) -> Self {
        Self {
            source,
            offsets: Offsets::new(source.text()),
            stack: Vec::new(),
            anchors: HashMap::new(),
            nodes: 0,
            documents: 0,
            root: None,
            problems: Diagnostics::new(),
        }
    }

    fn error(&self, code: Code, span: Span, message: impl Into<String>) -> Diagnostic {
        Diagnostic::error(self.source, code, span, message)
    }

    /// What stopped the reading, after what was found before.
    fn fail(&mut self, diagnostic: Diagnostic) -> Diagnostics {
        self.problems.push(diagnostic);
        std::mem::take(&mut self.problems)
    }

    fn take(&mut self, event: Event<'_>, span: Span) -> Taken {
        match event {
            Event::Nothing | Event::StreamStart | Event::StreamEnd | Event::DocumentEnd => Ok(()),
            Event::DocumentStart(_) => self.document(span),
            Event::Scalar(text, style, anchor, tag) => {
                self.refuse_tag(tag.is_some(), span)?;
                self.value(scalar(&text, style, span), anchor)
            }
            Event::SequenceStart(anchor, tag) => {
                self.refuse_tag(tag.is_some(), span)?;
                self.open(span, anchor, OpenKind::List(Vec::new()))
            }
            Event::MappingStart(anchor, tag) => {
                self.refuse_tag(tag.is_some(), span)?;
                let kind = OpenKind::Mapping {
                    entries: Vec::new(),
                    key: None,
                    seen: HashMap::new(),
                };
                self.open(span, anchor, kind)
            }
            Event::SequenceEnd | Event::MappingEnd => self.close(span),
            Event::Alias(anchor) => self.alias(anchor, span),
        }
    }

    fn document(&mut self, span: Span) -> Taken {
        self.documents += 1;
        if self.documents > 1 {
            return Err(self
                .error(Code::NotYaml, span, "a second document begins here")
                .help("a matrix file is one document: take out the `---`, or write two files")
                .into());
        }
        Ok(())
    }

    fn refuse_tag(&self, tagged: bool, span: Span) -> Taken {
        if tagged {
            return Err(self
                .error(Code::NotYaml, span, "a YAML tag means nothing in a matrix file")
                .help("take out the word that begins with `!`; put quotes around a text that begins with it")
                .into());
        }
        Ok(())
    }

    fn open(&mut self, span: Span, anchor: usize, kind: OpenKind) -> Taken {
        if self.stack.len() >= DEPTH {
            return Err(self
                .error(
                    Code::TooLarge,
                    span,
                    format!("nested more than {DEPTH} levels deep"),
                )
                .label("one level too deep")
                .help("a matrix file needs about five levels; is this one?")
                .into());
        }
        self.count(1, span)?;
        self.stack.push(Open {
            start: span.start,
            end: span.end,
            anchor,
            kind,
        });
        Ok(())
    }

    fn close(&mut self, span: Span) -> Taken {
        let Some(open) = self.stack.pop() else {
            return Ok(());
        };
        // The end of a block comes with the next line: its last child says better where it ends.
        let flow = self.source.text().get(open.start..=open.start);
        let end = if matches!(flow, Some("[" | "{")) {
            span.end
        } else {
            open.end
        };
        let content = match open.kind {
            OpenKind::List(items) => Content::List(items),
            OpenKind::Mapping { entries, .. } => Content::Mapping(entries),
        };
        let span = Span {
            start: open.start,
            end: end.max(open.start),
        };
        self.put(Node { span, content }, open.anchor)
    }

    fn alias(&mut self, anchor: usize, span: Span) -> Taken {
        let Some((node, size)) = self.anchors.get(&anchor).cloned() else {
            return Err(self
                .error(Code::NotYaml, span, "this alias stands within its own anchor")
                .help("write the value out")
                .into());
        };
        self.count(size, span)?;
        self.put(node, 0)
    }

    fn count(&mut self, nodes: usize, span: Span) -> Taken {
        self.nodes = self.nodes.saturating_add(nodes);
        if self.nodes > NODES {
            return Err(self
                .error(
                    Code::TooLarge,
                    span,
                    format!("more than {NODES} values, aliases included"),
                )
                .help("a matrix file of a thousand scenarios has some hundred; is this one?")
                .into());
        }
        Ok(())
    }

    fn value(&mut self, node: Node, anchor: usize) -> Taken {
        self.count(1, node.span)?;
        self.put(node, anchor)
    }

    /// A finished node, into what is open.
    fn put(&mut self, mut node: Node, anchor: usize) -> Taken {
        if anchor != 0 {
            let size = size(&node);
            self.anchors.insert(anchor, (node.clone(), size));
        }
        let section = self.section().map(str::to_owned);
        let Some(open) = self.stack.last_mut() else {
            self.root = Some(node);
            return Ok(());
        };
        open.end = open.end.max(node.span.end);
        match &mut open.kind {
            OpenKind::List(items) => items.push(node),
            OpenKind::Mapping { entries, key, seen } => match key.take() {
                Some(key) => {
                    // `key:` with nothing behind it: the scanner places the nothing on the next line.
                    if node.is_null() && node.span.start == node.span.end {
                        node.span = key.span;
                    }
                    if seen.get(&key.value) == Some(&key.span) {
                        entries.push(Entry { key, value: node });
                    }
                }
                None => {
                    let Content::Scalar { text, .. } = &node.content else {
                        return Err(self
                            .error(Code::NotYaml, node.span, "a key must be a word")
                            .help("was `key: value` meant, or quotes?")
                            .into());
                    };
                    match seen.entry(text.clone()) {
                        Slot::Vacant(slot) => {
                            slot.insert(node.span);
                        }
                        Slot::Occupied(first) => {
                            let first = *first.get();
                            let diagnostic =
                                duplicate(self.source, section.as_deref(), text, first, node.span);
                            self.problems.push(diagnostic);
                        }
                    }
                    *key = Some(Spanned::new(text.clone(), node.span));
                }
            },
        }
        Ok(())
    }

    /// The section that the open mapping is itself, if it is one.
    fn section(&self) -> Option<&str> {
        match self.stack.as_slice() {
            [root, _] => match &root.kind {
                OpenKind::Mapping { key, .. } => key.as_ref().map(|key| key.value.as_str()),
                OpenKind::List(_) => None,
            },
            _ => None,
        }
    }

    fn finish(self) -> Result<(Node, Diagnostics), Diagnostics> {
        let at_start = Span::default();
        match self.root {
            Some(root) if !root.is_null() => Ok((root, self.problems)),
            _ => Err(
                Diagnostic::error(self.source, Code::Empty, at_start, "there is nothing in the file")
                    .help("begin with `matrix:`, as in `matrix: {virtualization: [native, docker]}`")
                    .into(),
            ),
        }
    }
}

fn duplicate(
    source: &Arc<Source>,
    section: Option<&str>,
    key: &str,
    first: Span,
    second: Span,
) -> Diagnostic {
    let line = source.place(first.start).line;
    let what = match section {
        Some("hosts") => "host",
        Some("matrix") => "axis",
        Some("profiles") => "profile",
        _ => "key",
    };
    let message = format!("the {what} `{key}` is here twice, first in line {line}");
    Diagnostic::error(source, Code::DuplicateKey, second, message)
        .label("again")
        .also(first, "first")
        .help("keep one of the two, or give this one another name")
}

fn size(node: &Node) -> usize {
    // The depth is bounded by `DEPTH`.
    1 + match &node.content {
        Content::Scalar { .. } => 0,
        Content::List(items) => items.iter().map(size).sum(),
        Content::Mapping(entries) => entries.iter().map(|entry| size(&entry.value)).sum(),
    }
}

/// Quoted text is text; what a plain scalar means, `serde_yaml` says.
fn scalar(text: &str, style: ScalarStyle, span: Span) -> Node {
    let plain = matches!(style, ScalarStyle::Plain);
    let value = plain
        .then(|| serde_yaml::from_str::<Value>(text).ok())
        .flatten()
        .filter(|value| !matches!(value, Value::Sequence(_) | Value::Mapping(_) | Value::Tagged(_)))
        .unwrap_or_else(|| Value::String(text.to_owned()));
    // An absent value arrives as `~`.
    let text = if span.start == span.end && text == "~" {
        ""
    } else {
        text
    };
    Node {
        span,
        content: Content::Scalar {
            text: text.to_owned(),
            value,
        },
    }
}

/// The scanner's words, with our proposal where the cause is a common one.
fn not_yaml(source: &Arc<Source>, offsets: &Offsets, error: &ScanError) -> Diagnostic {
    let at = offsets.byte(error.marker().index());
    let place = source.place(at);
    let line = source.line(place.line);
    let indent = line.len() - line.trim_start().len();
    let start = at
        - line
            .char_indices()
            .nth(place.column - 1)
            .map_or(line.len(), |(at, _)| at)
            .min(at);
    if let Some(tab) = line.get(..indent).and_then(|indent| indent.find('\t')) {
        let span = Span {
            start: start + tab,
            end: start + tab + 1,
        };
        return Diagnostic::error(
            source,
            Code::NotYaml,
            span,
            "YAML does not allow tabs for indentation",
        )
        .label("a tab")
        .help("indent with spaces, two for each level");
    }
    let span = Span {
        start: at,
        end: source
            .text()
            .get(at..)
            .and_then(|rest| rest.chars().next())
            .map_or(at, |c| at + c.len_utf8()),
    };
    let message = format!("this is not YAML: {}", error.info());
    let help = if line.trim_start().starts_with(['%', '@', '`', '*', '&', '!']) || line.contains(": *") {
        "put quotes around a text that begins with one of % @ ` * & !"
    } else {
        "look for a missing `:`, quote or bracket here and on the line before, and for uneven indentation"
    };
    Diagnostic::error(source, Code::NotYaml, span, message).help(help)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tree(text: &str) -> Result<Node, Diagnostics> {
        parse(&Arc::new(Source::new("f.yaml", text)))
    }

    fn text_at(text: &str, span: Span) -> &str {
        &text[span.range()]
    }

    #[test]
    fn every_node_knows_where_it_stands() {
        let text = "µ: x\nmatrix:\n  os: [ubuntu, 22.10]\n  other:\n  - 'a b'\n  - {k: v}\nend:\n";
        let root = tree(text).unwrap();
        let matrix = &root.entry("matrix").unwrap().value;
        let Content::List(values) = &matrix.entry("os").unwrap().value.content else {
            panic!("{root:?}")
        };
        assert_eq!(text_at(text, values[1].span), "22.10");
        assert_eq!(values[1].text(), Some("22.10"));
        assert_eq!(
            text_at(text, matrix.entry("os").unwrap().value.span),
            "[ubuntu, 22.10]"
        );
        let other = matrix.entry("other").unwrap();
        assert_eq!(text_at(text, other.key.span), "other");
        assert!(text_at(text, other.value.span).ends_with("'a b'\n  - {k: v}"));
        let Content::List(values) = &other.value.content else {
            panic!("{root:?}")
        };
        assert_eq!(text_at(text, values[0].span), "'a b'");
        assert!(root.entry("end").unwrap().value.is_null());
        assert_eq!(text_at(text, root.entry("end").unwrap().value.span), "end");
    }

    #[test]
    fn all_duplicate_keys_are_found_in_one_go() {
        let found = tree("a: 1\nb: {c: 1, c: 2}\na: 2\n").unwrap_err();
        assert_eq!(
            found.iter().map(|d| d.code).collect::<Vec<_>>(),
            [Code::DuplicateKey; 2]
        );
    }

    #[test]
    fn an_alias_is_what_its_anchor_is() {
        let root = tree("a: &x {k: v}\nb: *x\n").unwrap();
        assert_eq!(root.entry("a").unwrap().value, root.entry("b").unwrap().value);
    }

    #[test]
    fn a_bomb_of_aliases_is_an_error() {
        let mut text = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n".to_owned();
        for level in 1..20 {
            let before = format!("*a{}", level - 1);
            text += &format!("a{level}: &a{level} [{}]\n", [before.as_str(); 9].join(", "));
        }
        let found = tree(&text).unwrap_err();
        assert_eq!(found.iter().next().unwrap().code, Code::TooLarge);
    }

    #[test]
    fn nesting_is_an_error_before_it_is_a_stack_overflow() {
        for text in [
            "[".repeat(500_000),
            "- ".repeat(400_000),
            "a: {".repeat(200_000),
            "? ".repeat(400_000),
        ] {
            let found = tree(&text).unwrap_err();
            assert_eq!(found.iter().count(), 1);
        }
    }
}
