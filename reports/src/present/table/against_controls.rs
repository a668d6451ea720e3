//! Table V: every other scenario against each baseline scenario, virtualization by operating system. The paper calls a
//! baseline scenario a control, and its Tables IV and V do so here, too.
//!
//! The paper's Table II has Ubuntu twice, and its Table V once: "Ubuntu, VirtualBox" can be its scenario c or i. Here a column is
//! the platform of its operating system on which the most virtualizations can run, which makes it i, as in Table IV, where
//! Docker and VirtualBox on Ubuntu are g and i. What is on the other platforms stands in a note.

use std::collections::BTreeMap;

use polars::{
    error::PolarsResult,
    frame::DataFrame,
    prelude::{BooleanChunked, IntoColumn, NamedFrom, Series},
};

use super::{Column, NO_DATA, Table, marked, no_baseline, no_data_note, short_platforms, texts, unlike_note};
use crate::{
    analysis::{comparison::sums, report::Report, scenario::ScenarioReport},
    present::frames::{self, pivot, truths},
};

/// What the ids of all these tables begin with.
pub(super) const IDS: &str = "rejections-against-";

/// Platforms that fit beside each other in a table of 80 columns.
const PLATFORMS_A_TABLE: usize = 4;
/// Controls up to which each has tables of its own.
const CONTROLS_APART: usize = 4;

/// The tables: one for each control, in several parts if there are many platforms.
pub(super) fn of(report: &Report, counts: &DataFrame) -> PolarsResult<Vec<Table>> {
    let frame = with_cells(&control_first(counts)?)?;
    let controls: Vec<&ScenarioReport> = report.baseline().filter(|it| it.can_run()).collect();
    if frame.height() == 0 || controls.is_empty() {
        return Ok(vec![Table {
            id: format!("{IDS}the-control"),
            title: "Table V. Rejections against the control".to_owned(),
            columns: Vec::new(),
            rows: Vec::new(),
            notes: missing(report, &controls),
        }]);
    }
    let is_shown = is_shown(&frame)?;
    let (shown, others) = (frame.filter(&is_shown)?, frame.filter(&!&is_shown)?);
    let names = short_platforms(&shown, "b")?;
    let platforms: Vec<String> =
        frames::texts(&frames::unique(&shown.select(["b_platform"])?)?, "b_platform")?
            .into_iter()
            .flatten()
            .collect();
    let mut tables = Vec::new();
    for (nth, control) in controls.iter().enumerate().take(CONTROLS_APART) {
        let of_control = frames::only(&shown, "a", &control.id)?;
        for (part, platforms) in platforms.chunks(PLATFORMS_A_TABLE).enumerate() {
            let mut table = table(&of_control, platforms, &names)?;
            let number = char::from(b'a' + nth as u8);
            table.id = id(nth, &control.id, part);
            table.title = format!(
                "Table V ({number}). Rejections against control {}, {}",
                nth + 1,
                control.id
            );
            if part > 0 {
                table.title.push_str(" (continued)");
            }
            table.notes.insert(
                0,
                format!("Control {}: {} is {}.", nth + 1, control.id, control.slug),
            );
            table.notes.extend(unlike_note(&table.rows));
            tables.push(table);
        }
    }
    if let Some(last) = tables.last_mut() {
        last.notes.extend(notes(report, &others, &controls)?);
    }
    Ok(tables)
}

/// The id of a control's table; `part` counts the tables that its platforms are divided into, from 0.
fn id(nth: usize, control: &str, part: usize) -> String {
    let id = format!("{IDS}control-{}-{control}", nth + 1);
    match part {
        0 => id,
        1 => format!("{id}-continued"),
        more => format!("{id}-continued-{more}"),
    }
}

/// The counts of a control and another scenario, the control as `a`.
fn control_first(counts: &DataFrame) -> PolarsResult<DataFrame> {
    let (a, b) = (truths(counts, "a_is_control")?, truths(counts, "b_is_control")?);
    let mut first = counts.filter(&(a & &!b))?;
    let mut second = counts.filter(&(&!a & b))?;
    let names: Vec<String> = second
        .get_column_names()
        .iter()
        .map(|name| turned(name))
        .collect();
    second.set_column_names(&names)?;
    first.vstack_mut_owned(second.select(counts.get_column_names_owned())?)?;
    Ok(first)
}

/// A column's name when the two scenarios change places.
fn turned(name: &str) -> String {
    match name.split_at_checked(1) {
        Some(("a", rest)) if rest.is_empty() || rest.starts_with('_') => format!("b{rest}"),
        Some(("b", rest)) if rest.is_empty() || rest.starts_with('_') => format!("a{rest}"),
        _ => name.to_owned(),
    }
}

/// With the column `cell`: what is said of a count.
fn with_cells(counts: &DataFrame) -> PolarsResult<DataFrame> {
    let text = |name: &str| frames::texts(counts, name);
    let (pairs, rejected, unlike) = (text("pairs")?, text("rejected")?, text("unlike")?);
    let cells: Vec<String> = (0..counts.height())
        .map(|at| match (&rejected[at], &pairs[at]) {
            (Some(rejected), Some(pairs)) => marked(format!("{rejected} of {pairs}"), unlike[at].is_some()),
            _ => NO_DATA.to_owned(),
        })
        .collect();
    let mut counts = counts.clone();
    counts.with_column(Series::new("cell".into(), cells).into_column())?;
    Ok(counts)
}

