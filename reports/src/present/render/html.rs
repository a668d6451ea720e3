//! The report as one page: `report.html`, which needs no network, no JavaScript and no other file. Light and dark, on a
//! phone and on paper. The main function is [`render`].
//!
//! ```text
//! verdict -> remarks -> shifts -> matrix -> heatmap -> tables -> pairs -> windows -> trajectories -> experiment -> packets -> environments -> methods
//! ```
//!
//! Colours are named in `style.css`, so that drawings follow light and dark; nothing is said by colour alone. What a browser
//! shows when the mouse rests on something stands in a table as well.

mod heatmap;
mod matrix;
mod packets;
mod plot;
mod windows;

use maud::{DOCTYPE, Markup, PreEscaped, html};
use record::{
    field,
    run_directory::{EnvironmentRecord, RecordedPlatform},
};

use crate::{
    analysis::report::Report,
    present::{
        Presentation,
        figure::{Figure, Kind},
        table::Table,
        writing::other_folder,
    },
};

const STYLE: &str = include_str!("html/style.css");
const SORT: &str = include_str!("html/sort.js");

/// The page. `figures` are those that are drawn elsewhere, too.
pub(super) fn render(presented: &Presentation<'_>, figures: &[Figure]) -> String {
    let report = presented.report;
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            (head(&format!("Report of {}", report.run)))
            body {
                a .skip href="#tables" { "To the tables" }
                header {
                    h1 { "Report of " (report.run) }
                    p { time datetime=(report.created) { (report.created) } }
                    div #verdict { @for (at, finding) in report.findings().iter().enumerate() {
                        @if at == 0 { p { strong { (prose(finding)) } } } @else { p { (prose(finding)) } }
                    } }
                    @if !presented.remarks.is_empty() {
                        ul #remarks { @for remark in &presented.remarks { li { (prose(remark)) } } }
                    }
                    ul #origins { @for origin in report.origins() { li { (origin) } } }
                    @if !report.others.is_empty() {
                        p #metrics {
                            "This page is about " code { (report.quantity.name) } ". Other metrics: "
                            @for (at, other) in report.others.iter().enumerate() {
                                @if at > 0 { ", " }
                                a href=(format!("{}/report.html", other_folder(&other.quantity.name).display())) { code { (other.quantity.name) } }
                            }
                            "."
                        }
                    }
                }
                (contents())
                main {
                    (section("shifts", "How large the differences are", &drawings(figures, &[Kind::Forest, Kind::Sweep, Kind::Causes], "No pair of scenarios has data.")))
                    (section("matrix", "The matrix", &matrix::draw(report)))
                    (section("heatmap", "Every comparison", &heatmap::draw(report)))
                    section #tables {
                        h2 { "Tables" }
                        @for table in &presented.tables { (drawn(table)) }
                    }
                    (section("pairs", "Pairs", &pairs(figures)))
                    (section("windows", "Windows", &windows::draw(report)))
                    (section("trajectories", "Trajectories", &drawings(figures, &[Kind::Trajectory], "No window has a whole period.")))
                    (section("experiment", "The experiment", &drawings(figures, EXPERIMENT, "Nothing was measured.")))
                    (section("packets", "Packets", &packets::draw(report)))
                    (section("environments", "Environments", &environments(report)))
                    (section("methods", "Methods", &methods(report)))
                }
                script { (PreEscaped(SORT)) }
            }
        }
    };
    page.into_string()
}

/// The head of a page, with one look for all pages.
pub(crate) fn head(title: &str) -> Markup {
    html! {
        head {
            meta charset="utf-8";
            meta name="viewport" content="width=device-width, initial-scale=1";
            meta name="color-scheme" content="light dark";
            title { (title) }
            style { (PreEscaped(STYLE)) }
        }
    }
}

const SECTIONS: [(&str, &str); 11] = [
    ("shifts", "Effects"),
    ("matrix", "Matrix"),
    ("heatmap", "Comparisons"),
    ("tables", "Tables"),
    ("pairs", "Pairs"),
    ("windows", "Windows"),
    ("trajectories", "Trajectories"),
    ("experiment", "Experiment"),
    ("packets", "Packets"),
    ("environments", "Environments"),
    ("methods", "Methods"),
];

fn contents() -> Markup {
    html! {
        nav aria-label="Contents" {
            ul { @for (id, name) in SECTIONS { li { a href={ "#" (id) } { (name) } } } }
        }
    }
}

fn section(id: &str, title: &str, content: &Markup) -> Markup {
    html! { section id=(id) { h2 { (title) } (content) } }
}

/// A table with its notes. Its columns can be sorted where there is JavaScript.
fn drawn(table: &Table) -> Markup {
    // With a prefix, because sections of the page have ids such as `packets`.
    let id = format!("table-{}", table.id);
    html! {
        h3 id=(id) { (table.title) }
        @if !table.rows.is_empty() {
            // A keyboard moves what is wider than the screen.
            div .wide tabindex="0" role="region" aria-labelledby=(id) {
                table .sortable {
                    thead { tr { @for column in &table.columns {
                        th scope="col" .number[column.is_number] { (column.heading) }
                    } } }
                    tbody { @for row in &table.rows {
                        tr { @for (cell, column) in row.iter().zip(&table.columns) {
                            td .number[column.is_number] { (cell) }
                        } }
                    } }
                }
            }
        }
        @for note in &table.notes { p .note { (prose(note)) } }
    }
}

