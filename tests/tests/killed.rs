//! `kill -9` of `matrix` while real workloads measure: they go on, and `resume` finds and collects what they measured.

use std::process::Command;

use rstest::rstest;
use serde_json::Value;
use tests::Workplace;

fn matrix(virtualization: &str) -> String {
    format!(
        "matrix:\n  virtualization: [{virtualization}]\n\
         workload:\n  windows: 4\n  window: 3s\n  period: 1s\n  reference: {{amplitude_m: 0.05}}\n"
    )
}

fn environments_of_windows(workplace: &Workplace) -> Vec<String> {
    let scenario = workplace.scenario_directory();
    (1..=4)
        .map(|window| {
            let path = scenario.join(format!("window-{window}/window.json"));
            let record: Value = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
            assert_eq!(record["complete"], true, "{record:#}");
            record["environment"].as_str().unwrap().to_owned()
        })
        .collect()
}

#[rstest]
#[case("native")]
#[case("docker")]
fn what_went_on_measuring_is_found_and_collected(#[case] virtualization: &str) {
    let workplace = Workplace::measuring();
    workplace.write("m.yaml", matrix(virtualization));
    let mut running = workplace.start(&["run", "m.yaml"]);
    running.wait_for("window 1 complete");
    running.kill();
    let directory = workplace.run_directory();
    let resumed = workplace.run(&["resume", directory.to_str().unwrap()]);
    assert_eq!(resumed.code, Some(0), "{resumed:?}");
    assert!(resumed.err.contains("found"), "{resumed:?}");
    let environments = environments_of_windows(&workplace);
    assert!(
        environments.iter().all(|name| *name == environments[0]),
        "one environment measured all: {environments:?}"
    );
    assert_eq!(workplace.run(&["clean"]).code, Some(0));
}

#[test]
fn windows_of_a_container_that_was_killed_count_and_only_the_missing_ones_are_measured_again() {
    let workplace = Workplace::measuring();
    workplace.write("m.yaml", matrix("docker"));
    let mut running = workplace.start(&["run", "m.yaml"]);
    running.wait_for("window 1 complete");
    let directory = workplace.run_directory();
    let status = workplace.json(&["status", directory.to_str().unwrap()]);
    let container = status["scenarios"][0]["environment"].as_str().unwrap().to_owned();
    let killed = Command::new("docker")
        .args(["kill", &container])
        .output()
        .unwrap();
    assert!(killed.status.success(), "{killed:?}");
    let ran = running.end();
    assert_eq!(
        ran.code,
        Some(3),
        "a killed container is a failure of the infrastructure: {ran:?}"
    );

    let resumed = workplace.run(&["resume", directory.to_str().unwrap()]);
    assert_eq!(resumed.code, Some(0), "{resumed:?}");
    let environments = environments_of_windows(&workplace);
    assert_eq!(
        environments[0], container,
        "the first window is the first container's"
    );
    assert_ne!(environments[3], container, "the last window is another's");
    let broken = workplace.scenario_directory();
    assert!(
        broken.join("broken").join(&container).is_dir(),
        "what broke is kept aside"
    );
    assert_eq!(workplace.run(&["clean"]).code, Some(0));
}

#[test]
fn ctrl_c_keeps_complete_windows_says_how_to_go_on_and_leaves_nothing_behind() {
    let workplace = Workplace::measuring();
    workplace.write("m.yaml", matrix("native"));
    let mut running = workplace.start(&["run", "m.yaml"]);
    running.wait_for("window 1 complete");
    let ran = running.interrupt();
    assert_eq!(ran.code, Some(130), "{ran:?}");
    assert!(ran.err.contains("matrix resume"), "{ran:?}");
    let left = workplace.json(&["clean", "--dry-run"]);
    let environments: Vec<_> = left["leftovers"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|leftover| leftover["run_directory"].as_str() == workplace.run_directory().to_str())
        .collect();
    assert!(environments.is_empty(), "{environments:#?}");
    let directory = workplace.run_directory();
    assert_eq!(
        workplace.run(&["resume", directory.to_str().unwrap()]).code,
        Some(0)
    );
    assert_eq!(environments_of_windows(&workplace).len(), 4);
    assert_eq!(workplace.run(&["clean"]).code, Some(0));
}
