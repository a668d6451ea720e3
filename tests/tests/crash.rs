//! Whatever kills `matrix`, the run can be gone on with and nothing is lost or left behind.

use std::{
    ffi::OsStr,
    fs,
    os::unix::ffi::OsStrExt as _,
    path::{Path, PathBuf},
    process::Command,
};

use rstest::rstest;
use serde_json::Value;
use tests::{FAKE, Ran, Workplace};

// Two tests, since they wait for disks more than they compute.
#[rstest]
#[case::odd(1)]
#[case::even(2)]
fn a_run_killed_after_any_line_is_whole_after_resume(#[case] first: usize) {
    let lines = {
        let workplace = Workplace::new();
        workplace.write("m.yaml", FAKE);
        let mut running = workplace.start(&["run", "m.yaml"]);
        std::iter::from_fn(|| running.next_line()).count()
    };
    assert!(lines > 20, "a run says what it does: {lines} lines");
    for killed_after in (first..lines).step_by(2) {
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
        let resumed = workplace.run(&["resume", directory, "--json"]);
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
        let report: Value = serde_json::from_str(&resumed.out).unwrap();
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

/// A run that has ended, with its two scenarios and eight windows, and one of the scenarios' folders.
fn ended() -> (Workplace, PathBuf, PathBuf) {
    let workplace = Workplace::new();
    workplace.write("m.yaml", FAKE);
    let ran = workplace.run(&["run", "m.yaml"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let directory = workplace.run_directory();
    let mut scenarios: Vec<PathBuf> = fs::read_dir(directory.join("scenarios"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    scenarios.sort();
    (workplace, directory, scenarios.remove(0))
}

fn records(scenario: &Path) -> Vec<Vec<u8>> {
    let record = |window| fs::read(scenario.join(format!("window-{window}/window.json"))).unwrap();
    (1..=4).map(record).collect()
}

fn windows_done(workplace: &Workplace, directory: &str) -> Vec<u64> {
    let status = workplace.json(&["status", directory]);
    let scenarios = status["scenarios"].as_array().unwrap().iter();
    scenarios
        .map(|scenario| scenario["windows_collected"].as_u64().unwrap())
        .collect()
}

#[test]
fn windows_that_the_journal_does_not_know_are_adopted_and_not_measured_again() {
    let lines = {
        let (_workplace, directory, _) = ended();
        fs::read_to_string(directory.join("events.jsonl"))
            .unwrap()
            .lines()
            .count()
    };
    for kept in [1, lines / 4, lines / 2, lines - 1] {
        let (workplace, directory, scenario) = ended();
        let journal = directory.join("events.jsonl");
        let text = fs::read_to_string(&journal).unwrap();
        let begin: String = text.lines().take(kept).map(|line| format!("{line}\n")).collect();
        fs::write(&journal, begin).unwrap();
        let before = records(&scenario);
        let path = directory.to_str().unwrap();
        let resumed = workplace.run(&["resume", path]);
        assert_eq!(resumed.code, Some(0), "{kept} lines kept: {resumed:?}");
        assert!(
            !resumed.err.contains("measuring window"),
            "{kept} lines kept: {resumed:?}"
        );
        assert!(
            records(&scenario) == before,
            "{kept} lines kept: a window was measured again"
        );
        assert_eq!(windows_done(&workplace, path), [4, 4]);
        assert_eq!(left_behind(&workplace, path), Vec::<Value>::new());
        let report = workplace.json(&["report", path]);
        assert_eq!(report["between"][0]["pairs"], 16, "{report:#}");
    }
}

#[rstest]
#[case::emptied(|window: &Path| fs::write(window.join("control.csv"), "").unwrap())]
#[case::another_digit(|window: &Path| {
    let path = window.join("control.csv");
    let mut bytes = fs::read(&path).unwrap();
    let at = bytes.len() / 2;
    bytes[at] = if bytes[at] == b'1' { b'2' } else { b'1' };
    fs::write(&path, bytes).unwrap();
})]
#[case::no_record(|window: &Path| fs::remove_file(window.join("window.json")).unwrap())]
#[case::no_bytes_in_the_record(|window: &Path| fs::write(window.join("window.json"), "").unwrap())]
fn a_window_that_is_not_whole_any_more_is_kept_aside_and_measured_again(#[case] damage: fn(&Path)) {
    let (workplace, directory, scenario) = ended();
    let before = records(&scenario);
    damage(&scenario.join("window-2"));
    let path = directory.to_str().unwrap();
    let resumed = workplace.run(&["resume", path]);
    assert_eq!(resumed.code, Some(0), "{resumed:?}");
    assert!(
        resumed.err.contains("window 2 broke and is kept aside"),
        "{resumed:?}"
    );
    let after = records(&scenario);
    for window in [0, 2, 3] {
        assert!(before[window] == after[window], "window {} was whole", window + 1);
    }
    let broken = fs::read_dir(scenario.join("broken"))
        .unwrap()
        .next()
        .unwrap()
        .unwrap();
    assert!(broken.path().join("window-2/control.csv").exists());
    let report = workplace.json(&["report", path]);
    assert_eq!(report["between"][0]["pairs"], 16, "{report:#}");
}

#[test]
fn a_damaged_window_is_found_after_what_was_left_measuring_has_ended() {
    let workplace = Workplace::new();
    workplace.write(
        "m.yaml",
        format!("{FAKE}providers:\n  fake: {{window_takes: 300ms}}\n"),
    );
    let mut running = workplace.start(&["run", "m.yaml"]);
    running.wait_for(": completed");
    running.wait_for("measuring window 1");
    running.kill();
    let directory = workplace.run_directory();
    let scenarios = fs::read_dir(directory.join("scenarios")).unwrap();
    let done = scenarios
        .map(|entry| entry.unwrap().path())
        .find(|scenario| scenario.join("window-4").exists())
        .unwrap();
    fs::write(done.join("window-3/control.csv"), "").unwrap();
    let path = directory.to_str().unwrap();
    let resumed = workplace.run(&["resume", path]);
    assert_eq!(resumed.code, Some(0), "{resumed:?}");
    let told = |words: &str| {
        resumed
            .err
            .find(words)
            .unwrap_or_else(|| panic!("{words}: {resumed:?}"))
    };
    assert!(told("found ") < told("window 3 broke and is kept aside"));
    assert_eq!(windows_done(&workplace, path), [4, 4]);
}

#[test]
fn a_window_that_was_taken_away_is_missing_for_every_command_and_measured_again() {
    let (workplace, directory, scenario) = ended();
    fs::rename(scenario.join("window-1"), workplace.path().join("elsewhere")).unwrap();
    let path = directory.to_str().unwrap();
    assert_eq!(windows_done(&workplace, path), [3, 4]);
    let told = workplace.run(&["status", path]).out;
    assert!(
        told.contains("3 of 4 windows") && told.contains("matrix resume"),
        "{told}"
    );
    let left = workplace.json(&["resume", path, "--dry-run"]);
    assert_eq!(
        left["scenarios"][0]["windows"],
        serde_json::json!([1]),
        "{left:#}"
    );
    let resumed = workplace.run(&["resume", path]);
    assert_eq!(resumed.code, Some(0), "{resumed:?}");
    assert_eq!(windows_done(&workplace, path), [4, 4]);
}

#[test]
fn two_lines_that_a_crash_cut_do_not_end_a_run() {
    let (workplace, directory, _) = ended();
    let journal = directory.join("events.jsonl");
    let mut text = fs::read_to_string(&journal).unwrap();
    text.truncate(text.len() - 20);
    text.push_str("\n{\"at\":\"2026-11-22T16:00:00.000Z\",\"event\":\"run-sta");
    fs::write(&journal, text).unwrap();
    let path = directory.to_str().unwrap();
    for command in ["status", "report", "resume", "report"] {
        let ran = workplace.run(&[command, path]);
        assert_eq!(ran.code, Some(0), "{command}: {ran:?}");
    }
}

#[rstest]
#[case::emptied(|file: &Path| fs::write(file, "").unwrap())]
#[case::gone(|file: &Path| fs::remove_file(file).unwrap())]
fn what_is_not_known_of_a_platform_costs_no_window_and_is_remarked_on(#[case] damage: fn(&Path)) {
    let (workplace, directory, scenario) = ended();
    damage(&scenario.join("environment.json"));
    let report = workplace.run(&["report", directory.to_str().unwrap()]);
    assert_eq!(report.code, Some(0), "{report:?}");
    assert!(
        report.out.contains("The platform of a is not known"),
        "{report:?}"
    );
}

#[test]
fn a_run_whose_directory_is_moved_while_it_is_live_is_in_use() {
    let workplace = Workplace::new();
    workplace.write(
        "m.yaml",
        format!("{FAKE}providers:\n  fake: {{window_takes: 1h}}\n"),
    );
    let mut running = workplace.start(&["run", "m.yaml"]);
    running.wait_for("measuring window 1");
    let moved = workplace.path().join("moved");
    fs::rename(workplace.run_directory(), &moved).unwrap();
    let clean = workplace.json(&["clean"]);
    assert_eq!(clean["leftovers"][0]["fate"], "in use", "{clean:#}");
    running.kill();
    let path = moved.to_str().unwrap();
    let left = workplace.json(&["clean"]);
    assert_eq!(left["leftovers"][0]["fate"], "removed", "{left:#}");
    assert_eq!(left_behind(&workplace, path), Vec::<Value>::new());
}

#[test]
fn a_run_goes_on_with_the_state_folder_that_it_was_begun_with_and_no_other() {
    let mut workplace = Workplace::new();
    workplace.write(
        "m.yaml",
        format!("{FAKE}providers:\n  fake: {{window_takes: 300ms}}\n"),
    );
    let mut running = workplace.start(&["run", "m.yaml"]);
    running.wait_for("window 2 complete");
    running.kill();
    let directory = workplace.run_directory();
    let path = directory.to_str().unwrap();
    let (begun_with, other) = (workplace.path().join("state"), workplace.path().join("other"));
    workplace.set("MATRIX_STATE_DIR", other.to_str().unwrap());
    let journal = || fs::read(directory.join("events.jsonl")).unwrap();
    let before = journal();
    for call in [&["resume", path][..], &["resume", path, "--dry-run"]] {
        let refused = workplace.run(call);
        assert_eq!(refused.code, Some(2), "{refused:?}");
        let call = format!("MATRIX_STATE_DIR={} matrix resume", begun_with.display());
        assert!(refused.err.contains(&call), "{refused:?}");
    }
    assert!(journal() == before, "nothing was done");
    workplace.set("MATRIX_STATE_DIR", begun_with.to_str().unwrap());
    let resumed = workplace.run(&["resume", path]);
    assert_eq!(resumed.code, Some(0), "{resumed:?}");
    assert_eq!(windows_done(&workplace, path), [4, 4]);
}

/// `matrix` below a limit, as the shell's `ulimit` has it.
fn below(workplace: &Workplace, limit: &str, arguments: &str) -> Ran {
    let matrix = workplace.matrix(["--version"]);
    let mut shell = Command::new("bash");
    shell.args(["-c", &format!("ulimit {limit} && exec \"$0\" {arguments}")]);
    shell.arg(matrix.get_program()).current_dir(workplace.path());
    shell.envs(matrix.get_envs().filter_map(|(name, value)| Some((name, value?))));
    Ran::of(shell.output().unwrap())
}

#[test]
fn too_few_open_files_are_told_before_anything_is_made_and_are_not_the_experiments_fault() {
    let workplace = Workplace::new();
    workplace.write("m.yaml", FAKE);
    let refused = below(&workplace, "-n 24", "run m.yaml");
    assert_eq!(refused.code, Some(3), "{refused:?}");
    for words in ["may open 24 files", "ulimit -n"] {
        assert!(refused.err.contains(words), "{refused:?}");
    }
    assert!(!workplace.path().join("runs").exists());
    // A limit that may be raised is.
    let ran = below(&workplace, "-S -n 24", "run m.yaml");
    assert_eq!(ran.code, Some(0), "{ran:?}");
}

#[test]
fn too_little_address_space_is_told_before_anything_is_made() {
    let workplace = Workplace::new();
    workplace.write("m.yaml", FAKE);
    let refused = below(&workplace, "-v 300000", "run m.yaml");
    assert_eq!(refused.code, Some(3), "{refused:?}");
    for words in ["292 MiB of address space", "ulimit -v unlimited"] {
        assert!(refused.err.contains(words), "{refused:?}");
    }
    assert!(!workplace.path().join("runs").exists());
}

#[test]
fn a_file_that_would_be_longer_than_is_allowed_is_told_and_costs_nothing() {
    let workplace = Workplace::new();
    workplace.write("m.yaml", FAKE);
    // In KiB: the manifest fits, the journal does not.
    let refused = below(&workplace, "-f 8", "run m.yaml");
    assert_eq!(refused.code, Some(3), "{refused:?}");
    assert!(refused.err.contains("ulimit -f unlimited"), "{refused:?}");
    let directory = workplace.run_directory();
    let resumed = workplace.run(&["resume", directory.to_str().unwrap()]);
    assert_eq!(resumed.code, Some(0), "{resumed:?}");
    assert_eq!(windows_done(&workplace, directory.to_str().unwrap()), [4, 4]);
}

#[test]
fn a_folder_whose_name_is_not_utf_8_is_refused_before_anything_is_made() {
    let workplace = Workplace::new();
    workplace.write("m.yaml", FAKE);
    let out = OsStr::from_bytes(b"r\xffns");
    let mut matrix = workplace.matrix(["run", "m.yaml", "--out"]);
    let refused = Ran::of(matrix.arg(out).output().unwrap());
    assert_eq!(refused.code, Some(2), "{refused:?}");
    assert!(refused.err.contains("is not UTF-8"), "{refused:?}");
    assert!(!workplace.path().join(out).exists());
}

#[rstest]
#[case::without_an_owner(|folder: &Path| fs::remove_dir_all(folder).and_then(|()| fs::create_dir(folder)).unwrap())]
#[case::unfinished(|folder: &Path| fs::rename(folder, folder.with_extension("unfinished")).unwrap())]
fn an_environment_that_was_being_made_or_removed_goes_with_resume(#[case] leave: fn(&Path)) {
    let workplace = Workplace::new();
    workplace.write(
        "m.yaml",
        format!("{FAKE}providers:\n  fake: {{window_takes: 100ms}}\n"),
    );
    let mut running = workplace.start(&["run", "m.yaml"]);
    running.wait_for("measuring window 1");
    running.kill();
    let environments = workplace.path().join("state/environments");
    let made = fs::read_dir(&environments).unwrap().next().unwrap().unwrap();
    leave(&made.path());
    let resumed = workplace.run(&["resume", workplace.run_directory().to_str().unwrap()]);
    assert_eq!(resumed.code, Some(0), "{resumed:?}");
    assert_eq!(fs::read_dir(&environments).unwrap().count(), 0, "{resumed:?}");
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
