//! A matrix of this machine and one behind SSH, a real sshd: a run, its report, and nothing left; also where the connection
//! is cut in a window.

use std::path::Path;

use serde_json::Value;
use tests::{Workplace, sshd::Sshd};

/// Another machine, as far as anybody can tell: sshd's users have a state folder of their own.
struct There {
    sshd: Sshd,
}

impl There {
    fn new() -> Self {
        Self { sshd: Sshd::start() }
    }

    fn connect(&self) -> String {
        format!(
            "{{ssh: \"{}\", identity: {}, known_hosts: {}}}",
            self.sshd.address(),
            self.sshd.identity().display(),
            self.sshd.known_hosts().display()
        )
    }

    /// What is in its folder of environments.
    fn environments(&self) -> Vec<String> {
        match std::fs::read_dir(self.sshd.folder().join("state/environments")) {
            Ok(entries) => entries
                .map(|entry| entry.unwrap().file_name().into_string().unwrap())
                .collect(),
            Err(_) => Vec::new(),
        }
    }
}

const WORKLOAD: &str =
    "workload:\n  windows: 2\n  window: 3s\n  period: 1s\n  reference: {amplitude_m: 0.05}\n";

/// Hosts whose hardware has names that tell them apart.
fn two_hosts(there: &There) -> String {
    format!(
        "hosts:\n  here: {{hardware: one}}\n  there: {{hardware: two, os: linux, connect: {}}}\n\
         matrix:\n  virtualization: [native]\n{WORKLOAD}",
        there.connect()
    )
}

fn only_there(there: &There) -> String {
    format!(
        "hosts:\n  there: {{hardware: two, os: linux, connect: {}}}\nmatrix:\n  virtualization: [native]\n{WORKLOAD}",
        there.connect()
    )
}

fn is_whole(window: &Path) -> bool {
    let record: Value = serde_json::from_slice(&std::fs::read(window.join("window.json")).unwrap()).unwrap();
    record["complete"] == true && window.join("control.csv").exists()
}

#[test]
fn two_hosts_are_measured_and_reported_and_nothing_is_left_on_either() {
    let workplace = Workplace::measuring();
    let there = There::new();
    workplace.write("m.yaml", two_hosts(&there));

    let plan = workplace.json(&["plan", "m.yaml"]);
    let hosts: Vec<_> = plan["scenarios"]
        .as_array()
        .unwrap()
        .iter()
        .map(|it| &it["host"])
        .collect();
    assert_eq!(hosts, ["here", "there"], "{plan:#}");
    let doctor = workplace.json(&["doctor", "m.yaml"]);
    assert_eq!(doctor["hosts"][0]["kernel"], doctor["hosts"][1]["kernel"]);
    assert_eq!(doctor["hosts"][1]["obstacle"], Value::Null, "{doctor:#}");

    let ran = workplace.run(&["run", "m.yaml"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let run = workplace.run_directory();
    let manifest: Value = serde_json::from_slice(&std::fs::read(run.join("manifest.json")).unwrap()).unwrap();
    assert_eq!(manifest["hosts"][1]["connect"]["ssh"], there.sshd.address());
    for scenario in std::fs::read_dir(run.join("scenarios")).unwrap() {
        let scenario = scenario.unwrap().path();
        assert!((1..=2).all(|window| is_whole(&scenario.join(format!("window-{window}")))));
    }
    let report = workplace.json(&["report", run.to_str().unwrap()]);
    assert_eq!(report["scenarios"].as_array().unwrap().len(), 2);

    assert_eq!(there.environments(), Vec::<String>::new());
    let cleaned = workplace.json(&["clean"]);
    let of_there = |it: &&Value| it["host"] == "there" && it["kind"] == "directory";
    assert_eq!(
        cleaned["leftovers"].as_array().unwrap().iter().find(of_there),
        None,
        "{cleaned:#}"
    );
}

#[test]
fn windows_are_whole_though_the_connection_is_cut_in_one() {
    let workplace = Workplace::measuring();
    let there = There::new();
    workplace.write("m.yaml", only_there(&there));
    let mut running = workplace.start(&["run", "m.yaml"]);
    running.wait_for("measuring window 1");
    there.sshd.cut();
    running.wait_for("window 1 complete");
    there.sshd.cut();
    let ran = running.end();
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let scenario = workplace.scenario_directory();
    assert!((1..=2).all(|window| is_whole(&scenario.join(format!("window-{window}")))));
    let journal = std::fs::read_to_string(workplace.run_directory().join("events.jsonl")).unwrap();
    for said in [
        r#""event":"network-up""#,
        r#""event":"window-complete","window":1,"#,
        r#""event":"window-complete","window":2,"#,
    ] {
        let lines = journal.lines().filter(|line| line.contains(said));
        assert_eq!(lines.count(), 1, "{said}:\n{journal}");
    }
    assert_eq!(there.environments(), Vec::<String>::new());
}

#[test]
fn a_host_that_does_not_answer_is_told_with_what_to_do_and_the_others_are_measured() {
    let workplace = Workplace::measuring();
    let there = There::new();
    workplace.write("m.yaml", two_hosts(&there));
    drop(there);
    let plan = workplace.json(&["plan", "m.yaml"]);
    let scenarios = plan["scenarios"].as_array().unwrap();
    assert_eq!(scenarios[0]["feasible"], true, "{plan:#}");
    let silent = scenarios.iter().find(|it| it["feasible"] == false).unwrap();
    assert!(silent["reason"].as_str().unwrap().contains("there"), "{silent:#}");
    assert!(silent["fix"].is_string(), "{silent:#}");
}

#[test]
fn what_a_killed_run_left_on_another_host_is_found_and_removed_without_its_run_directory() {
    let workplace = Workplace::measuring();
    let there = There::new();
    workplace.write("m.yaml", only_there(&there));
    let mut running = workplace.start(&["run", "m.yaml"]);
    running.wait_for("measuring window 1");
    running.kill();
    assert_eq!(there.environments().len(), 1);
    std::fs::remove_dir_all(workplace.run_directory()).unwrap();
    let cleaned = workplace.run(&["clean"]);
    assert_eq!(cleaned.code, Some(0), "{cleaned:?}");
    assert!(cleaned.out.contains(" on there"), "{cleaned:?}");
    assert_eq!(there.environments(), Vec::<String>::new());
    let again = workplace.json(&["clean", "--dry-run"]);
    assert!(
        again["leftovers"]
            .as_array()
            .unwrap()
            .iter()
            .all(|it| it["host"] != "there"),
        "{again:#}"
    );
}
