//! Runs as somebody finds them again: which there are, where each stands, and how one is followed that another process carries out.

use std::fs;

use serde_json::json;
use tests::{FAKE, Workplace};

#[test]
fn runs_are_listed_with_how_they_ended_and_the_newest_is_the_latest() {
    let workplace = Workplace::new();
    let none = workplace.run(&["runs"]);
    assert_eq!(none.code, Some(2), "{none:?}");
    let none = workplace.run(&["report", "latest"]);
    assert!(
        none.code == Some(2) && none.err.contains("there is no run in `runs`"),
        "{none:?}"
    );

    workplace.write("m.yaml", FAKE);
    assert_eq!(workplace.run(&["run", "m.yaml", "--quiet"]).code, Some(0));
    // Names begin with the second in which a run was asked for, and both runs may be of the same.
    let earlier = workplace.path().join("runs/20260101-000000-aaaa");
    fs::rename(workplace.run_directory(), earlier).unwrap();
    workplace.write(
        "late.yaml",
        format!("{FAKE}providers: {{fake: {{window_takes: 1h}}}}\n"),
    );
    let mut running = workplace.start(&["run", "late.yaml"]);
    running.wait_for("measuring window 1");
    let listed = workplace.run(&["runs"]).out;
    let lines: Vec<&str> = listed.lines().collect();
    assert!(
        lines[0].contains("  live       ") && lines[0].ends_with("0 of 8 windows  2 scenarios, late.yaml"),
        "{listed}"
    );
    assert_eq!(
        lines[1], "runs/20260101-000000-aaaa  completed  8 of 8 windows  2 scenarios, m.yaml",
        "{listed}"
    );
    running.kill();
    let document = workplace.json(&["runs"]);
    assert_eq!(document["runs"][0]["state"], "not finished", "{document:#}");
    let newest = document["runs"][0]["directory"].as_str().unwrap();
    let of_latest = workplace.json(&["status", "latest"]);
    assert_eq!(of_latest["windows_complete"], 0, "{of_latest:#}");
    assert_eq!(of_latest, workplace.json(&["status", newest]));
}

#[test]
fn status_has_the_windows_that_are_measured_and_the_one_under_way_while_it_runs() {
    let workplace = Workplace::new();
    workplace.write(
        "m.yaml",
        format!("{FAKE}providers: {{fake: {{window_takes: 500ms}}}}\n"),
    );
    let mut running = workplace.start(&["run", "m.yaml"]);
    running.wait_for("window 3 complete");
    let status = workplace.json(&["status", "latest"]);
    // None is collected before its environment has done all.
    assert!(status["windows_complete"].as_u64().unwrap() >= 3, "{status:#}");
    assert!(
        status["live"] == true && status["holder"]["pid"].is_u64(),
        "{status:#}"
    );
    let left_s = status["measuring_left_s"].as_f64().unwrap();
    assert!(
        left_s > 0.0 && left_s <= 40.0,
        "at most five windows of 8 s: {status:#}"
    );
    let text = workplace.run(&["status", "latest"]).out;
    assert!(
        text.contains(", live: process ") && text.contains("of measuring left"),
        "{text}"
    );
    assert_eq!(running.end().code, Some(0));
    let status = workplace.json(&["status", "latest"]);
    assert_eq!(status["measuring_left_s"], 0.0, "{status:#}");
    assert_eq!(
        (&status["windows"], &status["windows_complete"], &status["holder"]),
        (&json!(8), &json!(8), &json!(null)),
        "{status:#}"
    );
}

#[test]
fn whoever_watches_a_run_of_another_process_sees_it_from_its_beginning_to_its_end() {
    let workplace = Workplace::new();
    workplace.write(
        "m.yaml",
        format!("{FAKE}providers: {{fake: {{window_takes: 200ms}}}}\n"),
    );
    let mut running = workplace.start(&["run", "m.yaml"]);
    running.wait_for("window 2 complete");
    let watching = workplace.start(&["watch"]);
    assert_eq!(running.end().code, Some(0));
    let watched = watching.end();
    assert_eq!(watched.code, Some(0), "{watched:?}");
    for words in [
        "window 1 complete",
        "window 4 complete",
        "the run has ended, 8 of 8 windows are measured: `matrix report",
    ] {
        assert!(watched.err.contains(words), "{words}: {watched:?}");
    }
    // Of one that has ended there is all at once.
    let again = workplace.run(&["watch", "latest"]);
    assert_eq!(again.err.matches("window 4 complete").count(), 2, "{again:?}");
}
