//! An experiment of the user's own where it runs in other places than this machine's processes: containers and a host over SSH.
//! `tests/machine` has what it does wherever it runs.

#![allow(clippy::unwrap_used, clippy::panic)] // What tests may, but clippy knows only functions that are tests themselves.

use std::{fs, process::Command};

use serde_json::Value;
use tests::{
    There, Workplace,
    engine::{debian_image, on_the_engine},
    example,
};

/// Writes what it may do, where it may write, and a value.
const SCRIPT: &str = r#"#!/bin/sh
grep ^CapEff /proc/self/status >"$1/rights.txt"
[ ! -e /dev/net/tun ] || echo tun >>"$1/rights.txt"
touch /etc/here 2>/dev/null && echo root >>"$1/rights.txt"
seq 1 20 >"$1/values.txt"
"#;

fn workplace(more: &str) -> Workplace {
    let workplace = Workplace::measuring();
    fs::create_dir(workplace.path().join("sim")).unwrap();
    workplace.write("sim/look.sh", SCRIPT);
    workplace.write(
        "m.yaml",
        format!(
            "experiment:\n  name: look\n  files: [sim]\n  prepare: [test, -e, sim/look.sh]\n  run: [sh, sim/look.sh, \
             \"{{window.folder}}\"]\n  metrics:\n  - {{name: value, from: values.txt}}\n  - {{name: rights, from: rights.txt, \
             compare: identical}}\nworkload: {{windows: 2}}\n{more}"
        ),
    );
    workplace
}

fn rights(workplace: &Workplace) -> String {
    fs::read_to_string(workplace.scenario_directory().join("window-1/rights.txt")).unwrap()
}

#[test]
fn a_command_in_a_container_has_no_rights_beyond_those_that_are_asked_for_and_nothing_is_left() {
    let image = debian_image("matrix-python:debian-12", &["python3"]);
    for (asked, rights_of_it) in [
        ("", "CapEff:\t0000000000000000\n"),
        (", capabilities: [SYS_NICE]", "CapEff:\t0000000000800000\n"),
    ] {
        let workplace = workplace(&format!(
            "matrix: {{virtualization: [docker]}}\nproviders:\n  docker: {{image: \"{image}\"{asked}}}\n"
        ));
        let ran = workplace.run(&["run", "m.yaml"]);
        assert_eq!(ran.code, Some(0), "{ran:?}");
        assert_eq!(rights(&workplace), rights_of_it);
        assert_eq!(on_the_engine(&workplace), Vec::<String>::new());
    }
}

/// The IDs of the images that were made of recipes.
fn images_of_recipes() -> Vec<String> {
    let listed = Command::new("docker")
        .args(["images", "--quiet", "--no-trunc", "matrix-recipe"])
        .output()
        .unwrap();
    let listed = String::from_utf8(listed.stdout).unwrap();
    listed.lines().map(str::to_owned).collect()
}

#[test]
fn an_image_of_packages_is_made_once_and_is_removed_with_all_that_runs_share() {
    let workplace = workplace(
        "matrix: {virtualization: [docker]}\nproviders:\n  docker: {recipe: {packages: [perl-base, hostname]}}\n",
    );
    workplace.write("sim/look.sh", format!("{SCRIPT}hostname >>\"$1/rights.txt\"\n"));
    let cleaned = workplace.run(&["clean"]);
    assert_eq!(cleaned.code, Some(0), "{cleaned:?}");
    assert_eq!(images_of_recipes(), Vec::<String>::new());
    let first = workplace.run(&["run", "m.yaml"]);
    assert_eq!(first.code, Some(0), "{first:?}");
    assert!(
        rights(&workplace).ends_with("\nworkload\n"),
        "{}",
        rights(&workplace)
    );
    let made = images_of_recipes();
    assert_eq!(made.len(), 1);
    let again = workplace.run(&["run", "m.yaml"]);
    assert_eq!(again.code, Some(0), "{again:?}");
    assert_eq!(images_of_recipes(), made, "it was not made again");

    workplace.write(
        "m.yaml",
        fs::read_to_string(workplace.path().join("m.yaml"))
            .unwrap()
            .replace("hostname]", "no-such-package]"),
    );
    let failed = workplace.run(&["run", "m.yaml"]);
    assert_eq!(failed.code, Some(3), "{failed:?}");
    assert!(
        failed.err.contains("Unable to locate package no-such-package"),
        "{failed:?}"
    );
    let cleaned = workplace.run(&["clean"]);
    assert_eq!(cleaned.code, Some(0), "{cleaned:?}");
    assert_eq!(images_of_recipes(), Vec::<String>::new());
}

