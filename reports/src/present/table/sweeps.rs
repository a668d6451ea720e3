//! The metric of each scenario by its values on two axes: what a sweep over two settings is read from.

use statistics::effect::{level, mean_interval};

use super::{NO_DATA, Table, texts};
use crate::{
    analysis::{report::Report, scenario::ScenarioReport},
    present::axes::Axes,
};

/// Columns of such a table.
const MOST_COLUMNS: usize = 12;

/// The table; none where scenarios do not differ in two axes.
pub(super) fn of(report: &Report) -> Option<Table> {
    let axes = Axes::of(&report.scenarios);
    let [down, across] = axes.varying.as_slice() else {
        return None;
    };
    let values = |axis: &str| -> Vec<String> {
        let mut values: Vec<String> = Vec::new();
        for value in report.scenarios.iter().filter_map(|scenario| scenario.axis(axis)) {
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
    let is_at = |scenario: &&ScenarioReport, row: &String, column: &String| {
        scenario.axis(down).as_ref() == Some(row) && scenario.axis(across).as_ref() == Some(column)
    };
    let row = |row: &String| {
        let cells = columns.iter().map(|column| {
            let scenario = report
                .scenarios
                .iter()
                .find(|scenario| is_at(scenario, row, column));
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
