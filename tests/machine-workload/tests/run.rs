//! The real binary, from the command line to the windows on disk, with a real network under it: as root, or as an
//! ordinary user where user namespaces are allowed. Where neither is, it fails.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::{
    collections::HashMap,
    fs,
    io::{BufRead, BufReader, Lines},
    path::{Path, PathBuf},
    process::{Child, ChildStdout, Command, ExitStatus, Stdio},
    sync::{Mutex, PoisonError},
};

use machine_workload::workload_program;
use nix::{
    sys::signal::{Signal, kill},
    unistd::Pid,
};
use record::{
    FORMAT,
    check::CheckRecord,
    control_log::ControlRow,
    platform::SurveyRecord,
    progress::Progress,
    window::{Verdict, WindowRecord},
};
use sha2::{Digest, Sha256};

/// Two windows of two periods, 100 steps each.
const SETTINGS: &str = r#"{"dynamics":"robust","windows":2,"window":"2s","period":"1s"}"#;
const STEPS: u64 = 100;
const STEP_NS: i64 = 20_000_000;

/// They measure times, so that they run one after the other.
static MACHINE: Mutex<()> = Mutex::new(());

fn workload() -> Command {
    Command::new(workload_program())
}

/// A run of the workload, with its lines still to be read.
struct Run {
    child: Child,
    lines: Option<Lines<BufReader<ChildStdout>>>,
    said: Vec<Progress>,
}

impl Run {
    fn start(data: &Path, settings: &str, windows: &str) -> Self {
        let mut child = workload()
            .args(["run", "--environment", "test", "--settings", settings])
            .args(["--windows", windows, "--data"])
            .arg(data)
            .stdout(Stdio::piped())
            .stderr(Stdio::inherit())
            .spawn()
            .unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        Self {
            child,
            lines: Some(lines),
            said: Vec::new(),
        }
    }

    /// Reads its lines up to one of that kind.
    fn read_until(&mut self, wanted: impl Fn(&Progress) -> bool) {
        for line in self.lines.as_mut().unwrap() {
            let progress = serde_json::from_str(&line.unwrap()).unwrap();
            let found = wanted(&progress);
            self.said.push(progress);
            if found {
                return;
            }
        }
        panic!("it ended first: {:#?}", self.said);
    }

    fn signal(&self, signal: Signal) {
        kill(Pid::from_raw(i32::try_from(self.child.id()).unwrap()), signal).unwrap();
    }

    /// What it said from its first line to its last, without the lines of health, and how it ended.
    fn finish(mut self) -> (Vec<Progress>, ExitStatus) {
        let rest = self.lines.take().into_iter().flatten();
        self.said
            .extend(rest.map(|line| serde_json::from_str::<Progress>(&line.unwrap()).unwrap()));
        self.said
            .retain(|progress| !matches!(progress, Progress::Health { .. }));
        (self.said, self.child.wait().unwrap())
    }
}

fn read_json<T: serde::de::DeserializeOwned>(path: &Path) -> T {
    serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}

fn window(data: &Path, number: u32) -> PathBuf {
    data.join(format!("window-{number}"))
}

fn window_record(data: &Path, number: u32) -> WindowRecord {
    read_json(&window(data, number).join("window.json"))
}

/// The rows of a log, by the names in its first line.
fn rows(folder: &Path) -> Vec<HashMap<String, f64>> {
    let text = fs::read_to_string(folder.join("control.csv")).unwrap();
    let (header, rows) = text.split_once('\n').unwrap();
    assert_eq!(header, ControlRow::HEADER);
    let names: Vec<_> = header.split(',').collect();
    rows.lines()
        .map(|line| {
            let values: Vec<f64> = line.split(',').map(|value| value.parse().unwrap()).collect();
            assert_eq!(values.len(), names.len(), "{line}");
            names.iter().map(ToString::to_string).zip(values).collect()
        })
        .collect()
}

