//! Table III: rejections within each scenario that can run.

use polars::{error::PolarsResult, frame::DataFrame};
use record::axis::{HARDWARE, NATIVE, OS, VIRTUALIZATION};

use super::{NO_DATA, Table, clipped_to, named, texts, verdicts_note};
use crate::{
    analysis::{paper, report::Report, scenario::Standing},
    present::frames::{self, left, truths},
};

/// The table's id.
pub(super) const ID: &str = "rejections-within-each-scenario";

/// Characters of a layer.
const LAYER_WIDTH: usize = 14;

/// The table.
pub(super) fn of(report: &Report, scenarios: &DataFrame, counts: &DataFrame) -> PolarsResult<Table> {
    let mut own =
        counts
            .filter(&frames::same(counts, "a", "b")?)?
            .select(["a", "pairs", "rejected", "published"])?;
    own.rename("a", "id".into())?;
    let can_run = scenarios.filter(truths(scenarios, "can_run")?)?;
    let frame = left(&can_run, &own, &["id"])?;

    let text = |name: &str| frames::texts(&frame, name);
    let has = |cells: &[Option<String>]| cells.iter().any(Option::is_some);
    let or = |cell: &Option<String>, none: &str| cell.clone().unwrap_or_else(|| none.to_owned());
    let (others, published) = (text("other_axes")?, text("published")?);
    let (ids, hardware, os) = (text("id")?, text(HARDWARE)?, text(OS)?);
    let virtualization = text(VIRTUALIZATION)?;
    let (counted, windows) = (text("windows_counted")?, text("windows")?);
    let (pairs, rejected) = (text("pairs")?, text("rejected")?);
    let row = |at: usize| {
        let layer = |cells: &[Option<String>]| clipped_to(&or(&cells[at], "–"), LAYER_WIDTH);
        let mut row = vec![or(&ids[at], ""), layer(&hardware), layer(&os)];
        if has(&others) {
            row.push(or(&others[at], "–"));
        }
        row.push(match virtualization[at].as_deref() {
            Some(NATIVE) | None => "–".to_owned(),
            Some(other) => clipped_to(other, LAYER_WIDTH),
        });
        row.push(format!("{}/{}", or(&counted[at], ""), or(&windows[at], "")));
        row.extend([or(&pairs[at], "–"), or(&rejected[at], NO_DATA)]);
        if has(&published) {
            row.push(or(&published[at], "–"));
        }
        row
    };
    let mut columns = texts(&[("", false), ("L1", false), ("L2", false)]);
    if has(&others) {
        columns.extend(texts(&[("other axes", false)]));
    }
    columns.extend(texts(&[
        ("L3", false),
        ("windows", true),
        ("N", true),
        ("rejected", true),
    ]));
    if has(&published) {
        columns.extend(texts(&[("paper, of 6", true)]));
    }
    Ok(Table {
        id: ID.to_owned(),
        title: "Table III. Rejections within each scenario".to_owned(),
        columns,
        rows: (0..frame.height()).map(row).collect(),
        notes: notes(report),
    })
}

fn notes(report: &Report) -> Vec<String> {
    let mut notes = vec!["N is the number of window pairs, of windows that count.".to_owned()];
    notes.extend(named(
        "Cannot run, so without a row",
        report.scenarios.iter(),
        |standing| standing == Standing::Infeasible,
    ));
    notes.extend(named("Not completed", report.scenarios.iter(), |standing| {
        !matches!(standing, Standing::Infeasible | Standing::Completed)
    }));
    notes.extend(verdicts_note(report));
    notes.extend(papers_note(report));
    notes
}

/// Which of the paper's scenarios are not there to stand beside its counts.
fn papers_note(report: &Report) -> Option<String> {
    // Counts of another experiment are not to be held against the paper's.
    report.quantity.is_tracking_error.then(|| match paper::missing(&report.scenarios).as_slice() {
        [] => "Paper: the counts that it printed for the same scenario.".to_owned(),
        missing if missing.len() == paper::SCENARIOS.len() => {
            "None of the paper's scenarios is in this run, so that its counts do not stand beside.".to_owned()
        }
        missing => format!(
            "Paper: the counts that it printed for the same scenario. Its scenarios {} are not in this run.",
            missing.join(", ")
        ),
    })
}
