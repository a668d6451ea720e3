//! A text and the places in it. The main types are [`Source`] and [`Span`].

use std::ops::Range;

/// A text that a person wrote, with the name under which that person knows it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Source {
    name: String,
    text: String,
    /// Byte offset at which each line begins.
    lines: Vec<usize>,
}

/// A stretch of a source, in bytes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Span {
    /// Where it begins.
    pub start: usize,
    /// Where it has ended.
    pub end: usize,
}

impl Span {
    /// As a range.
    #[must_use]
    pub const fn range(self) -> Range<usize> {
        self.start..self.end
    }
}

/// A place as editors count: both from 1, columns in characters.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Place {
    /// From 1.
    pub line: usize,
    /// From 1, in characters.
    pub column: usize,
}

/// A value and where it stands.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Spanned<T> {
    /// The value.
    pub value: T,
    /// Where.
    pub span: Span,
}

impl<T> Spanned<T> {
    /// `value`, which stands at `span`.
    pub const fn new(value: T, span: Span) -> Self {
        Self { value, span }
    }
}

impl Source {
    /// A text under a name.
    pub fn new(name: impl Into<String>, text: impl Into<String>) -> Self {
        let text = text.into();
        let lines = std::iter::once(0)
            .chain(text.match_indices('\n').map(|(at, _)| at + 1))
            .collect();
        Self {
            name: name.into(),
            text,
            lines,
        }
    }

    /// A file's name, or an option's.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// All of it.
    #[must_use]
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Line and column of a byte offset. One that is out of the text or within a character counts as the nearest
    /// character before it.
    #[must_use]
    pub fn place(&self, offset: usize) -> Place {
        let offset = self.floor(offset);
        let line = self.lines.partition_point(|start| *start <= offset).max(1);
        let start = self.lines.get(line - 1).copied().unwrap_or(0);
        let column = self
            .text
            .get(start..offset)
            .map_or(0, |before| before.chars().count())
            + 1;
        Place { line, column }
    }

    /// What can be underlined of a span: its first line, without what is blank at the end, in whole characters.
    #[must_use]
    pub fn first_line_of(&self, span: Span) -> Span {
        let start = self.floor(span.start);
        let end = self.floor(span.end.max(start));
        let text = self.text.get(start..end).unwrap_or_default();
        let line = text.split('\n').next().unwrap_or_default().trim_end();
        Span {
            start,
            end: start + line.len(),
        }
    }

    /// The whole lines on which spans begin, and all between them.
    #[must_use]
    pub fn lines_of(&self, spans: impl Iterator<Item = Span>) -> Span {
        let lines: Vec<_> = spans.map(|span| self.place(span.start).line).collect();
        let first = lines.iter().min().copied().unwrap_or(1);
        let last = lines.iter().max().copied().unwrap_or(1);
        Span {
            start: self.lines.get(first - 1).copied().unwrap_or_default(),
            end: self.lines.get(last).copied().unwrap_or(self.text.len()),
        }
    }

    /// The text of a line, counted from 1.
    #[must_use]
    pub fn line(&self, line: usize) -> &str {
        let start = self.lines.get(line.saturating_sub(1)).copied();
        let rest = start.and_then(|start| self.text.get(start..));
        rest.and_then(|rest| rest.lines().next()).unwrap_or_default()
    }

    fn floor(&self, offset: usize) -> usize {
        let mut offset = offset.min(self.text.len());
        while !self.text.is_char_boundary(offset) {
            offset -= 1;
        }
        offset
    }
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    #[rstest]
    #[case::the_beginning(0, 1, 1)]
    #[case::within_a_line(2, 1, 3)]
    #[case::a_new_line_ends_its_line(3, 1, 4)]
    #[case::the_next_line(4, 2, 1)]
    #[case::columns_are_characters(6, 2, 2)]
    #[case::within_a_character(5, 2, 1)]
    #[case::the_end(7, 2, 3)]
    #[case::beyond_the_end(99, 2, 3)]
    fn places_are_counted_as_editors_do(#[case] offset: usize, #[case] line: usize, #[case] column: usize) {
        assert_eq!(Source::new("f", "abc\nµx").place(offset), Place { line, column });
    }

    #[test]
    fn only_the_first_line_of_a_span_is_underlined() {
        let source = Source::new("f", "a: [1,  \n 2]\n");
        assert_eq!(
            source.first_line_of(Span { start: 3, end: 12 }),
            Span { start: 3, end: 6 }
        );
        assert_eq!(source.line(2), " 2]");
    }
}
