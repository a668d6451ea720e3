use std::{
    fs,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64},
    },
};

use rstest::rstest;
use rtrb::{Producer, RingBuffer};
use sha2::{Digest, Sha256};
use tempfile::TempDir;

use super::*;
use crate::{
    network::NetworkError,
    record::window::{LinkRecord, Verdict, WindowRecord},
    settings::{Limit, ValiditySettings},
};

const STEPS: u64 = 10;
const STEP_NS: i64 = 20 * MILLISECOND_NS;

/// No hosts and no links; it may have broken down.
struct Unlinked {
    broken: bool,
}

impl Network for Unlinked {
    fn enter(&self, _: VirtualHost) -> Result<(), NetworkError> {
        Ok(())
    }

    fn interface(&self, host: VirtualHost) -> String {
        host.interface()
    }

    fn impair(&self) -> Result<(), NetworkError> {
        Ok(())
    }

    fn links(&self) -> Vec<LinkRecord> {
        Vec::new()
    }

    fn seed(&self) -> Option<u64> {
        None
    }

    fn failure(&self) -> Option<NetworkError> {
        self.broken.then_some(NetworkError::Carrying {
            action: "waiting for packets",
            source: nix::errno::Errno::EIO,
        })
    }
}

/// Limits that leave out what the machine that runs the tests is busy with.
fn still() -> ValiditySettings {
    let mut limits = ValiditySettings::default();
    limits.other_load.suspect = Limit::Never;
    limits.memory_pressure.suspect = Limit::Never;
    limits.steal.suspect = Limit::Never;
    limits.swapped.suspect = Limit::Never;
    limits.major_faults.suspect = Limit::Never;
    limits.throttled.suspect = Limit::Never;
    limits
}

/// A run whose loops have ended already: its rows and ticks are all in the queues.
struct Recorded {
    data: TempDir,
    stop: Arc<AtomicBool>,
    outcome: Result<Ending, ExperimentError>,
}

struct Loops {
    rows: Producer<ControlRow>,
    ticks: Producer<Tick>,
    stop: Arc<AtomicBool>,
    log_dropped: Arc<AtomicU64>,
}

impl Loops {
    fn step(&mut self, step: u64) {
        let due_ns = step as i64 * STEP_NS;
        self.rows
            .push(ControlRow {
                step,
                scheduled_ns: due_ns,
                actual_ns: due_ns + 1000,
                state_seq: step,
                ..ControlRow::default()
            })
            .unwrap();
        self.ticks
            .push(Tick {
                step,
                due_ns,
                began_ns: due_ns + 500,
            })
            .unwrap();
    }

    fn steps(&mut self, steps: std::ops::Range<u64>) {
        steps.for_each(|step| self.step(step));
    }
}

fn record(windows: &[u32], network: &Unlinked, loops_do: impl FnOnce(&mut Loops)) -> Recorded {
    let data = tempfile::tempdir().unwrap();
    let reporter = Reporter::start(Some(&data.path().join("progress.jsonl")));
    let (rows, row_source) = RingBuffer::new(100);
    let (ticks, tick_source) = RingBuffer::new(100);
    let stop = Arc::new(AtomicBool::new(false));
    let log_dropped = Arc::new(AtomicU64::new(0));
    let shared = Shared {
        zero_ns: monotonic_ns() - 10 * 1000 * MILLISECOND_NS,
        stop: stop.clone(),
        log_dropped: log_dropped.clone(),
    };
    let mut loops = Loops {
        rows,
        ticks,
        stop: stop.clone(),
        log_dropped,
    };
    loops_do(&mut loops);
    drop(loops);
    let sources = Sources {
        board: NoticeBoard::new(),
        rows: row_source,
        ticks: tick_source,
        captures: Vec::new(),
        network,
        shared,
    };
    let shape = WindowShape {
        environment: "test".into(),
        steps: STEPS,
        step_ns: STEP_NS,
        captures: 0,
        network_seed: Some(7),
        limits: still(),
    };
    let recorder = Recorder::begin(sources, shape, windows, data.path(), &reporter).unwrap();
    let outcome = recorder.run();
    Recorded { data, stop, outcome }
}

impl Recorded {
    fn window(&self, number: u32) -> WindowRecord {
        let path = self.data.path().join(format!("window-{number}/window.json"));
        serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
    }

    fn progress(&self) -> Vec<Progress> {
        let text = fs::read_to_string(self.data.path().join("progress.jsonl")).unwrap();
        text.lines()
            .map(|line| serde_json::from_str(line).unwrap())
            .collect()
    }
}

const WHOLE: Unlinked = Unlinked { broken: false };

