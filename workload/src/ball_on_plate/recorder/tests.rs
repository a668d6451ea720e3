use std::{
    fs,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64},
    },
};

use record::{
    settings::{Dynamics, LateTicks, Limit, Settings, ValiditySettings},
    topology::Topology,
    window::{LinkRecord, Verdict, WindowRecord},
};
use rstest::rstest;
use rtrb::{Producer, RingBuffer};
use sha2::{Digest, Sha256};
use tempfile::TempDir;

use super::*;
use crate::network::{Namespaces, NetworkError};

const STEPS: u64 = 10;
const STEP_NS: i64 = 20 * MILLISECOND_NS;

const NOBODY: Topology = Topology {
    hosts: Vec::new(),
    switches: Vec::new(),
};

/// No hosts and no links; it may have broken down.
struct Unlinked {
    namespaces: Namespaces,
    topology: Topology,
    broken: bool,
}

impl Network for Unlinked {
    fn namespaces(&self) -> &Namespaces {
        &self.namespaces
    }

    fn topology(&self) -> &Topology {
        &self.topology
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
fn still(late_ticks: LateTicks) -> ValiditySettings {
    let mut limits = ValiditySettings::default();
    limits.other_load.suspect = Limit::Never;
    limits.memory_pressure.suspect = Limit::Never;
    limits.steal.suspect = Limit::Never;
    limits.swapped.suspect = Limit::Never;
    limits.major_faults.suspect = Limit::Never;
    limits.throttled.suspect = Limit::Never;
    if late_ticks == LateTicks::Lost {
        let lost = Settings::of(Dynamics::Author).validity;
        limits.missed_deadlines = lost.missed_deadlines;
        limits.lateness = lost.lateness;
    }
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
    plant_rows: Producer<PlantRow>,
    stop: Arc<AtomicBool>,
    log_dropped: Arc<AtomicU64>,
}

impl Loops {
    fn step(&mut self, step: u64) {
        self.merged(step, step);
    }

    /// Of the ticks from `first` to `step` both loops did the last one.
    fn merged(&mut self, first: u64, step: u64) {
        let (scheduled_ns, now_ns) = (first as i64 * STEP_NS, step as i64 * STEP_NS);
        self.rows
            .push(ControlRow {
                step,
                scheduled_ns,
                actual_ns: now_ns + 1000,
                state_seq: step,
                ..ControlRow::default()
            })
            .unwrap();
        self.plant_rows
            .push(PlantRow {
                step,
                scheduled_ns,
                actual_ns: now_ns + 500,
                ..PlantRow::default()
            })
            .unwrap();
    }

    fn steps(&mut self, steps: std::ops::Range<u64>) {
        steps.for_each(|step| self.step(step));
    }
}

fn record(windows: &[u32], network: &Unlinked, loops_do: impl FnOnce(&mut Loops)) -> Recorded {
    record_ticks(LateTicks::CaughtUp, windows, network, loops_do)
}

fn record_ticks(
    late_ticks: LateTicks,
    windows: &[u32],
    network: &Unlinked,
    loops_do: impl FnOnce(&mut Loops),
) -> Recorded {
    let data = tempfile::tempdir().unwrap();
    let reporter = Reporter::start(Some(&data.path().join("progress.jsonl")));
    let (rows, row_source) = RingBuffer::new(100);
    let (plant_rows, plant_source) = RingBuffer::new(100);
    let stop = Arc::new(AtomicBool::new(false));
    let log_dropped = Arc::new(AtomicU64::new(0));
    let shared = Shared {
        zero_ns: monotonic_ns() - 10 * 1000 * MILLISECOND_NS,
        stop: stop.clone(),
        log_dropped: log_dropped.clone(),
    };
    let mut loops = Loops {
        rows,
        plant_rows,
        stop: stop.clone(),
        log_dropped,
    };
    loops_do(&mut loops);
    drop(loops);
    let sources = Sources {
        board: NoticeQueue::on(VirtualHost::OF_THE_BALL),
        rows: row_source,
        plant_rows: plant_source,
        processes: Vec::new(),
        captures: Vec::new(),
        network,
        shared,
    };
    let shape = WindowShape {
        environment: "test".into(),
        steps: STEPS,
        steps_per_period: STEPS,
        step_ns: STEP_NS,
        phase_ns: 0,
        late_ticks,
        captures: 0,
        network_seed: Some(7),
        limits: still(late_ticks),
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

const WHOLE: Unlinked = Unlinked {
    namespaces: Namespaces::NONE,
    topology: NOBODY,
    broken: false,
};

#[test]
fn lost_ticks_are_no_fault_of_a_window_also_where_they_are_its_last_and_first() {
    let recorded = record_ticks(LateTicks::Lost, &[1, 2], &WHOLE, |loops| {
        loops.steps(0..3);
        loops.merged(3, 5);
        loops.steps(6..8);
        // The last two of window 1 and the first two of window 2 were due while something took its time.
        loops.merged(8, 12);
        loops.steps(13..20);
    });
    assert_eq!(recorded.outcome.as_ref().unwrap(), &Ending::Finished);
    let (one, two) = (recorded.window(1), recorded.window(2));
    assert_eq!((one.verdict, &one.reasons), (Verdict::Valid, &Vec::new()));
    assert_eq!(
        (
            one.loops().unwrap().steps_done,
            one.loops().unwrap().controller.lost_ticks,
            one.loops().unwrap().plant.lost_ticks
        ),
        (6, 4, 4)
    );
    assert_eq!((two.verdict, &two.reasons), (Verdict::Valid, &Vec::new()));
    assert_eq!(
        (
            two.loops().unwrap().steps_done,
            two.loops().unwrap().controller.lost_ticks,
            two.loops().unwrap().plant.lost_ticks
        ),
        (8, 2, 2)
    );
}

#[test]
fn a_row_of_which_nobody_says_that_its_tick_was_lost_is_missing() {
    let recorded = record_ticks(LateTicks::Lost, &[1], &WHOLE, |loops| {
        loops.steps(0..3);
        loops.steps(4..10);
    });
    let window = recorded.window(1);
    assert_eq!(window.verdict, Verdict::Invalid);
    assert!(
        window.reasons[0].contains("The log has 9 steps, not 10"),
        "{:?}",
        window.reasons
    );
}

#[test]
fn the_plants_log_is_beside_the_controllers() {
    let recorded = record(&[1], &WHOLE, |loops| loops.steps(0..10));
    let files: Vec<_> = recorded
        .window(1)
        .files
        .into_iter()
        .map(|file| file.name)
        .collect();
    assert_eq!(files, ["control.csv", "plant.csv"]);
    let log = fs::read_to_string(recorded.data.path().join("window-1/plant.csv")).unwrap();
    assert_eq!(log.lines().count(), 11);
}

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
        (
            third.loops().unwrap().steps_done,
            fourth.loops().unwrap().steps_done,
            fourth.loops().unwrap().plant.steps
        ),
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
    let files = recorded.window(1).files;
    assert_eq!(files.len(), 2);
    for file in files {
        let content = fs::read(recorded.data.path().join("window-1").join(&file.name)).unwrap();
        assert_eq!(file.bytes, content.len() as u64);
        assert_eq!(file.sha256, format!("{:x}", Sha256::digest(&content)));
    }
}

#[test]
fn progress_says_when_measuring_began_and_which_windows_are_whole() {
    let recorded = record(&[1, 2], &WHOLE, |loops| loops.steps(0..20));
    let verdict = Verdict::Valid;
    assert_eq!(
        recorded.progress(),
        [
            Progress::Measuring { window: 1 },
            Progress::WindowComplete {
                window: 1,
                verdict,
                reason: None,
            },
            Progress::WindowComplete {
                window: 2,
                verdict,
                reason: None,
            },
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
        (cut.complete, cut.loops().unwrap().steps_done, cut.verdict),
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
        (
            recorded.window(1).verdict,
            recorded.window(1).loops().unwrap().steps_done
        ),
        (Verdict::Invalid, 9)
    );
    assert_eq!(recorded.window(2).loops().unwrap().steps_done, 10);
}

#[test]
fn a_network_that_broke_down_ends_the_run_and_stops_the_loops() {
    let recorded = record(
        &[1],
        &Unlinked {
            namespaces: Namespaces::NONE,
            topology: NOBODY,
            broken: true,
        },
        |loops| loops.steps(0..5),
    );
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
