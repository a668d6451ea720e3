//! What the tables of counts are made of: the scenarios and the counts as frames, joined, and the few operations that polars
//! has only with its feature `lazy`, which doubles its build. docs/report-columns.md has the same in Python.

use polars::{
    df,
    error::PolarsResult,
    frame::{DataFrame, UniqueKeepStrategy},
    prelude::{
        BooleanChunked, ChunkCompareEq, Column, DataFrameJoinOps, DataType, IntoColumn, JoinArgs, JoinType,
        MaintainOrderJoin, NamedFrom, Series,
    },
};
use record::axis::{HARDWARE, OS, VIRTUALIZATION};

use crate::analysis::{paper, report::Report, scenario::ScenarioReport};

/// What a comparison has of each of its two scenarios, as `a_slug`, `b_slug` and so on.
const OF_A_SCENARIO: [&str; 7] = [
    "slug",
    HARDWARE,
    OS,
    VIRTUALIZATION,
    "platform",
    "is_control",
    "paper",
];

/// A row for each scenario of the plan, in its order.
pub(crate) fn scenarios(report: &Report) -> PolarsResult<DataFrame> {
    fn column<'a, T>(report: &'a Report, of: impl Fn(&'a ScenarioReport) -> T) -> Vec<T> {
        report.scenarios.iter().map(of).collect()
    }
    df![
        "id" => column(report, |it| it.id.as_str()),
        "slug" => column(report, |it| it.slug.as_str()),
        HARDWARE => column(report, |it| it.axis(HARDWARE)),
        OS => column(report, |it| it.axis(OS)),
        VIRTUALIZATION => column(report, ScenarioReport::virtualization),
        "other_axes" => column(report, other_axes),
        "platform" => column(report, ScenarioReport::platform),
        "is_control" => column(report, |it| it.is_baseline),
        "simulated" => column(report, |it| it.is_simulated),
        "can_run" => column(report, ScenarioReport::can_run),
        "outcome" => column(report, |it| it.standing.name()),
        "windows" => column(report, |it| it.windows.len() as u32),
        "windows_counted" => column(report, |it| it.windows_counted() as u32),
        "paper" => paper::letters(&report.scenarios),
    ]
}

/// The values of the axes that are no layer of the paper; none without such.
fn other_axes(scenario: &ScenarioReport) -> Option<String> {
    let layers = [HARDWARE, OS, VIRTUALIZATION];
    let others = scenario
        .axes
        .keys()
        .filter(|axis| !layers.contains(&axis.as_str()));
    let values: Vec<String> = others.filter_map(|axis| scenario.axis(axis)).collect();
    (!values.is_empty()).then(|| values.join(" "))
}

/// A frame of pairs `a`, `b` with what there is of both scenarios, and of what is not the same of their experiments.
pub(crate) fn with_scenarios(
    report: &Report,
    pairs: &DataFrame,
    scenarios: &DataFrame,
) -> PolarsResult<DataFrame> {
    let mut joined = left(pairs, &unlike(report)?, &["a", "b"])?;
    for side in ["a", "b"] {
        let mut of_side = scenarios.select(["id"].into_iter().chain(OF_A_SCENARIO))?;
        let names = OF_A_SCENARIO.map(|name| format!("{side}_{name}"));
        of_side.rename("id", side.into())?;
        of_side.rename_many(
            OF_A_SCENARIO
                .into_iter()
                .zip(names.iter().map(|name| name.as_str().into())),
        )?;
        joined = left(&joined, &of_side, &[side])?;
    }
    let same = same(&joined, "a", "b")?;
    joined.with_column(Series::new("same_scenario".into(), same).into_column())?;
    Ok(joined)
}

/// Every two scenarios that can run with their count, which is null without data, and all else of [`with_scenarios`].
pub(crate) fn counts(report: &Report) -> PolarsResult<DataFrame> {
    let scenarios = scenarios(report)?;
    let can_run = scenarios.filter(truths(&scenarios, "can_run")?)?;
    let ids = texts(&can_run, "id")?;
    let every_two = || (0..ids.len()).flat_map(|a| (a..ids.len()).map(move |b| (a, b)));
    let pairs = df![
        "a" => Vec::from_iter(every_two().map(|(a, _)| ids[a].as_deref())),
        "b" => Vec::from_iter(every_two().map(|(_, b)| ids[b].as_deref())),
    ]?;
    let counted = report.comparisons.counts();
    let pairs = if counted.height() == 0 {
        let nothing = || vec![None::<u32>; pairs.height()];
        pairs.hstack(df!["pairs" => nothing(), "rejected" => nothing()]?.columns())?
    } else {
        left(&pairs, counted, &["a", "b"])?
    };
    let joined = with_scenarios(report, &pairs, &scenarios)?;
    left(&joined, &paper::published()?, &["a_paper", "b_paper"])
}

/// What is not the same of two experiments, in either order of the two.
fn unlike(report: &Report) -> PolarsResult<DataFrame> {
    let both = || {
        report
            .setup_differences
            .iter()
            .flat_map(|it| [(&*it.a, &*it.b, it), (&*it.b, &*it.a, it)])
    };
    df![
        "a" => Vec::from_iter(both().map(|(a, ..)| a)),
        "b" => Vec::from_iter(both().map(|(_, b, _)| b)),
        "unlike" => Vec::from_iter(both().map(|(.., it)| it.fields.join(" "))),
    ]
}

/// Each row of the frame with that row of the other one that has the same keys, if there is one.
pub(crate) fn left(frame: &DataFrame, other: &DataFrame, on: &[&str]) -> PolarsResult<DataFrame> {
    let arguments = JoinArgs {
        nulls_equal: false,
        maintain_order: MaintainOrderJoin::Left,
        ..JoinArgs::new(JoinType::Left)
    };
    frame.join(other, on, on, arguments, None)
}

/// A row for each value of `index` and a column for each value of `on`, both in the order in which they first appear; in
/// Python `DataFrame.pivot`.
pub(crate) fn pivot(frame: &DataFrame, on: &str, index: &str, values: &str) -> PolarsResult<DataFrame> {
    let mut wide = unique(&frame.select([index])?)?;
    for value in texts(&unique(&frame.select([on])?)?, on)?.into_iter().flatten() {
        let mut own = only(frame, on, &value)?.select([index, values])?;
        own.set_column_names(&[index, &value])?;
        wide = left(&wide, &own, &[index])?;
    }
    Ok(wide)
}

/// The rows with this text in a column.
pub(crate) fn only(frame: &DataFrame, column: &str, text: &str) -> PolarsResult<DataFrame> {
    frame.filter(&frame.column(column)?.str()?.equal(text))
}

/// Without the rows that are there before.
pub(crate) fn unique(frame: &DataFrame) -> PolarsResult<DataFrame> {
    frame.unique_stable(None, UniqueKeepStrategy::First, None)
}

/// A column of truths.
pub(crate) fn truths<'a>(frame: &'a DataFrame, name: &str) -> PolarsResult<&'a BooleanChunked> {
    frame.column(name)?.bool()
}

/// Whether two columns of texts have the same.
pub(crate) fn same(frame: &DataFrame, a: &str, b: &str) -> PolarsResult<BooleanChunked> {
    Ok(frame.column(a)?.str()?.equal(frame.column(b)?.str()?))
}

/// A column as texts, of whatever type.
pub(crate) fn texts(frame: &DataFrame, name: &str) -> PolarsResult<Vec<Option<String>>> {
    let column: Column = frame.column(name)?.cast(&DataType::String)?;
    Ok(column.str()?.iter().map(|text| text.map(str::to_owned)).collect())
}
