//! Logs, captures and records, a file alone.

use std::{fs, io::Cursor, path::PathBuf};

use captures::packets::{CaptureFile, CaptureReadError, Segment};
use record::{
    run_directory::{
        ControlTrace, EnvironmentRecord, Expected, FORMAT, Journal, Manifest, Place, PlanRecord, ReadError,
        read_record,
    },
    settings::{Dynamics, Messages, Settings, SimulationSettings},
    window::{FileRecord, WindowRecord},
};
use sha2::{Digest, Sha256};
use simulation::{
    closed_loop::{Platform, Simulation},
    message::{CommandMessage, StateMessage},
};

/// Reads the bytes as a control log that is as it was measured, with as many steps as it has lines.
pub fn control_log(bytes: &[u8]) {
    let place = written("control.csv", bytes);
    let record = FileRecord {
        name: "control.csv".to_owned(),
        bytes: bytes.len() as u64,
        sha256: Sha256::digest(bytes)
            .iter()
            .map(|byte| format!("{byte:02x}"))
            .collect(),
        measured: None,
    };
    let lines = bytes.split(|byte| *byte == b'\n');
    let steps = lines
        .filter(|line| !matches!(line, [] | [b'\r']))
        .count()
        .saturating_sub(1) as u64;
    for steps_per_period in [1, 10] {
        let expected = Expected {
            lost: 0,
            first_step: None,
            steps,
            steps_per_period,
            file: &record,
        };
        match ControlTrace::read(&place, expected, None) {
            Ok(trace) => {
                assert_eq!(trace.periods.len() as u64, steps / steps_per_period);
                assert!(
                    trace
                        .periods
                        .iter()
                        .all(|period| period.mean_square_m2.is_finite())
                );
                assert!(
                    bytes.is_empty() || bytes.ends_with(b"\n"),
                    "a cut last line was taken"
                );
            }
            Err(error) => assert!(!error.to_string().is_empty() && !error.hint().is_empty()),
        }
    }
}

/// Reads the bytes as a platform's file, and simulates a second on the platform.
pub fn platform(bytes: &[u8]) {
    let Some(platform) = orchestrator::fuzzing::platform(bytes) else {
        return;
    };
    for dynamics in Dynamics::ALL {
        let simulation = Some(SimulationSettings {
            platform: platform.clone(),
            ..SimulationSettings::default()
        });
        let settings = Settings {
            simulation,
            ..Settings::of(dynamics)
        };
        assert_eq!(settings.problems(), Vec::new());
        let mut last = i64::MIN;
        for step in Simulation::new(&settings, &Platform::of(&settings), 1).take(50) {
            assert!(step.row.actual_ns >= last, "time goes back");
            assert!(step.true_position_m.iter().all(|metres| metres.is_finite()));
            last = step.row.actual_ns;
        }
    }
}

/// Reads the bytes as a capture, plain and compressed, and every packet as a segment.
pub fn capture(bytes: &[u8]) {
    let opened = CaptureFile::from_source(PathBuf::from("h1.pcap"), Box::new(Cursor::new(bytes.to_vec())));
    packets_of(opened);
    let compressed = written("h1.pcap.zst", bytes);
    packets_of(CaptureFile::open(&compressed));
}

fn packets_of(opened: Result<CaptureFile, CaptureReadError>) {
    let mut capture = match opened {
        Ok(capture) => capture,
        Err(error) => return assert!(!error.to_string().is_empty() && !error.hint().is_empty()),
    };
    // What unpacks to more than that says nothing new.
    for _ in 0..10_000 {
        match capture.advance() {
            Ok(true) => {
                let segment = capture.packet().and_then(|packet| Segment::parse(&packet));
                assert!(
                    segment.is_none_or(|segment| segment.payload.len() <= segment.payload_bytes as usize)
                );
            }
            Ok(false) => break,
            Err(error) => return assert!(!error.to_string().is_empty()),
        }
    }
}

/// Reads the bytes as a state and as a command of each kind, in the wrapping of a `std_msgs/String` too.
pub fn messages(bytes: &[u8]) {
    let length = u32::try_from(bytes.len()).unwrap_or_default().to_le_bytes();
    for message in [bytes, &[&length[..], bytes].concat()] {
        for kind in [Messages::Text, Messages::Positions, Messages::Rates] {
            if let Some(state) = StateMessage::decode(kind, message) {
                assert!(state.to_values().iter().all(|value| value.is_finite()));
            }
            if let Some(command) = CommandMessage::decode(kind, message) {
                assert!(command.to_values().iter().all(|value| value.is_finite()));
            }
        }
    }
}

/// Reads the bytes as each of the files of a run directory.
pub fn run_directory(bytes: &[u8]) {
    let place = written("record.json", bytes);
    told(Journal::read(&place));
    told(read_record::<Manifest>(&place, FORMAT));
    told(read_record::<PlanRecord>(&place, FORMAT));
    told(read_record::<EnvironmentRecord>(&place, FORMAT));
    told(read_record::<WindowRecord>(&place, record::FORMAT));
}

fn told<T>(read: Result<T, ReadError>) {
    if let Err(error) = read {
        assert!(!error.to_string().is_empty() && !error.hint().is_empty());
    }
}

/// A file with these bytes, in memory where there is such a folder.
fn written(name: &str, bytes: &[u8]) -> Place {
    let memory = PathBuf::from("/dev/shm");
    let folder = if memory.is_dir() {
        memory
    } else {
        std::env::temp_dir()
    };
    let place = Place::root(folder).join(format!("matrix-fuzz-{}-{name}", std::process::id()));
    fs::write(place.path(), bytes).expect("there is room");
    place
}
