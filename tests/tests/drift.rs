//! Night after night, from the command line: runs of the fake platform, whose numbers are made up and said to be.

use std::{
    fs,
    path::{Path, PathBuf},
};

use serde_json::Value;
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
    // Of the error alone: the time that provisioning takes is the machine's, and may jump, too.
    let failed = junit.matches(r#"name="error"><failure message="drift">jumped from"#);
    assert_eq!(failed.count(), 1, "{junit}");
    let said = workplace.json(&["drift", "runs"]);
    assert_eq!(said["verdict"], "drift", "{said:#}");
    assert_described(&workplace, "drift-result", &said);
    let body: serde_json::Value =
        serde_json::from_slice(&fs::read(workplace.path().join("drift.json")).unwrap()).unwrap();
    let mut without_series = said.clone();
    let series = without_series.as_object_mut().unwrap().remove("series").unwrap();
    assert_eq!(body["drift"], without_series);
    let of_error = series
        .as_array()
        .unwrap()
        .iter()
        .find(|it| it["metric"] == "error")
        .unwrap();
    assert_eq!(of_error["nights"].as_array().unwrap().len(), 9, "{of_error:#}");
    let found = said["judgements"]
        .as_array()
        .unwrap()
        .iter()
        .find(|it| it["metric"] == "error")
        .unwrap();
    let report = found["findings"][0]["report"].as_str().unwrap();
    assert!(
        workplace.path().join(report).is_file() && ran.out.contains(report),
        "{ran:?}"
    );
    let known = found["findings"][0]["acknowledgement"].as_str().unwrap();
    assert!(known.starts_with("acknowledged:"), "{known}");

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

/// The run directories, the earliest first.
fn runs(workplace: &Workplace) -> Vec<PathBuf> {
    let entries = fs::read_dir(workplace.path().join("runs")).unwrap();
    let mut runs: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    runs.retain(|path| path.is_dir() && !path.is_symlink());
    runs.sort_by_key(|run| {
        let manifest: Value = serde_json::from_slice(&fs::read(run.join("manifest.json")).unwrap()).unwrap();
        manifest["created"].as_str().unwrap().to_owned()
    });
    runs
}

#[test]
fn a_pruned_run_keeps_its_night_its_records_and_its_report_and_nothing_takes_it_for_more() {
    let workplace = Workplace::new();
    for seed in 0..8 {
        night(&workplace, seed, if seed < 6 { "" } else { "shift_m: 0.2" });
    }
    let before = workplace.json(&["drift", "runs"]);
    assert_eq!(before["verdict"], "drift", "{before:#}");
    let runs = runs(&workplace);
    let control = |run: &Path| run.join(format!("scenarios/{SCENARIO}/window-1/control.csv"));
    let notes = control(&runs[0]).with_file_name("notes.txt");
    fs::write(&notes, "mine").unwrap();
    assert!(control(&runs[0]).is_file());

    let asked = workplace.json(&["prune", "runs", "--keep", "1", "--dry-run"]);
    assert_described(&workplace, "prune", &asked);
    assert!(control(&runs[0]).is_file(), "{asked:#}");
    let ran = workplace.run(&["prune", "runs", "--keep", "1"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    assert!(!control(&runs[0]).exists() && notes.is_file(), "{ran:?}");
    assert!(ran.out.contains("kept: it is one of the newest"), "{ran:?}");
    // The last night before the change, and the first with it.
    assert!(
        control(&runs[5]).is_file() && control(&runs[6]).is_file(),
        "{ran:?}"
    );
    assert_eq!(ran.out.matches("nobody has acknowledged").count(), 2, "{ran:?}");

    // The night is read of what was kept, whatever became of `report/`, and is the same to the last digit.
    fs::remove_dir_all(runs[0].join("report")).unwrap();
    assert_eq!(workplace.json(&["drift", "runs"]), before);
    let pruned = runs[0].to_str().unwrap();
    for command in ["report", "resume", "replay", "messages"] {
        let ran = workplace.run(&[command, pruned]);
        assert_eq!(ran.code, Some(2), "{command}: {ran:?}");
        assert!(
            ran.err.contains("its logs and captures are gone"),
            "{command}: {ran:?}"
        );
    }
    assert_eq!(workplace.run(&["status", pruned]).code, Some(0));
    let listed = workplace.run(&["runs"]);
    assert_eq!(listed.out.matches("pruned").count(), 5, "{listed:?}");
    let again = workplace.run(&["prune", "runs", "--keep", "1"]);
    assert_eq!(again.out.matches("nothing to prune").count(), 5, "{again:?}");

    // What a process left that was ended after it had kept the night.
    fs::copy(control(&runs[6]), control(&runs[0])).unwrap();
    let again = workplace.run(&["prune", "runs", "--keep", "1"]);
    assert!(again.out.contains("pruned: 1 file,"), "{again:?}");
    assert!(!control(&runs[0]).exists());
    assert_eq!(workplace.json(&["drift", "runs"]), before);

    // A night that somebody changed is not believed, and nothing else has its numbers.
    let kept = runs[0].join("pruned.json");
    let text = fs::read_to_string(&kept).unwrap();
    fs::write(&kept, text.replacen("\"run\":\"", "\"run\":\"x", 1)).unwrap();
    let ran = drift(&workplace, &[]);
    assert!(ran.out.contains("pruned.json is damaged"), "{ran:?}");
}

#[test]
fn a_run_that_is_not_finished_is_not_pruned() {
    let workplace = Workplace::new();
    night(&workplace, 0, "");
    night(&workplace, 1, "");
    let first = &runs(&workplace)[0];
    // As a power cut leaves it.
    let journal = first.join("events.jsonl");
    let text = fs::read_to_string(&journal).unwrap();
    let cut: Vec<&str> = text
        .lines()
        .take_while(|line| !line.contains("scenario-finished"))
        .collect();
    assert!(cut.len() < text.lines().count(), "{text}");
    fs::write(&journal, format!("{}\n", cut.join("\n"))).unwrap();
    let ran = workplace.run(&["prune", "runs", "--keep", "0"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    assert!(
        ran.out.contains("kept: it is not finished: `matrix resume"),
        "{ran:?}"
    );
    assert!(!first.join("pruned.json").exists(), "{ran:?}");
}
