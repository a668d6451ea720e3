//! What is wrong with a run directory is said once, with the file, the place and what to do.

use std::{error::Error, fs, path::Path};

use captures::traffic::Traffic;
use record::{
    progress::Progress,
    run_directory::{Event, Outcome, ReadError},
    window::Verdict,
};
use reports::{
    Run, analyse,
    input::run::{Ending, WindowState},
};
use rstest::rstest;

use crate::synthetic::{Scenario, Synthetic, journal};

const SLUG: &str = "i686-ubuntu-native";

fn one_scenario() -> Synthetic {
    Synthetic::new(&[Scenario::measured(SLUG, &[0.1, 0.1, 0.1, 0.1])])
}

/// The error with its causes, and the hint; the folder of the test left out.
fn complaint(synthetic: &Synthetic, result: Result<Run, ReadError>) -> (String, String) {
    let error = result.expect_err("the run directory should not be readable");
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        text.push_str(&format!(": {error}"));
        cause = error.source();
    }
    let folder = format!("{}/", synthetic.directory.path().display());
    (text.replace(&folder, ""), error.hint())
}

fn load(synthetic: &Synthetic) -> Result<Run, ReadError> {
    reports::load(synthetic.directory.path())
}

#[test]
fn a_missing_run_directory_is_not_found() {
    let error = reports::load("/nowhere/at/all").unwrap_err();
    assert_eq!(error.to_string(), "there is no run directory at /nowhere/at/all");
    assert!(error.hint().contains("matrix run"));
}

#[test]
fn a_file_or_an_empty_folder_is_not_a_run_directory() {
    let folder = tempfile::tempdir().unwrap();
    let error = reports::load(folder.path()).unwrap_err();
    assert!(
        error
            .to_string()
            .ends_with("is not a run directory: it has no manifest.json"),
        "{error}"
    );
    let file = folder.path().join("matrix.yaml");
    fs::write(&file, "matrix: {}").unwrap();
    let error = reports::load(&file).unwrap_err();
    assert!(
        error
            .to_string()
            .ends_with("is not a run directory: it is not a folder"),
        "{error}"
    );
}

#[rstest]
#[case("manifest.json")]
#[case("plan.json")]
#[case("events.jsonl")]
fn a_run_directory_without_one_of_its_files_is_half_written(#[case] file: &str) {
    let synthetic = one_scenario();
    fs::remove_file(synthetic.directory.path().join(file)).unwrap();
    let (text, hint) = complaint(&synthetic, load(&synthetic));
    assert_eq!(
        text,
        format!("the run directory is half-written: {file} is missing")
    );
    assert!(hint.contains("start again"), "{hint}");
}

#[rstest]
#[case("manifest.json")]
#[case("plan.json")]
#[case("scenarios/i686-ubuntu-native/window-2/window.json")]
fn a_future_format_is_said_before_anything_else_that_changed(#[case] file: &str) {
    let synthetic = one_scenario();
    fs::write(
        synthetic.directory.path().join(file),
        r#"{"format":2,"all":"else"}"#,
    )
    .unwrap();
    let (text, hint) = complaint(&synthetic, load(&synthetic));
    assert_eq!(
        text,
        format!("{file} has format 2, and this version of matrix knows formats up to 1")
    );
    assert!(hint.contains("version of matrix"), "{hint}");
}

#[test]
fn an_environment_that_cannot_be_read_is_a_remark_and_costs_no_window() {
    let synthetic = one_scenario();
    fs::write(synthetic.directory.environment(SLUG).path(), "\u{0}").unwrap();
    let run = load(&synthetic).unwrap();
    assert_eq!(run.scenarios[0].counted().count(), 4);
    let [remark] = run.remarks.as_slice() else {
        panic!("{:?}", run.remarks)
    };
    assert!(
        remark.starts_with("The platform of a is not known: ") && remark.contains("line 1"),
        "{remark}"
    );
}

#[rstest]
#[case("manifest.json", "")]
#[case("manifest.json", "{\"format\":1,\"run\":\"x")]
#[case("plan.json", "[]")]
fn a_damaged_file_is_named_with_the_place(#[case] file: &str, #[case] damaged: &str) {
    let synthetic = one_scenario();
    fs::write(synthetic.directory.path().join(file), damaged).unwrap();
    let (text, _) = complaint(&synthetic, load(&synthetic));
    assert!(
        text.starts_with(&format!("{file} cannot be understood: ")) && text.contains("line 1"),
        "{text}"
    );
}

/// Replaces one field of one line of a log, lines from 1.
fn with_field(log: &str, line: usize, column: usize, text: &str) -> String {
    let mut lines: Vec<String> = log.lines().map(str::to_owned).collect();
    let mut fields: Vec<&str> = lines[line - 1].split(',').collect();
    fields[column] = text;
    lines[line - 1] = fields.join(",");
    lines.join("\n") + "\n"
}

