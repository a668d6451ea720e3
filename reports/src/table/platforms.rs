//! Tables 2 and 3: what is the same on two platforms, and what virtualization changes on one.

use super::{
    Column, NO_DATA, NOT_INDEPENDENT, Table, clipped, clipped_to, count_and_rejected, marked, no_data_note,
    texts, unlike_note,
};
use crate::report::{Report, ScenarioReport, VIRTUALIZATION, text_of};

/// Characters that the description of a pair may take.
const PAIR_WIDTH: usize = 44;

/// Controls that fit beside each other in a table of 80 columns.
const CONTROLS_A_TABLE: usize = 4;

/// Table 2.
pub(super) fn contrasts(report: &Report) -> Table {
    let controls: Vec<&ScenarioReport> = report.scenarios.iter().filter(|s| s.is_control).collect();
    let mut rows = Vec::new();
    let mut shown = Vec::new();
    for (a, b) in pairs(&controls) {
        let what = format!("controls: {} / {}", platform(report, a), platform(report, b));
        rows.push(row(report, a, b, &what));
        shown.extend([a, b]);
    }
    let others: Vec<&ScenarioReport> = report.scenarios.iter().filter(|s| !s.is_control).collect();
    for (a, b) in pairs(&others)
        .into_iter()
        .filter(|(a, b)| differ_in_virtualization_only(a, b))
    {
        let value = |scenario: &ScenarioReport| scenario.axis(VIRTUALIZATION).unwrap_or_default();
        let what = format!("{} / {} on {}", value(a), value(b), without_virtualization(a));
        rows.push(row(report, a, b, &what));
        shown.extend([a, b]);
    }
    let mut notes: Vec<String> = missing_pairs(report, &controls, &others);
    notes.extend(unlike_note(&rows));
    notes.extend(no_data_note(shown.into_iter()));
    if !rows.is_empty() {
        notes.push(NOT_INDEPENDENT.to_owned());
    }
    Table {
        title: "Table 2. Controls against each other, and virtualizations on each platform".to_owned(),
        columns: texts(&[
            ("", false),
            ("", false),
            ("compared", false),
            ("N", true),
            ("rejected", true),
        ]),
        rows,
        notes,
    }
}

fn row(report: &Report, a: &ScenarioReport, b: &ScenarioReport, what: &str) -> Vec<String> {
    let mut row = vec![a.id.clone(), b.id.clone(), clipped_to(what, PAIR_WIDTH)];
    row.extend(count_and_rejected(report, &a.id, &b.id));
    row
}

/// Every two of them.
fn pairs<'a>(scenarios: &[&'a ScenarioReport]) -> Vec<(&'a ScenarioReport, &'a ScenarioReport)> {
    let firsts = scenarios.iter().enumerate();
    firsts
        .flat_map(|(at, a)| scenarios.iter().skip(at + 1).map(move |b| (*a, *b)))
        .collect()
}

fn missing_pairs(report: &Report, controls: &[&ScenarioReport], others: &[&ScenarioReport]) -> Vec<String> {
    let mut notes = Vec::new();
    match controls {
        [] => notes.push(format!("No control against another: {}.", no_control(report))),
        [one] => notes.push(format!(
            "No control against another: {} is the only one. A host of other hardware or another OS adds one.",
            one.id
        )),
        _ => {}
    }
    if !pairs(others)
        .iter()
        .any(|(a, b)| differ_in_virtualization_only(a, b))
    {
        notes.push(
            "No two virtualizations on one platform besides the control: name at least two on the axis \
             `virtualization`, such as docker and virtualbox."
                .to_owned(),
        );
    }
    notes
}

fn no_control(report: &Report) -> String {
    let axes: Vec<String> = report
        .settings
        .control
        .iter()
        .map(|(axis, value)| format!("{axis}: {value}"))
        .collect();
    format!(
        "no scenario is what `report.control` asks for ({})",
        axes.join(", ")
    )
}

fn differ_in_virtualization_only(a: &ScenarioReport, b: &ScenarioReport) -> bool {
    let axes = || a.axes.keys().chain(b.axes.keys());
    a.axis(VIRTUALIZATION) != b.axis(VIRTUALIZATION)
        && axes()
            .filter(|axis| *axis != VIRTUALIZATION)
            .all(|axis| a.axis(axis) == b.axis(axis))
}

/// The axis values that set a control apart from the other controls.
fn platform(report: &Report, scenario: &ScenarioReport) -> String {
    values(scenario, |axis| !report.settings.control.contains_key(axis))
}

fn without_virtualization(scenario: &ScenarioReport) -> String {
    values(scenario, |axis| axis != VIRTUALIZATION)
}

fn values(scenario: &ScenarioReport, wanted: impl Fn(&str) -> bool) -> String {
    let values: Vec<String> = scenario
        .axes
        .iter()
        .filter(|(axis, _)| wanted(axis))
        .map(|(_, value)| text_of(value))
        .collect();
    if values.is_empty() {
        scenario.slug.clone()
    } else {
        values.join(" ")
    }
}

/// Table 3, in several parts if there are many controls.
pub(super) fn against_controls(report: &Report) -> Vec<Table> {
    let controls: Vec<&ScenarioReport> = report.scenarios.iter().filter(|s| s.is_control).collect();
    let parts = controls.len().div_ceil(CONTROLS_A_TABLE).max(1);
    (0..parts)
        .map(|part| {
            let controls: Vec<_> = controls
                .iter()
                .copied()
                .skip(part * CONTROLS_A_TABLE)
                .take(CONTROLS_A_TABLE)
                .collect();
            let mut table = against(report, &controls);
            if part > 0 {
                table.title.push_str(" (continued)");
            }
            table
        })
        .collect()
}

fn against(report: &Report, controls: &[&ScenarioReport]) -> Table {
    let others: Vec<&ScenarioReport> = report.scenarios.iter().filter(|s| !s.is_control).collect();
    let mut columns = texts(&[("", false), ("scenario", false)]);
    let headings = controls.iter().map(|control| format!("against {}", control.id));
    columns.extend(headings.map(|heading| Column {
        heading,
        is_number: true,
    }));
    let cell = |a: &str, b: &str| match report.tally(a, b) {
        Some(tally) => marked(report, a, b, format!("{} of {}", tally.rejected, tally.pairs)),
        None => NO_DATA.to_owned(),
    };
    let rows = others
        .iter()
        .map(|scenario| {
            let mut row = vec![scenario.id.clone(), clipped(&scenario.slug)];
            row.extend(controls.iter().map(|control| cell(&scenario.id, &control.id)));
            row
        })
        .collect::<Vec<Vec<String>>>();
    let mut notes = vec!["Each cell: rejected, of N window pairs.".to_owned()];
    if controls.is_empty() {
        notes = vec![format!("Nothing to compare with: {}.", no_control(report))];
    } else {
        let names: Vec<String> = controls
            .iter()
            .map(|c| format!("{} is {}", c.id, c.slug))
            .collect();
        notes.push(format!("Controls: {}.", names.join("; ")));
    }
    if others.is_empty() {
        notes.push("Every scenario is a control: add another value to the axis `virtualization`.".to_owned());
    }
    notes.extend(unlike_note(&rows));
    notes.extend(no_data_note(others.iter().chain(controls).copied()));
    notes.push(
        "As in table 2, the pairs of a count share their windows and are not independent tests.".to_owned(),
    );
    Table {
        title: "Table 3. Rejections of each virtualized scenario against each control".to_owned(),
        columns,
        rows,
        notes,
    }
}
