//! The real binary, from its command line to the windows on disk, with windows of two seconds.

// Helpers are not marked as tests, so that clippy.toml does not know them as such.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr)]

use std::{
    fs,
    io::{BufRead, BufReader},
    path::Path,
    process::{Child, Command, Output, Stdio},
};

use nix::{
    sys::signal::{Signal, kill},
    unistd::Pid,
};
use sha2::{Digest, Sha256};
use tempfile::TempDir;
use workload::record::{
    check::CheckRecord,
    control_log::ControlRow,
    platform::PlatformRecord,
    progress::Progress,
    window::{Verdict, WindowRecord},
};

const SETTINGS: &str = r#"{"window":"2s","period":"1s","reference":{"amplitude_m":0.05}}"#;

fn workload() -> Command {
    Command::new(env!("CARGO_BIN_EXE_workload"))
}

fn run(data: &Path, settings: &str, windows: &str) -> Command {
    let mut command = workload();
    command.args([
        "run",
        "--environment",
        "whole-run",
        "--settings",
        settings,
        "--windows",
        windows,
    ]);
    command.arg("--data").arg(data);
    command
}

/// Whether the experiment can run here; where it cannot, the test says why and is of no use.
fn can_run_here() -> bool {
    let output = workload().arg("check").output().unwrap();
    assert!(output.status.success());
    let found: CheckRecord = serde_json::from_slice(&output.stdout).unwrap();
    if !found.can_run {
        eprintln!(
            "skipped, since the experiment cannot run here: {:?}",
            found.checks
        );
    }
    found.can_run
}

