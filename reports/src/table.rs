//! The paper's tables as data, before they are drawn: (1) rejections within each scenario, (2) the experimental controls
//! against each other and the virtualizations against each other on each platform, (3) each virtualized scenario against
//! each control. A cell without data says so; it is never a zero. The main type is [`Table`].

mod contrasts;
mod differences;
mod packets;
mod platforms;
mod releases;
mod schedule;
mod within;

use std::collections::BTreeSet;

use workload::record::window::Verdict;

use crate::report::{Report, ScenarioReport, Standing};

/// A table in no particular medium.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Table {
    /// What it shows.
    pub title: String,
    /// Its columns' headings and alignments.
    pub columns: Vec<Column>,
    /// Its rows, each as long as there are columns.
    pub rows: Vec<Vec<String>>,
    /// What a reader must know, one paragraph each.
    pub notes: Vec<String>,
}

/// One column.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Column {
    /// Its heading.
    pub heading: String,
    /// Whether its cells are numbers, set flush right.
    pub is_number: bool,
}

/// In place of a number that there is none of.
pub(crate) const NO_DATA: &str = "no data";

/// Characters that a scenario's name may take in a table of 80 columns; its letter is its identity there.
const NAME_WIDTH: usize = 28;

const NOT_INDEPENDENT: &str = "The pairs of a count share their windows: with four windows a side, 16 pairs are made of \
    eight measurements. They are not 16 independent tests, and values within a window are correlated, so a count is a \
    description and not a p-value. The counts within scenarios (table 1) show what the same platform gives against \
    itself.";

/// All tables of a report.
pub(crate) fn all(report: &Report) -> Vec<Table> {
    let mut tables = vec![within_scenarios(report), platforms::contrasts(report)];
    tables.extend(platforms::against_controls(report));
    tables.extend(contrasts::of(report));
    tables.extend(differences::of(report));
    tables.push(within::of(report));
    tables.extend(packets::of(report));
    tables.push(schedule::of(report));
    tables.extend(releases::of(report));
    tables
}

fn texts(columns: &[(&str, bool)]) -> Vec<Column> {
    columns
        .iter()
        .map(|(heading, is_number)| Column {
            heading: (*heading).to_owned(),
            is_number: *is_number,
        })
        .collect()
}

fn within_scenarios(report: &Report) -> Table {
    let rows = report
        .scenarios
        .iter()
        .map(|scenario| {
            let mut row = vec![
                scenario.id.clone(),
                clipped(&scenario.slug),
                scenario.standing.name().to_owned(),
            ];
            row.push(match scenario.standing {
                Standing::Infeasible | Standing::NotSelected => "–".to_owned(),
                _ => format!("{}/{}", scenario.windows_counted(), scenario.windows.len()),
            });
            row.extend(count_and_rejected(report, &scenario.id, &scenario.id));
            row
        })
        .collect();
    let mut notes = vec!["N is the number of window pairs, of windows that count.".to_owned()];
    notes.extend(verdicts_note(report));
    Table {
        title: "Table 1. Rejections within each scenario".to_owned(),
        columns: texts(&[
            ("", false),
            ("scenario", false),
            ("outcome", false),
            ("windows", true),
            ("N", true),
            ("rejected", true),
        ]),
        rows,
        notes,
    }
}

/// A note that names the windows that were measured and are not valid. Why they are not stands with the scenarios.
fn verdicts_note(report: &Report) -> Option<String> {
    let doubtful = [Verdict::Suspect.name(), Verdict::Invalid.name()];
    let mut named = Vec::new();
    for scenario in &report.scenarios {
        let verdicts = scenario.verdicts();
        let verdicts = verdicts.iter().filter(|one| doubtful.contains(&one.verdict));
        named.extend(verdicts.map(|one| format!("{} {one}", scenario.id)));
    }
    (!named.is_empty()).then(|| format!("Not valid: {}.", named.join("; ")))
}

/// N and the rejections among them, in two cells.
fn count_and_rejected(report: &Report, a: &str, b: &str) -> [String; 2] {
    match report.tally(a, b) {
        Some(tally) => [
            tally.pairs.to_string(),
            marked(report, a, b, tally.rejected.to_string()),
        ],
        None => ["–".to_owned(), NO_DATA.to_owned()],
    }
}

/// With a mark where the two did not run the same experiment, which the report's remarks explain.
fn marked(report: &Report, a: &str, b: &str, count: String) -> String {
    match report.unlike(a, b) {
        [] => count,
        [..] => format!("{count} *"),
    }
}

/// What the mark means, for tables in which there is one.
fn unlike_note(rows: &[Vec<String>]) -> Option<String> {
    let is_marked = rows.iter().flatten().any(|cell| cell.ends_with(" *"));
    is_marked.then(|| "* Not the same experiment: see the remark above.".to_owned())
}

fn clipped(name: &str) -> String {
    clipped_to(name, NAME_WIDTH)
}

fn clipped_to(name: &str, width: usize) -> String {
    if name.chars().count() <= width {
        return name.to_owned();
    }
    let mut clipped: String = name.chars().take(width - 1).collect();
    clipped.push('…');
    clipped
}

/// A note that names the scenarios of a table that have no data, and why.
fn no_data_note<'a>(scenarios: impl Iterator<Item = &'a ScenarioReport>) -> Option<String> {
    let without: BTreeSet<String> = scenarios
        .filter(|scenario| scenario.windows_counted() == 0)
        .map(|scenario| format!("{} ({})", scenario.id, scenario.standing.name()))
        .collect();
    let without: Vec<String> = without.into_iter().collect();
    (!without.is_empty()).then(|| format!("No data of {}: see the scenarios.", without.join(", ")))
}
