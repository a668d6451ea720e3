//! What was different between two environments whose windows were told apart: the first place to look for why.

use super::{Table, clipped_to, texts};
use crate::analysis::report::Report;

/// Differences that a pair shows; report.json has all.
const MOST: usize = 5;

/// Characters of a field's name or value.
const WIDTH: usize = 20;

/// The table; none where no window pair of the family was rejected.
pub(super) fn of(report: &Report) -> Option<Table> {
    let mut rows = Vec::new();
    let mut notes = vec![
        "From `environment.json`, for the pairs of the family of which a window pair was rejected. What differs need not be \
         the reason, and what is not recorded may be."
            .to_owned(),
    ];
    let rejected = report.contrasts.pairs.iter().filter(|pair| {
        report
            .tally(&pair.a, &pair.b)
            .is_some_and(|tally| tally.rejected > 0)
    });
    for pair in rejected {
        let differences = report.differences(&pair.a, &pair.b);
        if differences.is_empty() {
            notes.push(format!("{} / {}: no difference is recorded.", pair.a, pair.b));
        }
        for difference in differences.iter().take(MOST) {
            let value = |value: &Option<String>| clipped_to(value.as_deref().unwrap_or("–"), WIDTH);
            rows.push(vec![
                pair.a.clone(),
                pair.b.clone(),
                clipped_to(difference.field.trim_start_matches("platform."), WIDTH),
                value(&difference.first),
                value(&difference.second),
            ]);
        }
        if let Some(more @ 1..) = differences.len().checked_sub(MOST) {
            notes.push(format!("{} / {}: {more} more in report.json.", pair.a, pair.b));
        }
    }
    let any = !rows.is_empty() || notes.len() > 1;
    any.then(|| Table {
        id: "environment-differences".to_owned(),
        title: "What was different".to_owned(),
        columns: texts(&[
            ("", false),
            ("", false),
            ("what", false),
            ("in the first", false),
            ("in the second", false),
        ]),
        rows,
        notes,
    })
}
