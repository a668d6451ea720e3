//! `kill -9` of `matrix` at every moment of a scenario on a real Docker Engine, and `resume`.

use std::{
    collections::BTreeSet,
    process::Command,
    thread,
    time::{Duration, Instant},
};

use rstest::rstest;
use serde_json::Value;
use tests::{WHOLE_WINDOWS_COUNT, Workplace};

const MATRIX: &str = "\
matrix:
  virtualization: [docker]
workload:
  windows: 2
  window: 2s
  period: 500ms
  reference: {amplitude_m: 0.05}
";

/// Longer than any moment of this run takes to come; the bound only ends a hopeless wait.
const PATIENCE: Duration = Duration::from_secs(120);

/// The journal of the one run, as it is now; empty before there is one.
fn journal(workplace: &Workplace) -> Vec<Value> {
    let Ok(mut runs) = std::fs::read_dir(workplace.path().join("runs")) else {
        return Vec::new();
    };
    let Some(Ok(run)) = runs.next() else {
        return Vec::new();
    };
    let text = std::fs::read_to_string(run.path().join("events.jsonl")).unwrap_or_default();
    // The last line may be half-written just now.
    text.lines()
        .map_while(|line| serde_json::from_str(line).ok())
        .collect()
}

/// The names of what happened, with the workload's own as `workload/finished`.
fn names(journal: &[Value]) -> Vec<String> {
    let name = |entry: &Value| {
        let event = entry["event"].as_str().unwrap_or_default();
        match entry["progress"]["event"].as_str() {
            Some(said) => format!("{event}/{said}"),
            None => event.to_owned(),
        }
    };
    journal.iter().map(name).collect()
}

/// Starts the run and kills it as soon as the journal has that event.
fn kill_at(workplace: &Workplace, moment: &str) {
    let running = workplace.start(&["run", "m.yaml"]);
    let begun = Instant::now();
    while !names(&journal(workplace)).iter().any(|name| name == moment) {
        assert!(
            begun.elapsed() < PATIENCE,
            "no {moment}: {:#?}",
            journal(workplace)
        );
        thread::sleep(Duration::from_millis(1));
    }
    running.kill();
    let happened = names(&journal(workplace));
    for later in ["environment-discarded", "scenario-finished"] {
        assert!(
            !happened.iter().any(|name| name == later),
            "it was killed in time: {happened:?}"
        );
    }
}

/// The containers and volumes of a run that the engine has.
fn on_the_engine(run_directory: &str) -> Vec<String> {
    let filter = format!("label=matrix.run-directory={run_directory}");
    let kinds: [&[&str]; 2] = [&["ps", "--all"], &["volume", "ls"]];
    let mut found = Vec::new();
    for kind in kinds {
        let listed = Command::new("docker")
            .args(kind)
            .args(["--quiet", "--filter", &filter])
            .output()
            .unwrap();
        assert!(listed.status.success(), "{listed:?}");
        found.extend(
            String::from_utf8(listed.stdout)
                .unwrap()
                .lines()
                .map(str::to_owned),
        );
    }
    found
}

/// Each window is one environment's alone, all its steps in one stretch of the loop.
fn assert_windows_are_whole(workplace: &Workplace) {
    let scenario = workplace.scenario_directory();
    let records = [1, 2].map(|window| {
        let path = scenario.join(format!("window-{window}/window.json"));
        serde_json::from_slice::<Value>(&std::fs::read(path).unwrap()).unwrap()
    });
    for record in &records {
        assert_eq!(record["complete"], true, "{record:#}");
        assert_eq!(record["steps_done"], record["steps_expected"], "{record:#}");
        assert_eq!(record["plant"]["steps"], record["steps_expected"], "{record:#}");
    }
    let [first, second] = &records;
    assert_eq!(first["starts_run"], true, "{first:#}");
    if first["environment"] == second["environment"] {
        assert_eq!(first["ended_ns"], second["started_ns"]);
        assert_eq!(second["starts_run"], false, "{second:#}");
    } else {
        assert_eq!(second["starts_run"], true, "{second:#}");
    }
}

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
    let directory = workplace.run_directory();
    let directory = directory.to_str().unwrap();
    if moment.starts_with("workload/") {
        let there = on_the_engine(directory);
        assert!(!there.is_empty(), "what was killed left something behind");
    }

    let resumed = workplace.run(&["resume", directory]);
    assert_eq!(resumed.code, Some(0), "{resumed:?}");
    assert_windows_are_whole(&workplace);
    let report = workplace.json(&["report", directory]);
    assert_eq!(report["within"][0]["pairs"], 1, "{report:#}");
    assert_eq!(report["scenarios"][0]["outcome"], "completed", "{report:#}");
    let journal = journal(&workplace);
    let collected: BTreeSet<_> = journal
        .iter()
        .filter(|entry| entry["event"] == "window-collected")
        .map(|entry| (entry["window"].as_u64(), entry["environment"].as_str()))
        .collect();
    assert_eq!(
        collected.len(),
        2,
        "each window is one environment's: {collected:?}"
    );

    let cleaned = workplace.run(&["clean"]);
    assert_eq!(cleaned.code, Some(0), "{cleaned:?}");
    assert_eq!(on_the_engine(directory), Vec::<String>::new());
}
