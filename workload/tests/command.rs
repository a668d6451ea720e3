//! A command of the user's as the experiment: what it measures is kept, and whatever it does ends with its window.
//!
//! Here and not beside the code: the process in which a command is run ends all its descendants, other tests' too.

#![allow(clippy::unwrap_used, clippy::panic)] // What tests may, but clippy knows only functions that are tests themselves.

use std::{
    fs,
    path::PathBuf,
    process::Command,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use record::{
    settings::{Settings, ValiditySettings},
    window::{CommandRecord, OfExperiment, Verdict, WindowRecord},
};
use serde_json::{Value, json};
use tempfile::TempDir;
use workload::{
    experiment::{Ending, ExperimentError, Reporter, Request},
    experiments,
};

/// One at a time: each ends the descendants of all.
static ALONE: Mutex<()> = Mutex::new(());

struct Place {
    folder: TempDir,
    experiment: Value,
    windows: Vec<u32>,
    _alone: MutexGuard<'static, ()>,
}

impl Place {
    /// A shell script as the command of one window, which is to write `m.csv`.
    fn new(script: &str) -> Self {
        let script = script.replace('{', "{{").replace('}', "}}");
        Self {
            folder: tempfile::tempdir().unwrap(),
            experiment: json!({
                "name": "e",
                "run": ["/bin/sh", "-c", script, "sh", "{window.folder}", "{window.number}", "{window.seed}"],
                "metrics": [{"name": "m", "from": "m.csv", "column": "x"}],
            }),
            windows: vec![1],
            _alone: ALONE.lock().unwrap_or_else(PoisonError::into_inner),
        }
    }

    fn with(mut self, key: &str, value: Value) -> Self {
        self.experiment[key] = value;
        self
    }

    fn data(&self) -> PathBuf {
        self.folder.path().join("data")
    }

    fn run(&self) -> Result<Ending, ExperimentError> {
        self.run_until(&Arc::new(AtomicBool::new(false)))
    }

    fn run_until(&self, stop: &Arc<AtomicBool>) -> Result<Ending, ExperimentError> {
        fs::create_dir_all(self.data()).unwrap();
        let settings = Settings {
            experiment: Some(serde_json::from_value(self.experiment.clone()).unwrap()),
            validity: without_suspicion(),
            ..Settings::default()
        };
        assert_eq!(settings.problems(), []);
        let request = Request {
            environment: "e-1".to_owned(),
            data: self.data(),
            work: Some(self.folder.path().join("work")),
            windows: self.windows.clone(),
            settings,
        };
        experiments::of(&request.settings).run(&request, &Reporter::start(None), stop)
    }

    fn text(&self, path: &str) -> String {
        String::from_utf8_lossy(&fs::read(self.folder.path().join(path)).unwrap()).into_owned()
    }

    fn record(&self, window: u32) -> WindowRecord {
        let text = self.text(&format!("data/window-{window}/window.json"));
        let record: WindowRecord = serde_json::from_str(&text).unwrap();
        record.check().unwrap();
        record
    }

    /// The record of the one window, once all has been run.
    fn only(&self) -> WindowRecord {
        assert_eq!(self.run().unwrap(), Ending::Finished);
        self.record(1)
    }
}

/// Other tests run beside these.
fn without_suspicion() -> ValiditySettings {
    let mut limits = serde_json::to_value(ValiditySettings::default()).unwrap();
    for rule in limits.as_object_mut().unwrap().values_mut() {
        rule["suspect"] = json!("never");
    }
    serde_json::from_value(limits).unwrap()
}

fn command(record: &WindowRecord) -> CommandRecord {
    match &record.of {
        OfExperiment::Command { command } => command.clone(),
        OfExperiment::Loops(_) => panic!("{record:?}"),
    }
}

/// Whether the process whose number is in that file is gone.
fn is_gone(place: &Place, file: &str) -> bool {
    let stat = fs::read_to_string(format!("/proc/{}/stat", place.text(file).trim())).unwrap_or_default();
    let state = stat
        .rsplit_once(')')
        .map(|(_, fields)| fields.trim_start().to_owned());
    state.is_none_or(|state| state.starts_with('Z'))
}

#[test]
fn each_window_is_a_call_and_has_what_the_metrics_are_read_from() {
    let mut place =
        Place::new("echo x >$1/m.csv; echo $2 >>$1/m.csv; echo more >$1/other; echo seed $3; pwd >&2");
    place.windows = vec![3, 4];
    assert_eq!(place.run().unwrap(), Ending::Finished);
    let record = place.record(4);
    assert_eq!(
        (record.verdict, record.starts_run, record.complete),
        (Verdict::Valid, false, true)
    );
    assert!(place.record(3).starts_run && record.started_ns >= place.record(3).ended_ns);
    assert_eq!(command(&record).exit_code, Some(0));
    let files: Vec<&str> = record.files.iter().map(|file| file.name.as_str()).collect();
    assert_eq!(files, ["m.csv", "stderr.txt", "stdout.txt"]);
    assert_eq!(place.text("data/window-4/m.csv"), "x\n4\n");
    let seed = record::experiment::seed_of(4);
    assert_eq!(place.text("data/window-4/stdout.txt"), format!("seed {seed}\n"));
    let ran_in = fs::canonicalize(place.text("data/window-4/stderr.txt").trim()).unwrap();
    assert_eq!(
        ran_in,
        fs::canonicalize(place.folder.path().join("work/files")).unwrap()
    );
    assert!(place.text("data/environment.json").contains("\"after\""));
}

#[test]
fn what_a_command_used_is_on_record() {
    let record =
        Place::new("i=0; while [ $i -lt 100000 ]; do i=$((i+1)); done; printf 'x\\n1\\n' >$1/m.csv").only();
    let used = command(&record);
    assert!(
        used.cpu_ns > 1_000_000 && used.peak_memory_bytes > 100_000,
        "{used:?}"
    );
    assert!(record.cpu_share > 0.0);
}

#[test]
fn a_command_that_fails_makes_a_window_that_does_not_count_and_the_next_one_is_measured() {
    let mut place = Place::new(
        "printf 'x\\n1\\n' >$1/m.csv; [ $2 = 2 ] || { echo 'no converg\u{1b}[31mence' >&2; exit 3; }",
    );
    place.windows = vec![1, 2];
    assert_eq!(place.run().unwrap(), Ending::Finished);
    let failed = place.record(1);
    assert_eq!(
        (failed.verdict, command(&failed).exit_code),
        (Verdict::Invalid, Some(3))
    );
    assert_eq!(
        failed.reasons,
        [
            "the command ended with exit code 3",
            "it printed last: no converg\u{fffd}[31mence"
        ]
    );
    assert_eq!(place.record(2).verdict, Verdict::Valid);
}

#[rstest::rstest]
#[case::nothing("true", "the command wrote no `m.csv`")]
#[case::empty(": >$1/m.csv", "m.csv: line 1 names no column `x`; it names none")]
#[case::no_number(
    "printf 'x\\n1\\nfast\\n' >$1/m.csv",
    "m.csv: line 3, column 1: `fast` is not a finite number"
)]
#[case::link("ln -s /etc/passwd $1/m.csv", "`m.csv` is a link and no file")]
#[case::fifo("mkfifo $1/m.csv", "`m.csv` is no regular file")]
#[case::folder("mkdir $1/m.csv", "`m.csv` is no regular file")]
#[case::no_folder("rm -r $1", "the command wrote no `m.csv`")]
#[case::linked_folder(
    "rm -r $1; ln -s /etc $1",
    "`m.csv` cannot be read: Not a directory (os error 20)"
)]
fn what_cannot_be_a_metric_is_said_and_does_not_count(#[case] script: &str, #[case] reason: &str) {
    let record = Place::new(script).only();
    assert_eq!(
        (record.verdict, record.reasons),
        (Verdict::Invalid, vec![reason.to_owned()])
    );
}