fn without_line(log: &str, line: usize) -> String {
    log.lines()
        .enumerate()
        .filter(|(at, _)| at + 1 != line)
        .map(|(_, text)| format!("{text}\n"))
        .collect()
}

type Edit = fn(String) -> String;

#[rstest]
#[case::nan(|log: String| with_field(&log, 17, 9, "NaN"), "line 17 has `NaN` in column `x_m`: the loop diverged, or its arithmetic is broken")]
#[case::infinity(|log: String| with_field(&log, 17, 5, "-inf"), "line 17 has `-inf` in column `reference_y_m`: the loop diverged, or its arithmetic is broken")]
#[case::nan_elsewhere(|log: String| with_field(&log, 3, 18, "NaN"), "line 3 has `NaN` in column `command_y_v`: the loop diverged, or its arithmetic is broken")]
#[case::huge(|log: String| with_field(&log, 17, 13, "1e999"), "line 17 has `1e999` in column `y_m`: the loop diverged, or its arithmetic is broken")]
#[case::text(|log: String| with_field(&log, 17, 9, "<ok>"), "line 17 has `<ok>` in column `x_m`, which is not a number of its kind")]
#[case::words(|log: String| with_field(&log, 17, 9, "nine"), "line 17 has `nine` in column `x_m`, which is not a number of its kind")]
#[case::fraction_of_a_step(|log: String| with_field(&log, 17, 0, "1.5"), "line 17 has `1.5` in column `step`, which is not a number of its kind")]
#[case::cut_between_fields(|log: String| log[..log.len() - 60].to_owned(), "line 301 is cut short")]
#[case::cut_in_the_last_field(|log: String| log[..log.len() - 2].to_owned(), "line 301 is cut short")]
#[case::cut_at_a_line(|log: String| without_line(&log, 301), "it has 299 control steps, and its window has 300")]
#[case::gap(|log: String| without_line(&log, 100), "line 100 is step 399, and step 398 was to follow")]
#[case::twice(|log: String| with_field(&log, 100, 0, "397"), "line 100 is step 397, and step 398 was to follow")]
#[case::column(|log: String| log.replace("x_m,x_rate", "wide,x_rate"), "column `x_m` is missing in the first line")]
#[case::empty(|_: String| String::new(), "column `step` is missing in the first line")]
fn a_window_whose_log_cannot_be_used_does_not_count_and_its_line_is_named(
    #[case] edit: Edit,
    #[case] message: &str,
) {
    let synthetic = one_scenario();
    // As if it had been measured so, or written so by its host: the checksum fits.
    synthetic.edit_log(SLUG, 2, true, edit);
    assert_eq!(
        reason_of_the_second(&load(&synthetic).unwrap()),
        format!(
            "control.csv cannot be used: {message}; its SHA-256 is that of window.json, so it is as it was measured"
        )
    );
    // Changed afterwards: the same place, and another cause.
    let synthetic = one_scenario();
    synthetic.edit_log(SLUG, 2, false, edit);
    assert_eq!(
        reason_of_the_second(&load(&synthetic).unwrap()),
        format!(
            "control.csv cannot be used: {message}; the file was changed after it was measured, since its SHA-256 is not \
             that of window.json"
        )
    );
}

/// Why the second window of four does not count; the others do.
fn reason_of_the_second(run: &Run) -> String {
    let counted: Vec<u32> = run.scenarios[0].counted().map(|(number, ..)| number).collect();
    assert_eq!(counted, [1, 3, 4]);
    let WindowState::Broken { reason } = &run.scenarios[0].windows[1].state else {
        unreachable!("the second window counts")
    };
    reason.clone()
}

#[rstest]
#[case::no_record("{\"format\":1}", "window.json cannot be understood: missing field `window`")]
#[case::nothing("", "window.json cannot be understood: EOF")]
fn a_window_whose_record_cannot_be_understood_does_not_count(#[case] damaged: &str, #[case] words: &str) {
    let synthetic = one_scenario();
    let record = synthetic.directory.window(SLUG, 2).path().join("window.json");
    fs::write(record, damaged).unwrap();
    let reason = reason_of_the_second(&load(&synthetic).unwrap());
    assert!(reason.starts_with(words), "{reason}");
}

#[test]
fn the_report_says_why_a_window_with_a_damaged_log_does_not_count() {
    let synthetic = one_scenario();
    synthetic.edit_log(SLUG, 2, true, |log| with_field(&log, 17, 9, "NaN"));
    let run = load(&synthetic).unwrap();
    let report = analyse(&run, Traffic::default(), &run.manifest.report);
    let markdown = report.present().markdown().replace('\n', " ");
    assert!(
        markdown.contains("window 2 broken, not counted: control.csv cannot be used: line 17 has"),
        "{markdown}"
    );
}

