//! Several runs as one: machines that were measured apart make one matrix, if the runs are of the same experiment and are to
//! be reported in the same way. The function is [`combine`].

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt,
};

use record::{
    report_settings::{DrawnPair, ReportSettings},
    run_directory::letter,
};
use serde_json::{Value, json};

use crate::{
    analysis::{fields, setup},
    input::run::{Ending, Run, ScenarioRun},
};

/// The axis that tells apart what several runs measured.
const RUN: &str = "run";

/// The axis that sweeps a setting on which others depend.
const DYNAMICS: &str = "dynamics";

/// What becomes of a scenario that several runs measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Repeated {
    /// It is an error: nothing says which of them is meant.
    Refused,
    /// Each is a scenario of its own, by an axis `run` with the run's name. All scenarios get it.
    Distinguished,
}

/// Why runs make no one matrix.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Misfit {
    /// One is there twice.
    #[error("run {run} is there twice")]
    SameRun {
        /// The run's id.
        run: String,
    },
    /// The reports that they declare are not the same.
    #[error("{first} and {second} declare other reports: `{field}` is {value} and {other}")]
    Declaration {
        /// The first run.
        first: String,
        /// Another.
        second: String,
        /// What of `report:` is not the same.
        field: String,
        /// The first one's, as JSON.
        value: String,
        /// The other one's.
        other: String,
    },
    /// The names of their axes are not the same.
    #[error("{first} and {second} have other axes: {axes} and {others}")]
    Axes {
        /// The first run.
        first: String,
        /// Another.
        second: String,
        /// The first one's.
        axes: String,
        /// The other one's.
        others: String,
    },
    /// They ran other experiments.
    #[error("{first} and {second} ran other experiments: they differ in {}", fields.join(", "))]
    Experiment {
        /// The first run.
        first: String,
        /// Another.
        second: String,
        /// In what, such as `network.delay`.
        fields: Vec<String>,
    },
    /// Several measured the same scenario.
    #[error("{first} and {second} both measured {slug}")]
    Scenario {
        /// The first run.
        first: String,
        /// Another.
        second: String,
        /// The scenario.
        slug: String,
    },
    /// A declaration has letters that mean other scenarios in other runs.
    #[error("`report.{field}` names `{name}`, a letter that is not the same scenario in all runs")]
    Letter {
        /// `family` or `figures`.
        field: &'static str,
        /// The letter.
        name: String,
    },
}

/// All that keeps runs from being one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Misfits(pub Vec<Misfit>);

impl fmt::Display for Misfits {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        const MOST: usize = 6;
        let mut told: Vec<String> = self.0.iter().take(MOST).map(ToString::to_string).collect();
        if let Some(more @ 1..) = self.0.len().checked_sub(MOST) {
            told.push(format!("and {more} more"));
        }
        // Names and settings are what the run directories say.
        let told = told.join("; ").replace(char::is_control, " ");
        write!(f, "the runs are not of one matrix: {told}")
    }
}

impl std::error::Error for Misfits {}

impl Misfits {
    /// What to do about the first of them.
    #[must_use]
    pub fn hint(&self) -> Option<String> {
        Some(match self.0.first()? {
            Misfit::SameRun { .. } => "name each run directory once".to_owned(),
            Misfit::Declaration { field, .. } => match field.as_str() {
                "alpha" | "method" | "metric" | "error" | "discard_periods" | "warm_up" => format!(
                    "say which is meant for all of them, with `--{}`",
                    field.replace('_', "-")
                ),
                _ => "report each by itself with `matrix report RUN`".to_owned(),
            },
            Misfit::Axes { .. } | Misfit::Experiment { .. } => {
                "only runs of the same experiment make one matrix: report each by itself with `matrix report RUN`"
                    .to_owned()
            }
            Misfit::Scenario { .. } => {
                "leave one of them out, or give `--by-run` to have each as a scenario of its own".to_owned()
            }
            Misfit::Letter { .. } => "name scenarios by their slugs there".to_owned(),
        })
    }
}

/// Puts runs together. A scenario that one of them measured and others did not is the one's. Letters stay if they mean the
/// same scenarios in all runs, as in runs of one matrix file with `--only`; otherwise scenarios are lettered in the order of
/// the runs and their plans.
///
/// # Errors
/// All that does not fit.
pub fn combine(mut runs: Vec<Run>, repeated: Repeated) -> Result<Run, Misfits> {
    let misfits = misfits(&runs);
    if !misfits.is_empty() {
        return Err(Misfits(misfits));
    }
    if repeated == Repeated::Distinguished {
        runs.iter_mut().for_each(distinguish);
    }
    let mut report = runs
        .first()
        .map(|run| run.manifest.report.clone())
        .unwrap_or_default();
    report.figures = figures(&runs);
    let mut combined: Option<Run> = None;
    let mut groups = Groups::default();
    for run in runs {
        for scenario in run.scenarios {
            groups.add(&run.manifest.run, scenario);
        }
        match &mut combined {
            None => {
                combined = Some(Run {
                    scenarios: Vec::new(),
                    ..run
                })
            }
            Some(combined) => {
                combined.manifest.created = combined.manifest.created.clone().max(run.manifest.created);
                combined.manifest.run = format!("{} + {}", combined.manifest.run, run.manifest.run);
                combined.parts.extend(run.parts);
                for remark in run.remarks {
                    if !combined.remarks.contains(&remark) {
                        combined.remarks.push(remark);
                    }
                }
            }
        }
    }
    let mut combined = combined.ok_or_else(|| Misfits(Vec::new()))?;
    combined.manifest.report = report;
    groups.settle(combined)
}

