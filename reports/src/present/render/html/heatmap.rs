//! Every comparison of two windows as a field: the stronger its colour, the larger the distance; a dot where it was rejected. With many
//! windows the scenarios take their place: the share of their window pairs that was rejected. With many scenarios, fields that are alike
//! and beside each other are one shape, and no list is made: a hundred thousand fields of their own take a browser many seconds.

use std::collections::BTreeMap;

use maud::{Markup, html};

use crate::analysis::report::Report;

/// Windows up to which each has a row of its own.
const MOST_WINDOWS: usize = 48;
/// Fields up to which each is a shape of its own.
const MOST_FIELDS: usize = 5000;
/// Of a field, in the drawing's units.
const SIDE: f64 = 18.0;
const MARGIN: f64 = 40.0;

/// One field.
struct Field {
    row: usize,
    column: usize,
    /// From 0 to 1.
    depth: f64,
    rejected: bool,
    words: String,
    /// The same as a row of the list.
    cells: Vec<String>,
}

/// The list's columns by window, and by scenario.
const BY_WINDOW: [&str; 5] = ["between", "D", "", "log10 p", "verdict"];
const BY_SCENARIO: [&str; 3] = ["between", "window pairs", "rejected"];

pub(super) fn draw(report: &Report) -> Markup {
    if report.tallies.is_empty() {
        return html! { p { "No two windows count: nothing was compared." } };
    }
    let by_window = report.samples.len() <= MOST_WINDOWS && !report.comparisons.is_empty();
    let (names, fields) = if by_window {
        windows(report)
    } else {
        scenarios(report)
    };
    let is_each_drawn = fields.len() <= MOST_FIELDS;
    let headings: &[&str] = if by_window { &BY_WINDOW } else { &BY_SCENARIO };
    let is_number = |heading: &str| !["between", "verdict"].contains(&heading);
    let side = MARGIN + names.len() as f64 * SIDE + 2.0;
    let at = |index: usize| MARGIN + index as f64 * SIDE;
    let (name, scale_ends) = match by_window {
        true => ("D", MARGIN + 12.0 * SIDE),
        false => ("share rejected", MARGIN + 18.0 * SIDE),
    };
    let (width, height) = (side.max(scale_ends), side + 3.0 * SIDE);
    html! {
        figure {
            div .wide tabindex="0" role="region" aria-label="Every comparison" {
                svg .plot viewBox=(format!("0 0 {width} {height}")) width=(width * 1.3) role="img"
                    aria-label="A field for every comparison; the numbers are in the list below" xmlns="http://www.w3.org/2000/svg" {
                    @for (index, name) in names.iter().enumerate() {
                        text x=(MARGIN - 4.0) y=(at(index) + 13.0) text-anchor="end" { (name) }
                        text x=(at(index) + SIDE / 2.0) y=(MARGIN - 6.0) text-anchor="start"
                            transform=(format!("rotate(-60 {} {})", at(index) + SIDE / 2.0, MARGIN - 6.0)) { (name) }
                    }
                    @if !is_each_drawn {
                        @for (step, shape) in shapes(&fields) { path .cell d=(shape) fill-opacity=(opacity(f64::from(step) / f64::from(LEVELS))) stroke-width="0" {} }
                    } @else { @for field in &fields {
                        g {
                            title { (field.words) }
                            rect .cell x=(at(field.column)) y=(at(field.row)) width=(SIDE) height=(SIDE)
                                fill-opacity=(opacity(field.depth)) {}
                            @if field.rejected {
                                circle .dot cx=(at(field.column) + SIDE / 2.0) cy=(at(field.row) + SIDE / 2.0) r="3.5" {}
                            }
                        }
                    } }
                    (scale(name, side + SIDE / 2.0))
                }
            }
            figcaption {
                @if by_window {
                    "A field for each two windows, such as a1 and b2: the stronger its colour, the larger the distance D (0 to 1); a dot: \
                     rejected at p < " (report.settings.alpha) "."
                } @else if !is_each_drawn {
                    "A field for each two scenarios: the stronger its colour, the larger the share of their window pairs that was rejected. "
                    code { "between" } " of " code { "report.json" } " has the numbers."
                } @else {
                    "A field for each two scenarios: the stronger its colour, the larger the share of their window pairs that was rejected; a \
                     dot: some were."
                }
            }
        }
        @if is_each_drawn { details {
            summary { "The same as a list" }
            div .wide tabindex="0" role="region" aria-label="Every comparison as a list" {
                table .sortable {
                    thead { tr { @for heading in headings {
                        th scope="col" .number[is_number(heading)] { (heading) }
                    } } }
                    tbody { @for field in &fields {
                        tr { @for (cell, heading) in field.cells.iter().zip(headings) {
                            td .number[is_number(heading)] { (cell) }
                        } }
                    } }
                }
            }
        } }
    }
}

