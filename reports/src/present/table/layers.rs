//! Tables I and II: the five layers, and the scenarios by what they are made of.

use polars::{
    error::PolarsResult, frame::DataFrame, prelude::IntoColumn, prelude::NamedFrom, prelude::Series,
};
use record::{
    axis::{HARDWARE, OS, VIRTUALIZATION},
    settings::NetworkBackend,
};

use super::{Column, Table, texts};
use crate::{analysis::report::Report, present::frames};

/// Between the parts of a row's key.
const APART: &str = "\u{1f}";

/// Table I: what the paper calls each layer, and what it is in this run.
pub(super) fn layers(report: &Report, scenarios: &DataFrame) -> PolarsResult<Table> {
    let values = |axis: &str| -> PolarsResult<String> {
        let values = frames::texts(&frames::unique(&scenarios.select([axis])?)?, axis)?;
        let values: Vec<String> = values.into_iter().flatten().collect();
        Ok(if values.is_empty() {
            "–".to_owned()
        } else {
            values.join(", ")
        })
    };
    let (mut experiments, mut networks): (Vec<&str>, Vec<&str>) = (Vec::new(), Vec::new());
    for scenario in &report.scenarios {
        let layer = scenario.experiment.layer();
        if !experiments.contains(&layer) {
            experiments.push(layer);
        }
        let network = scenario.experiment.network().map(NetworkBackend::name);
        networks.extend(network.filter(|network| !networks.contains(network)));
    }
    let network = match networks.as_slice() {
        [] => "–".to_owned(),
        networks => format!("network: {}", networks.join(", ")),
    };
    let rows = [
        ("L5", "robot simulations", experiments.join(", ")),
        ("L4", "Mininet", network),
        ("L3", "virtualization", values(VIRTUALIZATION)?),
        ("L2", "host OS", values(OS)?),
        ("L1", "host machine", values(HARDWARE)?),
    ];
    Ok(Table {
        id: "the-layers-of-a-robot-simulation".to_owned(),
        title: "Table I. The layers of a robot simulation".to_owned(),
        columns: texts(&[("", false), ("layer", false), ("in this run", false)]),
        rows: rows
            .into_iter()
            .map(|(layer, name, here)| vec![layer.to_owned(), name.to_owned(), here])
            .collect(),
        notes: Vec::new(),
    })
}

/// Table II: a row for each platform, a column for each virtualization, in each cell the scenario.
pub(super) fn scenarios(scenarios: &DataFrame) -> PolarsResult<Table> {
    let rows_of = [HARDWARE, OS, "other_axes"];
    let parts = rows_of.map(|axis| frames::texts(scenarios, axis));
    let [hardware, os, others] = parts;
    let (hardware, os, others) = (hardware?, os?, others?);
    let has_others = others.iter().any(Option::is_some);
    let part = |values: &[Option<String>], at: usize| values[at].clone().unwrap_or_else(|| "–".to_owned());
    let keys: Vec<String> = (0..scenarios.height())
        .map(|at| [part(&hardware, at), part(&os, at), part(&others, at)].join(APART))
        .collect();
    let can_run = frames::truths(scenarios, "can_run")?;
    let letters = frames::texts(scenarios, "id")?
        .into_iter()
        .flatten()
        .zip(can_run.iter());
    let letters: Vec<String> = letters
        .map(|(id, can_run)| match can_run {
            Some(true) => id,
            _ => format!("({id})"),
        })
        .collect();
    let mut of_cells = scenarios.select([VIRTUALIZATION])?;
    of_cells.with_column(Series::new("key".into(), keys).into_column())?;
    of_cells.with_column(Series::new("letter".into(), letters).into_column())?;
    let wide = frames::pivot(&of_cells, VIRTUALIZATION, "key", "letter")?;

    let mut columns = texts(&[("L1", false), ("L2", false)]);
    if has_others {
        columns.extend(texts(&[("other axes", false)]));
    }
    let mut cells: Vec<Vec<Option<String>>> = Vec::new();
    for name in wide.get_column_names() {
        if name != "key" {
            columns.push(Column {
                heading: format!("L3 {name}"),
                is_number: false,
            });
        }
        cells.push(frames::texts(&wide, name)?);
    }
    let row = |at: usize| {
        let mut row: Vec<String> = Vec::new();
        for (nth, column) in cells.iter().enumerate() {
            let cell = column[at].clone().unwrap_or_else(|| "–".to_owned());
            match nth {
                0 => row.extend(
                    cell.split(APART)
                        .take(if has_others { 3 } else { 2 })
                        .map(str::to_owned),
                ),
                _ => row.push(cell),
            }
        }
        row
    };
    let is_any_left_out = can_run.iter().any(|can_run| can_run == Some(false));
    Ok(Table {
        id: "the-scenarios".to_owned(),
        title: "Table II. The scenarios".to_owned(),
        columns,
        rows: (0..wide.height()).map(row).collect(),
        notes: is_any_left_out
            .then(|| "In brackets: cannot run; the scenarios say why.".to_owned())
            .into_iter()
            .collect(),
    })
}
