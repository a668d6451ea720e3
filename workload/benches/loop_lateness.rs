//! The control loop's lateness against `cyclictest` (Debian's rt-tests) at the same scheduling and interval, in turn, in
//! one run: `cargo bench -p workload --bench loop_lateness`, as root. Prints percentiles and their ratios; it is not a
//! test and has no bound.
//!
//! It does so for `robust` at its real-time priority, and for `author` at ordinary scheduling. Each round measures three
//! things for the same time: the controller of a real window, with its network, captures and log; `cyclictest` alone; and
//! `cyclictest` while such a window is measured, which shows what the rest of the workload does to a thread of this
//! scheduling. With `LOAD=1` every processor is kept busy meanwhile by an ordinary thread. `ROUNDS` and `SECONDS` change the
//! rest.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

use std::{
    env, fs,
    path::Path,
    process::{Child, Command, Stdio},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle},
};

use record::{platform::PlatformRecord, window::WindowRecord};

/// The histogram of cyclictest goes that far; it says how many were beyond.
const LONGEST_US: usize = 100_000;

/// What is compared.
const CASES: [Case; 2] = [
    Case {
        dynamics: "robust",
        priority: 80,
        rate_hz: 250,
        cyclictest: &["--mlockall", "--policy=fifo", "--priority=80"],
    },
    Case {
        dynamics: "author",
        priority: 0,
        rate_hz: 50,
        cyclictest: &["--policy=other", "--priority=0"],
    },
];

fn main() {
    let plan = Plan {
        rounds: setting("ROUNDS", 6),
        seconds: setting("SECONDS", 20),
    };
    let load = Load::start(setting("LOAD", 0) > 0);
    CASES.iter().for_each(|case| plan.compare(case));
    drop(load);
}

fn setting(name: &str, default: u64) -> u64 {
    env::var(name).map_or(default, |text| {
        text.parse()
            .unwrap_or_else(|_| panic!("{name} is `{text}`: write a whole number"))
    })
}

/// Dynamics, and `cyclictest` as its controller is scheduled.
struct Case {
    dynamics: &'static str,
    /// Real-time priority of the loop; 0 for none.
    priority: u8,
    rate_hz: u64,
    cyclictest: &'static [&'static str],
}

/// How long and how often.
struct Plan {
    rounds: u64,
    seconds: u64,
}

impl Plan {
    fn compare(&self, case: &Case) {
        let (mut own, mut alone, mut beside) = (Samples::default(), Samples::default(), Samples::default());
        let mut stolen = Vec::new();
        for _ in 0..self.rounds {
            let (lateness, share) = self.window(case);
            own.extend(lateness);
            stolen.extend(share);
            alone.extend(self.cyclictest(case));
            let window = self.start_window(case);
            beside.extend(self.cyclictest(case));
            finish(window.0);
        }
        println!(
            "{}: {} rounds of {} s at {} Hz, {}, {} processors, steal {:.2} %",
            case.dynamics,
            self.rounds,
            self.seconds,
            case.rate_hz,
            case.scheduling(),
            thread::available_parallelism().map_or(0, usize::from),
            stolen.iter().sum::<f64>() * 100.0 / stolen.len().max(1) as f64,
        );
        println!(
            "{:30} {:>8} {:>8} {:>8} {:>8} {:>8}",
            "us", "steps", "p50", "p99", "p99.9", "max"
        );
        own.print("control loop");
        alone.print("cyclictest alone");
        beside.print("cyclictest beside a window");
        for (name, other) in [("alone ", &alone), ("beside", &beside)] {
            println!(
                "control loop / cyclictest {name} at p99.9: {:.2}",
                own.at(0.999) / other.at(0.999)
            );
        }
    }

    /// How late the controller's steps of one window began, in nanoseconds, and the steal meanwhile.
    fn window(&self, case: &Case) -> (Vec<i64>, Option<f64>) {
        let (window, data) = self.start_window(case);
        finish(window);
        let platform: PlatformRecord = read_json(&data.path().join("environment.json"));
        assert_eq!(
            platform.realtime.priority_granted, case.priority,
            "without its priority the loop cannot be compared: run as root; {:?}",
            platform.realtime.priority_refusal
        );
        let folder = data.path().join("window-1");
        let record: WindowRecord = read_json(&folder.join("window.json"));
        (
            lateness_ns(&folder.join("control.csv")),
            record.conditions.steal_share,
        )
    }

