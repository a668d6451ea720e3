//! The profiles of a matrix file: each is laid on top of it.

use std::sync::Arc;

use super::{
    diagnostic::{Code, Diagnostic, Diagnostics, Severity},
    sections::{EXPERIMENT, MATRIX, PROFILES, PROVIDERS, REPORT, WORKLOAD, check_keys},
    source::{Source, Span, Spanned},
    spelling::propose,
    tree::{Content, Node},
};

/// Most profiles in one file.
const MOST_PROFILES: usize = 100;
/// The sections that a profile can override.
const IN_PROFILES: [&str; 5] = [MATRIX, EXPERIMENT, WORKLOAD, REPORT, PROVIDERS];

/// A profile, as it is written.
pub(super) struct Profile<'a> {
    pub(super) name: &'a Spanned<String>,
    pub(super) node: &'a Node,
}

pub(super) fn read_profiles<'a>(
    source: &Arc<Source>,
    tree: &'a Node,
    found: &mut Diagnostics,
) -> Vec<Profile<'a>> {
    let Some(section) = tree.entry(PROFILES) else {
        return Vec::new();
    };
    let mut profiles = Vec::new();
    let is_mapping = |node: &Node| node.is_null() || matches!(node.content, Content::Mapping(_));
    let mut wrong = |node: &Node, help: &str| {
        let message = format!("keys with values belong here, not {}", node.describe());
        found.push(Diagnostic::error(source, Code::WrongType, node.span, message).help(help));
    };
    if !is_mapping(&section.value) {
        wrong(
            &section.value,
            "write names of profiles, as in `quick: {workload: {window: 32s}}`",
        );
    }
    for entry in section.value.entries() {
        if is_mapping(&entry.value) {
            profiles.push(Profile {
                name: &entry.key,
                node: &entry.value,
            });
        } else {
            wrong(
                &entry.value,
                "write the sections that the profile overrides, as in `workload: {window: 32s}`",
            );
        }
    }
    for profile in &profiles {
        check_keys(source, profile.node, &IN_PROFILES, found);
    }
    // Each is read with the whole file under it.
    if let Some(profile) = profiles.get(MOST_PROFILES) {
        let message = format!("there are more than {MOST_PROFILES} profiles");
        let error = Diagnostic::error(source, Code::TooLarge, profile.name.span, message);
        found.push(error.help("take some away, or write several matrix files"));
        profiles.truncate(MOST_PROFILES);
    }
    profiles
}

pub(super) fn choose<'a, 'b>(
    profiles: &'b [Profile<'a>],
    name: &str,
) -> Result<&'b Profile<'a>, Box<Diagnostic>> {
    let known = || profiles.iter().map(|profile| profile.name.value.as_str());
    profiles
        .iter()
        .find(|profile| profile.name.value == name)
        .ok_or_else(|| {
            let source = Arc::new(Source::new("--profile", name));
            let span = Span {
                start: 0,
                end: name.len(),
            };
            let error = Diagnostic::error(
                &source,
                Code::UnknownProfile,
                span,
                format!("the matrix file has no profile `{name}`"),
            );
            let help = if profiles.is_empty() {
                "it has no `profiles:` at all: leave the option out".to_owned()
            } else {
                propose(name, known().collect::<Vec<_>>())
            };
            Box::new(error.help(help))
        })
}

/// What only shows with a profile names it; the warnings of a profile that is not chosen concern nobody now.
pub(super) fn add_in_profile(
    found: &mut Diagnostics,
    in_profile: Diagnostics,
    profile: &Profile<'_>,
    is_chosen: bool,
) {
    for diagnostic in in_profile {
        let known = found
            .iter()
            .any(|known| known.span() == diagnostic.span() && known.message == diagnostic.message);
        if known || !(is_chosen || diagnostic.severity == Severity::Error) {
            continue;
        }
        let name = profile.name;
        found.push(diagnostic.also(name.span, format!("with the profile `{}`", name.value)));
    }
}
