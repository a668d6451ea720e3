//! A run that is killed at some moment of its scenario, and gone on with. The main functions are [`kill_at`] and
//! [`go_on_whole`].

use std::{
    collections::BTreeSet,
    thread,
    time::{Duration, Instant},
};

use serde_json::Value;

use crate::Workplace;

/// Longer than any moment of this run takes to come; the bound only ends a hopeless wait.
const TIMEOUT: Duration = Duration::from_secs(120);

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

/// Starts a run of `m.yaml` and kills it as soon as the journal has that event, `environment-creating` or
/// `workload/measuring`.
///
/// # Panics
/// When that never happens, or the run was done before it could be killed.
pub fn kill_at(workplace: &Workplace, moment: &str) {
    let running = workplace.start(&["run", "m.yaml"]);
    let begun = Instant::now();
    while !names(&journal(workplace)).iter().any(|name| name == moment) {
        assert!(
            begun.elapsed() < TIMEOUT,
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

/// Each window is one environment's alone, all its steps in one stretch of the loop.
fn assert_windows_are_whole(workplace: &Workplace) {
    let scenario = workplace.scenario_directory();
    let records = [1, 2].map(|window| {
        let path = scenario.join(format!("window-{window}/window.json"));
        serde_json::from_slice::<Value>(&std::fs::read(path).expect("it is as runs leave it"))
            .expect("it is as runs leave it")
    });
    for record in &records {
        assert_eq!(record["complete"], true, "{record:#}");
        // A timer that ran out twice before it was read is one tick, and says so.
        let ticks = |done: &Value, of: &str| {
            done.as_u64()
                .zip(record[of]["lost_ticks"].as_u64())
                .map(|(done, lost)| done + lost)
        };
        let expected = record["steps_expected"].as_u64();
        assert_eq!(ticks(&record["steps_done"], "controller"), expected, "{record:#}");
        assert_eq!(ticks(&record["plant"]["steps"], "plant"), expected, "{record:#}");
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

/// Goes on with the one run, of one scenario with two windows, and sees that nothing was lost and nothing counted twice.
///
/// # Panics
/// When it was not so.
pub fn go_on_whole(workplace: &Workplace) {
    let directory = workplace.run_directory();
    let directory = directory.to_str().expect("the path is text");
    let resumed = workplace.run(&["resume", directory]);
    assert_eq!(resumed.code, Some(0), "{resumed:?}");
    assert_windows_are_whole(workplace);
    let report = workplace.json(&["report", directory]);
    assert_eq!(report["within"][0]["pairs"], 1, "{report:#}");
    assert_eq!(report["scenarios"][0]["outcome"], "completed", "{report:#}");
    let journal = journal(workplace);
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
}

/// A matrix of one scenario with four windows.
#[must_use]
pub fn four_windows(virtualization: &str) -> String {
    format!(
        "matrix:\n  virtualization: [{virtualization}]\n\
         workload:\n  windows: 4\n  window: 3s\n  period: 1s\n  reference: {{amplitude_m: 0.05}}\n"
    )
}

/// Which environment measured each of the four windows.
///
/// # Panics
/// When one of them is not there or not complete.
#[must_use]
pub fn environments_of_windows(workplace: &Workplace) -> Vec<String> {
    let scenario = workplace.scenario_directory();
    (1..=4)
        .map(|window| {
            let path = scenario.join(format!("window-{window}/window.json"));
            let record: Value = serde_json::from_slice(&std::fs::read(path).expect("the window is there"))
                .expect("a record is JSON");
            assert_eq!(record["complete"], true, "{record:#}");
            record["environment"].as_str().expect("it names it").to_owned()
        })
        .collect()
}

/// Kills `matrix` in the second window and resumes: the environment went on measuring, and its windows are collected.
///
/// # Panics
/// When it was not so.
pub fn is_found_and_collected(virtualization: &str) {
    let workplace = Workplace::measuring();
    workplace.write("m.yaml", four_windows(virtualization));
    let mut running = workplace.start(&["run", "m.yaml"]);
    running.wait_for("window 1 complete");
    running.kill();
    let directory = workplace.run_directory();
    let resumed = workplace.run(&["resume", directory.to_str().expect("the path is text")]);
    assert_eq!(resumed.code, Some(0), "{resumed:?}");
    assert!(resumed.err.contains("found"), "{resumed:?}");
    let environments = environments_of_windows(&workplace);
    assert!(
        environments.iter().all(|name| *name == environments[0]),
        "one environment measured all: {environments:?}"
    );
    assert_eq!(workplace.run(&["clean"]).code, Some(0));
}
