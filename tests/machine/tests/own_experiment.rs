//! An experiment of the user's own, from its matrix file to its report, natively.

#![allow(clippy::unwrap_used, clippy::panic)] // What tests may, but clippy knows only functions that are tests themselves.

use std::{fs, process::Command};

use record::settings::ValiditySettings;
use serde_json::{Value, json};
use tests::{Ran, Workplace};

/// Writes twenty values and a state; what it does besides depends on its mode and the window.
const SCRIPT: &str = r#"#!/bin/sh
mode=$1 out=$2 window=$3 offset=$4
case $mode-$window in
    fails-2) printf '\033[31mno convergence\n' >&2; exit 3 ;;
    killed-2) kill -KILL $$ ;;
    slow-2) sleep 60 ;;
    no-number-2) printf 'error,step\n1,2\nfast,2\n' >"$out/errors.csv"; echo s >"$out/state.txt"; exit ;;
    nothing-2) exit ;;
    orphan-*) setsid sleep 1000 & ;;
esac
echo error,step >"$out/errors.csv"
for value in 1 2 3 4 5 6 7 8 9 10; do echo "$value.$window$offset,0.$value$offset"; done >>"$out/errors.csv"
echo "x $window" >"$out/state.txt"
[ "$mode" != other ] || [ "$window" != 2 ] || echo "y 3" >>"$out/state.txt"
echo "wrote $out"
"#;

fn workplace() -> Workplace {
    let workplace = Workplace::measuring();
    fs::create_dir(workplace.path().join("sim")).unwrap();
    workplace.write("sim/reach.sh", SCRIPT);
    workplace
}

/// No window is suspect for what else happens on the machine: other tests run beside these, and hypervisors take time.
fn whatever_the_machine_does() -> String {
    let never = |rule: &&str| format!("{rule}: {{suspect: never, invalid: never}}");
    Vec::from_iter(ValiditySettings::CONDITIONS.iter().map(never)).join(", ")
}

/// A file that measures these modes, and some more of it.
fn matrix_file(modes: &str, more: &str) -> String {
    format!(
        "matrix:\n  parameters.mode: [{modes}]\n\
         experiment:\n  name: reach\n  files: [sim/]\n  prepare: [echo, ready]\n  \
         run: [sh, sim/reach.sh, \"{{parameters.mode}}\", \"{{window.folder}}\", \"{{window.number}}\", \"{{parameters.offset}}\"]\n  \
         window: {{timeout: 2s}}\n  parameters: {{mode: good, offset: 0}}\n  metrics:\n  \
         - {{name: reach_error, unit: mm, from: errors.csv, column: error}}\n  \
         - {{name: step_time, unit: ms, from: errors.csv, column: step, equivalence_margin: 0.5}}\n  \
         - {{name: final_state, from: state.txt, compare: identical}}\n\
         workload: {{windows: 3, validity: {{{}}}}}\n{more}",
        whatever_the_machine_does()
    )
}

/// A scenario of a report by its mode.
fn scenario<'a>(report: &'a Value, mode: &str) -> &'a Value {
    let all = report["scenarios"].as_array().unwrap();
    all.iter()
        .find(|it| it["axes"]["parameters.mode"] == mode)
        .unwrap_or_else(|| panic!("{report:#}"))
}

/// Processes that sleep for so many seconds.
fn sleeping(seconds: u32) -> usize {
    let is = |words: &String| *words == format!("sleep\u{0}{seconds}\u{0}");
    let all = fs::read_dir("/proc").unwrap();
    let words = all.filter_map(|entry| fs::read_to_string(entry.ok()?.path().join("cmdline")).ok());
    words.filter(is).count()
}

fn succeeds(ran: &Ran) {
    assert_eq!(ran.code, Some(0), "{ran:?}");
}

