//! Settings of the report under the names that they had in earlier versions. The main function is [`rename`].

use std::sync::Arc;

use record::report_settings::ReportSettings;

use super::{
    diagnostic::{Code, Diagnostic, Diagnostics},
    sections::{PROFILES, REPORT},
    source::Source,
    tree::{Content, Entry, Node},
};

/// Gives each of them the name of today, so that a profile can override it under either name. The places stay those of the text.
pub fn rename(source: &Arc<Source>, file: &mut Node, found: &mut Diagnostics) {
    for section in entries(file) {
        match section.key.value.as_str() {
            REPORT => rename_in(source, &mut section.value, found),
            PROFILES => {
                let sections = entries(&mut section.value)
                    .iter_mut()
                    .flat_map(|profile| entries(&mut profile.value));
                for report in sections.filter(|section| section.key.value == REPORT) {
                    rename_in(source, &mut report.value, found);
                }
            }
            _ => {}
        }
    }
}

fn rename_in(source: &Arc<Source>, report: &mut Node, found: &mut Diagnostics) {
    let Content::Mapping(settings) = &mut report.content else {
        return;
    };
    for (former, own) in ReportSettings::RENAMED {
        let place_of = |name: &str| {
            settings
                .iter()
                .find(|it| it.key.value == name)
                .map(|it| it.key.span)
        };
        if let (Some(again), Some(first)) = (place_of(former), place_of(own)) {
            let message = format!("`{former}` and `{own}` are two names of one setting");
            found.push(
                Diagnostic::error(source, Code::DuplicateKey, again, message)
                    .label("its former name")
                    .also(first, "its name")
                    .help(format!("keep `{own}`")),
            );
            settings.retain(|it| it.key.value != former);
        }
        for setting in settings.iter_mut().filter(|it| it.key.value == former) {
            own.clone_into(&mut setting.key.value);
        }
    }
}

/// The entries of a mapping; of anything else, none.
fn entries(node: &mut Node) -> &mut [Entry] {
    match &mut node.content {
        Content::Mapping(entries) => entries,
        _ => &mut [],
    }
}
