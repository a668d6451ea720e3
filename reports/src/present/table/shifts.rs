//! How large the differences are, all at once: the forest plot in numbers, which stands before any count.

use statistics::effect::Interval;

use super::{
    Table,
    contrasts::{estimate, rows, signed, simultaneous},
    texts,
};
use crate::{
    analysis::{contrast::Contrast, report::Report},
    present::forest::percent,
};

/// The table; none where no pair of the family has data.
pub(crate) fn of(report: &Report) -> Option<Table> {
    let contrasts = &report.contrasts;
    let millimetres = |metres: f64| signed(metres * 1e3);
    let row = |pair: &Contrast| {
        vec![
            estimate(&pair.effect.shift_m, millimetres),
            pair.simultaneous_m.map_or_else(
                || "cannot".to_owned(),
                |Interval { low, high, .. }| format!("[{}, {}]", millimetres(low), millimetres(high)),
            ),
            pair.verdict.name().to_owned(),
        ]
    };
    (!contrasts.pairs.is_empty()).then(|| Table {
        id: "shifts".to_owned(),
        title: "How large the differences are, all at once".to_owned(),
        columns: texts(&[
            ("", false),
            ("", false),
            ("shift (mm)", true),
            ("all at once", true),
            ("verdict", false),
        ]),
        rows: rows(contrasts, row),
        notes: vec![
            simultaneous(report),
            format!(
                "Shift: of the second scenario against the first, with the interval of each pair by itself. Both intervals are of the \
                 shifts of the mean level that neither the studentised permutation test nor Welch's rejects: they hold where windows \
                 are independent, and either differ by a shift alone or have near normal levels of any spread. \"Cannot\": so few \
                 windows have no interval of {}.",
                percent(contrasts.simultaneous_confidence(&report.settings))
            ),
        ],
    })
}
