//! The report as one page: `report.html`, which needs no network, no JavaScript and no other file. Light and dark, on a
//! phone and on paper. The main function is [`render`].
//!
//! ```text
//! verdict -> remarks -> shifts -> matrix -> heatmap -> tables -> pairs -> windows -> trajectories -> experiment -> packets -> environments -> asked -> methods
//! ```
//!
//! Colours are named in `style.css`, so that drawings follow light and dark; nothing is said by colour alone. What a browser
//! shows when the mouse rests on something stands in a table as well.

mod asked;
mod environments;
mod heatmap;
mod matrix;
mod packets;
mod plot;
mod windows;

use maud::{DOCTYPE, Markup, PreEscaped, html};

use crate::{
    analysis::report::Report,
    present::{
        Presentation, colours,
        figure::{Figure, Kind, Layout},
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
            body .many[report.scenarios.len() > MOST_SHOWN] {
                a .skip href="#tables" { "To the tables" }
                header {
                    h1 { "Report of " (report.run) }
                    p { time datetime=(report.created) { (report.created) } }
                    div #verdict { @for (at, finding) in report.findings().iter().enumerate() {
                        @if at == 0 { p { strong { (prose(finding)) } } } @else { p { (prose(finding)) } }
                    } }
                    (remarks(&presented.remarks))
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
                        ol #list-of-tables { @for table in &presented.tables { li { a href={ "#" (table_id(table)) } { (table.title) } } } }
                        @for (number, table) in (1..).zip(&presented.tables) { (drawn(number, table)) }
                    }
                    (section("pairs", "Pairs", &pairs(figures)))
                    (section("windows", "Windows", &windows::draw(report)))
                    (section("trajectories", "Trajectories", &drawings(figures, &[Kind::Trajectory], "No window has a whole period.")))
                    (section("experiment", "The experiment", &drawings(figures, EXPERIMENT, "Nothing was measured.")))
                    (section("packets", "Packets", &packets::draw(report)))
                    (section("environments", "Environments", &environments::draw(report)))
                    (section("asked", "What was asked", &asked::draw(report)))
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

const SECTIONS: [(&str, &str); 12] = [
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
    ("asked", "What was asked"),
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

/// Scenarios, or drawings, that a section shows each by itself. With some hundreds a browser would take seconds for the page.
const MOST_SHOWN: usize = 48;

/// That a section shows the first of them alone, and where the others are.
fn left_out(shown: usize, elsewhere: &str) -> Markup {
    html! {
        @if let Some(more @ 1..) = shown.checked_sub(MOST_SHOWN) {
            p .note { "The first " (MOST_SHOWN) "; " (more) " more are in " code { (elsewhere) } "." }
        }
    }
}

/// Remarks that are read at once; more of them are folded.
const OPEN_REMARKS: usize = 3;

fn remarks(remarks: &[String]) -> Markup {
    let (open, folded) = remarks.split_at(remarks.len().min(OPEN_REMARKS));
    html! {
        @if !open.is_empty() {
            div #remarks {
                ul { @for remark in open { li { (prose(remark)) } } }
                @if !folded.is_empty() {
                    details {
                        summary { (folded.len()) " more " @if folded.len() == 1 { "remark" } @else { "remarks" } }
                        ul { @for remark in folded { li { (prose(remark)) } } }
                    }
                }
            }
        }
    }
}

/// With a prefix, because sections of the page have ids such as `packets`.
fn table_id(table: &Table) -> String {
    format!("table-{}", table.id)
}

/// A table with its notes. Its columns can be sorted where there is JavaScript.
fn drawn(number: usize, table: &Table) -> Markup {
    let id = table_id(table);
    html! {
        h3 id=(id) { (number) ". " (table.title) }
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

/// A scenario's colour beside its letter: the legend of all drawings.
fn swatch(report: &Report, scenario: &str) -> Markup {
    html! { span class=(format!("swatch s{}", colours::of(report, scenario))) aria-hidden="true" {} " " }
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

/// How wide a drawing may become: as wide as makes its letters those of the page's text.
fn width_rem(layout: Layout) -> f64 {
    /// How tall the page's letters are, measured as LaTeX measures them: 1 rem less what a smaller figure may have.
    const LETTERS_REM: f64 = 0.95;
    layout.width_pt() / layout.letters_pt() * LETTERS_REM
}

/// Drawings for paper. On a narrow screen they keep a size at which they can be read, and are moved.
fn drawings(figures: &[Figure], kinds: &[Kind], none: &str) -> Markup {
    let figures: Vec<&Figure> = figures
        .iter()
        .filter(|figure| kinds.contains(&figure.kind))
        .collect();
    html! {
        @if figures.is_empty() { p { (none) } }
        (left_out(figures.len(), "figures/"))
        div .pairs {
            @for figure in figures.iter().take(MOST_SHOWN) {
                figure {
                    div .wide tabindex="0" role="region" aria-label=(figure.stem()) {
                        // Of our own making, by a library that escapes texts.
                        div .paper style=(format!("max-width: {:.1}rem", width_rem(figure.layout))) role="img"
                            aria-label=(figure.caption) { (PreEscaped(&figure.svg)) }
                    }
                    figcaption { (prose(&figure.caption)) }
                }
            }
        }
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
    fn the_page_has_the_colours_of_the_figures() {
        for (number, (red, green, blue)) in colours::COLOURS.iter().enumerate() {
            let rule = format!(".s{number} {{ --own: #{red:02x}{green:02x}{blue:02x}; }}");
            assert!(STYLE.contains(&rule), "{rule}");
        }
    }

    #[test]
    fn names_of_files_and_settings_are_set_as_code() {
        let prose = prose("see `a.csv` and `report.alpha`").into_string();
        assert_eq!(prose, "see <code>a.csv</code> and <code>report.alpha</code>");
    }
}
