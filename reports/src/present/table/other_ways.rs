//! The same run decided in other ways.

use super::{Table, texts};
use crate::analysis::{other_ways::Way, report::Report};

/// The table; none where it was not asked for.
pub(super) fn of(report: &Report) -> Option<Table> {
    let of = |[some, all]: [usize; 2]| format!("{some} of {all}");
    let row = |way: &Way| {
        vec![
            if way.setting.is_empty() {
                "as reported"
            } else {
                way.setting
            }
            .to_owned(),
            way.value.clone(),
            of(way.within),
            of(way.between),
            of(way.told_apart),
        ]
    };
    let rows: Vec<Vec<String>> = report.other_ways.iter().map(row).collect();
    (!rows.is_empty()).then(|| Table {
        id: "sensitivity".to_owned(),
        title: "The same run, decided in other ways".to_owned(),
        columns: texts(&[
            ("setting", false),
            ("value", false),
            ("within", true),
            ("between", true),
            ("told apart", true),
        ]),
        rows,
        notes: vec![
            "Each row has one setting of the report otherwise. Within and between: rejected window pairs of the same scenario, and of two. \
             Told apart: pairs of the family."
                .to_owned(),
        ],
    })
}