fn lines(output: &Output) -> Vec<Progress> {
    let text = String::from_utf8(output.stdout.clone()).unwrap();
    text.lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

fn window(data: &TempDir, number: u32) -> WindowRecord {
    let path = data.path().join(format!("window-{number}/window.json"));
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

fn rows(data: &TempDir, number: u32) -> Vec<Vec<f64>> {
    let text = fs::read_to_string(data.path().join(format!("window-{number}/control.csv"))).unwrap();
    let (header, rows) = text.split_once('\n').unwrap();
    assert_eq!(header, ControlRow::HEADER);
    rows.lines()
        .map(|row| row.split(',').map(|value| value.parse().unwrap()).collect())
        .collect()
}

#[test]
fn two_windows_are_measured_whole_and_without_a_gap_between() {
    if !can_run_here() {
        return;
    }
    let data = tempfile::tempdir().unwrap();
    let output = run(data.path(), SETTINGS, "5,6").output().unwrap();
    assert!(output.status.success(), "{output:?}");
    assert_eq!(lines(&output).last(), Some(&Progress::Finished));

    let (first, second) = (window(&data, 5), window(&data, 6));
    for record in [&first, &second] {
        assert!(record.complete);
        assert_ne!(record.verdict, Verdict::Invalid, "{:?}", record.reasons);
        assert_eq!((record.steps_done, record.plant.steps), (100, 100));
        assert_eq!(record.links.len(), 3);
    }
    assert_eq!((first.started_ns, second.started_ns), (0, first.ended_ns));
    assert_eq!(first.ended_unix_ns, second.started_unix_ns);
    assert!(first.starts_run && !second.starts_run);
    let platform = fs::read(data.path().join("environment.json")).unwrap();
    serde_json::from_slice::<PlatformRecord>(&platform).unwrap();
}

#[test]
fn every_file_of_a_window_is_as_its_record_says() {
    if !can_run_here() {
        return;
    }
    let data = tempfile::tempdir().unwrap();
    assert!(run(data.path(), SETTINGS, "1").status().unwrap().success());
    let record = window(&data, 1);
    let names: Vec<&str> = record.files.iter().map(|file| file.name.as_str()).collect();
    assert_eq!(names, ["control.csv", "h1.pcap", "sta1.pcap", "sta2.pcap"]);
    for file in &record.files {
        let content = fs::read(data.path().join("window-1").join(&file.name)).unwrap();
        assert_eq!(file.bytes, content.len() as u64);
        assert_eq!(file.sha256, format!("{:x}", Sha256::digest(&content)));
    }
    // 50 states and 50 commands a second, both ways of each acknowledged; the losses leave most.
    let busy = record
        .captures
        .iter()
        .filter(|capture| capture.packets > 100)
        .count();
    assert_eq!(busy, 2, "{:?}", record.captures);
}

#[test]
fn a_state_is_as_old_as_the_links_make_it() {
    if !can_run_here() {
        return;
    }
    let data = tempfile::tempdir().unwrap();
    assert!(run(data.path(), SETTINGS, "1").status().unwrap().success());
    let names: Vec<&str> = ControlRow::HEADER.split(',').collect();
    let at = |row: &[f64], name: &str| row[names.iter().position(|it| *it == name).unwrap()];
    let travelled: Vec<f64> = rows(&data, 1)
        .iter()
        .filter(|row| at(row, "state_seq") > 0.0)
        .map(|row| at(row, "state_received_ns") - at(row, "state_stamp_ns"))
        .collect();
    assert!(travelled.len() > 50);
    // Two passes of 10 ms ± 1 ms, and what a lost packet adds: never less than 18 ms, half of them below 25 ms.
    let mut sorted = travelled;
    sorted.sort_by(f64::total_cmp);
    assert!(sorted[0] >= 18e6, "{}", sorted[0]);
    assert!(sorted[sorted.len() / 2] < 25e6, "{}", sorted[sorted.len() / 2]);
}

/// Reads lines until one that is wanted has come.
fn wait_for(child: &mut Child, wanted: impl Fn(&Progress) -> bool) {
    let mut out = BufReader::new(child.stdout.take().unwrap());
    let mut line = String::new();
    loop {
        line.clear();
        assert_ne!(out.read_line(&mut line).unwrap(), 0, "it ended before");
        if wanted(&serde_json::from_str(&line).unwrap()) {
            return;
        }
    }
}

#[test]
fn told_to_stop_it_leaves_a_cut_window_even_when_nobody_listens_any_more() {
    if !can_run_here() {
        return;
    }
    let data = tempfile::tempdir().unwrap();
    let long = r#"{"window":"60s","period":"1s","reference":{"amplitude_m":0.05}}"#;
    let mut child = run(data.path(), long, "1,2")
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    // Its standard output is closed after this.
    wait_for(&mut child, |line| matches!(line, Progress::Health { .. }));
    let pid = Pid::from_raw(i32::try_from(child.id()).unwrap());
    kill(pid, Signal::SIGHUP).unwrap();
    kill(pid, Signal::SIGTERM).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(0));
    let cut = window(&data, 1);
    assert!(!cut.complete && cut.steps_done > 0 && cut.steps_done < cut.steps_expected);
    assert_eq!(cut.verdict, Verdict::Invalid);
    assert!(!data.path().join("window-2").exists());
    let progress = fs::read_to_string(data.path().join("progress.jsonl")).unwrap();
    let last: Progress = serde_json::from_str(progress.lines().last().unwrap()).unwrap();
    assert_eq!(last, Progress::Stopped { window: 1 });
}

#[test]
fn settings_that_do_not_fit_are_refused_with_what_to_write() {
    let data = tempfile::tempdir().unwrap();
    let output = run(data.path(), r#"{"window":"250s"}"#, "1").output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    let said = lines(&output);
    let Some(Progress::Failed {
        reason,
        hint,
        platform,
    }) = said.last()
    else {
        panic!("{said:?}")
    };
    assert!(reason.starts_with("window: "), "{reason}");
    assert_eq!(hint.as_deref(), Some("write `300s`, which is 3 periods"));
    assert!(!platform);
}

#[test]
fn windows_that_are_there_are_never_overwritten() {
    if !can_run_here() {
        return;
    }
    let data = tempfile::tempdir().unwrap();
    fs::create_dir(data.path().join("window-1")).unwrap();
    fs::write(data.path().join("window-1/control.csv"), "precious").unwrap();
    let output = run(data.path(), SETTINGS, "1").output().unwrap();
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    let kept = fs::read_to_string(data.path().join("window-1/control.csv")).unwrap();
    assert_eq!(kept, "precious");
}
