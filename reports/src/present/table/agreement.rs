//! Which scenarios have the same, byte for byte, in a metric that is compared so.

use super::{Table, texts};
use crate::analysis::{
    agreement::{Agreement, Group, Parting},
    report::Report,
};

/// A table for each such metric.
pub(crate) fn of(report: &Report) -> Vec<Table> {
    report.agreements.iter().enumerate().map(table).collect()
}

fn table((number, agreement): (usize, &Agreement)) -> Table {
    let windows = agreement.windows.len();
    let row = |group: &Group| {
        vec![
            group.scenarios.join(", "),
            format!("{} of {windows}", group.same_as_first),
            group.parts.as_ref().map_or_else(|| "–".to_owned(), parts),
        ]
    };
    let metric = &agreement.metric;
    let mut notes = vec![match (agreement.groups.len(), windows) {
        (0, _) => "No window of any scenario counts.".to_owned(),
        (_, 0) => "There is no window that counts in all of these scenarios.".to_owned(),
        (1, _) => format!(
            "All scenarios with data have the same {metric}, byte for byte, in windows of the same number."
        ),
        (groups, _) => format!(
            "{groups} different {metric}: the scenarios of a row have the same, byte for byte, in windows of the same number. Same: \
             windows in which they have what the first row has. Part: where they first have something else; the first row's comes \
             first."
        ),
    }];
    if !agreement.without_data.is_empty() {
        notes.push(format!(
            "No data of {}: see the scenarios.",
            agreement.without_data.join(", ")
        ));
    }
    Table {
        id: format!("identical-{}", number + 1),
        title: format!("Which scenarios have the same {metric}"),
        columns: texts(&[("scenarios", false), ("same", true), ("part", false)]),
        rows: agreement.groups.iter().map(row).collect(),
        notes,
    }
}

fn parts(parting: &Parting) -> String {
    let Parting {
        window,
        byte,
        line,
        first,
        this,
    } = parting;
    match byte {
        Some(byte) => format!("window {window}, line {line}, byte {byte}: `{first}`, `{this}`"),
        None => format!("window {window}, after the first MiB"),
    }
}
