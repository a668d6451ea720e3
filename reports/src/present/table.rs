//! The tables before they are drawn: the paper's I to V in its layout, and what stands beside them. A cell without data says
//! so; it is never a zero. The main type is [`Table`].

mod against_controls;
mod agreement;
mod calls;
mod causes;
mod conclusions;
mod contrasts;
mod differences;
mod expected;
mod layers;
mod other_ways;
mod packets;
mod platforms;
mod releases;
mod replays;
mod replicates;
mod schedule;
mod shifts;
mod sweeps;
mod within;
mod within_scenarios;

use std::collections::{BTreeMap, BTreeSet};

pub(crate) use agreement::of as agreements;
pub(crate) use contrasts::p_in_words;
pub(crate) use shifts::of as shifts;

use record::window::Verdict;

use crate::{
    analysis::{
        comparison::FrameError,
        report::Report,
        scenario::{ScenarioReport, Standing},
    },
    present::{frames, listing::listed},
};

/// A table in no particular medium.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Table {
    /// Its name in files, labels and anchors, such as `the-scenarios`: unique in a report, of lower-case letters, digits and
    /// hyphens. It does not follow the title's words, because users' papers contain it.
    pub id: String,
    /// What it shows.
    pub title: String,
    /// Its columns' headings and alignments.
    pub columns: Vec<Column>,
    /// Its rows, each as long as there are columns.
    pub rows: Vec<Vec<String>>,
    /// What a reader must know, one paragraph each.
    pub notes: Vec<String>,
}

/// One column.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Column {
    /// Its heading.
    pub heading: String,
    /// Whether its cells are numbers, set flush right.
    pub is_number: bool,
}

/// More rows nobody reads, and a browser takes seconds for them. A sweep of a hundred scenarios has 5000 pairs.
const MOST_ROWS: usize = 2000;

impl Table {
    /// Its first rows, and a note where there are more.
    pub(super) fn shortened(mut self) -> Self {
        let rows = self.rows.len();
        if rows > MOST_ROWS {
            self.rows.truncate(MOST_ROWS);
            self.notes.insert(0, first_of(rows));
        }
        self
    }

    /// Whether its cells count tests, so that its caption says how they were made: the paper's Tables III to V.
    pub(crate) fn has_counts(&self) -> bool {
        [within_scenarios::ID, platforms::ID].contains(&self.id.as_str())
            || self.id.starts_with(against_controls::IDS)
    }
}

/// A note on a table that has the first of so many rows.
fn first_of(rows: usize) -> String {
    format!("The first {MOST_ROWS} of {rows} rows; `report.json` has the numbers of all.")
}

/// In place of a number that there is none of.
pub(crate) const NO_DATA: &str = "no data";

/// Characters that a platform's name may take in a table of 80 columns.
const PLATFORM_WIDTH: usize = 16;

const NOT_INDEPENDENT: &str = "The pairs of a count share their windows: with four windows a side, 16 pairs are made of \
    eight measurements. They are not 16 independent tests, and values within a window are correlated, so a count is a \
    description and not a p-value. The counts within scenarios (Table III) show what the same platform gives against \
    itself.";

/// The paper's five tables, made of the frames of scenarios and of counts.
///
/// # Errors
/// When polars refuses, which would be a fault of ours.
pub(crate) fn of_the_paper(report: &Report) -> Result<Vec<Table>, FrameError> {
    let scenarios = frames::scenarios(report)?;
    let counts = frames::counts(report)?;
    let mut tables = vec![
        layers::layers(report, &scenarios)?,
        layers::scenarios(&scenarios)?,
        within_scenarios::of(report, &scenarios, &counts)?,
        platforms::of(report, &counts)?,
    ];
    tables.extend(against_controls::of(report, &counts)?);
    Ok(tables)
}

/// What stands beside them.
pub(crate) fn beside(report: &Report) -> Vec<Table> {
    let mut tables = Vec::from_iter(expected::of(report));
    tables.extend(sweeps::of(report));
    tables.extend(conclusions::of(report));
    tables.extend(replicates::of(report));
    tables.extend(contrasts::of(report));
    tables.extend(differences::of(report));
    tables.extend(causes::of(report));
    tables.push(within::of(report));
    tables.extend(packets::of(report));
    tables.extend(other_ways::of(report));
    tables.extend(replays::of(report));
    tables.extend(schedule::of(report));
    tables.extend(calls::of(report));
    tables.extend(releases::of(report));
    tables
}