/// Every file beside the record is in it, with its length and hash.
fn assert_files_are_as_recorded(folder: &Path, record: &WindowRecord) {
    let mut names: Vec<_> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .filter(|name| name != "window.json")
        .collect();
    names.sort();
    let recorded: Vec<_> = record.files.iter().map(|file| file.name.clone()).collect();
    assert_eq!(
        names,
        ["control.csv", "h1.pcap", "plant.csv", "sta1.pcap", "sta2.pcap"]
    );
    assert_eq!(recorded, names);
    for file in &record.files {
        let content = fs::read(folder.join(&file.name)).unwrap();
        assert_eq!(file.bytes, content.len() as u64, "{}", file.name);
        assert_eq!(
            file.sha256,
            format!("{:x}", Sha256::digest(&content)),
            "{}",
            file.name
        );
    }
}

/// The processes that have this one for their parent.
fn children_of(pid: u32) -> Vec<u32> {
    let stat = |entry: fs::DirEntry| {
        let number = entry.file_name().to_str()?.parse().ok()?;
        let stat = fs::read_to_string(entry.path().join("stat")).ok()?;
        let (_, fields) = stat.rsplit_once(')')?;
        let parent: u32 = fields.split_whitespace().nth(1)?.parse().ok()?;
        (parent == pid).then_some(number)
    };
    fs::read_dir("/proc")
        .unwrap()
        .filter_map(|entry| stat(entry.ok()?))
        .collect()
}

/// Whether there is such a process, and it has not ended.
fn runs(pid: u32) -> bool {
    fs::read_to_string(format!("/proc/{pid}/stat"))
        .ok()
        .and_then(|stat| Some(stat.rsplit_once(')')?.1.trim_start().starts_with('Z')))
        .is_some_and(|is_dead| !is_dead)
}

const AUTHOR: &str = r#"{"dynamics":"author","windows":2,"window":"2s","period":"1s"}"#;

#[test]
fn the_authors_dynamics_are_measured_by_three_processes_of_which_nothing_is_left() {
    let _machine = MACHINE.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = tempfile::tempdir().unwrap();
    let mut run = Run::start(folder.path(), AUTHOR, "1,2");
    run.read_until(|progress| matches!(progress, Progress::Measuring { .. }));
    let nodes = children_of(run.child.id());
    assert_eq!(nodes.len(), 3, "master, plant and controller: {nodes:?}");
    let (said, status) = run.finish();
    assert!(status.success(), "{status}: {said:?}");
    assert!(!nodes.iter().any(|node| runs(*node)), "{nodes:?}");
    for number in [1, 2] {
        let record = window_record(folder.path(), number);
        assert!(record.complete, "{:?}", record.reasons);
        assert_eq!(
            record.loops().unwrap().steps_done + record.loops().unwrap().controller.lost_ticks,
            STEPS
        );
        assert_eq!(
            record.loops().unwrap().plant.steps + record.loops().unwrap().plant.lost_ticks,
            STEPS
        );
        assert_files_are_as_recorded(&window(folder.path(), number), &record);
        let rows = rows(&window(folder.path(), number));
        for row in rows.iter().filter(|row| row["state_seq"] > 0.0) {
            // As the text has it: four decimals, and the stamp of a command to the microsecond.
            for column in ["x_m", "y_m", "angle_x_rad", "angle_y_rad"] {
                assert!(
                    (row[column] * 1e4 - (row[column] * 1e4).round()).abs() < 1e-6,
                    "{row:?}"
                );
            }
            assert_eq!(row["state_stamp_ns"] % 1000.0, 0.0);
            // There and back over four ends of a link of at least 9 ms each.
            assert!(
                row["state_received_ns"] - row["state_stamp_ns"] >= 36e6,
                "{row:?}"
            );
        }
        assert!(rows.iter().any(|row| row["state_seq"] > 0.0));
    }
}

#[rstest::rstest]
#[case("master")]
#[case("plant")]
#[case("controller")]
fn a_node_that_is_killed_ends_the_run_with_its_name_and_the_window_is_kept(#[case] program: &str) {
    let _machine = MACHINE.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = tempfile::tempdir().unwrap();
    let long = AUTHOR.replace("\"window\":\"2s\"", "\"window\":\"600s\"");
    let mut run = Run::start(folder.path(), &long, "1");
    run.read_until(|progress| matches!(progress, Progress::Measuring { .. }));
    let is_it = |pid: &u32| {
        let line = fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
        line.split(|byte| *byte == 0).nth(2) == Some(program.as_bytes())
    };
    let node = children_of(run.child.id()).into_iter().find(is_it).unwrap();
    kill(Pid::from_raw(i32::try_from(node).unwrap()), Signal::SIGKILL).unwrap();
    let (said, status) = run.finish();
    assert_eq!(status.code(), Some(1));
    let Some(Progress::Failed { reason, platform, .. }) = said.last() else {
        panic!("{said:?}");
    };
    let wanted = format!("the {program} failed: it ended early: signal: 9");
    assert!(reason.contains(&wanted), "{reason}");
    assert!(!platform);
    let record = window_record(folder.path(), 1);
    assert!(
        !record.complete && record.loops().unwrap().steps_done > 0,
        "{record:?}"
    );
}

