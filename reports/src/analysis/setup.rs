//! Whether two scenarios ran the same experiment. Windows over other networks, at another rate or by another version of the
//! workload differ whatever they ran on, so that a difference between them says nothing of the platform. The main type is
//! [`SetupDifference`].

use std::{collections::HashMap, sync::Arc};

use record::{
    experiment::CommandExperiment,
    run_directory::{PlannedScenario, RecordedPlatform, fact},
    settings::Settings,
};
use serde_json::{Value, json};

use crate::{
    analysis::{fields, pairs::OfPair},
    input::run::ScenarioRun,
};

/// Two scenarios that did not run the same experiment.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SetupDifference {
    /// Letter of the first. Of a thousand scenarios there are half a million pairs, which share what they have.
    pub a: Arc<str>,
    /// Letter of the second.
    pub b: Arc<str>,
    /// What is not the same, such as `network.delay`; never empty.
    pub fields: Arc<[String]>,
}

impl SetupDifference {
    /// Every two scenarios that are, in the order of the plan. What was never measured is like any.
    #[must_use]
    pub fn all(scenarios: &[ScenarioRun]) -> Vec<Self> {
        let measured = scenarios
            .iter()
            .filter(|scenario| scenario.counted().next().is_some());
        let (letters, setups): (Vec<Arc<str>>, Vec<Value>) = measured
            .map(|scenario| (scenario.planned.id.as_str().into(), setup(scenario)))
            .unzip();
        let setups = Experiments::of_records(setups);
        let mut found = Vec::new();
        let mut names: HashMap<Vec<usize>, Arc<[String]>> = HashMap::new();
        for (first, a) in letters.iter().enumerate() {
            for (second, b) in letters.iter().enumerate().skip(first + 1) {
                let columns: Vec<usize> = setups.differing_columns(first, second).collect();
                if columns.is_empty() {
                    continue;
                }
                let fields = match names.get(&columns) {
                    Some(known) => Arc::clone(known),
                    None => {
                        let fields: Arc<[String]> = setups.names(&columns).into();
                        names.insert(columns, Arc::clone(&fields));
                        fields
                    }
                };
                found.push(Self {
                    a: Arc::clone(a),
                    b: Arc::clone(b),
                    fields,
                });
            }
        }
        found
    }
}

impl OfPair for SetupDifference {
    fn letters(&self) -> (&str, &str) {
        (&self.a, &self.b)
    }
}

/// What is not the same of the experiments that two scenarios are to run; empty if they are to run the same.
#[must_use]
pub fn differing_settings(a: &Settings, b: &Settings) -> Vec<String> {
    differing(&task(a), &task(b))
}

/// The experiments of many scenarios, to be compared two by two: of a thousand there are half a million pairs.
#[derive(Debug, Clone, Default)]
pub struct Experiments {
    /// The dotted paths of the fields.
    fields: Vec<String>,
    /// For each the number of its value in each field; 0 for what is not known.
    rows: Vec<Vec<u32>>,
}

impl Experiments {
    /// Those that these settings ask for, by their places.
    pub fn of<'a>(settings: impl IntoIterator<Item = &'a Settings>) -> Self {
        Self::of_records(settings.into_iter().map(task))
    }

    fn of_records(records: impl IntoIterator<Item = Value>) -> Self {
        let mut columns: HashMap<String, (usize, HashMap<String, u32>)> = HashMap::new();
        let mut experiments = Self::default();
        for record in records {
            let mut row = vec![0; columns.len()];
            for (path, value) in fields::leaves(&record) {
                let next = columns.len();
                let (at, values) = columns.entry(path).or_insert_with_key(|path| {
                    experiments.fields.push(path.clone());
                    (next, HashMap::new())
                });
                let known = u32::try_from(values.len()).unwrap_or(u32::MAX);
                let number = *values.entry(value.to_string()).or_insert(known.saturating_add(1));
                row.resize(row.len().max(*at + 1), 0);
                if let (Some(field), false) = (row.get_mut(*at), value.is_null()) {
                    *field = number;
                }
            }
            experiments.rows.push(row);
        }
        experiments
    }

    /// Whether those at two places differ, as [`differing_settings`] has it.
    #[must_use]
    pub fn differ(&self, a: usize, b: usize) -> bool {
        self.differing_columns(a, b).next().is_some()
    }

    /// The fields in some columns, in the order of their names.
    fn names(&self, columns: &[usize]) -> Vec<String> {
        let names = columns.iter().filter_map(|at| self.fields.get(*at));
        let mut names: Vec<String> = names.cloned().collect();
        names.sort_by(|one, other| one.split('.').cmp(other.split('.')));
        names
    }

    fn differing_columns(&self, a: usize, b: usize) -> impl Iterator<Item = usize> {
        let row = |at: usize| self.rows.get(at).map(Vec::as_slice).unwrap_or_default();
        let both = row(a).iter().zip(row(b)).enumerate();
        both.filter(|(_, (a, b))| **a != 0 && **b != 0 && a != b)
            .map(|(at, _)| at)
    }
}

