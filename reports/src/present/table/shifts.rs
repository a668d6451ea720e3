//! How large the differences are, all at once: the forest plot in numbers, which stands before any count.

use statistics::effect::Interval;

use super::{
    Table,
    contrasts::{estimate, simultaneous},
    texts,
};
use crate::{
    analysis::report::Report,
    present::forest::{Shift, percent, simultaneous_confidence},
};

/// The table; none where no pair of the family has data.
pub(crate) fn of(report: &Report) -> Option<Table> {
    let signed = |value: f64| report.quantity.signed(value);
    let row = |pair: &Shift| {
        vec![
            pair.a.clone(),
            pair.b.clone(),
            estimate(&pair.shift, signed),
            pair.all.map_or_else(
                || "cannot".to_owned(),
                |Interval { low, high, .. }| format!("[{}, {}]", signed(low), signed(high)),
            ),
            pair.verdict.name().to_owned(),
        ]
    };
    let rows: Vec<Vec<String>> = Shift::all(report).iter().map(row).collect();
    (!rows.is_empty()).then(|| Table {
        id: "shifts".to_owned(),
        title: "How large the differences are, all at once".to_owned(),
        columns: texts(&[
            ("", false),
            ("", false),
            (&report.quantity.heading("shift"), true),
            ("all at once", true),
            ("verdict", false),
        ]),
        rows,
        notes: vec![simultaneous(report), meaning(report)],
    })
}

fn meaning(report: &Report) -> String {
    let confidence = percent(simultaneous_confidence(report));
    match report.replicates {
        None => format!(
            "Shift: of the second scenario against the first, with the interval of each pair by itself. Both intervals are of the \
             shifts of the mean level that neither the studentised permutation test nor Welch's rejects: they hold where windows \
             are independent, and either differ by a shift alone or have near normal levels of any spread. \"Cannot\": so few \
             windows have no interval of {confidence}."
        ),
        Some(_) => format!(
            "Shift: the mean of the second scenario's environments less that of the first's. The interval takes environments for the \
             units, whatever they do to their windows, and holds where the differences of rounds are symmetric around the shift. \
             \"Cannot\": so few rounds have no interval of {confidence}; the widest that they have is then beside the shift."
        ),
    }
}
