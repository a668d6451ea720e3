//! What happens to engines, containers and the ways to them while a window is measured: what was measured is kept, what goes
//! on is collected whole, and what ended says why.

use std::{
    process::Command,
    time::{Duration, Instant},
};

use rstest::rstest;
use serde_json::Value;
use tests::{
    Ran, WHOLE_WINDOWS_COUNT, Workplace,
    engine::{Engine, on_the_engine},
    is_whole,
    sshd::Sshd,
};

fn matrix(hosts: &str, windows: usize, window: &str) -> String {
    format!(
        "{hosts}matrix:\n  virtualization: [docker]\nworkload:\n  dynamics: robust\n  windows: {windows}\n  window: {window}\n  period: 1s\n  \
         reference: {{amplitude_m: 0.05}}\n  {WHOLE_WINDOWS_COUNT}\n"
    )
}

fn whole_windows(workplace: &Workplace) -> Vec<usize> {
    let scenario = workplace.scenario_directory();
    (1..=9)
        .filter(|window| is_whole(&scenario.join(format!("window-{window}"))))
        .collect()
}

/// How the one scenario of the one run has ended.
fn outcome(workplace: &Workplace) -> Value {
    let report = workplace.json(&["report", workplace.run_directory().to_str().unwrap()]);
    report["scenarios"][0].clone()
}

fn resume(workplace: &Workplace) -> Ran {
    workplace.run(&["resume", workplace.run_directory().to_str().unwrap()])
}

#[test]
fn an_engine_that_restarts_and_leaves_its_containers_alone_costs_nothing() {
    let mut workplace = Workplace::measuring();
    let mut engine = Engine::start(true);
    workplace.set("DOCKER_HOST", &engine.address());
    workplace.write("m.yaml", matrix("", 2, "8s"));
    let mut running = workplace.start(&["run", "m.yaml"]);
    running.wait_for("measuring window 1");
    engine.restart();
    running.wait_for("window 1 complete");
    engine.crash();
    let ran = running.end();
    assert_eq!(ran.code, Some(0), "{ran:?}");
    assert_eq!(whole_windows(&workplace), [1, 2]);
    assert_eq!(outcome(&workplace)["outcome"], "completed");
    workplace.assert_lines_came_once();
    assert_eq!(engine.docker(&["ps", "--all", "--quiet"]).out, "");
    assert_eq!(engine.docker(&["volume", "ls", "--quiet"]).out, "");
}

#[rstest]
#[case::restarted(Engine::restart)]
#[case::crashed(Engine::crash)]
fn an_engine_that_takes_its_containers_with_it_ends_the_scenario_and_what_was_measured_is_kept(
    #[case] fault: fn(&mut Engine),
) {
    let mut workplace = Workplace::measuring();
    let mut engine = Engine::start(false);
    workplace.set("DOCKER_HOST", &engine.address());
    workplace.write("m.yaml", matrix("", 2, "8s"));
    let mut running = workplace.start(&["run", "m.yaml"]);
    running.wait_for("window 1 complete");
    fault(&mut engine);
    let ran = running.end();
    assert_eq!(ran.code, Some(3), "{ran:?}");
    assert_eq!(whole_windows(&workplace), [1]);
    let errored = outcome(&workplace);
    assert_eq!(errored["outcome"], "errored", "{errored:#}");
    let reason = errored["reason"].as_str().unwrap();
    assert!(reason.contains("without `live-restore`"), "{errored:#}");
    assert_eq!(engine.docker(&["ps", "--all", "--quiet"]).out, "");

    let resumed = resume(&workplace);
    assert_eq!(resumed.code, Some(0), "{resumed:?}");
    assert_eq!(whole_windows(&workplace), [1, 2]);
}

#[test]
fn a_container_that_is_killed_in_a_window_keeps_the_windows_before_and_says_so() {
    let workplace = Workplace::measuring();
    workplace.write("m.yaml", matrix("", 3, "4s"));
    let mut running = workplace.start(&["run", "m.yaml"]);
    running.wait_for("window 1 complete");
    let there = on_the_engine(&workplace);
    let container = there.first().unwrap();
    docker(&["kill", container]);
    let ran = running.end();
    assert_eq!(ran.code, Some(3), "{ran:?}");
    assert_eq!(whole_windows(&workplace), [1]);
    let errored = outcome(&workplace);
    assert_eq!(errored["outcome"], "errored", "{errored:#}");
    let reason = errored["reason"].as_str().unwrap();
    assert!(reason.contains("killed by signal 9"), "{errored:#}");
    assert_eq!(on_the_engine(&workplace), Vec::<String>::new());
    assert_eq!(resume(&workplace).code, Some(0));
    assert_eq!(whole_windows(&workplace), [1, 2, 3]);
}

