//! The `matrix:` section: axes, excludes and includes as they are written. The main type is [`Axes`].
//!
//! What they expand to is the plan's matter.

use std::{
    collections::{HashMap, HashSet},
    sync::Arc,
};

use record::{axis::NODE, run_directory::PlanRecord};
use wildmatch::WildMatch;

use super::{
    diagnostic::{Code, Diagnostic, Diagnostics},
    source::{Source, Span, Spanned},
    spelling::{did_you_mean, propose},
    sweep::{Role, known_axes},
    tree::{Content, Node},
    typing,
};
use crate::provider::Catalogue;

/// The section.
#[derive(Debug, Clone, PartialEq)]
pub struct Axes {
    /// The axes in the order of the file, the slowest first.
    pub axes: Vec<Axis>,
    /// Combinations that are not run.
    pub excludes: Vec<Exclude>,
    /// Combinations that are added, or additions to combinations.
    pub includes: Vec<Include>,
    /// Where the section stands.
    pub span: Span,
}

/// One axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Axis {
    /// The axis as the file names it.
    pub name: Spanned<String>,
    /// Its values, at least one, none twice.
    pub values: Vec<AxisValue>,
}

/// A value of an axis, with the spelling that it has in the file: `22.10` stays `22.10`.
#[derive(Debug, Clone, PartialEq)]
pub struct AxisValue {
    /// As it is written.
    pub text: String,
    /// As it stands in the file, for a setting that is swept.
    pub node: Node,
}

impl AxisValue {
    /// A value that stands nowhere in the file, such as one that a host gives.
    #[must_use]
    pub fn word(text: &str) -> Self {
        Self {
            text: text.to_owned(),
            node: Node {
                span: Span::default(),
                content: Content::Scalar {
                    text: text.to_owned(),
                    value: serde_yaml::Value::String(text.to_owned()),
                },
            },
        }
    }
}

/// `axis: value` in an include.
#[derive(Debug, Clone, PartialEq)]
pub struct Assignment {
    /// The axis.
    pub axis: Spanned<String>,
    /// The value.
    pub value: AxisValue,
}

/// `axis: value` or `axis: [value, …]` in an exclude. A value may have `*` and `?`.
#[derive(Debug, Clone, PartialEq)]
pub struct Condition {
    /// The axis.
    pub axis: Spanned<String>,
    /// The values, at least one.
    pub values: Vec<AxisValue>,
    /// Those that stand for themselves alone.
    plain: HashSet<String>,
    /// The others.
    patterns: Vec<WildMatch>,
    /// How long all patterns together are.
    pattern_letters: usize,
}

impl Condition {
    fn new(axis: Spanned<String>, values: Vec<AxisValue>) -> Self {
        let texts = || values.iter().map(|value| value.text.as_str());
        let patterns = || texts().filter(|text| is_pattern(text));
        Self {
            plain: texts()
                .filter(|text| !is_pattern(text))
                .map(str::to_owned)
                .collect(),
            patterns: patterns().map(WildMatch::new).collect(),
            pattern_letters: patterns().map(str::len).sum(),
            axis,
            values,
        }
    }

    /// Whether one of the values is that one, or fits it.
    #[must_use]
    pub fn fits(&self, value: &str) -> bool {
        self.plain.contains(value) || self.patterns.iter().any(|pattern| pattern.matches(value))
    }

    /// How many letters are compared at most to see whether a value fits: in the worst case, each of a pattern with each of the value.
    #[must_use]
    pub const fn letters_compared(&self, value: &str) -> usize {
        self.pattern_letters.saturating_mul(value.len())
    }

    /// The values that stand for themselves alone.
    pub fn plain(&self) -> impl Iterator<Item = &AxisValue> {
        self.values.iter().filter(|value| !is_pattern(&value.text))
    }
}

fn is_pattern(text: &str) -> bool {
    text.contains(['*', '?'])
}

/// Combinations that are not run: those that fit all of these conditions.
#[derive(Debug, Clone, PartialEq)]
pub struct Exclude {
    /// The conditions, each on another axis.
    pub conditions: Vec<Condition>,
    /// The reason that the file gives, for the plan and the report.
    pub reason: Option<String>,
    /// Where it stands.
    pub span: Span,
}

/// Values that are added to the combinations they fit, or a combination of their own.
#[derive(Debug, Clone, PartialEq)]
pub struct Include {
    /// The values.
    pub values: Vec<Assignment>,
    /// Where it stands.
    pub span: Span,
}