/// Whoever started it, root or an ordinary user in a namespace of its own: nothing by which a machine is taken over is left, in
/// any thread of any of its processes.
#[test]
fn what_measures_has_given_up_the_right_to_make_namespaces() {
    /// `DAC_OVERRIDE`, `SETGID`, `SETUID`, `NET_ADMIN`, `NET_RAW`, `IPC_LOCK`, `SYS_NICE` (`linux/capability.h`).
    const KEPT: u64 = 1 << 1 | 1 << 6 | 1 << 7 | 1 << 12 | 1 << 13 | 1 << 14 | 1 << 23;
    let _machine = MACHINE.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let mut run = Run::start(&data, AUTHOR, "1");
    run.read_until(|progress| matches!(progress, Progress::Measuring { .. }));
    let pid = run.child.id();
    let processes: Vec<u32> = children_of(pid).into_iter().chain([pid]).collect();
    assert_eq!(processes.len(), 4);
    for process in processes {
        for task in fs::read_dir(format!("/proc/{process}/task")).unwrap() {
            let status = fs::read_to_string(task.unwrap().path().join("status")).unwrap();
            for set in ["CapInh:", "CapPrm:", "CapEff:", "CapBnd:", "CapAmb:"] {
                let line = status.lines().find_map(|line| line.strip_prefix(set)).unwrap();
                let has = u64::from_str_radix(line.trim(), 16).unwrap();
                assert_eq!(has & !KEPT, 0, "{status}");
            }
            assert!(status.contains("NoNewPrivs:\t1"), "{status}");
        }
    }
    let (_, status) = run.finish();
    assert!(status.success(), "{status}");
    let survey: SurveyRecord = read_json(&data.join("environment.json"));
    let privileges = survey.before.privileges.unwrap();
    assert!(privileges.no_new_privileges, "{privileges:?}");
    assert!(
        !privileges.capabilities.iter().any(|name| name == "SYS_ADMIN"),
        "{privileges:?}"
    );
}

#[test]
fn nodes_end_with_a_workload_that_is_killed() {
    let _machine = MACHINE.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = tempfile::tempdir().unwrap();
    let mut run = Run::start(folder.path(), AUTHOR, "1,2");
    run.read_until(|progress| matches!(progress, Progress::Measuring { .. }));
    let nodes = children_of(run.child.id());
    run.child.kill().unwrap();
    run.child.wait().unwrap();
    let begun = std::time::Instant::now();
    while nodes.iter().any(|node| runs(*node)) {
        assert!(begun.elapsed() < std::time::Duration::from_secs(20), "{nodes:?}");
        std::thread::yield_now();
    }
}