#[test]
fn what_is_compared_byte_for_byte_need_be_no_number_but_something() {
    let metrics = json!([{"name": "s", "from": "state", "compare": "identical"}]);
    let record = Place::new("printf '\\000\\377' >$1/state")
        .with("metrics", metrics.clone())
        .only();
    assert_eq!(record.verdict, Verdict::Valid);
    let record = Place::new(": >$1/state").with("metrics", metrics).only();
    assert_eq!(record.reasons, ["`state` is empty"]);
}

#[test]
fn what_a_command_leaves_behind_ends_with_its_window_whatever_it_did_to_get_away() {
    let place = Place::new(
        "setsid sh -c 'trap \"\" TERM HUP INT; echo $$ >left; while :; do sleep 1; done' & \
         while [ ! -s left ]; do sleep 0.01; done; printf 'x\\n1\\n' >$1/m.csv",
    );
    let record = place.only();
    assert_eq!(record.verdict, Verdict::Valid);
    assert!(command(&record).left_behind >= 1);
    assert!(is_gone(&place, "work/files/left"));
}

#[test]
fn processes_that_start_others_without_end_leave_nothing() {
    let place = Place::new(
        "for i in 1 2 3 4 5 6 7 8; do (sleep 1000 & sleep 1000) & done; printf 'x\\n1\\n' >$1/m.csv",
    );
    let record = place.only();
    assert!(command(&record).left_behind >= 8, "{record:?}");
}