/// All that must be the same for a difference to be the platform's: the control task, the network between its nodes, and the
/// program. How many windows there are, how they were captured and what was asked of the operating system is not of it.
fn task(settings: &Settings) -> Value {
    if let Some(experiment) = &settings.experiment {
        let mut task = json!({ MEASURES: experiment.name, "experiment": of_a_command(experiment) });
        if let Some(network) = settings.network_in_use() {
            task["network"] = json!(network);
        }
        return task;
    }
    json!({
        MEASURES: "the ball on the plate",
        "period": settings.period,
        "rate": settings.rate,
        "reference": settings.reference,
        "plant": settings.plant,
        "control": settings.control,
        "network": settings.network,
        "ros": settings.ros,
        "loops": settings.loops,
    })
}

/// What is measured, in a word.
const MEASURES: &str = "measures";

/// All of a command that a measurement depends on. What is empty is written so that it differs from what is not: a field that one has and
/// the other lacks is taken for unknown.
fn of_a_command(experiment: &CommandExperiment) -> Value {
    let whole = |part: Value| Value::String(part.to_string());
    let mut window = experiment.window;
    // How long it may take and what comes of a failure change no value.
    window.timeout = CommandExperiment::default_timeout();
    json!({
        "files": whole(json!(experiment.files)),
        "prepare": whole(json!(experiment.prepare)),
        "restore": whole(json!(experiment.restore)),
        "run": whole(json!(experiment.run)),
        "nodes": whole(json!(experiment.nodes)),
        "ros_master": whole(json!(experiment.ros_master)),
        "window": whole(json!(window)),
        "parameters": experiment.parameters,
        "metrics": whole(json!(experiment.metrics)),
    })
}

/// The experiment of a plan, whichever of its scenarios is looked at: without what its axes sweep.
pub(crate) fn experiment(planned: &PlannedScenario) -> Value {
    let mut experiment = task(&planned.settings);
    for axis in planned.axes.keys() {
        let pointer = format!("/{}", axis.replace('.', "/"));
        let of_an_experiment = format!("/{}{pointer}", CommandExperiment::SECTION);
        let pointer = match experiment.pointer(&of_an_experiment) {
            Some(_) => of_an_experiment,
            None => pointer,
        };
        if let Some(swept) = experiment.pointer_mut(&pointer) {
            *swept = Value::Null;
        }
    }
    experiment
}

/// The same with the program that ran it.
fn setup(scenario: &ScenarioRun) -> Value {
    let mut setup = task(&scenario.planned.settings);
    let version = scenario
        .environment
        .as_ref()
        .and_then(|environment| environment.workload_version());
    setup["workload"] = json!({ "version": version, "sha256": program(scenario) });
    if scenario.planned.settings.experiment.is_some() {
        setup["experiment_sha256"] = json!(scenario.experiment_sha256);
    }
    setup
}

/// The hash of the workload by the machine that it is built for: those of other machines are other files anyway.
fn program(scenario: &ScenarioRun) -> Value {
    let Some(environment) = &scenario.environment else {
        return Value::Null;
    };
    let platform = environment.platform.as_ref();
    let machine = platform.and_then(RecordedPlatform::program_machine);
    match (machine, environment.facts.get(fact::WORKLOAD_SHA256)) {
        (Some(machine), Some(sha256)) => json!({ machine: sha256 }),
        _ => Value::Null,
    }
}

/// The dotted paths of all fields that are not the same. What one of them does not have, such as an environment's record, is
/// none.
pub(crate) fn differing(first: &Value, second: &Value) -> Vec<String> {
    let both_known = fields::differing(first, second)
        .into_iter()
        .filter(|(_, a, b)| !a.is_null() && !b.is_null());
    both_known.map(|(field, ..)| field).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_the_same_is_named_by_its_path() {
        let first = json!({"network": {"delay": "10ms", "loss": "1%"}, "rate": "50Hz"});
        let second = json!({"network": {"delay": "20ms", "loss": "1%"}, "rate": "100Hz"});
        assert_eq!(differing(&first, &second), ["network.delay", "rate"]);
        assert!(differing(&first, &first).is_empty());
    }

    #[test]
    fn many_experiments_differ_where_two_do() {
        let swept = |delay: &str, seed: Value, tcp_nodelay: bool| {
            Settings::from_json(
                json!({"network": {"delay": delay, "seed": seed}, "ros": {"tcp_nodelay": tcp_nodelay}}),
                record::settings::Dynamics::default(),
            )
            .unwrap()
        };
        let all = [
            swept("10ms", Value::Null, true),
            swept("20ms", Value::Null, true),
            swept("10ms", json!(7), true),
            swept("10ms", json!(8), false),
            swept("10ms", Value::Null, true),
        ];
        let experiments = Experiments::of(&all);
        for (a, first) in all.iter().enumerate() {
            for (b, second) in all.iter().enumerate() {
                let differ = !differing_settings(first, second).is_empty();
                assert_eq!(experiments.differ(a, b), differ, "{a} and {b}");
                let columns: Vec<usize> = experiments.differing_columns(a, b).collect();
                assert_eq!(experiments.names(&columns), differing_settings(first, second));
            }
        }
        assert!(experiments.differ(2, 3) && !experiments.differ(0, 2));
    }

    #[test]
    fn what_is_not_known_is_no_difference() {
        let known = json!({"workload": {"version": "0.1.0", "sha256": {"x86_64": "aa"}}});
        let other_machine = json!({"workload": {"version": "0.1.0", "sha256": {"aarch64": "bb"}}});
        let unknown = json!({"workload": {"version": null, "sha256": null}});
        assert!(differing(&known, &unknown).is_empty());
        assert!(differing(&known, &other_machine).is_empty());
    }
}
