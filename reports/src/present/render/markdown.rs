//! Markdown that is also meant to be read as it is, on a terminal of 80 columns.

use comfy_table::{CellAlignment, ContentArrangement, presets::ASCII_MARKDOWN};
use record::run_directory::EnvironmentRecord;

use crate::{
    analysis::{report::Report, scenario::ScenarioReport},
    present::{
        Presentation,
        forest::Forest,
        table::{self, Table},
        writing::other_folder,
    },
};

/// Columns of a terminal.
pub(super) const WIDTH: usize = 80;

pub(super) fn render(page: &Presentation<'_>) -> String {
    let report = page.report;
    let mut text = String::new();
    block(&mut text, &format!("# Report of {}", plain(&report.run)));
    block(&mut text, &wrapped(&plain(&report.findings().join(" ")), "", ""));
    for remark in &page.remarks {
        block(&mut text, &wrapped(&format!("**{}**", plain(remark)), "> ", "> "));
    }
    let origins: Vec<String> = report
        .origins()
        .iter()
        .map(|origin| wrapped(&plain(origin), "- ", "  "))
        .collect();
    block(&mut text, &origins.join("\n"));
    block(&mut text, &wrapped(&plain(&report.method()), "", ""));
    forest(&mut text, report);
    for table in &page.tables {
        render_table(&mut text, table);
    }
    for other in &report.others {
        metric(&mut text, other);
    }
    scenarios(&mut text, report);
    without_markup(&text)
}

/// Names and reasons of a run come from anyone: what would be a tag of HTML or a link in them is text. Ours has neither.
fn without_markup(text: &str) -> String {
    let mut shown = String::with_capacity(text.len());
    let mut letters = text.chars().peekable();
    while let Some(letter) = letters.next() {
        let is_tag = |next: &char| next.is_ascii_alphabetic() || matches!(next, '/' | '!' | '?');
        let is_markup = match letter {
            '<' => letters.peek().is_some_and(is_tag),
            ']' => matches!(letters.peek(), Some('(' | '[')),
            _ => false,
        };
        if is_markup {
            shown.push('\\');
        }
        shown.push(letter);
    }
    shown
}

/// Another metric: how large its differences are. The rest has a folder of its own.
fn metric(text: &mut String, report: &Report) {
    let name = &report.quantity.name;
    block(text, &format!("# Metric {}", plain(name)));
    block(text, &wrapped(&plain(&report.quantity.origin), "", ""));
    forest(text, report);
    if let Some(mut table) = table::shifts(report) {
        // The same words stand with the first metric.
        table.notes.truncate(1);
        render_table(text, &table);
    }
    let folder = other_folder(name);
    block(
        text,
        &wrapped(
            &format!(
                "`report/{}` has all its tables, figures and numbers.",
                folder.display()
            ),
            "",
            "",
        ),
    );
}

fn forest(text: &mut String, report: &Report) {
    if let Some(forest) = Forest::of(report) {
        block(text, &report.quantity.heading("## The shifts of all pairs"));
        block(text, &format!("```text\n{}\n```", forest.text(WIDTH)));
        block(
            text,
            &wrapped(
                &plain(&format!(
                    "{} Here: `=` each pair by itself, `-` all at once, `o` the shift, `|` none, `:` the margin.",
                    forest.caption
                )),
                "",
                "",
            ),
        );
    }
}

pub(super) fn block(text: &mut String, block: &str) {
    if !text.is_empty() {
        text.push('\n');
    }
    text.push_str(block);
    text.push('\n');
}

fn render_table(text: &mut String, table: &Table) {
    block(text, &format!("## {}", plain(&table.title)));
    if !table.rows.is_empty() {
        let head = table.columns.iter().map(|column| cell(&column.heading));
        let rows = table
            .rows
            .iter()
            .map(|row| row.iter().map(|text| cell(text)).collect());
        let numbers = table.columns.iter().map(|column| column.is_number);
        block(text, &drawn(head.collect(), rows, numbers));
    }
    for note in &table.notes {
        block(text, &wrapped(&plain(note), "", ""));
    }
}

/// A table of cells that are as they are to be seen, the columns of numbers set flush right.
pub(super) fn drawn(
    head: Vec<String>,
    rows: impl Iterator<Item = Vec<String>>,
    is_number: impl Iterator<Item = bool>,
) -> String {
    let mut drawn = comfy_table::Table::new();
    drawn
        .load_preset(ASCII_MARKDOWN)
        .set_content_arrangement(ContentArrangement::Disabled);
    drawn.set_header(head);
    drawn.add_rows(rows);
    for (column, is_number) in drawn.column_iter_mut().zip(is_number) {
        if is_number {
            column.set_cell_alignment(CellAlignment::Right);
        }
    }
    drawn.to_string()
}

pub(super) fn cell(text: &str) -> String {
    plain(text).replace('|', "\\|")
}

fn scenarios(text: &mut String, report: &Report) {
    block(text, "## Scenarios");
    let lines: Vec<String> = report.scenarios.iter().map(scenario).collect();
    block(text, &lines.join("\n"));
}

/// One list item for a scenario, and one below it for each thing to be said about it.
fn scenario(scenario: &ScenarioReport) -> String {
    let mut head = format!(
        "**{}** {}: {}",
        scenario.id,
        scenario.slug,
        scenario.standing.name()
    );
    if !scenario.windows.is_empty() {
        head.push_str(&format!(
            ", {} of {} windows count",
            scenario.windows_counted(),
            scenario.windows.len()
        ));
    }
    if scenario.is_simulated {
        head.push_str(" (simulated, not measured)");
    }
    let mut items = vec![wrapped(&plain(&head), "- ", "  ")];
    let mut item = |text: String| items.push(wrapped(&plain(&text), "  - ", "    "));
    if let Some(reason) = &scenario.reason {
        item(reason.clone());
    }
    if let Some(hint) = &scenario.hint {
        item(format!("to do: {hint}"));
    }
    for verdict in scenario.verdicts() {
        item(format!(
            "{verdict}: {}",
            record::window::reasons_in_one_line(verdict.reasons)
        ));
    }
    for broken in &scenario.broken {
        item(format!(
            "window {} broke in {}: {}",
            broken.window, broken.environment, broken.reason
        ));
    }
    if scenario.broken_beside > 0 {
        item(format!(
            "{} more windows broke, which events.jsonl has",
            scenario.broken_beside
        ));
    }
    for remark in scenario.environment.iter().flat_map(EnvironmentRecord::remarks) {
        item(remark);
    }
    items.join("\n")
}

pub(super) fn wrapped(text: &str, first: &str, rest: &str) -> String {
    let options = textwrap::Options::new(WIDTH)
        .initial_indent(first)
        .subsequent_indent(rest)
        .break_words(false)
        .word_splitter(textwrap::WordSplitter::NoHyphenation);
    textwrap::fill(text, options)
}

/// Without line breaks and control characters: a reason may come from a container's output, and this is a terminal.
pub(super) fn plain(text: &str) -> String {
    let spaced: String = text
        .chars()
        .map(|c| if c.is_control() { ' ' } else { c })
        .collect();
    spaced.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_run_says_is_no_markup() {
        assert_eq!(
            without_markup("<img src=x> </b> <!-- [c](http://evil) p < 0.001, a <= b, [1, 2] (s)"),
            "\\<img src=x> \\</b> \\<!-- [c\\](http://evil) p < 0.001, a <= b, [1, 2] (s)"
        );
    }
}