#[test]
fn what_a_command_left_behind_and_has_ended_is_waited_for_while_the_command_goes_on() {
    // `ended` counts the children of the workload that have ended and nobody has waited for.
    let place = Place::new(
        "ended() { cat /proc/$PPID/task/$PPID/children | tr ' ' '\n' | \
           while read pid; do grep -s '^State:.Z' /proc/$pid/status; done | wc -l; }
         for i in 1 2 3 4 5; do (sh -c : &); done
         looks=0; most=0
         while now=$(ended); [ $now -gt $most ] && most=$now; [ $most -lt 1 -o $now -gt 0 ] && [ $looks -lt 100 ]; do
           looks=$((looks + 1)); sleep 0.1; done
         printf 'x\n%s\n' $now >$1/m.csv; printf $most >most",
    );
    let record = place.only();
    assert_eq!(record.verdict, Verdict::Valid);
    assert_eq!(command(&record).left_behind, 0);
    assert_eq!(place.text("data/window-1/m.csv"), "x\n0\n");
    assert_ne!(place.text("work/files/most"), "0", "the command saw some");
}

#[test]
fn what_was_there_before_the_command_stays() {
    let place = Place::new("printf 'x\\n1\\n' >$1/m.csv");
    let mut daemon = Command::new("sleep").arg("1000").spawn().unwrap();
    place.only();
    assert!(
        daemon.try_wait().unwrap().is_none(),
        "an entry point's daemon goes on"
    );
    daemon.kill().unwrap();
    daemon.wait().unwrap();
}

#[test]
fn a_command_that_takes_too_long_is_ended_though_it_ignores_to_be_asked() {
    let place = Place::new("echo $$ >own; trap '' TERM; echo begun; while :; do sleep 0.1; done")
        .with("window", json!({"timeout": "300ms"}));
    let record = place.only();
    assert_eq!(
        (record.verdict, command(&record).exit_code),
        (Verdict::Invalid, None)
    );
    assert_eq!(
        record.reasons,
        [
            "the command was ended since it took longer than 0.3 s",
            "it printed last: begun"
        ]
    );
    assert!(record.complete && is_gone(&place, "work/files/own"));
}