/// Depths that are told apart where fields are drawn together.
const LEVELS: u32 = 10;

/// One shape for all fields of a depth: a rectangle for each run of them in a row.
fn shapes(fields: &[Field]) -> BTreeMap<u32, String> {
    let level = |field: &Field| (field.depth.clamp(0.0, 1.0) * f64::from(LEVELS)).round() as u32;
    let mut places: Vec<(usize, usize, u32)> = fields
        .iter()
        .map(|field| (field.row, field.column, level(field)))
        .collect();
    places.sort_unstable();
    let is_next = |(row, column, level): &(usize, usize, u32), next: &(usize, usize, u32)| {
        (*row, column + 1, *level) == *next
    };
    let mut shapes: BTreeMap<u32, String> = BTreeMap::new();
    for run in places.chunk_by(is_next) {
        if let Some((row, column, level)) = run.first() {
            let at = |index: usize| MARGIN + index as f64 * SIDE;
            let width = run.len() as f64 * SIDE;
            let shape = format!("M{} {}h{width}v{SIDE}h-{width}z", at(*column), at(*row));
            shapes.entry(*level).or_default().push_str(&shape);
        }
    }
    shapes
}

/// Fields of the scale, from 0 to 1.
const STEPS: u32 = 4;

/// What the colours mean, below the fields.
fn scale(name: &str, top: f64) -> Markup {
    let at = |step: u32| MARGIN + f64::from(step) * 2.0 * SIDE;
    let share = |step: u32| f64::from(step) / f64::from(STEPS);
    html! {
        @for step in 0..=STEPS {
            rect .cell x=(at(step)) y=(top) width=(2.0 * SIDE) height=(SIDE) fill-opacity=(opacity(share(step))) {}
            text x=(at(step) + SIDE) y=(top + SIDE + 16.0) text-anchor="middle" { (share(step)) }
        }
        text x=(at(STEPS + 1) + 8.0) y=(top + 14.0) { (name) }
    }
}

fn opacity(depth: f64) -> String {
    format!("{:.2}", 0.06 + 0.94 * depth)
}

fn windows(report: &Report) -> (Vec<String>, Vec<Field>) {
    let name = |scenario: &str, window: u32| format!("{scenario}{window}");
    let names: Vec<String> = report
        .samples
        .iter()
        .map(|sample| name(&sample.scenario, sample.window))
        .collect();
    let index = |wanted: &str| names.iter().position(|name| name == wanted);
    let fields = report.comparisons.rows().filter_map(|comparison| {
        let (a, b) = (
            name(comparison.a, comparison.a_window),
            name(comparison.b, comparison.b_window),
        );
        let test = &comparison.test;
        let verdict = if comparison.rejected {
            "rejected"
        } else {
            "not rejected"
        };
        let cells = vec![
            format!("{a} and {b}"),
            format!("{:.3}", test.d),
            format!("{}/{}", test.h, test.lcm),
            format!("{:.2}", test.log10_p),
            verdict.to_owned(),
        ];
        Some(Field {
            row: index(&b)?,
            column: index(&a)?,
            depth: test.d,
            rejected: comparison.rejected,
            words: format!(
                "{a} and {b}: D = {}/{} = {:.3}, log10 p = {:.2}, {verdict}",
                test.h, test.lcm, test.d, test.log10_p
            ),
            cells,
        })
    });
    (names.clone(), fields.collect())
}

fn scenarios(report: &Report) -> (Vec<String>, Vec<Field>) {
    let names: Vec<String> = report.scenarios.iter().map(|it| it.id.clone()).collect();
    let index = |wanted: &str| names.iter().position(|name| name == wanted);
    let fields = report.tallies.iter().filter_map(|tally| {
        Some(Field {
            row: index(&tally.b)?,
            column: index(&tally.a)?,
            depth: tally.rejected as f64 / tally.pairs.max(1) as f64,
            rejected: tally.rejected > 0,
            words: format!(
                "{} and {}: {} of {} window pairs rejected",
                tally.a, tally.b, tally.rejected, tally.pairs
            ),
            cells: vec![
                format!("{} and {}", tally.a, tally.b),
                tally.pairs.to_string(),
                tally.rejected.to_string(),
            ],
        })
    });
    (names.clone(), fields.collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_that_are_alike_and_beside_each_other_are_one_rectangle() {
        let field = |row, column, depth| Field {
            row,
            column,
            depth,
            rejected: false,
            words: String::new(),
            cells: Vec::new(),
        };
        let fields = [
            field(0, 0, 0.0),
            field(1, 1, 0.02),
            field(1, 0, 0.0),
            field(1, 2, 1.0),
        ];
        let shapes = shapes(&fields);
        assert_eq!(shapes[&0], "M40 40h18v18h-18zM40 58h36v18h-36z");
        assert_eq!(shapes[&10], "M76 58h18v18h-18z");
        assert_eq!(shapes.len(), 2);
    }
}
