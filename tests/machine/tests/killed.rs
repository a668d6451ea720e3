//! `kill -9` of `matrix` while real workloads measure: they go on, and `resume` finds and collects what they measured.

use std::process::Command;

use serde_json::Value;
use tests::{
    Workplace,
    killed::{environments_of_windows, four_windows, is_found_and_collected},
};

#[test]
fn a_process_that_went_on_measuring_is_found_and_collected() {
    is_found_and_collected("native");
}

/// Sends a signal to the workload of an environment on this machine.
fn signal(name: &str, environment: &str) {
    let workload = format!("^[^ ]*workload[^ ]* run --environment {environment} ");
    let sent = Command::new("pkill")
        .args([&format!("-{name}"), "--full", &workload])
        .output()
        .unwrap();
    assert!(sent.status.success(), "{sent:?}");
}

#[test]
fn a_workload_that_stands_still_is_left_after_ctrl_c_and_gone_on_with() {
    let workplace = Workplace::measuring();
    workplace.write("m.yaml", four_windows("native"));
    let mut running = workplace.start(&["run", "m.yaml"]);
    running.wait_for("window 1 complete");
    let directory = workplace.run_directory();
    let path = directory.to_str().unwrap();
    let status = workplace.json(&["status", path]);
    let environment = status["scenarios"][0]["environment"].as_str().unwrap().to_owned();
    signal("STOP", &environment);
    running.wait_for("nothing was heard of the workload for 10 s");
    let left = running.interrupt();
    assert_eq!(left.code, Some(130), "{left:?}");
    for words in ["stands still", "matrix resume", "interrupted"] {
        assert!(left.err.contains(words), "{words}: {left:?}");
    }
    // It is asked to end as soon as it gets on.
    signal("CONT", &environment);
    let resumed = workplace.run(&["resume", path]);
    assert_eq!(resumed.code, Some(0), "{resumed:?}");
    let environments = environments_of_windows(&workplace);
    assert_eq!(
        environments[0], environment,
        "what was complete is not measured again"
    );
    assert_eq!(workplace.run(&["clean"]).code, Some(0));
}

#[test]
fn ctrl_c_keeps_complete_windows_says_how_to_go_on_and_leaves_nothing_behind() {
    let workplace = Workplace::measuring();
    workplace.write("m.yaml", four_windows("native"));
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

#[test]
fn what_a_removal_that_was_cut_short_has_left_goes_with_resume() {
    let workplace = Workplace::measuring();
    workplace.write(
        "m.yaml",
        four_windows("native").replace("windows: 4", "windows: 2"),
    );
    let ran = workplace.run(&["run", "m.yaml"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let directory = workplace.run_directory();
    let journal = directory.join("events.jsonl");
    let text = std::fs::read_to_string(&journal).unwrap();
    let kept = 1 + text
        .lines()
        .position(|line| line.contains("environment-discarding"))
        .unwrap();
    let discarding: Value = serde_json::from_str(text.lines().nth(kept - 1).unwrap()).unwrap();
    let begin: String = text.lines().take(kept).map(|line| format!("{line}\n")).collect();
    std::fs::write(&journal, begin).unwrap();
    // The file that says whose it is was removed first.
    let environments = workplace.path().join("state/environments");
    let folder = environments.join(discarding["environment"].as_str().unwrap());
    std::fs::create_dir_all(folder.join("data/window-1")).unwrap();
    // And one was being made.
    std::fs::create_dir_all(folder.with_extension("77.unfinished")).unwrap();

    let resumed = workplace.run(&["resume", directory.to_str().unwrap()]);
    assert_eq!(resumed.code, Some(0), "{resumed:?}");
    assert_eq!(std::fs::read_dir(environments).unwrap().count(), 0, "{resumed:?}");
}