#[test]
fn each_metric_is_compared_in_its_own_unit() {
    let workplace = workplace();
    workplace.write(
        "m.yaml",
        matrix_file("good, other", "report: {family: [[a, b]]}\n"),
    );
    let report = workplace.json(&["run", "m.yaml"]);
    assert_eq!(
        report["quantity"],
        json!({
            "name": "reach_error", "unit": "mm", "origin": "Metric: reach_error, column `error` of `errors.csv`, in mm."
        })
    );
    assert_eq!(
        report["metrics"],
        json!(["reach_error", "step_time", "final_state"])
    );
    assert_eq!(scenario(&report, "good")["windows"][0]["n"], 10, "{report:#}");
    assert_eq!(
        report["agreements"],
        json!([{
            "metric": "final_state",
            "windows": [1, 2, 3],
            "groups": [
                {"scenarios": ["a"], "compared": 3, "same_as_first": 3, "parts": null},
                {"scenarios": ["b"], "compared": 3, "same_as_first": 2, "parts": {
                    "window": 2, "byte": 4, "line": 2, "first": "", "this": "y 3"
                }},
            ],
            "without_data": [],
        }])
    );

    // What differs in a parameter is not the platform's alone.
    assert_eq!(
        report["unlike"][0]["fields"],
        json!(["experiment.parameters.mode"])
    );
    assert_eq!(
        report["contrasts"].as_array().unwrap().len(),
        1,
        "since it is named"
    );

    let folder = workplace.run_directory();
    let other = fs::read_to_string(folder.join("report/metrics/step_time/report.json")).unwrap();
    let other: Value = serde_json::from_str(&other).unwrap();
    assert_eq!(
        (&other["quantity"]["name"], &other["family"]["equivalence_margin"]),
        (&json!("step_time"), &json!(0.5))
    );
    let told = workplace.run(&["report", folder.to_str().unwrap(), "--full"]);
    for words in [
        "Which scenarios have the same final_state",
        "shift (mm)",
        "# Metric step_time",
        "shift (ms)",
    ] {
        assert!(told.out.contains(words), "{words}: {told:?}");
    }
    for words in ["metre", "ball", "dynamics"] {
        assert!(!told.out.contains(words), "{words}: {told:?}");
    }

    let of_the_ball = workplace.run(&["report", folder.to_str().unwrap(), "--metric", "mean-abs-x"]);
    assert_eq!(of_the_ball.code, Some(2), "{of_the_ball:?}");
    assert!(
        of_the_ball.err.contains("`--metric` is of the ball on the plate"),
        "{of_the_ball:?}"
    );

    // All of it stays verifiable, and what a command printed does not leave the house.
    let slug = scenario(&report, "good")["slug"].as_str().unwrap();
    let window = folder.join("scenarios").join(slug).join("window-1");
    assert!(
        fs::read_to_string(window.join("stdout.txt"))
            .unwrap()
            .starts_with("wrote ")
    );
    let prepared = fs::read_dir(folder.join("scenarios").join(slug)).unwrap();
    let prepared = prepared.map(|entry| entry.unwrap().path());
    let prepared = prepared.filter(|path| path.to_str().unwrap().ends_with("-stdout.txt"));
    let prepared: Vec<String> = prepared.map(|path| fs::read_to_string(path).unwrap()).collect();
    assert_eq!(prepared, ["ready\n"]);
    succeeds(&workplace.run(&["status", folder.to_str().unwrap(), "--verify"]));
    let archive = folder.join("experiment.tar.lz4");
    let files = fs::read(&archive).unwrap();
    fs::write(&archive, b"others").unwrap();
    let damaged = workplace.run(&["status", folder.to_str().unwrap(), "--verify"]);
    assert_eq!(damaged.code, Some(2), "{damaged:?}");
    fs::write(&archive, files).unwrap();
    succeeds(&workplace.run(&["redact", folder.to_str().unwrap(), "--output", "blind"]));
    let blind = fs::read_dir(workplace.path().join("blind"))
        .unwrap()
        .next()
        .unwrap();
    let blind = blind.unwrap().path();
    succeeds(&workplace.run(&["status", blind.to_str().unwrap(), "--verify"]));
    assert!(!blind.join("experiment.tar.lz4").exists());
    assert_eq!(
        workplace.json(&["report", blind.to_str().unwrap()])["agreements"],
        report["agreements"]
    );
}