#[test]
fn a_log_that_was_changed_with_care_is_found_out_by_its_checksum() {
    let synthetic = one_scenario();
    synthetic.edit_log(SLUG, 2, false, |log| log.replacen("0.0,0.0", "0.0,0.1", 1));
    let reason = reason_of_the_second(&load(&synthetic).unwrap());
    assert!(
        reason.starts_with("control.csv cannot be used: it is not the file that was measured: its SHA-256"),
        "{reason}"
    );
}

#[test]
fn why_a_window_is_not_there_is_what_the_journal_says_of_it() {
    let synthetic = one_scenario();
    let complete = |window| Event::Workload {
        scenario: SLUG.to_owned(),
        progress: Progress::WindowComplete {
            window,
            verdict: Verdict::Valid,
            reason: None,
        },
    };
    let collected = |window| Event::WindowCollected {
        scenario: SLUG.to_owned(),
        environment: "e-1".to_owned(),
        window,
        verdict: Verdict::Valid,
        sha256: None,
    };
    let mut events = journal(&[Scenario::measured(SLUG, &[0.1])]);
    events.extend([complete(2), complete(3), collected(3)]);
    synthetic.write_journal(&events);
    for window in 2..=4 {
        fs::remove_dir_all(synthetic.directory.window(SLUG, window).path()).unwrap();
    }
    let run = load(&synthetic).unwrap();
    let report = analyse(&run, Traffic::default(), &run.manifest.report);
    let reasons = report.scenarios[0]
        .windows
        .iter()
        .map(|window| window.reasons.join(";"));
    assert_eq!(
        Vec::from_iter(reasons),
        [
            "",
            "it was measured, and has not been collected",
            "it was collected, and is not there any more",
            "it was not measured",
        ]
    );
}

#[test]
fn a_scenario_of_which_a_collected_window_broke_after_its_end_is_unfinished() {
    let synthetic = one_scenario();
    let mut events = journal(&[Scenario::measured(SLUG, &[0.1])]);
    let ended = events
        .iter()
        .position(|event| matches!(event, Event::ScenarioFinished { .. }));
    let collected = Event::WindowCollected {
        scenario: SLUG.to_owned(),
        environment: "e-1".to_owned(),
        window: 2,
        verdict: Verdict::Valid,
        sha256: None,
    };
    events.insert(ended.unwrap(), collected);
    synthetic.write_journal(&events);
    let ending = || load(&synthetic).unwrap().scenarios[0].ending.clone();
    assert!(matches!(
        ending(),
        Ending::Ended {
            outcome: Outcome::Completed,
            ..
        }
    ));
    events.push(Event::WindowBroken {
        scenario: SLUG.to_owned(),
        environment: "e-1".to_owned(),
        window: 2,
        reason: "it was in its place, and the checksum of control.csv does not match window.json".to_owned(),
    });
    synthetic.write_journal(&events);
    assert_eq!(ending(), Ending::Unfinished);
}

#[test]
fn columns_may_stand_in_any_order() {
    let synthetic = one_scenario();
    let before = load(&synthetic).unwrap();
    let reversed = |line: &str| line.split(',').rev().collect::<Vec<_>>().join(",") + "\n";
    synthetic.edit_log(SLUG, 1, true, |log| log.lines().map(reversed).collect());
    let after = load(&synthetic).unwrap();
    let traces = |run: &Run| {
        run.scenarios[0]
            .counted()
            .map(|(_, _, trace)| trace.clone())
            .collect::<Vec<_>>()
    };
    assert_eq!(traces(&before), traces(&after));
}

#[test]
fn the_log_of_an_invalid_window_is_not_even_read() {
    let synthetic = one_scenario();
    synthetic.edit_log(SLUG, 2, false, |_| "NaN".to_owned());
    synthetic.edit_window(SLUG, 2, |record| record.verdict = Verdict::Invalid);
    assert_eq!(load(&synthetic).unwrap().scenarios[0].counted().count(), 3);
}

#[test]
fn garbage_in_the_midst_of_the_journal_is_an_error() {
    let synthetic = one_scenario();
    let path = synthetic.directory.journal().path();
    let journal = fs::read_to_string(&path).unwrap();
    fs::write(
        &path,
        journal.replacen("scenario-started", "scenario-st\u{fffd}", 1),
    )
    .unwrap();
    let (text, hint) = complaint(&synthetic, load(&synthetic));
    assert!(
        text.starts_with("line 2 of events.jsonl is not an event: unknown variant"),
        "{text}"
    );
    assert!(hint.contains("restore line 2"), "{hint}");
}

#[test]
fn reading_changes_nothing() {
    let synthetic = one_scenario();
    let listing = |path: &Path| {
        let mut names: Vec<_> = fs::read_dir(path)
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .collect();
        names.sort();
        names
    };
    let before = listing(synthetic.directory.path());
    load(&synthetic).unwrap();
    assert_eq!(before, listing(synthetic.directory.path()));
}