/// More scenarios than these are a mistake: at the paper's settings a thousand take nine months.
pub const SCENARIOS: usize = PlanRecord::MOST_SCENARIOS;
/// What to do about too many.
pub const FEWER: &str = "take values away, or write several matrix files";

/// The names that are no axes in this section.
const EXCLUDE: &str = "exclude";
const INCLUDE: &str = "include";
const REASON: &str = "reason";
const LABELS: &str = "labels";
/// A value or a pattern that a person writes is no longer, in bytes.
const LONGEST_VALUE: usize = 1000;
/// So many values of an axis are repeated in a proposal.
const REPEATED: usize = 8;

/// Reads the section for these providers. What is wrong goes to `found`; what is right is in the result.
pub fn read(source: &Arc<Source>, node: &Node, catalogue: Catalogue, found: &mut Diagnostics) -> Axes {
    let mut section = Section {
        source,
        catalogue,
        found,
        labels: Vec::new(),
    };
    let mut axes = Axes {
        axes: Vec::new(),
        excludes: Vec::new(),
        includes: Vec::new(),
        span: node.span,
    };
    if !node.is_null() && !matches!(node.content, Content::Mapping(_)) {
        section.wrong_type(
            node,
            "axes and their values, as in `virtualization: [native, docker]`,",
        );
    }
    for entry in node.entries() {
        match entry.key.value.as_str() {
            EXCLUDE | INCLUDE => {}
            LABELS => axes.axes.extend(section.labels(&entry.value)),
            _ => axes.axes.extend(section.axis(&entry.key, &entry.value)),
        }
    }
    if let Some(entry) = node.entry(EXCLUDE) {
        let items = section.rules(&entry.value);
        axes.excludes = items.iter().filter_map(|item| section.exclude(item)).collect();
    }
    if let Some(entry) = node.entry(INCLUDE) {
        let items = section.rules(&entry.value);
        axes.includes = items.iter().filter_map(|item| section.include(item)).collect();
    }
    axes
}

struct Section<'a> {
    source: &'a Arc<Source>,
    catalogue: Catalogue,
    found: &'a mut Diagnostics,
    /// The labels of the section, which rules may name as they name other axes.
    labels: Vec<String>,
}

