//! Run directories that somebody else made: what is in them may lead astray, lie and never end. None of it may touch what
//! is outside of them, hang or break a report.

use std::{
    fs,
    os::unix::fs::symlink,
    path::{Path, PathBuf},
};

use record::{run_directory::RunDirectory, window::WindowRecord};
use reports::{analyse, drift::digest::night_of, input::traffic, messages::write_messages};
use rstest::rstest;
use tempfile::TempDir;

use crate::synthetic::{Scenario, Synthetic};

const SLUG: &str = "x86-debian-native";
const KEPT: &str = "mine, and to stay as it is";

fn run() -> Synthetic {
    Synthetic::new(&[
        Scenario::measured(SLUG, &[0.1; 4]),
        Scenario::measured("x86-debian-docker", &[0.2; 4]),
    ])
}

/// Folders and a file of the reader's, outside of the run directory.
struct Mine {
    folder: TempDir,
}

impl Mine {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("file"), KEPT).unwrap();
        fs::write(folder.path().join("cdf-mine.svg"), KEPT).unwrap();
        Self { folder }
    }

    fn file(&self) -> PathBuf {
        self.folder.path().join("file")
    }

    fn folder(&self) -> PathBuf {
        self.folder.path().to_owned()
    }

    fn is_as_it_was(&self) {
        let mut names: Vec<_> = fs::read_dir(self.folder.path())
            .unwrap()
            .map(|entry| entry.unwrap().file_name())
            .collect();
        names.sort();
        assert_eq!(names, ["cdf-mine.svg", "file"]);
        for name in names {
            assert_eq!(fs::read_to_string(self.folder.path().join(name)).unwrap(), KEPT);
        }
    }
}

/// Everything that reads a run directory or writes below it.
fn read_all_ways(directory: &RunDirectory) {
    if let Ok(run) = reports::load(directory.path()) {
        let report = analyse(&run, traffic::read(&run), &run.manifest.report);
        let _ = reports::write(&run, &report, reports::Layout::default());
    }
    let _ = night_of(directory.path());
    let _ = write_messages(directory, &[]);
}

fn replace_by_link(from: &Path, to: &Path) {
    let _ = fs::remove_file(from);
    let _ = fs::remove_dir_all(from);
    fs::create_dir_all(from.parent().unwrap()).unwrap();
    symlink(to, from).unwrap();
}

#[rstest]
fn a_link_to_a_file_is_neither_followed_nor_written_through(
    #[values(
        "report/tables.tex.new",
        "report/tables.md",
        "report/report.json.new",
        "report/night.json",
        "report/night.json.new",
        "report/figures/cdf-a-b.svg.new",
        "report/messages/x86-debian-native.csv.new"
    )]
    name: &str,
) {
    let (synthetic, mine) = (run(), Mine::new());
    replace_by_link(&synthetic.directory.path().join(name), &mine.file());
    read_all_ways(&synthetic.directory);
    mine.is_as_it_was();
}

#[rstest]
fn a_link_to_a_folder_is_no_way_out(
    #[values(
        "report",
        "report/figures",
        "report/tables",
        "report/messages",
        "scenarios",
        "scenarios/x86-debian-native"
    )]
    name: &str,
) {
    let (synthetic, mine) = (run(), Mine::new());
    replace_by_link(&synthetic.directory.path().join(name), &mine.folder());
    read_all_ways(&synthetic.directory);
    mine.is_as_it_was();
}

#[rstest]
#[case::link("/dev/zero")]
#[case::endless("/dev/urandom")]
fn a_file_that_never_ends_is_an_error_at_once(
    #[case] endless: &str,
    #[values(
        "manifest.json",
        "plan.json",
        "events.jsonl",
        "scenarios/x86-debian-native/window-1/window.json",
        "scenarios/x86-debian-native/window-1/control.csv"
    )]
    name: &str,
) {
    let synthetic = run();
    replace_by_link(&synthetic.directory.path().join(name), Path::new(endless));
    let error = reports::load(synthetic.directory.path()).unwrap_err();
    let told = record::causes::with_causes(&error);
    assert!(told.contains("a link, a device, a socket or a FIFO"), "{told}");
}

#[rstest]
fn a_fifo_is_an_error_and_is_not_waited_for(
    #[values(
        "manifest.json",
        "events.jsonl",
        "scenarios/x86-debian-native/window-1/window.json",
        "scenarios/x86-debian-native/window-1/control.csv"
    )]
    name: &str,
) {
    let synthetic = run();
    let path = synthetic.directory.path().join(name);
    fs::remove_file(&path).unwrap();
    let made = std::process::Command::new("mkfifo").arg(&path).status().unwrap();
    assert!(made.success());
    assert!(reports::load(synthetic.directory.path()).is_err());
}

#[rstest]
fn a_name_that_is_no_name_is_an_error_where_it_is_read(
    #[values("/tmp/x", "../x", "a/../../x", "..", "-rf", "a\nb", "")] name: &str,
    #[values(("manifest.json", "/run"), ("plan.json", "/scenarios/0/slug"), ("plan.json", "/scenarios/0/id"))]
    place: (&str, &str),
) {
    refuses_the_name(name, place);
}

/// A thousand scenarios have half a million pairs, each with two of them.
#[test]
fn a_scenario_has_no_longer_name_than_a_letter() {
    refuses_the_name(&"x".repeat(7), ("plan.json", "/scenarios/0/id"));
}

fn refuses_the_name(name: &str, place: (&str, &str)) {
    let synthetic = run();
    let (file, field) = place;
    let path = synthetic.directory.path().join(file);
    let mut record: serde_json::Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    *record.pointer_mut(field).unwrap() = name.into();
    fs::write(&path, record.to_string()).unwrap();
    let error = reports::load(synthetic.directory.path()).unwrap_err();
    let told = record::causes::with_causes(&error);
    assert!(told.contains("is no name"), "{told}");
}

