//! What is wrong with what a person wrote, where, and what to write instead. The main type is [`Diagnostic`].
//!
//! Every diagnostic shows the line and underlines the place, drawn by `annotate-snippets` as rustc draws its own.

use std::{error::Error, fmt, sync::Arc};

use annotate_snippets::{AnnotationKind, Group, Level, Renderer, Snippet};
use record::escaping::{harmless, harmless_line, is_unseen};
use schemars::JsonSchema;
use serde::Serialize;

use super::source::{Source, Span};

/// How bad it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// Nothing runs until it is mended.
    Error,
    /// It runs, though perhaps not as meant.
    Warning,
}

impl Severity {
    /// `error` or `warning`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Error => "error",
            Self::Warning => "warning",
        }
    }

    fn level(self) -> Level<'static> {
        match self {
            Self::Error => Level::ERROR,
            Self::Warning => Level::WARNING,
        }
    }
}

/// What kind of mistake it is, under a name that stays the same for programs that read it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Code {
    /// The file cannot be read at all.
    Unreadable,
    /// The file is larger or deeper than any matrix file.
    TooLarge,
    /// The file is not text in UTF-8.
    NotUtf8,
    /// The file is not YAML.
    NotYaml,
    /// There is nothing in it.
    Empty,
    /// The same key twice in one place.
    DuplicateKey,
    /// A key that means nothing there.
    UnknownKey,
    /// A key that must be there is not.
    MissingKey,
    /// A value of another kind than wanted.
    WrongType,
    /// A value that does not do: a wrong unit, out of range, or not fitting another setting.
    InvalidValue,
    /// None of the values that are known.
    UnknownValue,
    /// An axis without values.
    EmptyAxis,
    /// The same scenario twice.
    DuplicateScenario,
    /// An include that changes nothing.
    IdleInclude,
    /// An exclude that matches nothing.
    IdleExclude,
    /// An exclude that does not say why.
    NoReason,
    /// More scenarios than anybody measures.
    TooManyScenarios,
    /// A profile that is not in the file.
    UnknownProfile,
    /// `--only` or `--skip` with a pattern that matches nothing.
    EmptySelection,
    /// Samples too small for the tests to ever reject.
    NeverRejects,
    /// Something is said of a host that is not so.
    FalseClaim,
    /// A host that cannot be asked what it can do.
    SilentHost,
}

impl Code {
    /// Its name, such as `unknown-key`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Unreadable => "unreadable",
            Self::TooLarge => "too-large",
            Self::NotUtf8 => "not-utf8",
            Self::NotYaml => "not-yaml",
            Self::Empty => "empty",
            Self::DuplicateKey => "duplicate-key",
            Self::UnknownKey => "unknown-key",
            Self::MissingKey => "missing-key",
            Self::WrongType => "wrong-type",
            Self::InvalidValue => "invalid-value",
            Self::UnknownValue => "unknown-value",
            Self::EmptyAxis => "empty-axis",
            Self::DuplicateScenario => "duplicate-scenario",
            Self::IdleInclude => "idle-include",
            Self::IdleExclude => "idle-exclude",
            Self::NoReason => "no-reason",
            Self::TooManyScenarios => "too-many-scenarios",
            Self::UnknownProfile => "unknown-profile",
            Self::EmptySelection => "empty-selection",
            Self::NeverRejects => "never-rejects",
            Self::FalseClaim => "false-claim",
            Self::SilentHost => "silent-host",
        }
    }
}

/// A place and what is to be said of it.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Label {
    span: Span,
    text: String,
}

/// One mistake.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Diagnostic {
    /// How bad.
    pub severity: Severity,
    /// Of what kind.
    pub code: Code,
    /// What is wrong, in one sentence.
    pub message: String,
    /// What to write instead.
    pub help: Option<String>,
    source: Arc<Source>,
    label: Label,
    others: Vec<Label>,
}

/// A mistake in a matrix file or in a selection, as a program reads it.
#[derive(Debug, Serialize, JsonSchema)]
pub struct DiagnosticRecord<'a> {
    /// `error` or `warning`.
    pub severity: &'static str,
    /// The kind of mistake, a stable name such as `unknown-key`.
    pub code: &'static str,
    /// What is wrong, in one sentence.
    pub message: &'a str,
    /// The file, or the option, that it is in.
    pub file: &'a str,
    /// The line of the place, from 1.
    pub line: usize,
    /// The column of the place, from 1, in characters.
    pub column: usize,
    /// The line of the place's end, from 1.
    pub end_line: usize,
    /// The column of the place's end, from 1, in characters.
    pub end_column: usize,
    /// The line's text.
    pub text: String,
    /// The note at the marked place; may be empty.
    pub label: &'a str,
    /// What to write instead; null if nothing can be proposed.
    pub help: Option<&'a str>,
    /// Further places that have to do with it.
    pub others: Vec<OtherPlace<'a>>,
}

