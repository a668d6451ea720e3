//! Scenarios that have several environments each: rounds, and what a failure, a kill and a report make of them.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::{Value, json};
use tests::{Workplace, documents::assert_described};

/// Two fake scenarios of three environments with two windows each.
const ROUNDS: &str = "\
matrix:
  virtualization: [fake]
  labels: {place: [here, there]}
workload:
  windows: 2
  environments: 3
  window: 8s
  period: 1s
report:
  alpha: 0.6
";

fn journal(workplace: &Workplace) -> Vec<Value> {
    let text = std::fs::read_to_string(workplace.run_directory().join("events.jsonl")).unwrap();
    text.lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

fn of<'j>(journal: &'j [Value], event: &str) -> Vec<&'j Value> {
    journal.iter().filter(|entry| entry["event"] == event).collect()
}

/// The slug of the scenario with that letter.
fn slug(workplace: &Workplace, letter: &str) -> String {
    let plan = workplace.json(&["plan", "m.yaml"]);
    let mut scenarios = plan["scenarios"].as_array().unwrap().iter();
    let scenario = scenarios.find(|scenario| scenario["id"] == letter).unwrap();
    scenario["slug"].as_str().unwrap().to_owned()
}

#[test]
fn each_round_makes_every_scenario_anew_in_an_order_of_its_own() {
    let workplace = Workplace::new();
    workplace.write("m.yaml", ROUNDS);
    let plan = workplace.json(&["plan", "m.yaml"]);
    assert_eq!(plan["measuring_s"], 2.0 * 3.0 * 2.0 * 8.0);
    assert_eq!(plan["later_rounds"].as_array().unwrap().len(), 2, "{plan:#}");
    let design = &plan["environments_as_units"];
    assert_eq!(
        (&design["units"], &design["smallest_p"]),
        (&json!(3), &json!(0.25)),
        "{plan:#}"
    );
    assert_eq!(workplace.run(&["run", "m.yaml"]).code, Some(0));
    let journal = journal(&workplace);
    let made: Vec<(u64, Value)> = of(&journal, "environment-creating")
        .into_iter()
        .map(|entry| (entry["round"].as_u64().unwrap(), entry["windows"].clone()))
        .collect();
    let windows = [json!([1, 2]), json!([3, 4]), json!([5, 6])];
    let expected: Vec<(u64, Value)> = (1..=3).zip(windows).flat_map(|it| [it.clone(), it]).collect();
    assert_eq!(made, expected);
    for round in of(&journal, "environment-creating").chunks(2) {
        assert_ne!(round[0]["scenario"], round[1]["scenario"], "{round:#?}");
    }
    let names: BTreeSet<&str> = of(&journal, "environment-creating")
        .iter()
        .map(|entry| entry["environment"].as_str().unwrap())
        .collect();
    assert_eq!(names.len(), 6, "each is made anew: {names:?}");
    // One is gone before the next is made.
    let lives: Vec<&str> = journal
        .iter()
        .filter_map(|entry| entry["event"].as_str())
        .filter(|event| ["environment-creating", "environment-discarded"].contains(event))
        .collect();
    assert!(
        lives
            .chunks(2)
            .all(|life| life == ["environment-creating", "environment-discarded"])
    );

    let directory = workplace.run_directory();
    let directory = directory.to_str().unwrap();
    let status = workplace.json(&["status", directory, "--verify"]);
    assert_eq!(status["verified"]["damaged"], json!([]), "{status:#}");
    for scenario in status["scenarios"].as_array().unwrap() {
        assert_eq!(
            (&scenario["state"], &scenario["windows"]),
            (&json!("completed"), &json!(6))
        );
        assert_eq!(scenario["environments"].as_array().unwrap().len(), 3);
    }
    let report = workplace.json(&["report", directory]);
    for (name, document) in [("plan", &plan), ("status", &status), ("report", &report)] {
        assert_described(&workplace, name, document);
    }
    assert_eq!(
        report["between"][0]["pairs"], 36,
        "the paper's counts are over windows"
    );
    let pair = &report["replicates"]["pairs"][0];
    assert_eq!(
        (&pair["rounds"], &pair["labellings"]),
        (&json!(3), &json!(8)),
        "{pair:#}"
    );
    assert_eq!(
        pair["verdict"], report["contrasts"][0]["verdict"],
        "environments decide"
    );
    let tables = std::fs::read_to_string(workplace.run_directory().join("report/tables.md")).unwrap();
    let first = tables
        .split("\n## ")
        .find(|section| section.starts_with("How large the differences are, all at once"))
        .unwrap_or_else(|| panic!("{tables}"));
    let first = first.split_whitespace().collect::<Vec<_>>().join(" ");
    let shift_mm = 1e3 * pair["shift"].as_f64().unwrap();
    let places = if shift_mm.abs() < 9.995 { 2 } else { 1 };
    assert!(
        first.contains(&format!("| {shift_mm:+.places$} | [")),
        "{shift_mm}: {first}"
    );
    assert!(first.contains("takes environments for the units"), "{first}");
    let together = &report["replicates"]["together"];
    assert_eq!(
        together["between_environments"]["degrees_of_freedom"], 4.0,
        "{together:#}"
    );
}

