//! Whether the sections of a matrix file, and the keys in them, are those that there are.

use std::sync::Arc;

use record::experiment::CommandExperiment;

use super::{
    diagnostic::{Code, Diagnostic, Diagnostics},
    source::{Source, Span},
    spelling::{did_you_mean, propose},
    tree::{Content, Entry, Node},
};

pub(super) const MATRIX: &str = "matrix";
pub(super) const HOSTS: &str = "hosts";
pub(super) const WORKLOAD: &str = "workload";
pub(super) const REPORT: &str = "report";
pub(super) const PROVIDERS: &str = "providers";
pub(super) const PROFILES: &str = "profiles";
pub(super) const EXPERIMENT: &str = CommandExperiment::SECTION;

/// The sections of a matrix file.
const SECTIONS: [&str; 7] = [MATRIX, HOSTS, EXPERIMENT, WORKLOAD, REPORT, PROVIDERS, PROFILES];

pub(super) fn check_sections(source: &Arc<Source>, tree: &Node, found: &mut Diagnostics) {
    if !matches!(tree.content, Content::Mapping(_)) {
        let message = format!("a matrix file is sections with settings, not {}", tree.describe());
        found.push(
            Diagnostic::error(source, Code::WrongType, tree.span, message)
                .help("begin with `matrix:`, as in `matrix: {virtualization: [native, docker]}`"),
        );
        return;
    }
    check_keys(source, tree, &SECTIONS, found);
    let misspelt = |entry: &Entry| did_you_mean(&entry.key.value, SECTIONS) == Some(MATRIX);
    if tree.entry(MATRIX).is_none() && !tree.entries().iter().any(misspelt) {
        found.push(
            Diagnostic::error(source, Code::MissingKey, Span::default(), "there is no `matrix:`")
                .help("add `matrix:` with the axes, as in `matrix: {virtualization: [native, docker]}`"),
        );
    }
}

pub(super) fn check_keys(source: &Arc<Source>, node: &Node, known: &[&str], found: &mut Diagnostics) {
    for entry in node.entries() {
        let key = entry.key.value.as_str();
        if !known.contains(&key) {
            found.push_error(|| {
                Diagnostic::error(
                    source,
                    Code::UnknownKey,
                    entry.key.span,
                    format!("there is no key `{key}` here"),
                )
                .label("unknown key")
                .help(propose(key, known.iter().copied()))
            });
        }
    }
}