/// A further place that has to do with a mistake.
#[derive(Debug, Serialize, JsonSchema)]
pub struct OtherPlace<'a> {
    /// Its line, from 1.
    pub line: usize,
    /// Its column, from 1, in characters.
    pub column: usize,
    /// What to say of it.
    pub text: &'a str,
}

impl Diagnostic {
    /// An error at a place.
    pub fn error(source: &Arc<Source>, code: Code, span: Span, message: impl Into<String>) -> Self {
        Self {
            severity: Severity::Error,
            code,
            message: shortened(message.into()),
            help: None,
            source: Arc::clone(source),
            label: Label {
                span,
                text: String::new(),
            },
            others: Vec::new(),
        }
    }

    /// A warning at a place.
    pub fn warning(source: &Arc<Source>, code: Code, span: Span, message: impl Into<String>) -> Self {
        Self {
            severity: Severity::Warning,
            ..Self::error(source, code, span, message)
        }
    }

    /// With what stands under the place.
    #[must_use]
    pub fn label(mut self, text: impl Into<String>) -> Self {
        self.label.text = text.into();
        self
    }

    /// With another place that has to do with it.
    #[must_use]
    pub fn also(mut self, span: Span, text: impl Into<String>) -> Self {
        self.others.push(Label {
            span,
            text: text.into(),
        });
        self
    }

    /// With what to write instead.
    #[must_use]
    pub fn help(mut self, help: impl Into<String>) -> Self {
        self.help = Some(shortened(help.into()));
        self
    }

    /// The text that it is about.
    #[must_use]
    pub fn source_name(&self) -> &str {
        self.source.name()
    }

    /// Where it is in that text, in bytes.
    #[must_use]
    pub const fn span(&self) -> Span {
        self.label.span
    }

    /// As a person reads it, several lines without a newline at the end.
    #[must_use]
    pub fn render(&self, renderer: &Renderer) -> String {
        let labels = || std::iter::once(&self.label).chain(&self.others);
        let shown = self.source.lines_of(labels().map(|label| label.span));
        let text = self.source.text().get(shown.range()).unwrap_or_default();
        let range = |label: &Label| {
            let span = self.source.first_line_of(label.span);
            let place = |offset: usize| {
                let before = text.get(..offset.saturating_sub(shown.start));
                visibly(before.unwrap_or(text)).len()
            };
            place(span.start)..place(span.end)
        };
        let (text, path) = (visibly(text), harmless_line(self.source.name()));
        let others = self.others.iter();
        let others = others.map(|other| {
            AnnotationKind::Context
                .span(range(other))
                .label(other.text.as_str())
        });
        // Only the lines in question: the renderer's time goes with the text it is given.
        let snippet = Snippet::source(text)
            .path(path)
            .line_start(self.source.place(shown.start).line)
            .annotation(
                AnnotationKind::Primary
                    .span(range(&self.label))
                    .label(self.label.text.as_str()),
            )
            .annotations(others);
        // The title is ours, but parts of it come from the file: no control character may reach the terminal.
        // Nor any that ends the line: the next one could be a command for a runner of a CI system.
        let title = harmless_line(&self.message);
        let mut group = Group::with_title(self.severity.level().primary_title(title).id(self.code.name()))
            .element(snippet);
        if let Some(help) = &self.help {
            group = group.element(Level::HELP.message(harmless(help)));
        }
        renderer.render(&[group])
    }

    /// As a program reads it.
    #[must_use]
    pub fn to_json(&self) -> DiagnosticRecord<'_> {
        let from = self.source.place(self.label.span.start);
        let to = self.source.place(self.label.span.end);
        let others = self.others.iter().map(|other| {
            let place = self.source.place(other.span.start);
            OtherPlace {
                line: place.line,
                column: place.column,
                text: &other.text,
            }
        });
        DiagnosticRecord {
            severity: self.severity.name(),
            code: self.code.name(),
            message: &self.message,
            file: self.source.name(),
            line: from.line,
            column: from.column,
            end_line: to.line,
            end_column: to.column,
            text: shortened(self.source.line(from.line).to_owned()),
            label: &self.label.text,
            help: self.help.as_deref(),
            others: others.collect(),
        }
    }
}

