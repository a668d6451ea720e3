//! The matrix as a picture of its scenarios: a row for each platform, a column for each virtualization.

use maud::{Markup, html};

use super::{prose, swatch};
use crate::analysis::{
    report::Report,
    scenario::{ScenarioReport, Standing},
};

pub(super) fn draw(report: &Report) -> Markup {
    let mut columns: Vec<String> = Vec::new();
    let mut rows: Vec<String> = Vec::new();
    for scenario in &report.scenarios {
        for (known, value) in [
            (&mut columns, scenario.virtualization()),
            (&mut rows, scenario.platform()),
        ] {
            if !known.contains(&value) {
                known.push(value);
            }
        }
    }
    let at = |row_name: &str, column_name: &str| -> Vec<&ScenarioReport> {
        let mut found: Vec<_> = report.scenarios.iter().collect();
        found.retain(|it| it.platform() == row_name && it.virtualization() == column_name);
        found
    };
    html! {
        div .wide tabindex="0" role="region" aria-label="The matrix" {
            table .matrix {
                thead { tr {
                    td {}
                    @for name in &columns { th scope="col" { (name) } }
                } }
                tbody { @for name in &rows {
                    tr {
                        th scope="row" { (name) }
                        @for column in &columns { td { @for scenario in at(name, column) { (cell(report, scenario)) } } }
                    }
                } }
            }
        }
    }
}

fn cell(report: &Report, scenario: &ScenarioReport) -> Markup {
    let suspect = scenario.windows_suspect();
    let (sign, class) = match scenario.standing {
        // What went well on a disturbed machine is not to look as if it had gone well.
        Standing::Completed if suspect > 0 => ("!", "suspect"),
        standing => sign(standing),
    };
    html! {
        div {
            (swatch(report, &scenario.id)) strong { (scenario.id) } " "
            span class=(class) { (sign) " " (scenario.standing.name()) }
            @if !scenario.windows.is_empty() {
                br; (scenario.windows_counted()) " of " (scenario.windows.len()) " windows count"
            }
            @if suspect > 0 { br; span .suspect { (suspect) " of them suspect" } }
            @if scenario.is_baseline { br; "baseline" }
            @if scenario.is_simulated { br; strong { "simulated, not measured" } }
            @if let Some(reason) = &scenario.reason { br; span .note { (prose(reason)) } }
        }
    }
}

const fn sign(standing: Standing) -> (&'static str, &'static str) {
    match standing {
        Standing::Completed => ("✓", "completed"),
        Standing::Failed | Standing::Errored => ("✗", "troubled"),
        Standing::Interrupted | Standing::Unfinished => ("…", "troubled"),
        Standing::Infeasible | Standing::NotSelected | Standing::NotStarted => ("–", "left-out"),
    }
}
