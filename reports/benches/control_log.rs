//! Loading a run of nine scenarios, a window of 6000 s each: from the logs to the errors of the periods, on one thread,
//! against the plain CSV reads of pandas and polars, which only parse; and the checksum alone, which is part of loading.
//!
//! `MATRIX_PEERS_PYTHON=$(reports/benches/prepare) cargo bench --profile dev --workspace --bench control_log`: in the profile
//! that users have. Prints medians; it is not a test and has no bound. docs/performance.md has the last figures.

#![allow(clippy::unwrap_used, clippy::print_stdout, dead_code)] // As in tests, whose run directories these are.

use std::{
    env, fs,
    hint::black_box,
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
    process::Command,
    time::Duration,
};

use record::control_log::ControlRow;
use serde_json::json;
use sha2::{Digest, Sha256};
use synthetic::{Scenario, Synthetic};
use timing::{median, time};

#[path = "../tests/reports/synthetic.rs"]
mod synthetic;
mod timing;

const SLUGS: [&str; 9] = [
    "a-a-native",
    "b-b-docker",
    "c-c-docker",
    "d-d-docker",
    "e-e-docker",
    "f-f-docker",
    "g-g-docker",
    "h-h-docker",
    "i-i-docker",
];
const STEPS: i64 = 300_000;
const STEP_NS: i64 = 20_000_000;
const ROUNDS: usize = 3;

fn main() {
    let (synthetic, logs) = run();
    let bytes: u64 = logs.iter().map(|log| log.metadata().unwrap().len()).sum();
    let gigabytes = bytes as f64 / 1e9;
    let python = env::var_os("MATRIX_PEERS_PYTHON").unwrap_or("python3".into());
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/peers/logs.py");
    let (mut ours, mut all_cores) = (Vec::new(), Vec::new());
    let (mut checksum, mut pandas, mut polars) = (Vec::new(), Vec::new(), Vec::new());
    let one_core = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let load = || reports::load(synthetic.directory.path()).unwrap().scenarios.len();
    for _ in 0..ROUNDS {
        ours.push(time(|| one_core.install(load)));
        all_cores.push(time(load));
        checksum.push(time(|| logs.iter().map(|log| hashed(log)).sum::<usize>()));
        let output = Command::new(&python).arg(&script).args(&logs).output().unwrap();
        assert!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
        let text = String::from_utf8(output.stdout).unwrap();
        let mut seconds = text
            .lines()
            .map(|line| Duration::from_secs_f64(line.parse().unwrap()));
        pandas.push(seconds.next().unwrap());
        polars.push(seconds.next().unwrap());
    }
    println!(
        "{} logs of {STEPS} steps, {gigabytes:.2} GB, medians of {ROUNDS} rounds",
        logs.len()
    );
    let ours = median(ours).as_secs_f64() / gigabytes;
    let checksum = median(checksum).as_secs_f64() / gigabytes;
    let row = |name: &str, seconds: f64| println!("{name:<40} {seconds:>6.2} s/GB {:>6.2} x", seconds / ours);
    row("load: checksum, parse, reduce", ours);
    row("of it the checksum, SHA-256", checksum);
    row("of it all else", ours - checksum);
    row(
        "the same on all cores",
        median(all_cores).as_secs_f64() / gigabytes,
    );
    row("pandas.read_csv", median(pandas).as_secs_f64() / gigabytes);
    row(
        "polars.read_csv, one thread",
        median(polars).as_secs_f64() / gigabytes,
    );
}

/// A run, and its logs.
fn run() -> (Synthetic, Vec<PathBuf>) {
    let synthetic = Synthetic::new(&SLUGS.map(|slug| Scenario::measured(slug, &[0.1])));
    let mut plan: serde_json::Value =
        serde_json::from_slice(&fs::read(synthetic.directory.plan().path()).unwrap()).unwrap();
    for scenario in plan["scenarios"].as_array_mut().unwrap() {
        let settings = scenario["settings"].as_object_mut().unwrap();
        settings.insert("windows".into(), json!(1));
        settings.insert("window".into(), json!("6000s"));
        settings.insert("period".into(), json!("100s"));
        settings.insert("rate".into(), json!("50Hz"));
    }
    synthetic.write_json(synthetic.directory.plan().path(), &plan);
    let log = log();
    let logs = SLUGS.map(|slug| {
        synthetic.write_window(slug, 1, &log);
        synthetic.directory.window(slug, 1).path().join("control.csv")
    });
    (synthetic, logs.to_vec())
}

/// Numbers as long as measured ones are.
fn log() -> String {
    let mut state = 88_172_645_463_325_252_u64;
    let mut noise = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1_u64 << 53) as f64 * 0.01
    };
    let mut log = format!("{}\n", ControlRow::HEADER).into_bytes();
    for step in 0..STEPS {
        let (due, angle) = (step * STEP_NS, step as f64 * 0.001_256);
        let (x, y) = (angle.sin() * 0.4, angle.cos() * 0.4);
        let row = ControlRow {
            step: step as u64,
            scheduled_ns: due,
            actual_ns: due + 57_123,
            done_ns: due + 98_765,
            reference_x_m: x,
            reference_y_m: y,
            state_seq: step as u64 + 1,
            state_stamp_ns: due - 30_000_123,
            state_received_ns: due - 10_000_321,
            x_m: x + noise(),
            x_rate_m_s: noise(),
            angle_x_rad: noise(),
            angle_x_rate_rad_s: noise(),
            y_m: y + noise(),
            y_rate_m_s: noise(),
            angle_y_rad: noise(),
            angle_y_rate_rad_s: noise(),
            command_x_v: noise(),
            command_y_v: noise(),
        };
        row.write_to(&mut log).unwrap();
    }
    String::from_utf8(log).unwrap()
}

/// As much at a time as our reading takes.
fn hashed(path: &Path) -> usize {
    let mut hasher = Sha256::new();
    let mut reader = BufReader::with_capacity(1 << 17, fs::File::open(path).unwrap());
    loop {
        let block = reader.fill_buf().unwrap();
        if block.is_empty() {
            return black_box(hasher.finalize()).len();
        }
        hasher.update(block);
        let read = block.len();
        reader.consume(read);
    }
}