#[test]
fn windows_are_contiguous_and_keep_their_numbers() {
    let recorded = record(&[3, 4], &WHOLE, |loops| loops.steps(0..20));
    assert_eq!(recorded.outcome.as_ref().unwrap(), &Ending::Finished);
    let (third, fourth) = (recorded.window(3), recorded.window(4));
    assert_eq!((third.started_ns, third.ended_ns), (0, 10 * STEP_NS));
    assert_eq!((fourth.started_ns, fourth.ended_ns), (10 * STEP_NS, 20 * STEP_NS));
    assert_eq!(third.ended_unix_ns, fourth.started_unix_ns);
    assert_eq!((third.starts_run, fourth.starts_run), (true, false));
    assert_eq!(
        (third.steps_done, fourth.steps_done, fourth.plant.steps),
        (10, 10, 10)
    );
    assert_eq!((third.verdict, fourth.verdict), (Verdict::Valid, Verdict::Valid));
}

#[test]
fn the_log_of_a_window_has_its_own_rows_only() {
    let recorded = record(&[1, 2], &WHOLE, |loops| loops.steps(0..20));
    let log = fs::read_to_string(recorded.data.path().join("window-2/control.csv")).unwrap();
    let mut lines = log.lines();
    assert_eq!(lines.next(), Some(ControlRow::HEADER));
    let steps: Vec<&str> = lines.map(|line| line.split(',').next().unwrap()).collect();
    assert_eq!(
        steps,
        ["10", "11", "12", "13", "14", "15", "16", "17", "18", "19"]
    );
}

#[test]
fn a_record_has_the_checksum_of_every_file_beside_it() {
    let recorded = record(&[1], &WHOLE, |loops| loops.steps(0..10));
    let [file] = recorded.window(1).files.try_into().unwrap();
    let content = fs::read(recorded.data.path().join("window-1/control.csv")).unwrap();
    assert_eq!(file.name, "control.csv");
    assert_eq!(file.bytes, content.len() as u64);
    assert_eq!(file.sha256, format!("{:x}", Sha256::digest(&content)));
}

#[test]
fn progress_says_when_measuring_began_and_which_windows_are_whole() {
    let recorded = record(&[1, 2], &WHOLE, |loops| loops.steps(0..20));
    let verdict = Verdict::Valid;
    assert_eq!(
        recorded.progress(),
        [
            Progress::Measuring { window: 1 },
            Progress::WindowComplete { window: 1, verdict },
            Progress::WindowComplete { window: 2, verdict },
        ]
    );
}

#[test]
fn a_run_that_is_stopped_leaves_a_cut_window_and_none_after_it() {
    let recorded = record(&[1, 2, 3], &WHOLE, |loops| {
        loops.steps(0..14);
        loops.stop.store(true, Ordering::Relaxed);
    });
    assert_eq!(recorded.outcome.as_ref().unwrap(), &Ending::Stopped { window: 2 });
    assert!(recorded.window(1).complete);
    let cut = recorded.window(2);
    assert_eq!(
        (cut.complete, cut.steps_done, cut.verdict),
        (false, 4, Verdict::Invalid)
    );
    assert!(!recorded.data.path().join("window-3").exists());
    assert!(
        !recorded
            .progress()
            .iter()
            .any(|line| matches!(line, Progress::WindowComplete { window: 2, .. }))
    );
}

#[rstest]
#[case::amid_a_window(&[4])]
#[case::at_its_end(&[9])]
fn rows_that_the_queue_had_no_room_for_make_their_window_invalid(#[case] lost: &[u64]) {
    let recorded = record(&[1, 2], &WHOLE, |loops| {
        (0..20)
            .filter(|step| !lost.contains(step))
            .for_each(|step| loops.step(step));
        loops.log_dropped.store(lost.len() as u64, Ordering::Relaxed);
    });
    assert_eq!(recorded.outcome.as_ref().unwrap(), &Ending::Finished);
    assert_eq!(
        (recorded.window(1).verdict, recorded.window(1).steps_done),
        (Verdict::Invalid, 9)
    );
    assert_eq!(recorded.window(2).steps_done, 10);
}

#[test]
fn a_network_that_broke_down_ends_the_run_and_stops_the_loops() {
    let recorded = record(&[1], &Unlinked { broken: true }, |loops| loops.steps(0..5));
    assert!(matches!(recorded.outcome, Err(ExperimentError::Network(_))));
    assert!(recorded.stop.load(Ordering::Relaxed));
    let cut = recorded.window(1);
    assert_eq!((cut.complete, cut.verdict), (false, Verdict::Invalid));
    assert_eq!(
        cut.reasons,
        [
            "The window was cut after 5 of 10 steps.",
            "The experiment failed: the virtual hosts' network failed: the network stopped: waiting for packets failed: \
             EIO: I/O error.",
        ]
    );
    assert_eq!(recorded.progress(), [Progress::Measuring { window: 1 }]);
}

#[test]
fn a_loop_that_dies_before_its_last_window_is_a_failure() {
    let recorded = record(&[1, 2], &WHOLE, |loops| loops.steps(0..5));
    assert!(matches!(
        recorded.outcome,
        Err(ExperimentError::ThreadEnded { .. })
    ));
    let cut = recorded.window(1);
    assert_eq!((cut.complete, cut.verdict), (false, Verdict::Invalid), "{cut:#?}");
    assert!(!recorded.data.path().join("window-2").exists());
}
