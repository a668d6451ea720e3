//! Night after night, from the command line: runs of the fake platform, whose numbers are made up and said to be.

use std::fs;

use tests::{Ran, Workplace, documents::assert_described};

const SCENARIO: &str = "x86-64-debian-12-fake";

/// Runs a night of its own noise, with what is special about it.
fn night(workplace: &Workplace, seed: u32, special: &str) {
    workplace.write(
        "m.yaml",
        format!(
            "matrix: {{hardware: [x86_64], os: [debian-12], virtualization: [fake]}}\n\
             hosts: {{here: {{connect: local, hardware: x86_64, os: debian-12}}}}\n\
             workload: {{windows: 4, window: 10s, period: 1s}}\n\
             providers: {{fake: {{seed: {seed}, scenarios: {{{SCENARIO}: {{{special}}}}}}}}}\n"
        ),
    );
    let ran = workplace.run(&["run", "m.yaml", "--quiet"]);
    assert!(matches!(ran.code, Some(0 | 3)), "{ran:?}");
}

fn drift(workplace: &Workplace, more: &[&str]) -> Ran {
    let ran = workplace.run(&[&["drift", "runs"], more].concat());
    assert!(!ran.err.contains("panicked"), "{ran:?}");
    ran
}

#[test]
fn a_night_shift_is_told_once_what_changed_and_never_that_nothing_did_when_nothing_was_measured() {
    let workplace = Workplace::new();
    night(&workplace, 0, "");
    let ran = drift(&workplace, &[]);
    assert_eq!(ran.code, Some(6), "one night: {ran:?}");

    for seed in 1..8 {
        night(&workplace, seed, "");
    }
    let ran = drift(&workplace, &[]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    assert!(ran.out.contains("no drift found in 8 nights"), "{ran:?}");
    assert!(ran.out.contains("SIMULATED, NOT MEASURED"), "{ran:?}");

    for (max_age, margin) in [("--max-age", "--equivalence-margin"), ("--within", "--matters")] {
        assert_eq!(drift(&workplace, &[max_age, "1h", margin, "1mm"]).code, Some(0));
        let ran = drift(&workplace, &[max_age, "0s"]);
        assert_eq!(ran.code, Some(6), "none of tonight: {ran:?}");
    }

    night(&workplace, 8, "shift_m: 0.2");
    let ran = drift(&workplace, &["--junit", "drift.xml", "--webhook", "drift.json"]);
    assert_eq!(ran.code, Some(4), "{ran:?}");
    assert!(ran.out.contains("jumped from"), "{ran:?}");
    assert!(
        ran.out.contains("what was asked for changed with it"),
        "a seed and a shift: {ran:?}"
    );
    let junit = fs::read_to_string(workplace.path().join("drift.xml")).unwrap();
    // Of the error alone: the time that provisioning takes is the machine's, in whole milliseconds, and may jump, too.
    let failed = junit.matches(r#"name="error"><failure message="drift">jumped from"#);
    assert_eq!(failed.count(), 1, "{junit}");
    let said = workplace.json(&["drift", "runs"]);
    assert_eq!(said["verdict"], "drift", "{said:#}");
    assert_described(&workplace, "drift-result", &said);
    let body: serde_json::Value =
        serde_json::from_slice(&fs::read(workplace.path().join("drift.json")).unwrap()).unwrap();
    assert_eq!(body["drift"], said);

    let since = said["nights"].as_array().unwrap().last().unwrap();
    let known = format!(
        "acknowledged:\n  - {{scenario: {SCENARIO}, metric: error, since: {since}, reason: moved, person: Ada, \
         expires: 2999-01-01, baseline: keep}}\n"
    );
    workplace.write("runs/drift.yaml", &known);
    let ran = drift(&workplace, &[]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    assert!(ran.out.contains("acknowledged by Ada"), "{ran:?}");
    workplace.write("runs/drift.yaml", known.replace("2999-01-01", "soon"));
    let ran = drift(&workplace, &[]);
    assert_eq!(ran.code, Some(2), "{ran:?}");
    assert!(ran.err.contains("`expires: soon` is no day"), "{ran:?}");
    workplace.write("runs/drift.yaml", &known);

    night(&workplace, 9, "fail: {at: create}");
    let ran = drift(&workplace, &["--github"]);
    assert_eq!(ran.code, Some(6), "nothing was measured: {ran:?}");
    assert!(ran.out.contains("::warning title="), "{ran:?}");
}

#[test]
fn a_candidate_is_judged_against_runs_that_are_known_to_be_good() {
    let workplace = Workplace::new();
    for seed in 0..5 {
        night(&workplace, seed, "");
    }
    let mut runs: Vec<String> = fs::read_dir(workplace.path().join("runs"))
        .unwrap()
        .map(|entry| entry.unwrap())
        .filter(|entry| !entry.path().is_symlink())
        .map(|entry| format!("runs/{}", entry.file_name().to_str().unwrap()))
        .collect();
    runs.sort();
    let (candidate, baseline) = runs.split_last().unwrap();
    let mut arguments = vec!["drift", "--candidate", candidate, "--baseline"];
    arguments.extend(baseline.iter().map(String::as_str));
    let ran = workplace.run(&arguments);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    arguments.push(candidate);
    let ran = workplace.run(&arguments);
    assert_eq!(ran.code, Some(2), "the candidate in its own baseline: {ran:?}");
    assert!(ran.err.contains("is there twice"), "{ran:?}");

    // A run that was killed as it began.
    let killed = workplace.path().join("runs/20000101-000000-dead");
    fs::create_dir(&killed).unwrap();
    fs::copy(
        workplace.path().join(candidate).join("manifest.json"),
        killed.join("manifest.json"),
    )
    .unwrap();
    let ran = workplace.run(&["drift", "runs"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    assert!(ran.out.contains("left out: runs/20000101-000000-dead"), "{ran:?}");
    fs::rename(&killed, workplace.path().join("runs/29990101-000000-dead")).unwrap();
    let ran = workplace.run(&["drift", "runs"]);
    assert_eq!(ran.code, Some(6), "nothing is known of tonight: {ran:?}");

    let ran = workplace.run(&["drift", "--candidate", candidate]);
    assert_eq!(ran.code, Some(2), "{ran:?}");
    let ran = workplace.run(&["drift", "nowhere"]);
    assert_eq!(ran.code, Some(2), "{ran:?}");
    assert!(
        ran.err.contains("give the folder with the run directories"),
        "{ran:?}"
    );
}