#[test]
fn whatever_a_command_does_ends_its_own_window_and_is_told() {
    let workplace = workplace();
    workplace.write(
        "m.yaml",
        matrix_file("fails, killed, slow, no-number, nothing, orphan", ""),
    );
    let ran = workplace.run(&["run", "m.yaml"]);
    for words in [
        "window 2 complete, invalid: the command ended with exit code 3; it printed last: \u{fffd}[31mno convergence",
        "the command of window 2 was killed by signal 9",
        "window 2 complete, invalid: the command was ended since it took longer than 2 s",
        "window 2 complete, invalid: errors.csv: line 3, column 1: `fast` is not a finite number",
        "window 2 complete, invalid: the command wrote no `errors.csv`; the command wrote no `state.txt`",
    ] {
        assert!(ran.err.contains(words), "{words}: {}", ran.err);
    }
    assert!(!ran.err.contains('\u{1b}') && !ran.out.contains('\u{1b}'));
    let directory = workplace.run_directory();
    let report = workplace.json(&["report", directory.to_str().unwrap()]);
    for mode in ["fails", "slow", "no-number", "nothing"] {
        let scenario = scenario(&report, mode);
        assert_eq!(scenario["outcome"], "completed", "{scenario:#}");
        let counted: Vec<&Value> = scenario["windows"]
            .as_array()
            .unwrap()
            .iter()
            .map(|it| &it["counted"])
            .collect();
        assert_eq!(counted, [true, false, true], "{mode}: the others count");
    }
    assert_eq!(scenario(&report, "killed")["outcome"], "errored");
    assert_eq!(scenario(&report, "orphan")["calls"]["left_behind"], 3);
    assert_eq!(sleeping(1000), 0);
}

#[test]
fn a_run_that_is_killed_goes_on_with_the_files_it_began_with() {
    let workplace = workplace();
    workplace.write(
        "m.yaml",
        matrix_file("good", "").replace("timeout: 2s", "timeout: 60s"),
    );
    // It waits in its second window until it is let go.
    let waiting = SCRIPT.replace(
        "echo error,step",
        "while [ $window = 2 ] && [ ! -e \"$offset/go\" ]; do setsid sleep 1001; done\necho error,step",
    );
    workplace.write(
        "sim/reach.sh",
        waiting.replace("$offset,", ",").replace("$offset\"", "\""),
    );
    let offset = workplace.path().to_str().unwrap().to_owned();
    let text = fs::read_to_string(workplace.path().join("m.yaml")).unwrap();
    workplace.write("m.yaml", text.replace("offset: 0", &format!("offset: {offset}")));
    let mut running = workplace.start(&["run", "m.yaml"]);
    running.wait_for("window 1 complete");
    running.kill();
    // Its workload, too: the windows that are missing are measured in another environment.
    let journal = fs::read_to_string(workplace.run_directory().join("events.jsonl")).unwrap();
    let started = journal
        .lines()
        .map(|line| serde_json::from_str::<Value>(line).unwrap());
    let pid = started
        .filter_map(|event| event["progress"]["pid"].as_i64())
        .next()
        .unwrap();
    let killed = Command::new("kill")
        .args(["-KILL", &pid.to_string()])
        .status()
        .unwrap();
    assert!(killed.success());
    // Another experiment now, which this run did not begin with.
    workplace.write("sim/reach.sh", "exit 1\n");
    workplace.write("go", "");
    let directory = workplace.run_directory();
    let resumed = workplace.run(&["resume", directory.to_str().unwrap()]);
    succeeds(&resumed);
    assert_eq!(
        sleeping(1001),
        0,
        "what the killed workload's command started is gone"
    );
    let report = workplace.json(&["report", directory.to_str().unwrap()]);
    let windows = scenario(&report, "good")["windows"].as_array().unwrap();
    assert!(
        windows
            .iter()
            .all(|window| window["verdict"] != "invalid" && window["counted"] == true),
        "{report:#}"
    );
}

#[test]
fn an_errored_scenario_is_tried_again_and_a_failed_one_is_not() {
    let workplace = workplace();
    let there = workplace.path().display().to_string();
    // It is killed once, and then never again.
    let killed_once = "[ $window != 2 ] || [ -e \"$offset/once\" ] || { touch \"$offset/once\"; kill -KILL $$; }\necho error,step";
    let script = SCRIPT.replace("echo error,step", killed_once);
    workplace.write(
        "sim/reach.sh",
        script
            .replace("$offset,", ",")
            .replace("$value$offset\"", "$value\""),
    );
    let hooks = format!("  retries: 1\n  restore: [touch, {there}/restored]\n  parameters:");
    let file = matrix_file("good", "").replace("offset: 0", &format!("offset: {there}"));
    workplace.write("m.yaml", file.replace("  parameters:", &hooks));
    let report = workplace.json(&["run", "m.yaml"]);
    let good = scenario(&report, "good");
    assert_eq!(good["outcome"], "completed", "{report:#}");
    let counted = good["windows"]
        .as_array()
        .unwrap()
        .iter()
        .all(|it| it["counted"] == true);
    assert!(counted, "{report:#}");
    let environment = good["environment"]["environment"].as_str().unwrap();
    assert!(
        environment.ends_with("-2"),
        "window 1 is of the first, the others of the second: {environment}"
    );
    assert!(workplace.path().join("restored").exists());

    let failing = workplace.beside();
    fs::create_dir(failing.path().join("sim")).unwrap();
    failing.write("sim/reach.sh", SCRIPT);
    failing.write(
        "m.yaml",
        matrix_file("fails", "").replace("  parameters:", "  retries: 5\n  fail_fast: true\n  parameters:"),
    );
    let ran = failing.run(&["run", "m.yaml"]);
    assert_eq!(ran.code, Some(1), "{ran:?}");
    assert!(
        ran.err
            .contains("failed: window 2 does not count, and `fail_fast` ends the scenario"),
        "{ran:?}"
    );
    assert_eq!(ran.err.matches("environment is up").count(), 1, "{ran:?}");
}

