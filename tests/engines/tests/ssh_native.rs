//! A matrix of this machine and one behind SSH, a real sshd: a run, its report, and nothing left.

use std::{fs::File, process::Command};

use serde_json::Value;
use tests::{Ran, There, Workplace, is_whole};

const WORKLOAD: &str = "  windows: 2\n  window: 3s\n  period: 1s\n  reference: {amplitude_m: 0.05}\n";

/// Hosts whose hardware has names that tell them apart.
fn two_hosts(there: &There) -> String {
    format!(
        "hosts:\n  here: {{hardware: one}}\n  there: {{hardware: two, os: linux, connect: {}}}\n\
         matrix:\n  virtualization: [native]\nworkload:\n{WORKLOAD}",
        there.connect()
    )
}

#[test]
fn two_hosts_are_measured_and_reported_and_nothing_is_left_on_either() {
    let workplace = Workplace::measuring();
    let there = There::start();
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
    // One machine has one clock, whichever way it is asked.
    let clock = |it: &str| doctor["hosts"][1][it].as_f64().unwrap();
    assert!(
        clock("clock_ahead_ms").abs() <= clock("clock_within_ms"),
        "{doctor:#}"
    );
    assert!(doctor["hosts"][1]["free_bytes"].as_u64().unwrap() > 0);
    let asked = workplace.run(&["doctor", "m.yaml"]);
    let head = asked.out.lines().next().unwrap();
    let columns: Vec<_> = head.split_whitespace().collect();
    assert_eq!(columns.first(), Some(&"host"), "{asked:?}");
    assert_eq!(columns.last(), Some(&"clock"), "{asked:?}");
    assert!(
        asked.out.lines().nth(2).unwrap().starts_with("there "),
        "{asked:?}"
    );

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
fn what_is_kept_can_be_entered_until_it_is_removed() {
    let workplace = Workplace::measuring();
    let there = There::start();
    workplace.write("m.yaml", two_hosts(&there));
    let ran = workplace.run(&["run", "m.yaml", "--keep", "always"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    assert!(ran.err.contains("is kept: `matrix shell "), "{ran:?}");
    let kept = there.environments();
    assert_eq!(kept.len(), 1);
    workplace.write("typed", "pwd; ls data\n");
    for (scenario, folder) in [
        ("a", workplace.path().join("state")),
        ("b", there.sshd.folder().join("state")),
    ] {
        let mut shell = workplace.matrix(["shell", scenario]);
        let typed = File::open(workplace.path().join("typed")).unwrap();
        let entered = Ran::of(shell.stdin(typed).output().unwrap());
        let mut lines = entered.out.lines();
        let environments = folder.join("environments/matrix-");
        let inside = lines.next().unwrap_or_default();
        assert!(inside.starts_with(environments.to_str().unwrap()), "{entered:?}");
        assert!(lines.any(|line| line == "window-2"), "{entered:?}");
    }
    // A network is made for the shell, with the experiment's nodes on it, and goes with it.
    workplace.write(
        "typed",
        "ls data; cat /proc/net/dev; echo > /dev/tcp/10.0.0.1/11311 && echo master\nexit 7\n",
    );
    for scenario in ["a", "b"] {
        let mut shell = workplace.matrix(["shell", scenario, "--virtual-host", "sta2"]);
        let typed = File::open(workplace.path().join("typed")).unwrap();
        let entered = Ran::of(shell.env("SHELL", "/bin/bash").stdin(typed).output().unwrap());
        for expected in ["window-2", "sta2-eth0:", "master"] {
            assert!(entered.out.contains(expected), "{entered:?}");
        }
        assert!(!entered.out.contains("h1-eth0"), "{entered:?}");
        assert_eq!(entered.code, Some(7), "{entered:?}");
        let rehearsals = Command::new("pgrep")
            .args(["-f", "workload rehearse"])
            .output()
            .unwrap();
        assert_eq!(String::from_utf8(rehearsals.stdout).unwrap(), "");
    }
    let nowhere = workplace.run(&["shell", "a", "--virtual-host", "sta9"]);
    assert_eq!(nowhere.code, Some(3), "{nowhere:?}");
    assert!(nowhere.err.contains("name one of h1, sta1, sta2"), "{nowhere:?}");
    assert_eq!(workplace.run(&["clean"]).code, Some(0));
    assert_eq!(there.environments(), Vec::<String>::new());
    let gone = workplace.run(&["shell", "b"]);
    assert_eq!(gone.code, Some(2), "{gone:?}");
    assert!(gone.err.contains("does not exist any more"), "{gone:?}");
}

#[test]
fn a_host_that_another_matrix_measures_on_is_waited_for() {
    let here = Workplace::measuring();
    let elsewhere = here.beside();
    let there = There::start();
    for control in [&here, &elsewhere] {
        control.write("m.yaml", there.matrix(WORKLOAD));
    }
    let mut running = here.start(&["run", "m.yaml"]);
    running.wait_for("measuring window 1");
    let mut waiting = elsewhere.start(&["run", "m.yaml"]);
    waiting.wait_for("there: waiting, held by process");
    // Neither knows of the other's file or process; the host does.
    assert_eq!(running.end().code, Some(0));
    let second = waiting.end();
    assert_eq!(second.code, Some(0), "{second:?}");
}

#[test]
fn a_host_that_does_not_answer_is_tried_all_the_same_and_resumed_when_it_is_back() {
    let workplace = Workplace::measuring();
    let mut there = There::start();
    workplace.write("m.yaml", two_hosts(&there));
    there.sshd.stop();
    let plan = workplace.json(&["plan", "m.yaml"]);
    assert_eq!(plan["order"].as_array().unwrap().len(), 2, "{plan:#}");
    let warning = &plan["warnings"][0];
    assert_eq!(warning["code"], "silent-host", "{plan:#}");
    assert_eq!(warning["line"], 3, "{plan:#}");
    assert!(
        warning["message"]
            .as_str()
            .unwrap()
            .contains("`there` cannot be asked"),
        "{plan:#}"
    );

    let ran = workplace.run(&["run", "m.yaml"]);
    assert_eq!(ran.code, Some(3), "{ran:?}");
    let run = workplace.run_directory();
    let run = run.to_str().unwrap();
    let states = || {
        let status = workplace.json(&["status", run]);
        let scenarios = status["scenarios"].as_array().unwrap().iter();
        scenarios
            .map(|it| it["state"].as_str().unwrap().to_owned())
            .collect::<Vec<_>>()
    };
    assert_eq!(states(), ["completed", "errored"], "{ran:?}");

    there.sshd.restart();
    let resumed = workplace.run(&["resume", run]);
    assert_eq!(resumed.code, Some(0), "{resumed:?}");
    assert_eq!(states(), ["completed", "completed"]);
}

#[test]
fn a_host_that_is_another_than_the_file_says_is_an_error_at_its_place() {
    let workplace = Workplace::new();
    let there = There::start();
    workplace.write(
        "m.yaml",
        format!(
            "hosts:\n  there:\n    hardware: riscv64\n    os: linux\n    connect: {}\nmatrix: {{}}\n",
            there.connect()
        ),
    );
    for command in ["plan", "run"] {
        let ran = workplace.run(&[command, "m.yaml"]);
        assert_eq!(ran.code, Some(2), "{ran:?}");
        assert!(
            ran.err
                .contains("the file says `hardware: riscv64` of host `there`, which is `"),
            "{ran:?}"
        );
        assert!(ran.err.contains("m.yaml:3:15"), "{ran:?}");
        assert!(ran.err.contains("write `hardware: "), "{ran:?}");
    }
}

#[test]
fn what_a_killed_run_left_on_another_host_is_found_and_removed_without_its_run_directory() {
    let workplace = Workplace::measuring();
    let there = There::start();
    workplace.write("m.yaml", there.matrix(WORKLOAD));
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