    /// A window that ends after the measuring time, and its folder.
    fn start_window(&self, case: &Case) -> (Child, tempfile::TempDir) {
        let data = tempfile::tempdir().unwrap();
        let settings = format!(
            r#"{{"dynamics":"{0}","window":"{1}s","period":"{1}s","rate":"{2}Hz","control":{{"phase":"1ms"}}}}"#,
            case.dynamics, self.seconds, case.rate_hz
        );
        let child = Command::new(env!("CARGO_BIN_EXE_workload"))
            .args([
                "run",
                "--environment",
                "bench",
                "--windows",
                "1",
                "--settings",
                &settings,
                "--data",
            ])
            .arg(data.path())
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        (child, data)
    }

    /// What cyclictest measures in the same time, in nanoseconds.
    fn cyclictest(&self, case: &Case) -> Vec<i64> {
        let output = Command::new("cyclictest")
            .args(["--quiet", "--threads=1"])
            .args(case.cyclictest)
            .arg(format!("--interval={}", 1_000_000 / case.rate_hz))
            .arg(format!("--loops={}", self.seconds * case.rate_hz))
            .arg(format!("--histogram={LONGEST_US}"))
            .output()
            .expect("cyclictest is needed: `apt-get install rt-tests`");
        assert!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
        histogram(&String::from_utf8_lossy(&output.stdout))
    }
}

impl Case {
    fn scheduling(&self) -> String {
        match self.priority {
            0 => "SCHED_OTHER".to_owned(),
            priority => format!("SCHED_FIFO {priority}"),
        }
    }
}

fn finish(mut window: Child) {
    let status = window.wait().unwrap();
    assert!(status.success(), "the workload failed: {status}");
}

fn read_json<T: serde::de::DeserializeOwned>(path: &Path) -> T {
    serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}

/// Without the steps that were due while an earlier one had not begun: the loop catches up on them and cyclictest skips
/// them, so that one interruption counts once for both.
fn lateness_ns(log: &Path) -> Vec<i64> {
    let text = fs::read_to_string(log).unwrap();
    let mut lines = text.lines();
    let columns: Vec<&str> = lines.next().unwrap().split(',').collect();
    let place = |name: &str| columns.iter().position(|column| *column == name).unwrap();
    let (scheduled, actual) = (place("scheduled_ns"), place("actual_ns"));
    let mut began_ns = i64::MIN;
    let rows = lines.filter_map(|line| {
        let fields: Vec<&str> = line.split(',').collect();
        let [due_ns, actual_ns] = [scheduled, actual].map(|column| fields[column].parse::<i64>().unwrap());
        if due_ns <= began_ns {
            return None;
        }
        began_ns = actual_ns;
        Some(actual_ns - due_ns)
    });
    rows.collect()
}

/// Lines of `microseconds count`; those beyond are put at the largest that there was.
fn histogram(text: &str) -> Vec<i64> {
    let mut values = Vec::new();
    for line in text.lines().filter(|line| !line.starts_with('#')) {
        let mut fields = line
            .split_whitespace()
            .map_while(|field| field.parse::<i64>().ok());
        if let (Some(us), Some(count)) = (fields.next(), fields.next()) {
            values.extend((0..count).map(|_| us * 1000));
        }
    }
    let about = |name: &str| {
        let line = text.lines().find_map(|line| line.strip_prefix(name));
        line.and_then(|rest| rest.trim().parse::<i64>().ok()).unwrap_or(0)
    };
    let largest_us = about("# Max Latencies:");
    values.extend((0..about("# Histogram Overflows:")).map(|_| largest_us * 1000));
    assert!(
        !values.is_empty(),
        "cyclictest said nothing that can be read: {text}"
    );
    values
}

/// Lateness, in nanoseconds.
#[derive(Default)]
struct Samples(Vec<i64>);

impl Samples {
    fn extend(&mut self, more_ns: Vec<i64>) {
        // cyclictest leaves out the part below a microsecond.
        self.0.extend(more_ns.into_iter().map(|ns| ns / 1000 * 1000));
        self.0.sort_unstable();
    }

    /// In microseconds.
    fn at(&self, share: f64) -> f64 {
        let rank = (share * self.0.len() as f64).ceil() as usize;
        self.0[rank.saturating_sub(1)] as f64 / 1e3
    }

    fn print(&self, name: &str) {
        println!(
            "{name:30} {:>8} {:>8.0} {:>8.0} {:>8.0} {:>8.0}",
            self.0.len(),
            self.at(0.5),
            self.at(0.99),
            self.at(0.999),
            self.at(1.0)
        );
    }
}

/// An ordinary thread for each processor that never rests.
struct Load {
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl Load {
    fn start(wanted: bool) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let processors = if wanted {
            thread::available_parallelism().map_or(1, usize::from)
        } else {
            0
        };
        let threads = (0..processors)
            .map(|_| {
                let stop = Arc::clone(&stop);
                thread::spawn(move || {
                    while !stop.load(Ordering::Relaxed) {
                        std::hint::spin_loop();
                    }
                })
            })
            .collect();
        Self { stop, threads }
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}