#[test]
fn a_run_killed_in_its_second_round_goes_on_there_and_measures_each_window_once() {
    let workplace = Workplace::new();
    workplace.write(
        "m.yaml",
        format!("{ROUNDS}providers:\n  fake: {{window_takes: 200ms}}\n"),
    );
    let mut running = workplace.start(&["run", "m.yaml"]);
    running.wait_for("environment 2, windows 3, 4");
    running.wait_for("measuring window 3");
    running.kill();
    let directory = workplace.run_directory();
    let directory = directory.to_str().unwrap();

    let status = workplace.json(&["status", directory]);
    let states: BTreeMap<u64, BTreeSet<&str>> = status["scenarios"]
        .as_array()
        .unwrap()
        .iter()
        .flat_map(|scenario| scenario["environments"].as_array().unwrap())
        .fold(BTreeMap::new(), |mut states, environment| {
            let round = environment["round"].as_u64().unwrap();
            states
                .entry(round)
                .or_insert_with(BTreeSet::new)
                .insert(environment["state"].as_str().unwrap());
            states
        });
    assert_eq!(states[&1], BTreeSet::from(["completed"]), "{status:#}");
    assert_eq!(
        states[&2],
        BTreeSet::from(["left behind", "waiting"]),
        "{status:#}"
    );
    assert_eq!(states[&3], BTreeSet::from(["waiting"]), "{status:#}");
    let left = workplace.json(&["resume", directory, "--dry-run"]);
    for scenario in left["scenarios"].as_array().unwrap() {
        assert_eq!(scenario["windows"], json!([3, 4, 5, 6]), "{left:#}");
    }

    assert_eq!(workplace.run(&["resume", directory]).code, Some(0));
    let journal = journal(&workplace);
    let collected: Vec<(&str, u64)> = of(&journal, "window-collected")
        .into_iter()
        .map(|entry| {
            (
                entry["scenario"].as_str().unwrap(),
                entry["window"].as_u64().unwrap(),
            )
        })
        .collect();
    let distinct: BTreeSet<_> = collected.iter().collect();
    assert_eq!((collected.len(), distinct.len()), (12, 12), "{collected:?}");
    let begun = of(&journal, "run-started").len();
    assert_eq!(begun, 2);
    let again = of(&journal, "scenario-started")
        .into_iter()
        .filter(|entry| entry["round"] == 1)
        .count();
    assert_eq!(again, 2, "the first round was not begun again");
    let status = workplace.json(&["status", directory]);
    assert_eq!(status["finished"], true, "{status:#}");
    // An image that other runs of this machine left is no leftover of this one.
    let left = workplace.json(&["clean", "--dry-run"]);
    let ours = left["leftovers"].as_array().into_iter().flatten();
    assert_eq!(ours.filter(|it| it["run"].is_string()).count(), 0, "{left:#}");
}

#[test]
fn an_environment_that_fails_costs_its_own_windows_and_its_round_alone() {
    let workplace = Workplace::new();
    workplace.write("m.yaml", ROUNDS);
    let failing = slug(&workplace, "a");
    workplace.write(
        "m.yaml",
        format!("{ROUNDS}providers:\n  fake:\n    scenarios:\n      {failing}: {{fail: {{at: measure, window: 3}}}}\n"),
    );
    let ran = workplace.run(&["run", "m.yaml"]);
    assert_eq!(ran.code, Some(1), "{ran:?}");
    let journal = journal(&workplace);
    let outcomes: BTreeMap<(&str, u64), &str> = of(&journal, "scenario-finished")
        .into_iter()
        .map(|entry| {
            let unit = (
                entry["scenario"].as_str().unwrap(),
                entry["round"].as_u64().unwrap(),
            );
            (unit, entry["outcome"].as_str().unwrap())
        })
        .collect();
    let failed: Vec<_> = outcomes
        .iter()
        .filter(|(_, outcome)| **outcome != "completed")
        .collect();
    assert_eq!(outcomes.len(), 6);
    assert_eq!(failed, [(&(failing.as_str(), 2), &"failed")], "{outcomes:?}");

    let directory = workplace.run_directory();
    let report = workplace.json(&["report", directory.to_str().unwrap()]);
    let a = &report["scenarios"][0];
    assert_eq!(a["outcome"], "failed");
    assert!(
        a["reason"].as_str().unwrap().starts_with("environment 2: "),
        "{a:#}"
    );
    let counted = a["windows"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|window| window["counted"] == true);
    assert_eq!(counted.count(), 4, "{a:#}");
    let replicates = &report["replicates"];
    assert_eq!(replicates["pairs"][0]["rounds"], 2, "{replicates:#}");
    assert_eq!(replicates["scenarios"][0]["environments"], 2, "{replicates:#}");
    assert_eq!(replicates["scenarios"][1]["environments"], 3, "{replicates:#}");
    // The experiment's own word is final: nothing is left to do.
    let resumed = workplace.json(&["resume", directory.to_str().unwrap(), "--dry-run"]);
    assert_eq!(resumed["scenarios"], json!([]), "{resumed:#}");
}

