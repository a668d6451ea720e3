//! The `matrix:` section: axes, excludes and includes as they are written. The main type is [`Axes`].
//!
//! What they expand to is the plan's matter.

use std::sync::Arc;

use record::run_directory::PlanRecord;

use super::{
    diagnostic::{Code, Diagnostic, Diagnostics},
    source::{Source, Span, Spanned},
    spelling::{did_you_mean, propose},
    sweep::{Role, known_axes},
    tree::{Content, Node},
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

/// `axis: value` in an exclude or an include.
#[derive(Debug, Clone, PartialEq)]
pub struct Assignment {
    /// The axis.
    pub axis: Spanned<String>,
    /// The value.
    pub value: AxisValue,
}

/// Combinations that are not run: those with all of these values.
#[derive(Debug, Clone, PartialEq)]
pub struct Exclude {
    /// The values.
    pub values: Vec<Assignment>,
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
        if !matches!(entry.key.value.as_str(), EXCLUDE | INCLUDE) {
            axes.axes.extend(section.axis(&entry.key, &entry.value));
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
    /// Labels that were warned of: once is enough.
    labels: Vec<String>,
}

impl Section<'_> {
    fn error(&self, code: Code, span: Span, message: impl Into<String>) -> Diagnostic {
        Diagnostic::error(self.source, code, span, message)
    }

    fn wrong_type(&mut self, node: &Node, wanted: &str) {
        let message = format!("{wanted} belongs here, not {}", node.describe());
        let error = self.error(Code::WrongType, node.span, message);
        self.found
            .push(error.help(format!("write {}", wanted.trim_end_matches(','))));
    }

    fn axis(&mut self, name: &Spanned<String>, node: &Node) -> Option<Axis> {
        self.role(name)?;
        self.warn_of_label(name);
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
        for item in items {
            let Some(value) = self.axis_value(&name.value, item) else {
                continue;
            };
            if let Some(first) = values.iter().find(|first| first.text == value.text) {
                let message = format!("`{}` is on the axis `{}` twice", value.text, name.value);
                let error = self
                    .error(Code::DuplicateScenario, item.span, message)
                    .label("again")
                    .also(first.node.span, "first")
                    .help("keep one: the same value twice gives the same scenarios twice");
                self.found.push(error);
            } else {
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

    /// A label may be a misspelling.
    fn warn_of_label(&mut self, name: &Spanned<String>) {
        if Role::of(&name.value) != Ok(Role::Label) || self.labels.contains(&name.value) {
            return;
        }
        self.labels.push(name.value.clone());
        let message = format!(
            "the axis `{}` is a label: it changes nothing but names",
            name.value
        );
        let help = did_you_mean(&name.value, known_axes()).map_or_else(
            || "an axis with the path of a setting changes it, as in `network.loss: [0%, 1%]`".to_owned(),
            |meant| format!("did you mean `{meant}`?"),
        );
        self.found.push(
            Diagnostic::warning(self.source, Code::LabelAxis, name.span, message)
                .label("no setting of this name")
                .help(help),
        );
    }

    fn axis_value(&mut self, axis: &str, node: &Node) -> Option<AxisValue> {
        let Some(text) = node.text().filter(|text| !text.trim().is_empty()) else {
            self.wrong_type(node, "a word or a number");
            return None;
        };
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
        let values = self.assignments(node, &[REASON])?;
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
            values,
            reason,
            span: node.span,
        })
    }

    fn include(&mut self, node: &Node) -> Option<Include> {
        let values = self.assignments(node, &[])?;
        values
            .iter()
            .for_each(|assignment| self.warn_of_label(&assignment.axis));
        Some(Include {
            values,
            span: node.span,
        })
    }

    /// The `axis: value` pairs of a rule; none if one of them is wrong, for the rule means something else without it.
    fn assignments(&mut self, node: &Node, besides: &[&str]) -> Option<Vec<Assignment>> {
        if !matches!(node.content, Content::Mapping(_)) {
            self.wrong_type(node, "axes and values, as in `os: osx`,");
            return None;
        }
        let entries = node.entries().iter();
        let entries: Vec<_> = entries
            .filter(|entry| !besides.contains(&entry.key.value.as_str()))
            .collect();
        if entries.is_empty() {
            let error = self
                .error(Code::MissingKey, node.span, "this names no axis")
                .help("write the values that a combination must have, as in `os: osx`");
            self.found.push(error);
            return None;
        }
        let assignments: Vec<_> = entries
            .iter()
            .filter_map(|entry| {
                self.role(&entry.key)?;
                Some(Assignment {
                    axis: entry.key.clone(),
                    value: self.axis_value(&entry.key.value, &entry.value)?,
                })
            })
            .collect();
        (assignments.len() == entries.len()).then_some(assignments)
    }
}