#[test]
fn a_restore_that_fails_is_told_though_all_windows_are_there() {
    let workplace = workplace();
    let file = matrix_file("good", "").replace(
        "  parameters:",
        "  retries: 2\n  restore: [sh, -c, exit 7]\n  parameters:",
    );
    workplace.write("m.yaml", file);
    let ran = workplace.run(&["run", "m.yaml"]);
    assert_eq!(ran.code, Some(3), "{ran:?}");
    assert!(
        ran.err.contains("the command `restore` ended with exit code 7"),
        "{ran:?}"
    );
    assert_eq!(
        ran.err.matches("environment is up").count(),
        1,
        "there is no window to try again: {ran:?}"
    );
    let report = workplace.json(&["report", &workplace.run_directory().display().to_string()]);
    let windows = scenario(&report, "good")["windows"].as_array().unwrap();
    assert!(
        windows.len() == 3 && windows.iter().all(|it| it["counted"] == true),
        "{report:#}"
    );
}

#[test]
fn a_scenario_that_fails_fast_has_no_further_environments() {
    let workplace = workplace();
    let file = matrix_file("fails", "").replace("  parameters:", "  fail_fast: true\n  parameters:");
    workplace.write(
        "m.yaml",
        file.replace("{windows: 3,", "{windows: 3, environments: 3,"),
    );
    let ran = workplace.run(&["run", "m.yaml"]);
    assert_eq!(ran.code, Some(1), "{ran:?}");
    assert_eq!(ran.err.matches("environment is up").count(), 1, "{ran:?}");
}

#[test]
fn a_metric_of_the_users_drifts_is_acknowledged_and_told_no_more() {
    let workplace = workplace();
    // The last digit is the offset: nights that differ a little, and one that is far away.
    let night = |offset: u32, far: bool| {
        let file = matrix_file("good", "").replace("offset: 0", &format!("offset: {offset}"));
        workplace.write("m.yaml", file);
        let script = match far {
            true => SCRIPT.replace("$value.$window", "9$value.$window"),
            false => SCRIPT.to_owned(),
        };
        workplace.write("sim/reach.sh", script);
        succeeds(&workplace.run(&["run", "m.yaml", "--quiet"]));
    };
    for night_of in 0..10 {
        night(night_of * 7 % 10, false);
    }
    let before = workplace.json(&["drift", "runs"]);
    assert_eq!(before["verdict"], "no drift found", "{before:#}");
    night(3, true);
    let told = workplace.run(&["drift", "runs"]);
    assert_eq!(told.code, Some(4), "{told:?}");
    for words in ["reach_error jumped from 5.", " mm", "experiment_sha256"] {
        assert!(told.out.contains(words), "{words}: {told:?}");
    }

    let newest = {
        let mut runs: Vec<String> = fs::read_dir(workplace.path().join("runs"))
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        runs.sort();
        runs.pop().unwrap()
    };
    workplace.write(
        "known.yaml",
        format!(
            "acknowledged:\n  - {{scenario: \"*\", metric: reach_error, since: {newest}, reason: another arm, person: Ada, expires: 2999-01-01}}\n"
        ),
    );
    let known = workplace.run(&["drift", "runs", "--acknowledged", "known.yaml"]);
    assert_ne!(known.code, Some(4), "{known:?}");
    // Lines end where a terminal's do.
    let words: Vec<&str> = known.out.split_whitespace().collect();
    assert!(words.join(" ").contains("acknowledged by Ada"), "{known:?}");
}