#[test]
fn a_run_that_is_to_stop_ends_its_command_and_marks_the_window_cut() {
    let mut place = Place::new("echo $$ >own; sleep 1000");
    place.windows = vec![1, 2];
    let stop = Arc::new(AtomicBool::new(false));
    let begun = Instant::now();
    let own = place.folder.path().join("work/files/own");
    let watcher = thread::spawn({
        let stop = Arc::clone(&stop);
        move || {
            while !own.exists() && begun.elapsed() < Duration::from_secs(60) {
                thread::yield_now();
            }
            stop.store(true, Ordering::Relaxed);
        }
    });
    assert_eq!(place.run_until(&stop).unwrap(), Ending::Stopped { window: 1 });
    watcher.join().unwrap();
    assert!(!place.record(1).complete && is_gone(&place, "work/files/own"));
    assert!(!place.data().join("window-2").exists());
}

#[test]
fn a_command_that_crashes_spoils_its_window_and_is_not_tried_until_it_does_not() {
    let record = Place::new("ulimit -c 0; echo oops; kill -SEGV $$").only();
    assert_eq!(record.verdict, Verdict::Invalid);
    assert_eq!(
        record.reasons,
        ["the command crashed with signal 11", "it printed last: oops"]
    );
}

#[test]
fn a_command_that_is_killed_is_the_platforms_and_its_window_is_not_there() {
    let place = Place::new("echo out of luck; kill -KILL $$");
    let error = place.run().unwrap_err();
    assert!(error.is_of_platform());
    assert_eq!(
        error.to_string(),
        "the command of window 1 was killed by signal 9; it printed last: out of luck"
    );
    assert!(!place.data().join("window-1/window.json").exists());
    assert_eq!(place.text("data/window-1/stdout.txt"), "out of luck\n");
}

#[test]
fn a_program_that_is_not_there_is_told_with_what_to_do() {
    let place = Place::new("").with("run", json!(["no-such-program"]));
    let error = place.run().unwrap_err();
    assert_eq!(error.to_string(), "`no-such-program` cannot be started");
    assert!(error.is_of_platform() && error.hint().unwrap().contains("`prepare:`"));
}

#[test]
fn what_a_command_prints_without_end_is_bounded() {
    let place = Place::new("head -c 20000000 /dev/zero; printf 'x\\n1\\n' >$1/m.csv");
    let record = place.only();
    assert_eq!(command(&record).stdout_bytes, 20_000_000);
    assert!(
        fs::metadata(place.data().join("window-1/stdout.txt"))
            .unwrap()
            .len()
            < (1 << 20) + 100
    );
}

#[test]
fn what_comes_before_the_windows_is_done_once_and_its_output_is_kept() {
    let mut place = Place::new("cat made >$1/m.csv").with(
        "prepare",
        json!([
            "/bin/sh",
            "-c",
            "echo preparing; printf 'x\\n1\\n' >made; [ ! -e twice ] && : >twice"
        ]),
    );
    place.windows = vec![1, 2];
    assert_eq!(place.run().unwrap(), Ending::Finished);
    assert_eq!(place.record(2).verdict, Verdict::Valid);
    assert_eq!(place.text("data/prepare/stdout.txt"), "preparing\n");
}

#[test]
fn where_it_fails_nothing_is_measured_and_the_platform_is_named() {
    let place = Place::new("true").with(
        "prepare",
        json!(["/bin/sh", "-c", "echo no compiler >&2; exit 2"]),
    );
    let error = place.run().unwrap_err();
    assert!(error.is_of_platform());
    assert_eq!(
        error.to_string(),
        "the command `prepare` ended with exit code 2; it printed last: no compiler"
    );
    assert!(!place.data().join("window-1").exists());
}

impl Place {
    /// A shell script as a command that lasts for all windows, of 300 ms each.
    fn continuous(script: &str, windows: Vec<u32>) -> Self {
        let mut place = Self::new(script).with("window", json!({"continuous": true, "length": "300ms"}));
        place.experiment["run"] = json!([
            "/bin/sh",
            "-c",
            place.experiment["run"][2],
            "sh",
            "{window.folder}",
            "{window.seed}"
        ]);
        place.windows = windows;
        place
    }