#[test]
fn what_a_container_measured_that_somebody_removed_is_collected_from_its_volume() {
    let workplace = Workplace::measuring();
    workplace.write("m.yaml", matrix("", 3, "4s"));
    let mut running = workplace.start(&["run", "m.yaml"]);
    running.wait_for("window 1 complete");
    let there = on_the_engine(&workplace);
    docker(&["rm", "--force", there.first().unwrap()]);
    let ran = running.end();
    assert_eq!(ran.code, Some(3), "{ran:?}");
    for words in [
        "window 1 collected",
        "it ended without saying how",
        "matrix resume",
    ] {
        assert!(ran.err.contains(words), "{words}: {ran:?}");
    }
    let resumed = resume(&workplace);
    assert_eq!(resumed.code, Some(0), "{resumed:?}");
    assert_eq!(whole_windows(&workplace), [1, 2, 3]);
    assert_eq!(on_the_engine(&workplace), Vec::<String>::new());
}

fn docker(arguments: &[&str]) {
    let done = Command::new("docker").args(arguments).output().unwrap();
    assert!(done.status.success(), "{done:?}");
}

#[test]
fn a_container_that_stands_still_is_told_and_what_it_measured_before_and_after_counts() {
    let workplace = Workplace::measuring();
    workplace.write("m.yaml", matrix("", 3, "4s"));
    let mut running = workplace.start(&["run", "m.yaml"]);
    running.wait_for("window 1 complete");
    let there = on_the_engine(&workplace);
    let container = there.first().unwrap();
    docker(&["pause", container]);
    let begun = Instant::now();
    running.wait_for("nothing was heard of the workload for 10 s");
    assert!(begun.elapsed() < Duration::from_secs(15), "{:?}", begun.elapsed());
    let directory = workplace.run_directory();
    let status = workplace.run(&["status", directory.to_str().unwrap()]);
    assert!(status.out.contains("nothing was heard"), "{status:?}");
    docker(&["unpause", container]);
    running.wait_for("the workload was heard of again");
    let ran = running.end();
    assert_eq!(ran.code, Some(0), "{ran:?}");
    assert_eq!(whole_windows(&workplace), [1, 2, 3]);
    assert_eq!(on_the_engine(&workplace), Vec::<String>::new());
}

#[test]
fn windows_on_an_engine_behind_ssh_are_whole_though_the_connection_is_cut_in_one() {
    let workplace = Workplace::measuring();
    let sshd = Sshd::start();
    let hosts = format!(
        "hosts:\n  there: {{hardware: two, os: linux, connect: {}}}\n",
        sshd.connect()
    );
    workplace.write("m.yaml", matrix(&hosts, 2, "6s"));
    let mut running = workplace.start(&["run", "m.yaml"]);
    running.wait_for("measuring window 1");
    sshd.cut();
    running.wait_for("window 1 complete");
    sshd.cut();
    running.wait_for("all windows measured");
    sshd.cut();
    let ran = running.end();
    assert_eq!(ran.code, Some(0), "{ran:?}");
    assert_eq!(whole_windows(&workplace), [1, 2]);
    workplace.assert_lines_came_once();
    assert_eq!(on_the_engine(&workplace), Vec::<String>::new());
}

#[test]
fn an_engine_that_ssh_may_not_reach_makes_a_scenario_infeasible() {
    let workplace = Workplace::new();
    let sshd = Sshd::with("AllowStreamLocalForwarding no");
    let hosts = format!(
        "hosts:\n  there: {{hardware: two, os: linux, connect: {}}}\n",
        sshd.connect()
    );
    workplace.write("m.yaml", matrix(&hosts, 1, "4s"));
    let plan = workplace.json(&["plan", "m.yaml"]);
    let scenario = &plan["scenarios"][0];
    assert_eq!(scenario["feasible"], false, "{plan:#}");
    let reason = scenario["reason"].as_str().unwrap();
    assert!(
        reason.contains("docker.sock") && reason.contains("there"),
        "{reason}"
    );
}