impl Section<'_> {
    fn error(&self, code: Code, span: Span, message: impl Into<String>) -> Diagnostic {
        Diagnostic::error(self.source, code, span, message)
    }

    fn wrong_type(&mut self, node: &Node, wanted: &str) {
        let message = typing::belongs_here(wanted, &node.describe());
        let error = self.error(Code::WrongType, node.span, message);
        self.found
            .push(error.help(format!("write {}", wanted.trim_end_matches(','))));
    }

    fn axis(&mut self, name: &Spanned<String>, node: &Node) -> Option<Axis> {
        if self.role(name)? == Role::Label {
            self.unknown_axis(name, node);
            return None;
        }
        self.values(name, node)
    }

    /// The axes below `labels:`.
    fn labels(&mut self, node: &Node) -> Vec<Axis> {
        if !node.is_null() && !matches!(node.content, Content::Mapping(_)) {
            self.wrong_type(node, "names and their values, as in `rack: [north, south]`,");
        }
        let mut axes = Vec::new();
        for entry in node.entries() {
            if self.is_label(&entry.key) {
                self.labels.push(entry.key.value.clone());
                axes.extend(self.values(&entry.key, &entry.value));
            }
        }
        axes
    }

    /// Whether a name below `labels:` can be a label's.
    fn is_label(&mut self, name: &Spanned<String>) -> bool {
        let (message, help) = match Role::of(&name.value) {
            Ok(Role::Label) if !matches!(name.value.as_str(), EXCLUDE | INCLUDE | LABELS | REASON) => {
                return true;
            }
            Ok(Role::Label) => (
                format!("`{}` has a meaning of its own and cannot be a label", name.value),
                "give the label another name".to_owned(),
            ),
            Ok(_) => (
                format!("`{}` is an axis that changes something, and no label", name.value),
                "write it beside `labels:`, not below".to_owned(),
            ),
            Err(_) => (
                format!(
                    "`{}` reads like the path of a setting, and cannot be a label",
                    name.value
                ),
                "give the label a name without the name of a section of settings".to_owned(),
            ),
        };
        let error = self.error(Code::UnknownKey, name.span, message);
        self.found.push(error.help(help));
        false
    }

    /// An axis with its values.
    fn values(&mut self, name: &Spanned<String>, node: &Node) -> Option<Axis> {
        let Content::List(items) = &node.content else {
            let one = node.text().map_or_else(|| "…".to_owned(), str::to_owned);
            let error = if node.is_null() {
                self.error(
                    Code::EmptyAxis,
                    name.span,
                    format!("the axis `{}` has no values", name.value),
                )
                .help("write its values as a list, or leave the axis out")
            } else {
                let message = format!("the axis `{}` is not a list of values", name.value);
                self.error(Code::WrongType, node.span, message)
                    .help(format!("write `{}: [{one}]`", name.value))
            };
            self.found.push(error);
            return None;
        };
        if items.is_empty() {
            let error = self
                .error(
                    Code::EmptyAxis,
                    node.span,
                    format!("the axis `{}` has no values", name.value),
                )
                .label("an empty list makes no scenario at all")
                .help("write its values, or leave the axis out");
            self.found.push(error);
            return None;
        }
        if items.len() > SCENARIOS {
            let message = format!(
                "the axis `{}` has {} values, more than {SCENARIOS}",
                name.value,
                items.len()
            );
            self.found
                .push(self.error(Code::TooManyScenarios, name.span, message).help(FEWER));
            return None;
        }
        let mut values: Vec<AxisValue> = Vec::new();
        let mut seen: HashMap<String, usize> = HashMap::new();
        for item in items {
            let Some(value) = self.axis_value(&name.value, item) else {
                continue;
            };
            let first = seen.get(&value.text).and_then(|first| values.get(*first));
            if let Some(first) = first {
                let message = format!("`{}` is on the axis `{}` twice", value.text, name.value);
                let error = self
                    .error(Code::DuplicateScenario, item.span, message)
                    .label("again")
                    .also(first.node.span, "first")
                    .help("keep one: the same value twice gives the same scenarios twice");
                self.found.push(error);
            } else {
                seen.insert(value.text.clone(), values.len());
                values.push(value);
            }
        }
        (!values.is_empty()).then(|| Axis {
            name: name.clone(),
            values,
        })
    }

    /// What an axis of that name is for.
    fn role(&mut self, name: &Spanned<String>) -> Option<Role> {
        Role::of(&name.value)
            .map_err(|no_axis| {
                let error = self.error(Code::UnknownKey, name.span, no_axis.message);
                self.found.push(error.help(no_axis.help));
            })
            .ok()
    }

    /// A name that is no setting's: it would change nothing but names, which is seldom meant.
    fn unknown_axis(&mut self, name: &Spanned<String>, node: &Node) {
        let message = format!(
            "there is no setting `{}`, so an axis of that name changes nothing",
            name.value
        );
        let meant = did_you_mean(&name.value, known_axes());
        let meant = meant
            .map(|meant| format!("did you mean `{meant}`? "))
            .unwrap_or_default();
        let help = format!(
            "{meant}If it is to change nothing but names, write:\n{LABELS}:\n  {}: {}",
            name.value,
            as_written(node)
        );
        let error = self.error(Code::UnknownKey, name.span, message);
        self.found.push(error.label("no setting of this name").help(help));
    }

    fn axis_value(&mut self, axis: &str, node: &Node) -> Option<AxisValue> {
        let Some(text) = node.text().filter(|text| !text.trim().is_empty()) else {
            self.wrong_type(node, "a word or a number");
            return None;
        };
        self.is_short(node, text).then_some(())?;
        if Role::of(axis) == Ok(Role::Virtualization) && self.catalogue.kind(text).is_none() {
            let error = self
                .error(
                    Code::UnknownValue,
                    node.span,
                    format!("there is no virtualization `{text}`"),
                )
                .label("unknown value")
                .help(propose(text, self.catalogue.names()));
            self.found.push(error);
            return None;
        }
        Some(AxisValue {
            text: text.to_owned(),
            node: node.clone(),
        })
    }

    /// Whether a value is one that a person wrote: to compare longer ones takes their square.
    fn is_short(&mut self, node: &Node, text: &str) -> bool {
        let is_short = text.len() <= LONGEST_VALUE;
        if !is_short {
            let message = format!("a value of {} bytes is longer than {LONGEST_VALUE}", text.len());
            let error = self.error(Code::TooLarge, node.span, message);
            self.found
                .push(error.help("write a short name, or a pattern with `*` in place of most of it"));
        }
        is_short
    }

    /// The items of `exclude:` or `include:`.
    fn rules<'n>(&mut self, node: &'n Node) -> &'n [Node] {
        match &node.content {
            Content::List(items) => items,
            _ if node.is_null() => &[],
            _ => {
                self.wrong_type(
                    node,
                    "a list, each item with axes and values, as in `- {os: osx}`,",
                );
                &[]
            }
        }
    }

    fn exclude(&mut self, node: &Node) -> Option<Exclude> {
        let reason = node
            .entry(REASON)
            .and_then(|entry| entry.value.text())
            .map(str::to_owned);
        let conditions = self.rule(node, &[REASON], Self::condition)?;
        if reason.is_none() {
            self.found.push(
                Diagnostic::warning(
                    self.source,
                    Code::NoReason,
                    node.span,
                    "this exclude does not say why",
                )
                .help("add `reason: …`: it stands in every report in the place of the results"),
            );
        }
        Some(Exclude {
            conditions,
            reason,
            span: node.span,
        })
    }

    fn include(&mut self, node: &Node) -> Option<Include> {
        Some(Include {
            values: self.rule(node, &[], Self::assignment)?,
            span: node.span,
        })
    }

    /// What a rule has for each axis; none if one of these is wrong, for the rule means something else without it.
    fn rule<T>(
        &mut self,
        node: &Node,
        besides: &[&str],
        read: impl Fn(&mut Self, &Spanned<String>, &Node) -> Option<T>,
    ) -> Option<Vec<T>> {
        if !matches!(node.content, Content::Mapping(_)) {
            self.wrong_type(node, "axes and values, as in `os: osx`,");
            return None;
        }
        let entries = node.entries().iter();
        let entries = entries.filter(|entry| !besides.contains(&entry.key.value.as_str()));
        let mut parts = Vec::new();
        for entry in entries {
            if entry.key.value != LABELS {
                parts.push(
                    self.is_axis(&entry.key, &entry.value)
                        .then_some((&entry.key, &entry.value)),
                );
                continue;
            }
            if !matches!(entry.value.content, Content::Mapping(_)) {
                self.wrong_type(&entry.value, "names and values, as in `rack: north`,");
                return None;
            }
            for label in entry.value.entries() {
                parts.push(self.is_label(&label.key).then_some((&label.key, &label.value)));
            }
        }
        if parts.is_empty() {
            let error = self
                .error(Code::MissingKey, node.span, "this names no axis")
                .help("write the values that a combination must have, as in `os: osx`");
            self.found.push(error);
            return None;
        }
        let read: Vec<Option<T>> = parts
            .into_iter()
            .map(|part| part.and_then(|(name, node)| read(self, name, node)))
            .collect();
        read.into_iter().collect()
    }

    /// Whether a rule may name it: an axis that changes something, or one of the section's labels.
    fn is_axis(&mut self, name: &Spanned<String>, node: &Node) -> bool {
        match self.role(name) {
            // A cluster's nodes are no label's values.
            Some(Role::Label) if name.value != NODE && !self.labels.contains(&name.value) => {
                self.unknown_axis(name, node);
                false
            }
            role => role.is_some(),
        }
    }

    fn assignment(&mut self, name: &Spanned<String>, node: &Node) -> Option<Assignment> {
        Some(Assignment {
            axis: name.clone(),
            value: self.axis_value(&name.value, node)?,
        })
    }

    fn condition(&mut self, name: &Spanned<String>, node: &Node) -> Option<Condition> {
        let nodes = match &node.content {
            Content::List(items) => items.as_slice(),
            _ => std::slice::from_ref(node),
        };
        if nodes.is_empty() {
            self.wrong_type(node, "a value or a list of values");
            return None;
        }
        let values: Vec<Option<AxisValue>> = nodes
            .iter()
            .map(|node| match node.text() {
                Some(text) if is_pattern(text) => self.is_short(node, text).then(|| AxisValue {
                    text: text.to_owned(),
                    node: node.clone(),
                }),
                _ => self.axis_value(&name.value, node),
            })
            .collect();
        Some(Condition::new(
            name.clone(),
            values.into_iter().collect::<Option<_>>()?,
        ))
    }
}

/// A value or a list of values on one line of YAML, as far as a proposal needs it.
fn as_written(node: &Node) -> String {
    match &node.content {
        Content::List(items) => {
            let texts = items.iter().take(REPEATED).map(as_written);
            let more = (items.len() > REPEATED).then(|| "…".to_owned());
            format!("[{}]", texts.chain(more).collect::<Vec<_>>().join(", "))
        }
        _ => node.text().unwrap_or("…").to_owned(),
    }
}
