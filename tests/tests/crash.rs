//! Whatever kills `matrix`, the run can be gone on with and nothing is lost or left behind.

use serde_json::Value;
use tests::Workplace;

/// Two fake scenarios of four windows: the whole pipeline in a blink.
const FAKE: &str = "\
matrix:
  virtualization: [fake]
  place: [here, there]
workload:
  windows: 4
  window: 8s
  period: 1s
";

#[test]
fn a_run_killed_after_any_line_is_whole_after_resume() {
    let lines = {
        let workplace = Workplace::new();
        workplace.write("m.yaml", FAKE);
        let mut running = workplace.start(&["run", "m.yaml"]);
        std::iter::from_fn(|| running.next_line()).count()
    };
    assert!(lines > 20, "a run says what it does: {lines} lines");
    for killed_after in 1..lines {
        let workplace = Workplace::new();
        workplace.write("m.yaml", FAKE);
        let mut running = workplace.start(&["run", "m.yaml"]);
        for _ in 0..killed_after {
            running.next_line();
        }
        running.kill();
        let Ok(mut runs) = std::fs::read_dir(workplace.path().join("runs")) else {
            continue;
        };
        if runs.next().is_none() {
            continue;
        }
        let directory = workplace.run_directory();
        let directory = directory.to_str().unwrap();
        let resumed = workplace.run(&["resume", directory]);
        if !workplace.run_directory().join("manifest.json").exists() {
            // Killed while the run directory was made: nothing was created, and the user is told to start again.
            assert_eq!(resumed.code, Some(2), "{resumed:?}");
            assert_eq!(left_behind(&workplace, directory), Vec::<Value>::new());
            continue;
        }
        assert_eq!(
            resumed.code,
            Some(0),
            "killed after {killed_after} lines: {resumed:?}"
        );
        let report = workplace.json(&["report", directory]);
        for scenario in report["within"].as_array().unwrap() {
            assert_eq!(
                scenario["pairs"], 6,
                "killed after {killed_after} lines: {report:#}"
            );
        }
        assert_eq!(
            report["between"][0]["pairs"], 16,
            "killed after {killed_after} lines: {report:#}"
        );
        let left = left_behind(&workplace, directory);
        assert!(
            left.is_empty(),
            "killed after {killed_after} lines, left behind: {left:#?}"
        );
    }
}

#[test]
fn what_is_left_to_do_is_told_and_not_done() {
    let workplace = Workplace::new();
    workplace.write(
        "m.yaml",
        format!("{FAKE}providers:\n  fake: {{window_takes: 1h}}\n"),
    );
    let mut running = workplace.start(&["run", "m.yaml"]);
    running.wait_for("measuring window 1");
    running.kill();
    let directory = workplace.run_directory();
    let journal = || std::fs::read(directory.join("events.jsonl")).unwrap();
    let before = journal();
    let path = directory.to_str().unwrap();
    let left = workplace.json(&["resume", path, "--dry-run"]);
    let scenarios = left["scenarios"].as_array().unwrap();
    assert_eq!(scenarios.len(), 2, "{left:#}");
    for scenario in scenarios {
        assert_eq!(scenario["windows"], serde_json::json!([1, 2, 3, 4]), "{left:#}");
    }
    let begun: Vec<_> = scenarios
        .iter()
        .filter(|scenario| scenario["environment"].is_string())
        .collect();
    assert_eq!(begun.len(), 1, "{left:#}");
    let text = workplace.run(&["resume", path, "--dry-run"]).out;
    for words in ["windows 1, 2, 3, 4", begun[0]["environment"].as_str().unwrap()] {
        assert!(text.contains(words), "{words} is not in {text}");
    }
    assert!(journal() == before, "nothing was done");

    let workplace = Workplace::new();
    workplace.write("m.yaml", FAKE);
    assert_eq!(workplace.run(&["run", "m.yaml"]).code, Some(0));
    let directory = workplace.run_directory();
    let left = workplace.json(&["resume", directory.to_str().unwrap(), "--dry-run"]);
    assert_eq!(left["scenarios"], serde_json::json!([]), "{left:#}");
}

/// What `matrix clean` finds of a run; other tests may be at work on the same engine.
fn left_behind(workplace: &Workplace, directory: &str) -> Vec<Value> {
    let clean = workplace.json(&["clean", "--dry-run"]);
    let leftovers = clean["leftovers"].as_array().unwrap().iter();
    leftovers
        .filter(|leftover| leftover["run_directory"] == directory)
        .cloned()
        .collect()
}