/// Numbers at the edges, for each number of a window's record.
#[rstest]
fn no_number_of_a_windows_record_ends_a_report_or_the_drift_watch(
    #[values(
        "started_unix_ns",
        "ended_unix_ns",
        "started_ns",
        "ended_ns",
        "steps_expected",
        "steps_done",
        "stale_steps",
        "longest_gap_ns",
        "clock_jump_ns",
        "log_dropped",
        "network_seed",
        "controller/steps",
        "controller/lost_ticks",
        "controller/missed_deadlines",
        "controller/late_steps",
        "controller/lateness_max_ns",
        "plant/steps",
        "plant/missed_deadlines",
        "plant/late_steps",
        "captures/0/dropped",
        "captures/0/packets",
        "releases/released",
        "releases/lateness_max_ns",
        "notices/count",
        "links/0/up/offered",
        "links/0/down/lost"
    )]
    field: &str,
) {
    let recorded = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/fixtures/recorded");
    for number in [
        u64::MAX.to_string(),
        i64::MAX.to_string(),
        i64::MIN.to_string(),
        "0".to_owned(),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let copied = std::process::Command::new("cp")
            .args(["-r", recorded])
            .arg(folder.path().join("run"))
            .status();
        assert!(copied.unwrap().success());
        let directory = RunDirectory::new(folder.path().join("run"));
        let windows = windows_of(directory.path());
        assert!(!windows.is_empty());
        for path in windows {
            let mut record: serde_json::Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
            let place = format!("/{field}");
            let (above, name) = place.rsplit_once('/').unwrap();
            let Some(above) = record.pointer_mut(above) else {
                panic!("{above} is not in {}", path.display());
            };
            above[name] = serde_json::from_str(&number).unwrap();
            fs::write(&path, record.to_string()).unwrap();
        }
        // Neither panics, whatever they say.
        read_all_ways(&directory);
    }
}

/// On a disk it takes one block.
fn make_sparse(path: &Path) {
    let file = fs::OpenOptions::new().write(true).open(path).unwrap();
    file.set_len(15 << 40).unwrap();
}

#[rstest]
fn a_log_that_is_longer_than_it_was_measured_takes_its_window_out_at_once(
    #[values(false, true)] recorded_so: bool,
) {
    let synthetic = run();
    make_sparse(&synthetic.directory.window(SLUG, 2).join("control.csv").path());
    if recorded_so {
        synthetic.edit_window(SLUG, 2, |record| record.files[0].bytes = 15 << 40);
    }
    let run = reports::load(synthetic.directory.path()).unwrap();
    assert_eq!(run.scenarios[0].counted().count(), 3);
    let found = reports::input::verification::verify(&synthetic.directory).unwrap();
    assert_eq!(found.damaged.len(), 1, "{found:?}");
    let _ = write_messages(&synthetic.directory, &[]);
}

#[test]
fn a_file_that_is_longer_than_it_was_measured_is_not_copied() {
    let synthetic = run();
    make_sparse(&synthetic.directory.window(SLUG, 2).join("control.csv").path());
    let copies = tempfile::tempdir().unwrap();
    let redaction = reports::redaction::Redaction::default();
    let error = reports::redaction::copy(&synthetic.directory, &copies.path().join("copy"), &redaction);
    let told = record::causes::with_causes(&error.unwrap_err());
    assert!(told.contains("control.csv"), "{told}");
}

#[rstest]
#[case::negative(-1.0)]
#[case::large(1e308)]
#[case::two(2.0)]
fn a_setting_of_the_report_that_no_matrix_file_may_have_is_an_error(#[case] alpha: f64) {
    let synthetic = run();
    let path = synthetic.directory.manifest().path();
    let mut manifest: serde_json::Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    manifest["report"]["alpha"] = alpha.into();
    fs::write(&path, manifest.to_string()).unwrap();
    let told = record::causes::with_causes(&reports::load(synthetic.directory.path()).unwrap_err());
    assert!(told.contains("`report.alpha` is"), "{told}");
}

#[test]
fn an_environment_that_never_ends_is_a_platform_that_is_not_known() {
    let synthetic = run();
    replace_by_link(
        &synthetic.directory.environment(SLUG).path(),
        Path::new("/dev/zero"),
    );
    let run = reports::load(synthetic.directory.path()).unwrap();
    assert!(run.remarks[0].contains("a link, a device"), "{:?}", run.remarks);
    assert_eq!(run.scenarios[0].counted().count(), 4);
}

fn windows_of(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(windows_of(&path));
        } else if path.file_name().is_some_and(|name| name == "window.json") {
            found.push(path);
        }
    }
    found
}

#[test]
fn what_no_window_can_be_is_said_of_its_window_and_the_others_count() {
    let synthetic = run();
    synthetic.edit_window(SLUG, 2, |record: &mut WindowRecord| {
        record.loops_mut().unwrap().plant.steps = u64::MAX;
    });
    let run = reports::load(synthetic.directory.path()).unwrap();
    let states: Vec<bool> = run.scenarios[0]
        .windows
        .iter()
        .map(|window| matches!(window.state, reports::input::run::WindowState::Counted { .. }))
        .collect();
    assert_eq!(states, [true, false, true, true]);
    let reports::input::run::WindowState::Broken { reason } = &run.scenarios[0].windows[1].state else {
        panic!("{:?}", run.scenarios[0].windows[1].state);
    };
    assert_eq!(
        reason,
        "window.json cannot be what was measured: `plant.steps` is 18446744073709551615, which no run has"
    );
}