fn texts(columns: &[(&str, bool)]) -> Vec<Column> {
    columns
        .iter()
        .map(|(heading, is_number)| Column {
            heading: (*heading).to_owned(),
            is_number: *is_number,
        })
        .collect()
}

/// A note that names the windows that were measured and are not valid. Why they are not stands with the scenarios.
fn verdicts_note(report: &Report) -> Option<String> {
    let doubtful = [Verdict::Suspect.name(), Verdict::Invalid.name()];
    let mut named = Vec::new();
    for scenario in &report.scenarios {
        let verdicts = scenario.verdicts();
        let verdicts = verdicts.iter().filter(|one| doubtful.contains(&one.verdict));
        named.extend(verdicts.map(|one| format!("{} {one}", scenario.id)));
    }
    (!named.is_empty()).then(|| format!("Not valid: {}.", named.join("; ")))
}

/// A count, with a mark where the two did not run the same experiment, which the report's remarks explain.
fn marked(count: String, is_unlike: bool) -> String {
    if is_unlike { format!("{count} *") } else { count }
}

/// What the mark means, for tables in which there is one.
fn unlike_note(rows: &[Vec<String>]) -> Option<String> {
    let is_marked = rows.iter().flatten().any(|cell| cell.ends_with(" *"));
    is_marked.then(|| "* Not the same experiment: see the remark above.".to_owned())
}

fn clipped_to(name: &str, width: usize) -> String {
    if name.chars().count() <= width {
        return name.to_owned();
    }
    let mut clipped: String = name.chars().take(width - 1).collect();
    clipped.push('…');
    clipped
}

fn no_baseline(report: &Report) -> String {
    let axes = report.settings.baseline.iter();
    let axes: Vec<String> = axes.map(|(axis, value)| format!("{axis}: {value}")).collect();
    format!(
        "no scenario is what `report.baseline` asks for ({})",
        axes.join(", ")
    )
}

/// What the platforms of one side of some counts are called: by their operating system alone where it has no other platform
/// among them.
fn short_platforms(
    counts: &polars::frame::DataFrame,
    side: &str,
) -> polars::error::PolarsResult<BTreeMap<String, String>> {
    let names = [format!("{side}_platform"), format!("{side}_os")];
    let each = frames::unique(&counts.select(&names)?)?;
    let [platform, os] = [frames::texts(&each, &names[0])?, frames::texts(&each, &names[1])?];
    let platforms = platform.into_iter().flatten().zip(&os);
    let name = |platform: &str, own: &Option<String>| match own {
        Some(own) if os.iter().flatten().filter(|other| *other == own).count() == 1 => own.clone(),
        _ => platform.to_owned(),
    };
    Ok(platforms
        .map(|(platform, own)| {
            let name = clipped_to(&name(&platform, own), PLATFORM_WIDTH);
            (platform, name)
        })
        .collect())
}

/// A note that names the scenarios that stand like this, and how.
fn named<'a>(
    what: &str,
    scenarios: impl Iterator<Item = &'a ScenarioReport>,
    is: impl Fn(Standing) -> bool,
) -> Option<String> {
    let scenarios = scenarios.filter(|scenario| is(scenario.standing));
    let named: Vec<String> = scenarios
        .map(|scenario| format!("{} ({})", scenario.id, scenario.standing.name()))
        .collect();
    (!named.is_empty()).then(|| format!("{what}: {}.", listed(&named)))
}

/// A note that names the scenarios of a table that have no data, and why.
fn no_data_note<'a>(scenarios: impl Iterator<Item = &'a ScenarioReport>) -> Option<String> {
    let without: BTreeSet<String> = scenarios
        .filter(|scenario| scenario.windows_counted() == 0)
        .map(|scenario| format!("{} ({})", scenario.id, scenario.standing.name()))
        .collect();
    let without: Vec<String> = without.into_iter().collect();
    (!without.is_empty()).then(|| format!("No data of {}: see the scenarios.", listed(&without)))
}
