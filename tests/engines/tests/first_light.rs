//! The whole way through on the real engines: native and Docker, from a matrix file to the paper's tables.

use std::{fs::File, process::Command};

use serde_json::Value;
use tests::{Ran, WHOLE_WINDOWS_COUNT, Workplace};

/// Windows of eight periods of one second: the test can reject at that size, and the way through is the whole way.
const MATRIX: &str = "\
matrix:
  virtualization: [native, docker, virtualbox]
workload:
  windows: 4
  window: 8s
  period: 1s
  reference: {amplitude_m: 0.05}
";

fn find<'a>(rows: &'a Value, id: &str) -> &'a Value {
    rows.as_array()
        .unwrap()
        .iter()
        .find(|row| row["id"] == id)
        .unwrap()
}

#[test]
fn native_and_docker_are_measured_and_compared_as_in_the_paper() {
    let workplace = Workplace::measuring();
    workplace.write("matrix.yaml", format!("{MATRIX}  {WHOLE_WINDOWS_COUNT}\n"));
    let mut running = workplace.start(&["run", "matrix.yaml"]);
    let before = running.wait_for("window 4 complete");
    let memory = running.peak_memory_kib();
    assert!(
        memory <= 80 * 1024,
        "matrix has {memory} KiB resident during a run"
    );
    let mut ran = running.end();
    ran.err.insert_str(0, &before);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let discard = ran.err.find("matrix clean").expect("it says how to clean up");
    let created = ran.err.find("creating").expect("it says what it creates");
    assert!(
        discard < created,
        "how to clean up is said before anything is created:\n{}",
        ran.err
    );

    let directory = workplace.run_directory();
    let report = workplace.json(&["report", directory.to_str().unwrap()]);
    for id in ["a", "b"] {
        assert_eq!(find(&report["within"], id)["pairs"], 6, "{report:#}");
    }
    // The times on record give the errors on record again, to the last bit.
    let replayed = workplace.run(&["replay", directory.to_str().unwrap()]);
    assert_eq!(replayed.code, Some(0), "{replayed:?}");
    assert_eq!(report["between"].as_array().unwrap().len(), 1, "{report:#}");
    assert_eq!(report["between"][0]["pairs"], 16, "{report:#}");
    let sizes: Vec<u64> = report["comparisons"]
        .as_array()
        .unwrap()
        .iter()
        .map(|c| c["n"].as_u64().unwrap())
        .collect();
    assert!(
        sizes.iter().all(|n| *n == 7 || *n == 8),
        "the first period of a run is left out: {sizes:?}"
    );

    for scenario in std::fs::read_dir(directory.join("scenarios")).unwrap() {
        let scenario = scenario.unwrap().path();
        let environment: Value =
            serde_json::from_slice(&std::fs::read(scenario.join("environment.json")).unwrap()).unwrap();
        assert_ne!(environment["provider"], "fake");
        for window in 1..=4 {
            let folder = scenario.join(format!("window-{window}"));
            let record: Value =
                serde_json::from_slice(&std::fs::read(folder.join("window.json")).unwrap()).unwrap();
            // On a busy machine a timer may run out twice before it is read.
            let lost = record["controller"]["lost_ticks"].as_u64().unwrap();
            assert_eq!(record["steps_done"].as_u64().unwrap() + lost, 400, "{record:#}");
            assert!(lost <= 20, "{record:#}");
            for capture in record["captures"].as_array().unwrap() {
                // h1 has the master, which is silent once the nodes know each other.
                let least = if capture["host"] == "h1" { 0 } else { 400 };
                assert!(capture["packets"].as_u64().unwrap() >= least, "{record:#}");
                assert_eq!(capture["dropped"], 0, "{record:#}");
            }
        }
    }

    every_message_of_the_logs_is_in_the_captures(&workplace, directory.to_str().unwrap());

    let status = workplace.json(&["status", directory.to_str().unwrap()]);
    assert_eq!(status["finished"], true);
    assert_eq!(find(&status["scenarios"], "c")["state"], "infeasible");

    assert_eq!(workplace.run(&["clean"]).code, Some(0));
    assert_eq!(
        workplace.json(&["clean", "--dry-run"])["leftovers"],
        serde_json::json!([])
    );
    assert_eq!(labelled("ps"), "", "no container is left");
    assert_eq!(labelled("volume"), "", "no volume is left");
}

