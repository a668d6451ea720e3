//! Table IV: the baseline scenarios, which the paper calls controls, against each other, and two virtualizations on each
//! platform.

use std::collections::BTreeSet;

use polars::{error::PolarsResult, frame::DataFrame};

use super::{
    MOST_ROWS, NO_DATA, NOT_INDEPENDENT, Table, clipped_to, first_of, marked, no_baseline, no_data_note,
    short_platforms, texts, unlike_note,
};
use crate::{
    analysis::report::Report,
    present::frames::{self, same, truths},
};

/// The table's id.
pub(super) const ID: &str = "controls-and-virtualizations";

/// Characters that one side of a comparison may take.
const SIDE_WIDTH: usize = 24;

const A_CONTROL: &str = "A control is what the paper calls a scenario of the baseline (`report.baseline`).";

/// The table.
pub(super) fn of(report: &Report, counts: &DataFrame) -> PolarsResult<Table> {
    let (a, b) = (truths(counts, "a_is_control")?, truths(counts, "b_is_control")?);
    let is_other = !&same(counts, "a", "b")?;
    let controls = counts.filter(&(&(a & b) & &is_other))?;
    let neither = &!a & &!b;
    let on_one_platform =
        &same(counts, "a_platform", "b_platform")? & &!&same(counts, "a_virtualization", "b_virtualization")?;
    let virtualizations = counts.filter(&(&neither & &on_one_platform))?;

    let platforms = short_platforms(&virtualizations, "a")?;
    let mut rows = rows(&controls, "_platform", |_| "control".to_owned())?;
    rows.extend(self::rows(&virtualizations, "_virtualization", |platform| {
        platforms.get(platform).cloned().unwrap_or_default()
    })?);
    let mut columns = texts(&[
        ("", false),
        ("scenario 1", false),
        ("scenario 2", false),
        ("N", true),
        ("rejected", true),
    ]);
    let has_published = rows.iter().any(|row| row.last().is_some_and(|cell| cell != "–"));
    if has_published {
        columns.extend(texts(&[("paper, of 16", true)]));
    } else {
        rows.iter_mut().for_each(|row| {
            row.pop();
        });
    }
    let mut notes = vec![A_CONTROL.to_owned()];
    let all = controls.height() + virtualizations.height();
    if all > MOST_ROWS {
        rows.truncate(MOST_ROWS);
        notes.insert(0, first_of(all));
    }
    notes.extend(missing_pairs(report, &virtualizations));
    notes.extend(unlike_note(&rows));
    let mut shown = BTreeSet::new();
    for frame in [&controls, &virtualizations] {
        for side in ["a", "b"] {
            shown.extend(frames::texts(frame, side)?.into_iter().flatten());
        }
    }
    let shown = report
        .scenarios
        .iter()
        .filter(|scenario| shown.contains(&scenario.id));
    notes.extend(no_data_note(shown));
    if !rows.is_empty() {
        notes.push(NOT_INDEPENDENT.to_owned());
    }
    Ok(Table {
        id: ID.to_owned(),
        title: "Table IV. Controls against each other, and virtualizations on each platform".to_owned(),
        columns,
        rows,
        notes,
    })
}

/// A row for each of these counts; `side` is what is said of each scenario, `what` of their platform.
fn rows(counts: &DataFrame, side: &str, what: impl Fn(&str) -> String) -> PolarsResult<Vec<Vec<String>>> {
    // More are not shown.
    let counts = &counts.head(Some(MOST_ROWS));
    let text = |name: &str| frames::texts(counts, name);
    let (a, b) = (text("a")?, text("b")?);
    let (a_side, b_side) = (text(&format!("a{side}"))?, text(&format!("b{side}"))?);
    let (platform, unlike) = (text("a_platform")?, text("unlike")?);
    let (pairs, rejected, published) = (text("pairs")?, text("rejected")?, text("published")?);
    let row = |at: usize| {
        let or = |cell: &Option<String>, none: &str| cell.clone().unwrap_or_else(|| none.to_owned());
        let side = |id: &Option<String>, about: &Option<String>| {
            clipped_to(&format!("{} {}", or(id, ""), or(about, "")), SIDE_WIDTH)
        };
        let rejected = match &rejected[at] {
            Some(rejected) => marked(rejected.clone(), unlike[at].is_some()),
            None => NO_DATA.to_owned(),
        };
        vec![
            what(platform[at].as_deref().unwrap_or_default()),
            side(&a[at], &a_side[at]),
            side(&b[at], &b_side[at]),
            or(&pairs[at], "–"),
            rejected,
            or(&published[at], "–"),
        ]
    };
    Ok((0..counts.height()).map(row).collect())
}

fn missing_pairs(report: &Report, virtualizations: &DataFrame) -> Vec<String> {
    let mut notes = Vec::new();
    let controls: Vec<&str> = report.baseline().map(|control| control.id.as_str()).collect();
    match controls.as_slice() {
        [] => notes.push(format!("No control against another: {}.", no_baseline(report))),
        [one] => notes.push(format!(
            "No control against another: {one} is the only one. A host of other hardware or another OS adds one."
        )),
        _ => {}
    }
    if virtualizations.height() == 0 {
        notes.push(
            "No two virtualizations on one platform besides the baseline can run: name at least two on the axis \
             `virtualization`, such as docker and virtualbox. The scenarios say why one cannot."
                .to_owned(),
        );
    }
    notes
}
