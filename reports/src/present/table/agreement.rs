//! Which scenarios have the same, byte for byte, in a metric that is compared so.

use super::{Table, texts};
use crate::{
    analysis::{
        agreement::{Agreement, Group, Parting},
        report::Report,
    },
    present::listing::listed,
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
            format!("{} of {}", group.same_as_first, group.compared),
            group.parts.as_ref().map_or_else(|| "–".to_owned(), parts),
        ]
    };
    let metric = &agreement.metric;
    let mut notes = vec![match (agreement.groups.len(), windows) {
        (0, _) => "No window of any scenario counts.".to_owned(),
        (_, 0) => "No window counts in the first of these scenarios and in another.".to_owned(),
        (1, _) => format!(
            "All scenarios with data have the same {metric}, byte for byte, in every window that they both have."
        ),
        (groups, _) => format!(
            "{groups} different {metric}: the scenarios of a row have the same, byte for byte, in every window that they both have. Same: \
             windows in which the first of them has what the first row has, of those that both have. Part: where they first have something else; the first row's comes \
             first."
        ),
    }];
    if !agreement.without_data.is_empty() {
        notes.push(format!(
            "No data of {}: see the scenarios.",
            listed(&agreement.without_data)
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
