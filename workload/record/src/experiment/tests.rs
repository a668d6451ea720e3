use rstest::rstest;
use serde_json::{Value, json};

use super::*;
use crate::settings::NetworkSettings;

fn reach() -> Value {
    json!({
        "name": "arm-reach",
        "files": ["sim/"],
        "prepare": ["./setup.sh", "{parameters.solver}"],
        "run": ["python3", "sim/reach.py", "--steps", "{parameters.steps}", "--seed={window.seed}", "{window.folder}"],
        "parameters": {"steps": "5000", "solver": "newton"},
        "metrics": [
            {"name": "reach_error", "unit": "mm", "from": "errors.csv", "column": "error"},
            {"name": "final_state", "from": "state.txt", "compare": "identical"},
        ],
    })
}

fn with(edit: impl FnOnce(&mut Value)) -> Vec<(String, String)> {
    let mut experiment = reach();
    edit(&mut experiment);
    let experiment: CommandExperiment = serde_json::from_value(experiment).unwrap();
    let found = experiment
        .problems(&NetworkSettings::default().topology())
        .into_iter();
    found
        .map(|problem| (problem.path.into_owned(), problem.message))
        .collect()
}

#[test]
fn an_experiment_is_written_as_it_was_read() {
    let experiment: CommandExperiment = serde_json::from_value(reach()).unwrap();
    assert_eq!(experiment.problems(&NetworkSettings::default().topology()), []);
    assert_eq!(experiment.window.timeout, TimeSpan::from_secs(600));
    let written = serde_json::to_value(&experiment).unwrap();
    assert_eq!(written["run"], reach()["run"]);
    assert_eq!(
        serde_json::from_value::<CommandExperiment>(written).unwrap(),
        experiment
    );
}

#[rstest]
#[case::no_command(|it: &mut Value| it["run"] = json!([]), "experiment.run", "there is no command to run")]
#[case::no_metric(|it: &mut Value| it["metrics"] = json!([]), "experiment.metrics", "nothing is measured")]
#[case::no_such_parameter(
    |it: &mut Value| it["run"] = json!(["a", "{parameters.seed}"]), "experiment.run.1", "there is no parameter `seed`"
)]
#[case::before_the_windows(
    |it: &mut Value| it["prepare"] = json!(["a", "{window.seed}"]),
    "experiment.prepare.1", "`{window.seed}` has no value in `prepare`, which runs once for all windows"
)]
#[case::twice(
    |it: &mut Value| it["metrics"][1]["name"] = json!("reach_error"),
    "experiment.metrics.1.name", "two metrics are called `reach_error`"
)]
#[case::outside(
    |it: &mut Value| it["files"] = json!(["../secret"]), "experiment.files.0", "`../secret` is not below the matrix file's folder"
)]
#[case::root(|it: &mut Value| it["files"] = json!(["/etc"]), "experiment.files.0", "`/etc` is not below the matrix file's folder")]
#[case::name_of_a_parameter(
    |it: &mut Value| it["parameters"]["a b"] = json!("1"), "experiment.parameters", "`a b` cannot be a parameter's name"
)]
#[case::no_length(
    |it: &mut Value| { it["window"] = json!({"continuous": true}); it["metrics"].as_array_mut().unwrap().pop(); },
    "experiment.window.continuous", "the windows of a continuous command have no length"
)]
#[case::length_of_a_call(
    |it: &mut Value| it["window"] = json!({"length": "10s"}), "experiment.window.length", "a window that is a call is as long as the call"
)]
#[case::short(
    |it: &mut Value| { it["window"] = json!({"continuous": true, "length": "1ms"}); it["metrics"].as_array_mut().unwrap().pop(); },
    "experiment.window.length", "a window of 1ms is shorter than 100ms"
)]
#[case::grows(
    |it: &mut Value| it["window"] = json!({"continuous": true, "length": "10s"}), "experiment.metrics.1.compare",
    "`final_state` compares whole files, and those of a continuous command grow"
)]
#[case::number_of_all(
    |it: &mut Value| {
        it["window"] = json!({"continuous": true, "length": "10s"});
        it["metrics"].as_array_mut().unwrap().pop();
        it["run"] = json!(["a", "{window.number}"]);
    },
    "experiment.run.1", "`{window.number}` has no value in a command that lasts for all windows"
)]
#[case::no_time(
    |it: &mut Value| it["window"] = json!({"timeout": "0s"}), "experiment.window.timeout", "a command cannot end in no time"
)]
#[case::no_network(
    |it: &mut Value| it["run"] = json!(["a", "{hosts.h1.address}"]),
    "experiment.run.1", "`{hosts.h1.address}` has no value where there is no network"
)]
#[case::both(|it: &mut Value| it["nodes"] = json!([nodes()[1]]), "experiment.run", "an experiment has a command for each window or nodes, not both")]
#[case::master_of_nobody(
    |it: &mut Value| it["ros_master"] = json!({}), "experiment.ros_master", "there are no nodes that a ROS master could be for"
)]
#[case::many(
    |it: &mut Value| it["files"] = json!(vec!["a"; 101]), "experiment.files", "101 are more than 100"
)]
fn what_does_not_fit_together_is_found(
    #[case] edit: fn(&mut Value),
    #[case] path: &str,
    #[case] message: &str,
) {
    assert_eq!(with(edit), [(path.to_owned(), message.to_owned())]);
}