/// What does not fit of whole runs, each held against those before it.
fn misfits(runs: &[Run]) -> Vec<Misfit> {
    let mut found = Vec::new();
    for (at, second) in runs.iter().enumerate() {
        for first in runs.iter().take(at) {
            match first.manifest.run == second.manifest.run {
                true => found.push(Misfit::SameRun {
                    run: first.manifest.run.clone(),
                }),
                false => found.extend(misfits_of(first, second)),
            }
        }
    }
    found
}

fn misfits_of(first: &Run, second: &Run) -> Vec<Misfit> {
    let names = || (first.manifest.run.clone(), second.manifest.run.clone());
    let mut found = Vec::new();
    for (field, value, other) in fields::differing(&declared(first), &declared(second)) {
        let (first, second) = names();
        let (value, other) = (value.to_string(), other.to_string());
        found.push(Misfit::Declaration {
            first,
            second,
            field,
            value,
            other,
        });
    }
    let (axes, others) = (axes(first), axes(second));
    if axes != others {
        let (first, second) = names();
        found.push(Misfit::Axes {
            first,
            second,
            axes,
            others,
        });
    }
    let (experiments, others) = (experiments(first), experiments(second));
    let every_two = experiments
        .iter()
        .flat_map(|one| others.iter().map(move |other| (one, other)));
    let fields: BTreeSet<String> = every_two
        .filter(|((dynamics, _), (others, _))| dynamics == others)
        .flat_map(|((_, one), (_, other))| setup::differing(one, other))
        .collect();
    if !fields.is_empty() {
        let (first, second) = names();
        let fields = fields.into_iter().collect();
        found.push(Misfit::Experiment {
            first,
            second,
            fields,
        });
    }
    found
}

/// The distinct experiments of a run, without what its axes sweep. An axis of dynamics changes many settings at once: only
/// scenarios with the same value of it are held against each other.
fn experiments(run: &Run) -> Vec<(Option<&Value>, Value)> {
    let mut distinct = Vec::new();
    for scenario in run.scenarios.iter().filter(|scenario| scenario.planned.runs()) {
        let planned = &scenario.planned;
        let experiment = (planned.axes.get(DYNAMICS), setup::experiment(planned));
        if !distinct.contains(&experiment) {
            distinct.push(experiment);
        }
    }
    distinct
}

/// All that must be declared alike; which figures are drawn changes no number.
fn declared(run: &Run) -> Value {
    let settings = ReportSettings {
        figures: Vec::new(),
        ..run.manifest.report.clone()
    };
    // Plain data can always be written as JSON.
    serde_json::to_value(settings).unwrap_or_default()
}

/// The axes that all of a run's scenarios have, by name.
fn axes(run: &Run) -> String {
    let names = run
        .scenarios
        .iter()
        .map(|scenario| scenario.planned.axes.keys().collect::<BTreeSet<_>>());
    let common = names.reduce(|common, names| &common & &names).unwrap_or_default();
    common
        .into_iter()
        .map(String::as_str)
        .collect::<Vec<_>>()
        .join(", ")
}

fn figures(runs: &[Run]) -> Vec<DrawnPair> {
    let mut figures: Vec<DrawnPair> = Vec::new();
    for pair in runs.iter().flat_map(|run| &run.manifest.report.figures) {
        if !figures.contains(pair) {
            figures.push(pair.clone());
        }
    }
    figures
}

/// Makes each scenario one of this run alone. What it left out is another run's to show.
fn distinguish(run: &mut Run) {
    let name = &run.manifest.run;
    run.scenarios
        .retain(|scenario| !matches!(scenario.ending, Ending::NotSelected { .. }));
    for scenario in &mut run.scenarios {
        scenario.planned.axes.insert(RUN.to_owned(), json!(name));
        scenario.planned.slug = format!("{}-{name}", scenario.planned.slug);
    }
}

/// The same scenario in several runs, by its axis values.
#[derive(Default)]
struct Groups {
    /// In the order in which they were met first.
    groups: Vec<Vec<(String, ScenarioRun)>>,
    /// Where each is, by its axis values.
    places: BTreeMap<String, usize>,
}

