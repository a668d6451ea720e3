//! The metric of each scenario by its values on two axes: what a sweep over two settings is read from.

use statistics::effect::{level, mean_interval};

use super::{NO_DATA, Table, texts};
use crate::{
    analysis::{report::Report, scenario::ScenarioReport},
    present::{axes::Axes, sweep::Sweep},
};

/// Columns of such a table.
const MOST_COLUMNS: usize = 12;

/// Such tables: of scenarios that differ in further axes, one for each combination of their values.
const MOST_TABLES: usize = 12;

/// The tables; none where scenarios do not differ in two axes, or in two swept settings and others.
pub(super) fn of(report: &Report) -> Vec<Table> {
    let axes = Axes::of(&report.scenarios);
    let swept: Vec<String> = Sweep::all(report).into_iter().map(|sweep| sweep.axis).collect();
    let (([down, across], _) | (_, [down, across])) = (axes.varying.as_slice(), swept.as_slice()) else {
        return Vec::new();
    };
    let others = axes.without(&[down.as_str(), across.as_str()]);
    let mut names: Vec<String> = Vec::new();
    for name in report.scenarios.iter().map(|scenario| others.name(scenario)) {
        if !names.contains(&name) {
            names.push(name);
        }
    }
    let with_name = |name: &String| {
        let scenarios = report.scenarios.iter();
        scenarios
            .filter(|scenario| others.name(scenario) == *name)
            .collect::<Vec<_>>()
    };
    let fields = names.iter().filter_map(|name| {
        let mut table = field(report, &axes, [down, across], &with_name(name))?;
        if !name.is_empty() {
            table.title = format!("{}: {name}", table.title);
        }
        Some(table)
    });
    let mut tables: Vec<Table> = fields.collect();
    let all = tables.len();
    tables.truncate(MOST_TABLES);
    if let Some(last) = tables.last_mut().filter(|_| all > MOST_TABLES) {
        last.notes.push(format!(
            "The first {MOST_TABLES} of {all} such tables; `report.json` has the numbers of all."
        ));
    }
    for (table, number) in tables.iter_mut().zip(1..).skip(1) {
        table.id = format!("{}-{number}", table.id);
    }
    tables
}

/// That of scenarios that differ in these two axes alone; none if there is nothing to go across.
fn field(
    report: &Report,
    axes: &Axes,
    [down, across]: [&String; 2],
    scenarios: &[&ScenarioReport],
) -> Option<Table> {
    let values = |axis: &str| -> Vec<String> {
        let mut values: Vec<String> = Vec::new();
        for value in scenarios.iter().filter_map(|scenario| scenario.axis(axis)) {
            if !values.contains(&value) {
                values.push(value);
            }
        }
        values
    };
    let (rows, columns) = (values(down), values(across));
    let is_a_field = rows.len() > 1 && (2..=MOST_COLUMNS).contains(&columns.len());
    if !is_a_field {
        return None;
    }
    let is_at = |scenario: &&&ScenarioReport, row: &String, column: &String| {
        scenario.axis(down).as_ref() == Some(row) && scenario.axis(across).as_ref() == Some(column)
    };
    let row = |row: &String| {
        let cells = columns.iter().map(|column| {
            let scenario = scenarios.iter().find(|scenario| is_at(scenario, row, column));
            scenario.map_or_else(|| "–".to_owned(), |scenario| cell(report, scenario))
        });
        std::iter::once(row.clone()).chain(cells).collect()
    };
    let mut headings = vec![(axes.heading(down), false)];
    headings.extend(columns.iter().map(|column| (column.as_str(), true)));
    let name = &report.quantity.name;
    Some(Table {
        id: "sweep".to_owned(),
        title: report
            .quantity
            .heading(&format!("The {name} by {down} and {across}")),
        columns: texts(&headings),
        rows: rows.iter().map(row).collect(),
        notes: vec![format!(
            "Rows: {down}. Columns: {across}. The mean of the window means ± half of its interval of 95 % by Student's distribution over \
             windows, which takes them for independent."
        )],
    })
}

fn cell(report: &Report, scenario: &ScenarioReport) -> String {
    let levels = report.levels(&scenario.id);
    let Some(mean) = level(&levels) else {
        return NO_DATA.to_owned();
    };
    let mean = report.quantity.digits(mean);
    match mean_interval(&levels) {
        None => mean,
        Some(interval) => {
            let half = report.quantity.digits((interval.high - interval.low) / 2.0);
            format!("{mean} ± {half}")
        }
    }
}