#[test]
fn a_run_measures_contiguous_windows_with_all_their_files() {
    let _machine = MACHINE.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("made/by/the/workload");
    let (said, status) = Run::start(&data, SETTINGS, "3,4").finish();
    assert!(status.success(), "{status}: {said:?}");

    let records = [3, 4].map(|number| window_record(&data, number));
    let complete = |record: &WindowRecord| Progress::WindowComplete {
        window: record.window,
        verdict: record.verdict,
        reason: record.invalid_for(),
    };
    assert!(matches!(said[0], Progress::Started { .. }), "{said:?}");
    assert_eq!(
        said[1..],
        [
            Progress::NetworkUp,
            Progress::Connected,
            Progress::Measuring { window: 3 },
            complete(&records[0]),
            complete(&records[1]),
            Progress::Finished,
        ]
    );
    assert!(
        records[0].network_seed.is_some(),
        "drawn, since the settings have none"
    );
    assert_eq!(records[0].network_seed, records[1].network_seed);
    let journal = fs::read_to_string(data.join("progress.jsonl")).unwrap();
    let journal: Vec<Progress> = journal
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert_eq!(journal, said);
    let survey: SurveyRecord = read_json(&data.join("environment.json"));
    let platform = &survey.before;
    assert_eq!(survey.after.as_ref().unwrap().kernel, platform.kernel);
    assert_eq!(survey.changes, Vec::new());
    assert_eq!(
        platform.workload_machine.as_deref(),
        Some(record::platform::MACHINE)
    );
    assert_eq!(platform.realtime.priority_asked, 80);
    assert_eq!(
        platform.realtime.priority_granted == 0,
        platform.realtime.priority_refusal.is_some()
    );

    let mut expected_step = 0_u64;
    for (record, number) in records.iter().zip([3, 4]) {
        let folder = window(&data, number);
        assert_eq!((record.format, record.window), (FORMAT, number));
        assert_eq!(record.environment, "test");
        assert!(record.complete);
        assert_eq!(
            (
                record.loops().unwrap().steps_done,
                record.loops().unwrap().steps_expected
            ),
            (STEPS, STEPS)
        );
        assert_eq!(
            (
                record.loops().unwrap().controller.steps,
                record.loops().unwrap().plant.steps
            ),
            (STEPS, STEPS)
        );
        assert_eq!(record.ended_ns - record.started_ns, 2_000_000_000);
        assert!(record.loops().unwrap().longest_gap_ns >= STEP_NS / 2);
        assert!(record.cpu_share > 0.0);
        assert_files_are_as_recorded(&folder, record);
        // h1 has nothing to say once the nodes have found each other.
        let packets: Vec<_> = record.captures.iter().map(|capture| capture.packets).collect();
        assert!(
            packets.len() == 3 && packets[1] >= STEPS && packets[2] >= STEPS,
            "{packets:?}"
        );
        assert!(record.captures.iter().all(|capture| capture.dropped == 0));
        let releases = record.releases.unwrap();
        assert!(releases.released >= 2 * STEPS, "{releases:?}");
        assert!(
            0 < releases.lateness_p99_ns
                && releases.lateness_p99_ns <= releases.lateness_p999_ns
                && releases.lateness_p999_ns <= releases.lateness_max_ns
                && releases.lateness_mean_ns < releases.lateness_max_ns as f64,
            "{releases:?}"
        );
        assert!(record.links[1].up.delivered >= STEPS / 2, "{:?}", record.links);

        let rows = rows(&folder);
        assert_eq!(rows.len() as u64, STEPS);
        for row in &rows {
            assert_eq!(row["step"], expected_step as f64);
            assert_eq!(row["scheduled_ns"], (expected_step as i64 * STEP_NS) as f64);
            assert!(row["actual_ns"] >= row["scheduled_ns"] && row["done_ns"] >= row["actual_ns"]);
            if row["state_seq"] > 0.0 {
                // Two stages of at least 9 ms each.
                let way_ms = (row["state_received_ns"] - row["state_stamp_ns"]) / 1e6;
                assert!(way_ms >= 18.0, "{way_ms} ms");
                // It may have come between the beginning of the step and the look at it.
                assert!(row["state_received_ns"] <= row["done_ns"]);
            }
            expected_step += 1;
        }
        let mut ways_ms: Vec<f64> = rows
            .iter()
            .filter(|row| row["state_seq"] > 0.0)
            .map(|row| (row["state_received_ns"] - row["state_stamp_ns"]) / 1e6)
            .collect();
        ways_ms.sort_by(f64::total_cmp);
        let median_ms = ways_ms[ways_ms.len() / 2];
        assert!((19.0..25.0).contains(&median_ms), "{median_ms} ms");
        let commanded = rows
            .iter()
            .any(|row| row["command_x_v"] != 0.0 && row["command_y_v"] != 0.0);
        assert!(commanded);
    }
    let [first, second] = &records;
    assert!(first.starts_run && !second.starts_run);
    assert_eq!((first.started_ns, first.ended_ns), (0, second.started_ns));
    assert_eq!(first.ended_unix_ns, second.started_unix_ns);
}