fn nodes() -> Value {
    json!([
        {"name": "plant", "host": "sta2", "run": ["./plant"], "ready": {"topic": "/state"}, "background": true},
        {"name": "controller", "host": "sta1", "run": ["./controller", "{hosts.sta2.address}", "{window.seed}"]},
    ])
}

fn with_nodes(edit: impl FnOnce(&mut Value)) -> Vec<(String, String)> {
    with(|it| {
        it["run"] = json!([]);
        it["nodes"] = nodes();
        it["ros_master"] = json!({"program": "rosmaster"});
        edit(it);
    })
}

#[test]
fn nodes_are_an_experiment() {
    assert_eq!(with_nodes(|_| ()), []);
}

#[rstest]
#[case::host(|it: &mut Value| it["nodes"][0]["host"] = json!("sta3"), "experiment.nodes.0.host", "the network has no host `sta3`")]
#[case::address(
    |it: &mut Value| it["nodes"][1]["run"][1] = json!("{hosts.base.address}"), "experiment.nodes.1.run.1",
    "the network has no host `base`"
)]
#[case::twice(|it: &mut Value| it["nodes"][1]["name"] = json!("plant"), "experiment.nodes.1.name", "two nodes are called `plant`")]
#[case::nothing(|it: &mut Value| it["nodes"][0]["run"] = json!([]), "experiment.nodes.0.run", "there is no program to start")]
#[case::endless(
    |it: &mut Value| it["nodes"][1]["background"] = json!(true), "experiment.nodes",
    "all nodes are in the background, and nothing ends the window"
)]
#[case::no_master(
    |it: &mut Value| { it.as_object_mut().unwrap().remove("ros_master"); }, "experiment.nodes.0.ready",
    "there is no ROS master that could know a topic"
)]
#[case::topic(
    |it: &mut Value| it["nodes"][0]["ready"] = json!({"topic": "state"}), "experiment.nodes.0.ready", "that is no topic of ROS"
)]
#[case::port(|it: &mut Value| it["nodes"][0]["ready"] = json!({"port": 0}), "experiment.nodes.0.ready", "that is no port")]
#[case::line(
    |it: &mut Value| it["nodes"][0]["ready"] = json!({"line": " "}), "experiment.nodes.0.ready", "no line is known by that text"
)]
#[case::master(
    |it: &mut Value| it["ros_master"] = json!({"host": "h2"}), "experiment.ros_master.host", "the network has no host `h2`"
)]
#[case::capture(
    |it: &mut Value| it["metrics"][0]["from"] = json!("sta1.pcap"), "experiment.metrics.0.from",
    "`sta1.pcap` is a file that `matrix` writes"
)]
#[case::printed(
    |it: &mut Value| it["metrics"][0]["from"] = json!("plant.stdout.txt"), "experiment.metrics.0.from",
    "`plant.stdout.txt` is a file that `matrix` writes"
)]
fn what_nodes_cannot_be_is_found(#[case] edit: fn(&mut Value), #[case] path: &str, #[case] message: &str) {
    assert_eq!(with_nodes(edit), [(path.to_owned(), message.to_owned())]);
}

#[test]
fn a_window_has_the_same_seed_everywhere_and_no_other_window_has_it() {
    assert_eq!(seed_of(1), seed_of(1));
    let seeds: BTreeSet<u32> = (1..=10_000).map(seed_of).collect();
    assert_eq!(seeds.len(), 10_000);
    assert!(seeds.iter().all(|seed| *seed < 1 << 31));
}