#[test]
fn one_environment_each_leaves_the_records_that_it_always_left() {
    let workplace = Workplace::new();
    workplace.write(
        "m.yaml",
        ROUNDS.replace("  environments: 3\n", "  environments: 1\n"),
    );
    assert_eq!(workplace.run(&["run", "m.yaml"]).code, Some(0));
    assert!(
        journal(&workplace)
            .iter()
            .all(|entry| entry.get("round").is_none())
    );
    let plan = std::fs::read(workplace.run_directory().join("plan.json")).unwrap();
    let plan: Value = serde_json::from_slice(&plan).unwrap();
    assert!(plan.get("later_rounds").is_none(), "{plan:#}");
    assert!(
        plan["scenarios"][0]["settings"].get("environments").is_none(),
        "{plan:#}"
    );
    let directory = workplace.run_directory();
    let report = workplace.json(&["report", directory.to_str().unwrap()]);
    assert!(report.get("replicates").is_none());
}

#[test]
fn numbers_of_environments_that_nobody_measures_are_mistakes() {
    for (environments, windows, words) in [
        ("0", "2", "0 environments cannot be measured in"),
        ("1001", "2", "1001 environments cannot be measured in"),
        ("200", "100", "100 windows in each of 200 environments"),
    ] {
        let workplace = Workplace::new();
        let file = ROUNDS
            .replace("environments: 3", &format!("environments: {environments}"))
            .replace("windows: 2", &format!("windows: {windows}"));
        workplace.write("m.yaml", file);
        let ran = workplace.run(&["check", "m.yaml"]);
        assert_eq!(ran.code, Some(2), "{ran:?}");
        assert!(ran.err.contains(words), "{ran:?}");
    }
}

#[test]
fn scenarios_are_compared_over_nights_with_the_night_as_a_block() {
    let workplace = Workplace::new();
    workplace.write("m.yaml", ROUNDS.replace("  environments: 3\n", ""));
    for _ in 0..3 {
        assert_eq!(workplace.run(&["run", "m.yaml", "--quiet"]).code, Some(0));
    }
    let drift = workplace.json(&["drift", "runs", "--between-scenarios"]);
    assert_described(&workplace, "drift-result", &drift);
    let contrasts = &drift["between_scenarios"];
    let pair = &contrasts["pairs"][0];
    assert_eq!(
        (&pair["nights"], &pair["smallest_p"]),
        (&json!(3), &json!(0.25)),
        "{contrasts:#}"
    );
    assert!(contrasts["between_nights"].is_f64(), "{contrasts:#}");
    let text = workplace.run(&["drift", "runs", "--between-scenarios"]).out;
    assert!(
        text.contains("Each two scenarios, the night as a block"),
        "{text}"
    );
    assert!(
        workplace
            .json(&["drift", "runs"])
            .get("between_scenarios")
            .is_none()
    );
}

#[test]
fn a_plan_says_what_environments_would_find_as_a_pilot_has_it() {
    let workplace = Workplace::new();
    workplace.write("m.yaml", ROUNDS);
    assert_eq!(workplace.run(&["run", "m.yaml"]).code, Some(0));
    let pilot = workplace.run_directory().display().to_string();
    workplace.write(
        "more.yaml",
        ROUNDS
            .replace("environments: 3", "environments: 6")
            .replace("0.6", "0.05"),
    );

    let power = |options: &[&str]| {
        let plan = workplace.json(&[&["plan", "more.yaml"], options].concat());
        plan["power"].clone()
    };
    let relative = power(&[]);
    assert_eq!(
        (&relative["unit"], &relative["spread"]),
        (&json!("environment"), &json!(null))
    );
    let point = &power(&["--environment-sd", "2mm"])["curve"][0];
    let shift_sd = relative["curve"][0]["shift_sd"].as_f64().unwrap();
    assert_eq!(
        (&point["units"], &point["shift"]),
        (&json!(6), &json!(0.002 * shift_sd))
    );
    let by_pilot = power(&["--pilot", &pilot]);
    assert_eq!(
        by_pilot["spread_freedom"], 2,
        "two scenarios in three rounds: {by_pilot:#}"
    );
    assert!(
        by_pilot["curve"][0]["shift_sd"].as_f64().unwrap() > 1.2 * shift_sd,
        "{by_pilot:#}"
    );

    let refused = workplace.run(&["plan", "more.yaml", "--window-sd", "1mm"]);
    assert_eq!(refused.code, Some(2), "{}", refused.err);
    assert!(refused.err.contains("give `--environment-sd`"), "{}", refused.err);
}
