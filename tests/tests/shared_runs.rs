//! Runs that are handed on: several as one matrix, and copies that name nobody.

use std::{fs, path::Path};

use serde_json::Value;
use tests::{Ran, Workplace};

const HOSTS: &str = "hosts:\n  \
    here: {connect: local, hardware: x86_64, os: debian-12}\n  \
    attic-pi: {hardware: aarch64, os: debian-12, connect: {ssh: zuzana@attic-pi.lovelace.example}}\n";

/// A workplace with a run of each scenario that the fake platform of this machine has, measured apart.
fn measured_apart() -> (Workplace, Vec<String>) {
    let workplace = Workplace::new();
    workplace.write(
        "m.yaml",
        format!(
            "{HOSTS}matrix: {{virtualization: [fake], network.delay: [5ms, 10ms]}}\n\
             workload: {{windows: 2, window: 20s, period: 1s}}\n"
        ),
    );
    for only in ["network.delay=5ms", "network.delay=10ms"] {
        let ran = workplace.run(&["run", "m.yaml", "--only", only, "--quiet"]);
        assert!(ran.code.is_some_and(|code| code != 2), "{ran:?}");
    }
    let runs = fs::read_dir(workplace.path().join("runs")).unwrap();
    let mut runs: Vec<String> = runs
        .map(|run| run.unwrap().path().display().to_string())
        .collect();
    runs.sort();
    assert_eq!(runs.len(), 2);
    (workplace, runs)
}

fn refused(ran: &Ran, words: &[&str]) {
    assert_eq!(ran.code, Some(2), "{ran:?}");
    for word in words {
        assert!(ran.err.contains(word), "{word:?} is not in:\n{}", ran.err);
    }
}

#[test]
fn runs_that_were_measured_apart_are_reported_as_one_where_the_call_says() {
    let (workplace, runs) = measured_apart();
    let [a, b] = [runs[0].as_str(), runs[1].as_str()];
    refused(&workplace.run(&["report", a, b]), &["--output DIR"]);
    refused(
        &workplace.run(&["report", a, a, "--output", "both"]),
        &["is there twice"],
    );

    let report = workplace.json(&["report", a, b, "--output", "both"]);
    let measured: Vec<&Value> = report["runs"]
        .as_array()
        .unwrap()
        .iter()
        .map(|run| &run["scenarios"])
        .collect();
    let plan = workplace.json(&["plan", "m.yaml"]);
    let letter = |delay: &str| {
        let scenarios = plan["scenarios"].as_array().unwrap().iter();
        let mut fitting =
            scenarios.filter(|it| it["axes"]["network.delay"] == delay && it["axes"]["hardware"] == "x86_64");
        fitting.next().unwrap()["id"].clone()
    };
    assert_eq!(
        measured,
        [
            &Value::from(vec![letter("5ms")]),
            &Value::from(vec![letter("10ms")])
        ]
    );
    assert_eq!(
        report["between"].as_array().unwrap().len(),
        1,
        "the one with the other"
    );
    assert!(report["runs"][0]["matrix_version"].is_string());
    assert!(workplace.path().join("both/report.html").exists());

    // Again over its own, and never over something else.
    assert_eq!(workplace.run(&["report", a, b, "--output", "both"]).code, Some(0));
    fs::create_dir(workplace.path().join("mine")).unwrap();
    workplace.write("mine/thesis.tex", "mine");
    refused(
        &workplace.run(&["report", a, b, "--output", "mine"]),
        &["mine is there", "not there yet"],
    );
}

fn all_text(folder: &Path) -> String {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    entries
        .map(|path| match path.is_dir() {
            true => all_text(&path),
            false => String::from_utf8_lossy(&fs::read(path).unwrap()).to_lowercase(),
        })
        .collect()
}

#[test]
fn a_redacted_copy_can_be_reported_and_not_resumed_and_names_nobody() {
    let (workplace, runs) = measured_apart();
    let folder = workplace.path().display().to_string().to_lowercase();
    assert!(all_text(Path::new(&runs[0])).contains("zuzana@attic-pi.lovelace.example"));
    let ran = workplace.run(&["redact", &runs[0], &runs[1], "--output", "blind"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    assert!(ran.out.contains("attic-pi is host-"), "{ran:?}");
    let copies: Vec<&str> = ran
        .out
        .lines()
        .filter(|line| line.starts_with("blind/"))
        .collect();
    let told = all_text(&workplace.path().join("blind"));
    for secret in ["zuzana", "attic", "lovelace", folder.as_str()] {
        assert!(!told.contains(secret), "{secret}");
    }

    let [original, copied] = [&runs[0], copies[0]].map(|run| workplace.json(&["report", run]));
    assert_eq!(copied["comparisons"], original["comparisons"]);
    assert!(
        copied["remarks"].to_string().contains("Redacted"),
        "{}",
        copied["remarks"]
    );
    refused(&workplace.run(&["resume", copies[0]]), &["redacted copy"]);
    let again = workplace.run(&["redact", &runs[0], "--output", "blind"]);
    assert_eq!(again.code, Some(2), "{again:?}");
    assert!(again.err.contains("--output"), "{again:?}");

    let ran = workplace.run(&["report", &runs[0], "--redact", "--output", "told"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let told = all_text(&workplace.path().join("told")) + &ran.out.to_lowercase();
    assert!(
        !told.contains("attic") && !told.contains("lovelace"),
        "a name is in the report"
    );
}