impl Groups {
    fn add(&mut self, run: &str, scenario: ScenarioRun) {
        let values: BTreeMap<_, _> = scenario.planned.axes.iter().collect();
        let place = *self
            .places
            .entry(json!(values).to_string())
            .or_insert(self.groups.len());
        let member = (run.to_owned(), scenario);
        match self.groups.get_mut(place) {
            Some(group) => group.push(member),
            None => self.groups.push(vec![member]),
        }
    }

    /// Takes one of each group into the combined run.
    fn settle(mut self, mut combined: Run) -> Result<Run, Misfits> {
        let has_letters = self.keep_their_letters();
        let mut found = match has_letters {
            true => Vec::new(),
            false => self.letters_named(&combined.manifest.report),
        };
        if has_letters {
            self.groups.sort_by_key(|group| {
                let letter = group.first().map(|(_, scenario)| scenario.planned.id.clone());
                letter.map(|letter| (letter.len(), letter))
            });
        }
        for part in &mut combined.parts {
            part.scenarios.clear();
        }
        for (place, group) in self.groups.into_iter().enumerate() {
            let (run, mut scenario) = match chosen(group, &mut combined.remarks) {
                Ok(Some(chosen)) => chosen,
                Ok(None) => continue,
                Err(misfit) => {
                    found.push(misfit);
                    continue;
                }
            };
            if !has_letters {
                scenario.planned.id = letter(place);
            }
            if scenario.counted().next().is_some() {
                let part = combined.parts.iter_mut().find(|part| part.run == run);
                part.into_iter()
                    .for_each(|part| part.scenarios.push(scenario.planned.id.clone()));
            }
            combined.scenarios.push(scenario);
        }
        if !has_letters {
            combined.remarks.push(
                "The runs have other letters for the same scenarios, or the same letters for others: the letters here are \
                 this report's own."
                    .to_owned(),
            );
        }
        match found.is_empty() {
            true => Ok(combined),
            false => Err(Misfits(found)),
        }
    }

    /// Whether a letter means one scenario, and a scenario has one letter, in all runs.
    fn keep_their_letters(&self) -> bool {
        let mut used = BTreeSet::new();
        self.groups.iter().all(|group| {
            let letters: BTreeSet<&str> = group
                .iter()
                .map(|(_, scenario)| scenario.planned.id.as_str())
                .collect();
            letters.len() == 1 && letters.into_iter().all(|letter| used.insert(letter))
        })
    }

    /// What declarations name by letters that mean other scenarios elsewhere.
    fn letters_named(&self, report: &ReportSettings) -> Vec<Misfit> {
        let scenarios = || {
            self.groups
                .iter()
                .flatten()
                .map(|(_, scenario)| &scenario.planned)
        };
        let is_letter = |name: &str| {
            scenarios().any(|planned| planned.id == name) && scenarios().all(|planned| planned.slug != name)
        };
        let figures = report
            .figures
            .iter()
            .flat_map(DrawnPair::sides)
            .map(|side| side.name.as_str());
        let family = report.family.names().map(|name| ("family", name));
        let names = family.chain(figures.map(|name| ("figures", name)));
        names
            .filter(|(_, name)| is_letter(name))
            .map(|(field, name)| Misfit::Letter {
                field,
                name: name.to_owned(),
            })
            .collect()
    }
}

/// How much a run has of a scenario.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
enum Worth {
    NotSelected,
    Infeasible,
    NotStarted,
    Begun,
    Measured,
}

impl Worth {
    fn of(scenario: &ScenarioRun) -> Self {
        match scenario.ending {
            _ if scenario.counted().next().is_some() => Self::Measured,
            Ending::Ended { .. } | Ending::Unfinished => Self::Begun,
            Ending::NotStarted => Self::NotStarted,
            Ending::Infeasible { .. } => Self::Infeasible,
            Ending::NotSelected { .. } => Self::NotSelected,
        }
    }
}

/// The one of the same scenario's runs that has most of it, the first of those that have as much. What was begun elsewhere, and
/// left no window that counts, is remarked.
fn chosen(
    mut group: Vec<(String, ScenarioRun)>,
    remarks: &mut Vec<String>,
) -> Result<Option<(String, ScenarioRun)>, Misfit> {
    // The last of the largest wins, and so the first of them from behind.
    group.reverse();
    let best =
        (0..group.len()).max_by_key(|place| group.get(*place).map(|(_, scenario)| Worth::of(scenario)));
    let Some((run, scenario)) = best.map(|place| group.remove(place)) else {
        return Ok(None);
    };
    let slug = &scenario.planned.slug;
    for (other, left_out) in group.into_iter().rev() {
        match Worth::of(&left_out) {
            Worth::Measured => {
                return Err(Misfit::Scenario {
                    first: run,
                    second: other,
                    slug: slug.clone(),
                });
            }
            Worth::Begun => remarks.push(format!(
                "{slug} was begun in run {other} too, and is taken from run {run}."
            )),
            Worth::NotStarted | Worth::Infeasible | Worth::NotSelected => {}
        }
    }
    Ok(Some((run, scenario)))
}