    fn values(&self, window: u32) -> Vec<u32> {
        let text = self.text(&format!("data/window-{window}/m.csv"));
        text.lines().skip(1).map(|line| line.parse().unwrap()).collect()
    }
}

#[test]
fn a_continuous_command_is_cut_into_windows_and_asked_to_end_after_the_last() {
    let place = Place::continuous(
        "trap 'echo asked; exit 0' TERM; echo x >$1/m.csv; i=0; while :; do i=$((i+1)); echo $i >>$1/m.csv; sleep 0.02; done",
        vec![2, 3, 4],
    );
    assert_eq!(place.run().unwrap(), Ending::Finished);
    let all: Vec<u32> = [2, 3, 4]
        .into_iter()
        .flat_map(|window| place.values(window))
        .collect();
    // One after the other, each once: nothing is lost between two windows.
    assert!(all.iter().copied().eq(1..=all.len() as u32), "{all:?}");
    for window in [2, 3, 4] {
        let record = place.record(window);
        assert_eq!(
            (record.verdict, record.starts_run),
            (Verdict::Valid, window == 2),
            "{record:?}"
        );
        assert!(place.values(window).len() > 3, "{:?}", place.values(window));
        let took_ms = (record.ended_ns - record.started_ns) / 1_000_000;
        assert!((295..600).contains(&took_ms), "{took_ms} ms");
        assert_eq!(command(&record).exit_code, None);
        assert!(command(&record).peak_memory_bytes > 100_000);
    }
    assert_eq!(place.text("data/window-4/stdout.txt"), "asked\n");
    assert!(!place.data().join("window-2/stdout.txt").exists());
}

#[test]
fn a_continuous_command_that_ends_spoils_its_window_and_is_started_again_for_the_next() {
    let place = Place::continuous(
        "printf 'x\\n1\\n' >$1/m.csv; [ -e ../twice ] || { touch ../twice; echo bye; exit 4; }; sleep 1000",
        vec![1, 2, 3],
    );
    assert_eq!(place.run().unwrap(), Ending::Finished);
    let failed = place.record(1);
    assert_eq!(
        failed.reasons,
        ["the command ended with exit code 4", "it printed last: bye"]
    );
    assert_eq!(place.record(2).verdict, Verdict::Valid);
    // Of a window in which nothing was added nothing can be said.
    assert_eq!(place.record(3).reasons, ["m.csv has no value"]);
}

#[test]
fn a_continuous_command_that_ends_well_has_ended_too_early() {
    let place = Place::continuous("printf 'x\\n1\\n2' >$1/m.csv", vec![1]);
    let record = place.only();
    assert_eq!(
        record.reasons,
        ["the command ended with exit code 0 before its windows were over"]
    );
    // All of its rows are there.
    assert_eq!(place.values(1), [1, 2]);
}

#[test]
fn nothing_is_left_of_a_continuous_command_that_does_not_end_when_it_is_asked_to() {
    let place = Place::continuous(
        "echo $$ >$1/../pid; trap '' TERM; printf 'x\\n1\\n' >$1/m.csv; sleep 1000 & while :; do wait; done",
        vec![1],
    );
    let record = place.only();
    assert_eq!(record.verdict, Verdict::Valid, "{record:?}");
    assert!(command(&record).left_behind >= 1);
    assert!(is_gone(&place, "work/pid"));
}

#[test]
fn a_continuous_command_that_fails_fast_is_ended_with_its_scenario() {
    let place =
        Place::continuous("echo $$ >$1/../pid; sleep 1000", vec![1, 2]).with("fail_fast", json!(true));
    let error = place.run().unwrap_err();
    assert!(
        error.to_string().contains("`fail_fast` ends the scenario"),
        "{error}"
    );
    assert!(is_gone(&place, "work/pid"));
}