/// Which rows are of a platform on which as many virtualizations can run as on any other of its operating system.
fn is_shown(counts: &DataFrame) -> PolarsResult<BooleanChunked> {
    let mut each = frames::unique(&counts.select(["b_os", "b_platform", "b_virtualization"])?)?;
    let ones = vec![1_u32; each.height()];
    each.with_column(Series::new("virtualizations".into(), ones).into_column())?;
    let by_platform = sums(&each, &["b_os", "b_platform"], &["virtualizations"])?;
    let (os, platform) = (
        frames::texts(&by_platform, "b_os")?,
        frames::texts(&by_platform, "b_platform")?,
    );
    let number = by_platform.column("virtualizations")?.u32()?;
    let mut most: BTreeMap<Option<String>, u32> = BTreeMap::new();
    for (os, number) in os.iter().zip(number.iter().flatten()) {
        let so_far = most.entry(os.clone()).or_default();
        *so_far = number.max(*so_far);
    }
    let shown: Vec<&Option<String>> = (0..by_platform.height())
        .filter(|at| number.get(*at) == most.get(&os[*at]).copied())
        .map(|at| &platform[at])
        .collect();
    let rows = frames::texts(counts, "b_platform")?;
    Ok(rows
        .iter()
        .map(|platform| Some(shown.contains(&platform)))
        .collect())
}

/// One control's counts: virtualizations by platforms, and the published ones beside them.
fn table(counts: &DataFrame, platforms: &[String], names: &BTreeMap<String, String>) -> PolarsResult<Table> {
    // As the paper has its rows: VirtualBox, Docker.
    let counts = counts.sort(
        ["b_virtualization"],
        polars::prelude::SortMultipleOptions::default().with_order_descending(true),
    )?;
    let cells = pivot(&counts, "b_platform", "b_virtualization", "cell")?;
    let published = pivot(&counts, "b_platform", "b_virtualization", "published")?;
    let mut named: Vec<(&String, &String)> = platforms
        .iter()
        .filter_map(|platform| Some((names.get(platform)?, platform)))
        .collect();
    named.sort_unstable();
    let mut columns = texts(&[("", false)]);
    let mut content = vec![frames::texts(&cells, "b_virtualization")?];
    for (wide, about) in [(&cells, ""), (&published, "paper: ")] {
        for (name, platform) in &named {
            let Ok(column) = frames::texts(wide, platform) else {
                continue;
            };
            // No column for what the paper does not have.
            if !about.is_empty() && column.iter().all(Option::is_none) {
                continue;
            }
            columns.push(Column {
                heading: format!("{about}{name}"),
                is_number: true,
            });
            content.push(column);
        }
    }
    let row = |at: usize| {
        let cells = content.iter().map(|column| column[at].clone());
        cells.map(|cell| cell.unwrap_or_else(|| "–".to_owned())).collect()
    };
    Ok(Table {
        id: String::new(),
        title: String::new(),
        columns,
        rows: (0..cells.height()).map(row).collect(),
        notes: Vec::new(),
    })
}

fn notes(report: &Report, others: &DataFrame, controls: &[&ScenarioReport]) -> PolarsResult<Vec<String>> {
    let mut notes = vec!["Each cell: rejected, of N window pairs.".to_owned()];
    if others.height() > 0 {
        let text = |name: &str| frames::texts(others, name);
        let (control, id, cell) = (text("a")?, text("b")?, text("cell")?);
        let (virtualization, platform) = (text("b_virtualization")?, text("b_platform")?);
        let said = (0..others.height()).filter_map(|at| {
            Some(format!(
                "{} ({} on {}) against {}: {}",
                id[at].as_ref()?,
                virtualization[at].as_ref()?,
                platform[at].as_ref()?,
                control[at].as_ref()?,
                cell[at].as_ref()?
            ))
        });
        notes.push(format!(
            "An operating system's column is the platform on which the most virtualizations can run. On the others: {}.",
            said.collect::<Vec<_>>().join("; ")
        ));
    }
    if frames::texts(others, "b_paper")?
        .iter()
        .flatten()
        .any(|letter| letter == "c")
    {
        notes.push(
            "The paper does not say which of its two platforms with Ubuntu its cell of Ubuntu and VirtualBox is, c or i of its \
             Table II. It is taken for i, on whose platform Docker runs, too, as in its Table IV; it printed 0 for both controls."
                .to_owned(),
        );
    }
    if let Some(more @ 1..) = controls.len().checked_sub(CONTROLS_APART) {
        let more_are: Vec<&str> = controls
            .iter()
            .rev()
            .take(more)
            .rev()
            .map(|it| it.id.as_str())
            .collect();
        notes.push(format!(
            "Against the further controls {}: `comparisons.csv` has the comparisons, and `report.json` the counts.",
            more_are.join(", ")
        ));
    }
    let shown = report.scenarios.iter().filter(|scenario| scenario.can_run());
    notes.extend(no_data_note(shown));
    notes.push(
        "As in Table IV, the pairs of a count share their windows and are not independent tests.".to_owned(),
    );
    Ok(notes)
}

fn missing(report: &Report, controls: &[&ScenarioReport]) -> Vec<String> {
    match controls {
        [] => vec![format!("Nothing to compare with: {}.", no_baseline(report))],
        _ => vec![
            "Every scenario that can run belongs to the baseline: add another value to the axis `virtualization`."
                .to_owned(),
        ],
    }
}