#[test]
fn a_run_that_is_asked_to_stop_leaves_whole_windows_whole_and_marks_the_one_it_cut() {
    let _machine = MACHINE.lock().unwrap_or_else(PoisonError::into_inner);
    let data = tempfile::tempdir().unwrap();
    let mut run = Run::start(data.path(), SETTINGS, "1,2");
    run.read_until(|progress| matches!(progress, Progress::WindowComplete { window: 1, .. }));
    run.signal(Signal::SIGTERM);
    let (said, status) = run.finish();
    assert_eq!(said.last(), Some(&Progress::Stopped { window: 2 }));
    assert!(status.success(), "{status}");

    let first = window_record(data.path(), 1);
    assert!(first.complete && first.loops().unwrap().steps_done == STEPS);
    assert_files_are_as_recorded(&window(data.path(), 1), &first);
    let second = window_record(data.path(), 2);
    assert!(
        !second.complete && second.loops().unwrap().steps_done < STEPS,
        "{second:?}"
    );
    assert_eq!(second.verdict, Verdict::Invalid);
    assert_eq!(
        rows(&window(data.path(), 2)).len() as u64,
        second.loops().unwrap().steps_done
    );
    assert!(second.ended_ns - second.started_ns < 2_000_000_000);
    assert_files_are_as_recorded(&window(data.path(), 2), &second);
}

#[test]
fn a_run_outlives_its_client() {
    let _machine = MACHINE.lock().unwrap_or_else(PoisonError::into_inner);
    let data = tempfile::tempdir().unwrap();
    let mut run = Run::start(data.path(), SETTINGS, "1,2");
    run.read_until(|progress| matches!(progress, Progress::Measuring { .. }));
    run.lines = None;
    run.signal(Signal::SIGHUP);
    let (_, status) = run.finish();
    assert!(status.success(), "{status}");
    assert!(window_record(data.path(), 2).complete);
    let journal = fs::read_to_string(data.path().join("progress.jsonl")).unwrap();
    assert_eq!(journal.lines().last(), Some(r#"{"event":"finished"}"#));
}

#[test]
fn a_window_that_is_there_is_never_overwritten() {
    let _machine = MACHINE.lock().unwrap_or_else(PoisonError::into_inner);
    let data = tempfile::tempdir().unwrap();
    let taken = window(data.path(), 1);
    fs::create_dir(&taken).unwrap();
    fs::write(taken.join("control.csv"), "precious").unwrap();
    let (said, status) = Run::start(data.path(), SETTINGS, "1").finish();
    assert_eq!(status.code(), Some(1));
    let Some(Progress::Failed {
        reason,
        hint,
        platform: false,
    }) = said.last()
    else {
        panic!("{said:?}");
    };
    assert!(reason.contains("window-1"), "{reason}");
    assert!(hint.is_some());
    assert_eq!(fs::read_to_string(taken.join("control.csv")).unwrap(), "precious");
}

#[rstest::rstest]
#[case::window_cuts_a_period(r#"{"window":"3s","period":"2s"}"#, "1", "window")]
#[case::no_unit(r#"{"window":3}"#, "1", "unit")]
#[case::no_json("windows: 3", "1", "settings")]
#[case::unknown_key(r#"{"windo":"3s"}"#, "1", "windo")]
#[case::window_twice("{}", "1,2,1", "twice")]
#[case::window_zero("{}", "0", "0")]
fn a_wrong_call_is_refused_with_its_reason(
    #[case] settings: &str,
    #[case] windows: &str,
    #[case] says: &str,
) {
    let data = tempfile::tempdir().unwrap();
    let output = workload()
        .args([
            "run",
            "--environment",
            "test",
            "--settings",
            settings,
            "--windows",
            windows,
            "--data",
        ])
        .arg(data.path())
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(2));
    let complaint = String::from_utf8(output.stderr).unwrap();
    assert!(complaint.contains(says), "{complaint}");
    assert!(!window(data.path(), 1).exists());
}

#[test]
fn a_check_is_one_line_of_json() {
    let output = workload().arg("check").output().unwrap();
    assert!(output.status.success());
    let text = String::from_utf8(output.stdout).unwrap();
    assert_eq!(text.lines().count(), 1);
    let found: CheckRecord = serde_json::from_str(&text).unwrap();
    assert_eq!(
        found.can_run,
        found
            .checks
            .iter()
            .all(|check| check.available || !check.required)
    );
    assert!(
        found
            .checks
            .iter()
            .all(|check| check.available == check.reason.is_none()),
        "{found:?}"
    );
}