/// A text whose names of files and settings stand between backticks, as in Markdown.
fn prose(text: &str) -> Markup {
    html! {
        @for (index, part) in text.split('`').enumerate() {
            @if index % 2 == 0 { (part) } @else { code { (part) } }
        }
    }
}

/// What the experiment and its test are.
const EXPERIMENT: &[Kind] = &[Kind::ControlLoop, Kind::Topology, Kind::KsTest];

fn pairs(figures: &[Figure]) -> Markup {
    html! {
        p {
            "One window of each of two scenarios. " code { "report.figures" } " of the matrix file and "
            code { "matrix report --figures" } " name pairs and windows."
        }
        (drawings(figures, &[Kind::Histogram, Kind::Distributions], "No pair of scenarios has data."))
    }
}

/// Drawings for paper. On a narrow screen they keep a size at which they can be read, and are moved.
fn drawings(figures: &[Figure], kinds: &[Kind], none: &str) -> Markup {
    let figures: Vec<&Figure> = figures
        .iter()
        .filter(|figure| kinds.contains(&figure.kind))
        .collect();
    html! {
        @if figures.is_empty() { p { (none) } }
        div .pairs {
            @for figure in figures {
                figure {
                    div .wide tabindex="0" role="region" aria-label=(figure.stem()) {
                        // Of our own making, by a library that escapes texts.
                        div .paper role="img" aria-label=(figure.caption) { (PreEscaped(&figure.svg)) }
                    }
                    figcaption { (prose(&figure.caption)) }
                }
            }
        }
    }
}

fn environments(report: &Report) -> Markup {
    let scenarios = report.scenarios.iter();
    let described: Vec<_> = scenarios
        .filter_map(|scenario| Some((scenario, scenario.environment.as_ref()?)))
        .collect();
    html! {
        p { "What was different between the environments of a rejected pair stands among the tables." }
        @if described.is_empty() { p { "No scenario came so far as to have an environment." } }
        @for (scenario, environment) in described {
            @for remark in environment.remarks() {
                p { strong { (scenario.id) } " " (scenario.slug) ": " (prose(&remark)) }
            }
            details {
                summary { (scenario.id) " " (scenario.slug) }
                dl { @for (name, value) in facts(environment) { dt { (name) } dd { (value) } } }
            }
        }
    }
}

/// What an environment was, field by field, by its dotted path.
fn facts(environment: &EnvironmentRecord) -> Vec<(String, String)> {
    const PLATFORM: &str = field!(EnvironmentRecord, platform);
    let mut facts = vec![
        (
            field!(EnvironmentRecord, provider).to_owned(),
            environment.provider.clone(),
        ),
        (
            field!(EnvironmentRecord, host).to_owned(),
            environment.host.clone(),
        ),
    ];
    for (name, value) in &environment.facts {
        flatten(name, value, &mut facts);
    }
    for (name, value) in environment.platform.iter().flat_map(RecordedPlatform::fields) {
        flatten(&format!("{PLATFORM}.{name}"), value, &mut facts);
    }
    facts
}

fn flatten(path: &str, value: &serde_json::Value, facts: &mut Vec<(String, String)>) {
    match value {
        serde_json::Value::Null => {}
        serde_json::Value::Object(fields) => {
            for (name, field) in fields {
                flatten(&format!("{path}.{name}"), field, facts);
            }
        }
        other => facts.push((path.to_owned(), record::axis::axis_text(other))),
    }
}

fn methods(report: &Report) -> Markup {
    html! {
        p { (prose(&report.method())) }
        p {
            "The numbers behind every drawing: " code { "comparisons.csv" } " (each test of two windows), "
            code { "contrasts.csv" } " (each pair of scenarios), " code { "samples.csv" } " (each value), "
            code { "packets.csv" } " (what became of each period's packets), and all of it in "
            code { "report.json" } ", beside this file. docs/statistics.md of matrix has formulas and sources."
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_files_and_settings_are_set_as_code() {
        let prose = prose("see `a.csv` and `report.alpha`").into_string();
        assert_eq!(prose, "see <code>a.csv</code> and <code>report.alpha</code>");
    }

    #[test]
    fn facts_are_named_by_their_paths_and_nothing_stands_for_what_is_not_known() {
        let mut facts = Vec::new();
        let platform =
            serde_json::json!({"cpu": {"model": "x", "governor": null}, "load": 0.5, "list": [1, 2]});
        flatten("platform", &platform, &mut facts);
        let facts: Vec<_> = facts
            .iter()
            .map(|(name, value)| format!("{name}={value}"))
            .collect();
        assert_eq!(
            facts,
            ["platform.cpu.model=x", "platform.load=0.5", "platform.list=[1,2]"]
        );
    }
}
