//! `kill -9` of `matrix` at every moment of a scenario on a real Docker Engine, and `resume`.

use std::process::Command;

use rstest::rstest;
use tests::{
    WHOLE_WINDOWS_COUNT, Workplace,
    engine::on_the_engine,
    killed::{environments_of_windows, four_windows, go_on_whole, is_found_and_collected, kill_at},
};

const MATRIX: &str = "\
matrix:
  virtualization: [docker]
workload:
  windows: 2
  window: 2s
  period: 500ms
  reference: {amplitude_m: 0.05}
";

#[rstest]
#[case::creating("environment-creating")]
#[case::created("environment-created")]
#[case::measuring("workload/measuring")]
#[case::between_windows("workload/window-complete")]
#[case::collecting("workload/finished")]
#[case::collected("window-collected")]
#[case::discarding("environment-discarding")]
fn a_run_killed_on_docker_is_whole_after_resume(#[case] moment: &str) {
    let workplace = Workplace::measuring();
    workplace.write("m.yaml", format!("{MATRIX}  {WHOLE_WINDOWS_COUNT}\n"));
    kill_at(&workplace, moment);
    if moment.starts_with("workload/") {
        let there = on_the_engine(&workplace);
        assert!(!there.is_empty(), "what was killed left something behind");
    }

    go_on_whole(&workplace);

    let cleaned = workplace.run(&["clean"]);
    assert_eq!(cleaned.code, Some(0), "{cleaned:?}");
    assert_eq!(on_the_engine(&workplace), Vec::<String>::new());
}

#[test]
fn a_container_that_went_on_measuring_is_found_and_collected() {
    is_found_and_collected("docker");
}

#[test]
fn windows_of_a_container_that_was_killed_count_and_only_the_missing_ones_are_measured_again() {
    let workplace = Workplace::measuring();
    workplace.write("m.yaml", four_windows("docker"));
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