/// A text as it is, but for letters that take no room, such as a zero-width space: a misspelling by one would show as none. Each is one
/// letter still, so that columns are those of the file. The renderer sees to control characters.
fn visibly(text: &str) -> String {
    let visibly = |character: char| match is_unseen(character) && !character.is_control() {
        true => char::REPLACEMENT_CHARACTER,
        false => character,
    };
    text.chars().map(visibly).collect()
}

/// Most mistakes of one severity that are kept; nobody reads more at a time.
const KEPT: usize = 50;

/// Most characters of a sentence: a word that is quoted from the file may be all of the file.
const SENTENCE: usize = 1000;

fn shortened(text: String) -> String {
    match text.char_indices().nth(SENTENCE) {
        Some((end, _)) => format!("{}…", text.get(..end).unwrap_or_default()),
        None => text,
    }
}

/// One or more mistakes, in the order of the text.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Diagnostics {
    kept: Vec<Diagnostic>,
    /// Mistakes beyond [`KEPT`].
    more: usize,
}

impl Diagnostics {
    /// None yet.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            kept: Vec::new(),
            more: 0,
        }
    }

    /// One more, unless the very same is there: profiles are read on top of the same file, and find its mistakes again.
    pub fn push(&mut self, diagnostic: Diagnostic) {
        if self.has_all_it_keeps(diagnostic.severity) {
            self.more += 1;
        } else if !self.kept.contains(&diagnostic) {
            self.kept.push(diagnostic);
        }
    }

    /// One more error, which is made only if it is kept: to look for what was meant takes long.
    pub fn push_error(&mut self, make: impl FnOnce() -> Diagnostic) {
        match self.has_all_it_keeps(Severity::Error) {
            true => self.more += 1,
            false => self.push(make()),
        }
    }

    /// Whether one more of that severity would only be counted.
    #[must_use]
    pub fn has_all_it_keeps(&self, severity: Severity) -> bool {
        let same = |known: &&Diagnostic| known.severity == severity;
        self.kept.iter().filter(same).count() >= KEPT
    }

    /// All of them.
    pub fn iter(&self) -> impl Iterator<Item = &Diagnostic> {
        self.kept.iter()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.kept.is_empty()
    }

    /// Whether one of them is an error.
    #[must_use]
    pub fn has_errors(&self) -> bool {
        self.kept
            .iter()
            .any(|diagnostic| diagnostic.severity == Severity::Error)
    }

    /// These if one of them is an error, `value` and the warnings if none is.
    ///
    /// # Errors
    /// These, in the order of the text.
    pub fn unless_errors<T>(mut self, value: T) -> Result<(T, Self), Self> {
        self.kept
            .sort_by_key(|diagnostic| (diagnostic.severity, diagnostic.label.span));
        if self.has_errors() {
            Err(self)
        } else {
            Ok((value, self))
        }
    }

    /// As a person reads them. [`Renderer::plain`] has no colours and says the same on every terminal.
    #[must_use]
    pub fn render(&self, renderer: &Renderer) -> String {
        let mut rendered: Vec<_> = self
            .iter()
            .map(|diagnostic| diagnostic.render(renderer))
            .collect();
        if self.more > 0 {
            rendered.push(format!("and {} more", self.more));
        }
        rendered.join("\n\n")
    }

    /// As a program reads them: a list.
    #[must_use]
    pub fn to_json(&self) -> Vec<DiagnosticRecord<'_>> {
        self.kept.iter().map(Diagnostic::to_json).collect()
    }
}

impl Extend<Diagnostic> for Diagnostics {
    fn extend<I: IntoIterator<Item = Diagnostic>>(&mut self, diagnostics: I) {
        for diagnostic in diagnostics {
            self.push(diagnostic);
        }
    }
}

impl IntoIterator for Diagnostics {
    type Item = Diagnostic;
    type IntoIter = std::vec::IntoIter<Diagnostic>;

    fn into_iter(self) -> Self::IntoIter {
        self.kept.into_iter()
    }
}

impl From<Diagnostic> for Diagnostics {
    fn from(diagnostic: Diagnostic) -> Self {
        Self {
            kept: vec![diagnostic],
            more: 0,
        }
    }
}

impl fmt::Display for Diagnostics {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.render(&Renderer::plain()))
    }
}

impl Error for Diagnostics {}
