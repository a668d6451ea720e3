//! What was asked: the command, the matrix file and what of its settings is not as it is by default.

use maud::{Markup, html};
use record::escaping::visible;

use crate::{
    analysis::report::Report,
    input::run::{Asked, RunPart},
};

/// Characters of a matrix file that are shown.
const LONGEST: usize = 64 << 10;

pub(super) fn draw(report: &Report) -> Markup {
    html! {
        @for part in &report.parts { (of_part(part)) }
        h3 { "Settings that are not as they are by default" }
        @if report.changed_settings.is_empty() { p { "All are as they are by default." } } @else {
            div .wide tabindex="0" role="region" aria-label="Settings that are not as they are by default" {
                table .sortable {
                    thead { tr { @for heading in ["setting", "value", "by default", "scenarios"] { th scope="col" { (heading) } } } }
                    tbody { @for setting in &report.changed_settings { tr {
                        td { code { (setting.path) } }
                        td { (setting.value) }
                        td { (setting.default.as_deref().unwrap_or("–")) }
                        td { @if setting.scenarios.len() == report.scenarios.len() { "all" } @else { (setting.scenarios.join(", ")) } }
                    } } }
                }
            }
            p .note { "Below " code { "workload" } ". Dynamics of another name than the default's have other defaults; those are meant here." }
        }
    }
}

fn of_part(part: &RunPart) -> Markup {
    let Asked {
        invocation,
        matrix_file,
        matrix_text,
        profile,
        order,
        seed,
    } = &part.asked;
    let name = matrix_file.rsplit('/').next().unwrap_or_default();
    let start: String = matrix_text.chars().take(LONGEST).collect();
    html! {
        h3 { "Run " (part.run) }
        dl {
            dt { "by" } dd { "matrix " (part.matrix_version) @if let Some(revision) = &part.matrix_revision { ", revision " (revision.to_string()) } }
            @if !invocation.is_empty() { dt { "command" } dd { code { (visible(&invocation.join(" "))) } } }
            @if let Some(profile) = profile { dt { "profile" } dd { (profile) } }
            dt { "order of the scenarios" } dd { (order) ", seed " (seed) }
        }
        @if matrix_text.is_empty() { p { "The matrix file is not in this copy of the run." } } @else {
            details {
                summary { "The matrix file, " code { (name) } }
                pre tabindex="0" { (visible(&start)) @if start.len() < matrix_text.len() { "\n… cut here" } }
            }
        }
    }
}