#[test]
fn nodes_in_a_container_have_what_an_emulated_network_leaves_them_and_no_right_to_make_another() {
    let image = debian_image("matrix-python:debian-12", &["python3"]);
    let workplace = workplace(&format!(
        "matrix: {{virtualization: [docker]}}\nproviders:\n  docker: {{image: \"{image}\"}}\n"
    ));
    let command = "run: [sh, sim/look.sh, \"{window.folder}\"]";
    let file = fs::read_to_string(workplace.path().join("m.yaml")).unwrap();
    let node = format!("nodes: [{{name: look, host: sta1, {command}}}]");
    workplace.write("m.yaml", file.replace(command, &node));
    let ran = workplace.run(&["run", "m.yaml"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    // NET_ADMIN, NET_RAW, IPC_LOCK and SYS_NICE (linux/capability.h).
    assert_eq!(rights(&workplace), "CapEff:\t0000000000807000\ntun\n");
    assert!(
        workplace
            .scenario_directory()
            .join("window-1/sta1.pcap.zst")
            .exists()
    );
    assert_eq!(on_the_engine(&workplace), Vec::<String>::new());
}

#[test]
fn what_is_left_of_a_command_in_a_container_when_matrix_was_killed_is_found_and_removed() {
    let image = debian_image("matrix-python:debian-12", &["python3"]);
    let workplace = workplace(&format!(
        "matrix: {{virtualization: [docker]}}\nproviders:\n  docker: {{image: \"{image}\"}}\n"
    ));
    workplace.write("sim/look.sh", format!("{SCRIPT}sleep 1000\n"));
    let mut running = workplace.start(&["run", "m.yaml"]);
    running.wait_for("measuring window 1");
    running.kill();
    // The container and both of its volumes.
    assert_eq!(on_the_engine(&workplace).len(), 3);
    let cleaned = workplace.run(&["clean"]);
    assert_eq!(cleaned.code, Some(0), "{cleaned:?}");
    assert_eq!(on_the_engine(&workplace), Vec::<String>::new());
}

#[test]
fn a_command_that_needs_more_memory_than_its_container_has_is_errored() {
    let image = debian_image("matrix-python:debian-12", &["python3"]);
    let workplace = workplace(&format!(
        "matrix: {{virtualization: [docker]}}\nproviders:\n  docker: {{image: \"{image}\", memory: 64MiB}}\n"
    ));
    workplace.write(
        "sim/look.sh",
        "exec python3 -c \"print(len(bytearray(1 << 28)))\"\n",
    );
    let ran = workplace.run(&["run", "m.yaml"]);
    assert_eq!(ran.code, Some(3), "{ran:?}");
    assert!(
        ran.err.contains("the command of window 1 was killed by signal 9"),
        "{ran:?}"
    );
    assert_eq!(on_the_engine(&workplace), Vec::<String>::new());
}

#[test]
fn a_command_is_measured_on_a_host_over_ssh_and_nothing_is_left_there() {
    let there = There::start();
    let workplace = workplace(&format!(
        "hosts:\n  here: {{hardware: one}}\n  there: {{hardware: two, os: linux, connect: {}}}\nmatrix:\n  virtualization: \
         [native]\n",
        there.connect()
    ));
    let report = workplace.json(&["run", "m.yaml"]);
    for scenario in report["scenarios"].as_array().unwrap() {
        assert_eq!(scenario["outcome"], "completed", "{scenario:#}");
        assert!(
            scenario["windows"]
                .as_array()
                .unwrap()
                .iter()
                .all(|it| it["counted"] == true)
        );
    }
    // The same machine, whichever way it is reached.
    let groups = report["agreements"][0]["groups"].as_array().unwrap();
    assert_eq!(groups.len(), 1, "{report:#}");
    assert_eq!(there.environments(), Vec::<String>::new());
}

#[test]
fn hosts_of_a_pool_take_turns_with_the_rounds() {
    let there = There::start();
    let workplace = workplace(&format!(
        "hosts:\n  here: {{hardware: pc, os: linux, pool: lab}}\n  there: {{hardware: pc, os: linux, pool: lab, connect: {}}}\n\
         matrix:\n  virtualization: [native]\n",
        there.connect()
    ));
    let file = fs::read_to_string(workplace.path().join("m.yaml")).unwrap();
    workplace.write(
        "m.yaml",
        file.replace("{windows: 2}", "{windows: 1, environments: 4}"),
    );
    let report = workplace.json(&["run", "m.yaml"]);
    let [scenario] = report["scenarios"].as_array().unwrap().as_slice() else {
        panic!("{report:#}")
    };
    assert_eq!(scenario["outcome"], "completed", "{scenario:#}");
    let journal = fs::read_to_string(workplace.run_directory().join("events.jsonl")).unwrap();
    let created = journal
        .lines()
        .map(|line| serde_json::from_str::<Value>(line).unwrap());
    let created = created.filter(|event| event["event"] == "environment-creating");
    let mut hosts: Vec<(u64, String)> = created
        .map(|event| {
            (
                event["round"].as_u64().unwrap(),
                event["resources"][0]["host"].as_str().unwrap().to_owned(),
            )
        })
        .collect();
    hosts.sort();
    let expected = [(1, "here"), (2, "there"), (3, "here"), (4, "there")];
    assert_eq!(hosts, expected.map(|(round, host)| (round, host.to_owned())));
    assert_eq!(there.environments(), Vec::<String>::new());
}

#[test]
fn the_same_pile_of_bodies_falls_in_the_same_way_natively_and_in_a_container() {
    assert!(!debian_image("matrix-python:debian-12", &["python3"]).is_empty());
    let workplace = example("falling-bodies");
    // Through its shell: the file was written a moment ago, and another test may be starting a program meanwhile (ETXTBSY).
    let fetched = Command::new("bash")
        .arg("get-wheels")
        .current_dir(workplace.path())
        .status()
        .unwrap();
    assert!(fetched.success());
    let report = workplace.json(&["run", "matrix.yaml", "--profile", "quick"]);
    let state = &report["agreements"][0];
    assert_eq!(
        (&state["metric"], state["windows"].as_array().unwrap().len()),
        (&Value::from("final_state"), 2)
    );
    assert_eq!(state["groups"].as_array().unwrap().len(), 1, "{state:#}");
    assert_eq!(report["quantity"]["unit"], "us");
    assert_eq!(report["contrasts"].as_array().unwrap().len(), 1, "{report:#}");
    // Other seeds make other piles: what is compared is no constant.
    let scenario = workplace
        .run_directory()
        .join("scenarios/x86-64-debian-12-native");
    let state = |window: u32| fs::read(scenario.join(format!("window-{window}/state.txt"))).unwrap();
    assert_ne!(state(1), state(2));
}

#[test]
fn two_nodes_of_rospy_hold_the_ball_over_the_papers_network_natively_and_in_a_container() {
    let workplace = example("rospy-loop");
    let report = workplace.json(&["run", "matrix.yaml", "--profile", "quick"]);
    for scenario in report["scenarios"].as_array().unwrap() {
        assert_eq!(scenario["outcome"], "completed", "{scenario:#}");
        for window in scenario["windows"].as_array().unwrap() {
            assert_eq!(
                (&window["counted"], &window["n"]),
                (&Value::Bool(true), &4.into()),
                "{scenario:#}"
            );
        }
    }
    for slug in ["x86-64-debian-12-native", "x86-64-debian-12-docker"] {
        let folder = workplace.run_directory().join("scenarios").join(slug);
        let text = fs::read_to_string(folder.join("window-2/periods.csv")).unwrap();
        let rows = text.lines().skip(1).map(|row| row.split_once(',').unwrap());
        for (error_mm, age_ms) in
            rows.map(|(error, age)| (error.parse::<f64>().unwrap(), age.parse::<f64>().unwrap()))
        {
            // A ball that nobody holds is at the rim, 3.1 m from the centre; a state takes two passes of about 10 ms.
            assert!(error_mm > 0.0 && error_mm < 250.0, "{slug}: {text}");
            assert!(age_ms > 18.0, "{slug}: {text}");
        }
        let record: Value =
            serde_json::from_slice(&fs::read(folder.join("window-2/window.json")).unwrap()).unwrap();
        let [plant, controller] = record["command"]["nodes"].as_array().unwrap().as_slice() else {
            panic!("{record:#}")
        };
        // rospy ends in order when it is asked to.
        assert_eq!(
            (&plant["name"], &plant["exit_code"]),
            (&"plant".into(), &0.into()),
            "{record:#}"
        );
        assert_eq!(controller["exit_code"], 0, "{record:#}");
    }
    assert_eq!(on_the_engine(&workplace), Vec::<String>::new());
}

#[test]
fn how_late_threads_are_woken_is_measured_and_drift_can_be_judged() {
    assert!(!debian_image("matrix-cc:debian-12", &["gcc", "libc6-dev"]).is_empty());
    let workplace = example("wakeup-latency");
    for _ in 0..2 {
        let report = workplace.json(&["run", "matrix.yaml", "--profile", "quick"]);
        for scenario in report["scenarios"].as_array().unwrap() {
            assert_eq!(scenario["outcome"], "completed", "{scenario:#}");
            assert_eq!(scenario["windows"][0]["n"], 200, "{scenario:#}");
        }
    }
    let drift = workplace.run(&["drift", "runs"]);
    assert_eq!(drift.code, Some(6), "two nights are too few: {drift:?}");
    assert!(drift.out.contains("native lateness"), "{drift:?}");
}