fn every_message_of_the_logs_is_in_the_captures(workplace: &Workplace, directory: &str) {
    let messages = workplace.json(&["messages", directory]);
    let scenarios = messages["scenarios"].as_array().unwrap();
    assert_eq!(scenarios.len(), 2, "{messages:#}");
    let topics = scenarios
        .iter()
        .flat_map(|scenario| scenario["topics"].as_array().unwrap());
    let retransmitted: u64 = topics.map(|topic| topic["retransmitted"].as_u64().unwrap()).sum();
    // Some 55 segments of both scenarios are lost, each with a message or more: fewer than 20 once in a million runs.
    assert!(retransmitted >= 20, "{messages:#}");
    for scenario in scenarios {
        assert_eq!(scenario["windows"], serde_json::json!([1, 2, 3, 4]));
        let [state, command] = [&scenario["topics"][0], &scenario["topics"][1]];
        for topic in [state, command] {
            let count = |name: &str| topic[name].as_u64().unwrap();
            // With Nagle's algorithm the last messages wait for an acknowledgement, for which a run does not: the program that
            // would send them has ended.
            let held_back = count("logged") - count("found");
            let numbers = topic["missing"].as_array().unwrap();
            let of_the_last = numbers
                .iter()
                .all(|number| number.as_u64().unwrap() > count("logged") - held_back);
            assert!(of_the_last && held_back <= 25, "{messages:#}");
            // At the end of the last window some are still under way.
            assert!(
                count("arrived") + held_back >= 1560 && count("arrived") <= count("sent"),
                "{messages:#}"
            );
            // With Nagle's algorithm 1600 messages are some 700 segments, of which one in fifty is lost: none once in a million runs.
            assert!(count("retransmitted") >= 1, "{messages:#}");
            let mean_ns = topic["one_way"]["mean_ns"].as_f64().unwrap();
            let min_ns = topic["one_way"]["min_ns"].as_f64().unwrap();
            assert!(min_ns >= 18e6 && (19e6..60e6).contains(&mean_ns), "{messages:#}");
        }
        assert!(command["logged"].as_u64().unwrap() >= 1580, "{messages:#}");
        let table = std::fs::read_to_string(scenario["files"][0].as_str().unwrap()).unwrap();
        let sent = state["sent"].as_u64().unwrap() + command["sent"].as_u64().unwrap();
        assert_eq!(table.lines().count() as u64, 1 + sent, "one line a message");
        let columnar = std::fs::read(scenario["files"][1].as_str().unwrap()).unwrap();
        assert!(columnar.starts_with(b"PAR1") && columnar.ends_with(b"PAR1"));
    }
}

/// Removed when dropped: an image of this machine's shell and `ls`, with what they are linked with.
struct ShellImage(String);

impl ShellImage {
    fn make() -> Self {
        let name = format!("shell-of-a-test-{}:1", std::process::id());
        let script = r#"tar -chP /bin/sh /bin/ls $(ldd /bin/sh /bin/ls | grep -o ' /[^ ]*\|^.*/lib64[^ ]*' | sort -u) | docker import - "$1""#;
        let made = Command::new("sh")
            .args(["-c", script, "sh", &name])
            .output()
            .unwrap();
        assert!(made.status.success(), "{made:?}");
        Self(name)
    }
}

impl Drop for ShellImage {
    fn drop(&mut self) {
        let _ = Command::new("docker").args(["rmi", &self.0]).output();
    }
}

#[test]
fn the_data_of_a_container_that_was_kept_are_looked_at_from_an_image_with_a_shell() {
    let workplace = Workplace::measuring();
    workplace.write(
        "m.yaml",
        MATRIX
            .replace("[native, docker, virtualbox]", "[docker]")
            .replace("windows: 4", "windows: 1"),
    );
    let ran = workplace.run(&["run", "m.yaml", "--keep", "always"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let without = workplace.run(&["shell", "a"]);
    assert_eq!(without.code, Some(3), "{without:?}");
    assert!(without.err.contains("`--image debian:12`"), "{without:?}");
    let image = ShellImage::make();
    workplace.write("typed", "pwd; ls; exit 7\n");
    let typed = File::open(workplace.path().join("typed")).unwrap();
    let mut shell = workplace.matrix(["shell", "a", "--image", &image.0]);
    let entered = Ran::of(shell.stdin(typed).output().unwrap());
    assert_eq!(entered.code, Some(7), "{entered:?}");
    assert!(entered.out.starts_with("/data\n"), "{entered:?}");
    assert!(entered.out.contains("window-1"), "{entered:?}");
    // Nothing is pulled.
    let mut shell = workplace.matrix(["shell", "a", "--image", "nobody-has-it:1"]);
    let refused = Ran::of(shell.output().unwrap());
    assert_eq!(refused.code, Some(125), "{refused:?}");
    let cleaned = workplace.run(&["clean"]);
    assert_eq!(cleaned.code, Some(0), "{cleaned:?}");
}

/// What the engine has with a label of ours.
fn labelled(kind: &str) -> String {
    let arguments: &[&str] = match kind {
        "ps" => &["ps", "-aq", "--filter", "label=matrix.run"],
        _ => &["volume", "ls", "-q", "--filter", "label=matrix.run"],
    };
    let output = Command::new("docker")
        .args(arguments)
        .output()
        .expect("the docker command is there");
    assert!(output.status.success(), "{output:?}");
    String::from_utf8_lossy(&output.stdout).trim().to_owned()
}

#[test]
fn a_selection_runs_what_it_names_and_is_done_with_that() {
    let workplace = Workplace::new();
    workplace.write(
        "m.yaml",
        "matrix:\n  virtualization: [fake]\n  labels: {place: [here, there]}\n\
         workload:\n  windows: 2\n  window: 8s\n  period: 1s\n",
    );
    let ran = workplace.run(&["run", "m.yaml", "--only", "place=there"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let status = workplace.json(&["status", workplace.run_directory().to_str().unwrap()]);
    assert_eq!(find(&status["scenarios"], "a")["state"], "not selected");
    assert_eq!(find(&status["scenarios"], "b")["state"], "completed");
}
