//! Whether real windows and simulated ones can be told apart, by the report's KS test on period errors:
//!
//! ```text
//! cargo run -p reports --example real_and_virtual -- DATA STACK_US SETTINGS [WORKLOAD]
//! ```
//!
//! With a WORKLOAD (as root) windows of the SETTINGS (JSON) are measured into the folder DATA first; without one they are
//! there. STACK_US is what a packet takes through both hosts beside the links, in microseconds (docs/twin.md). Each
//! real window is compared with simulated ones of the same length. Prints a line of JSON a window.

#![allow(clippy::print_stdout)]

use std::{env, error::Error, fs, path::Path, process::Command};

use rayon::prelude::*;
use record::{
    control_log::ControlRow,
    report_settings::{Metric, ReportSettings},
    run_directory::PeriodError,
    settings::{Dynamics, Settings},
};
use serde::Serialize;
use serde_json::json;
use simulation::closed_loop::{Platform, Simulation};
use statistics::ks;

type Outcome<T> = Result<T, Box<dyn Error>>;

/// Simulated windows for each real one.
const TIMES: u64 = 50;
/// Periods at the start of a run, with the transient in them.
const LEFT_OUT: u64 = 1;
const METRIC: Metric = Metric::MeanAbsSum;

/// What a window's control steps come to.
#[derive(Debug, Clone, Serialize)]
struct Window {
    n: usize,
    mean_mm: f64,
    sd_mm: f64,
    /// From the stamp on a state to its use, which is a command's way there and back where the plant answers.
    mean_age_ms: f64,
    /// Shares of steps that used the state of the step before, and that were lost.
    stale: f64,
    lost: f64,
    late_mean_ms: f64,
    late_99_percent_ms: f64,
    #[serde(skip)]
    errors_mm: Vec<f64>,
}

fn main() -> Outcome<()> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let [data, stack_us, settings, workload @ ..] = arguments.as_slice() else {
        return Err("real_and_virtual DATA STACK_US SETTINGS [WORKLOAD]".into());
    };
    if let [workload] = workload {
        measure(workload, data, settings)?;
    }
    let settings = Settings::from_json(serde_json::from_str(settings)?, Dynamics::default())?;
    let mut platform = Platform::ideal(&settings);
    platform.network.stack_ns = stack_us.parse::<i64>()? * 1000;
    let simulated: Vec<Window> = (0..TIMES)
        .into_par_iter()
        .map(|seed| simulate(&settings, &platform, seed))
        .collect();
    let pooled: Vec<f64> = simulated
        .iter()
        .flat_map(|window| window.errors_mm.clone())
        .collect();
    let alpha = ReportSettings::default().alpha;
    for number in 1.. {
        let path = Path::new(data).join(format!("window-{number}/control.csv"));
        if !path.exists() {
            break;
        }
        let rows = csv::Reader::from_path(&path)?
            .deserialize()
            .collect::<Result<Vec<ControlRow>, _>>()?;
        let real = Window::of(&rows, &settings);
        let p = simulated
            .iter()
            .map(|window| Ok(ks::test(&real.errors_mm, &window.errors_mm)?.p))
            .collect::<Outcome<Vec<f64>>>()?;
        let all = ks::test(&real.errors_mm, &pooled)?;
        let below = |level: f64| p.iter().filter(|p| **p < level).count();
        let found = json!({
            "window": number,
            "real": real,
            "simulated": Window::mean(&simulated),
            "against_all": {"n": pooled.len(), "d": all.d, "p": all.p},
            "against_each": {"windows": TIMES, "p_below_0.05": below(0.05), "p_below_alpha": below(alpha)},
            "load": fs::read_to_string("/proc/loadavg")?.trim(),
        });
        println!("{found}");
    }
    Ok(())
}

fn measure(workload: &str, data: &str, settings: &str) -> Outcome<()> {
    let windows = Settings::from_json(serde_json::from_str(settings)?, Dynamics::default())?.windows;
    let status = Command::new(workload)
        .args(["run", "--environment", "real-and-virtual", "--data", data])
        .args(["--windows", &windows.to_string(), "--settings", settings])
        .stdout(std::process::Stdio::null())
        .status()?;
    if status.success() {
        Ok(())
    } else {
        Err(format!("the workload ended with {status}").into())
    }
}

fn simulate(settings: &Settings, platform: &Platform, seed: u64) -> Window {
    let end = LEFT_OUT * settings.steps_per_period() + settings.steps_per_window();
    let rows: Vec<ControlRow> = Simulation::new(settings, platform, seed)
        .map(|step| step.row)
        .take_while(|row| row.step < end)
        .collect();
    Window::of(&rows, settings)
}

impl Window {
    fn of(rows: &[ControlRow], settings: &Settings) -> Self {
        let per_period = settings.steps_per_period();
        let counted: Vec<&ControlRow> = rows
            .iter()
            .filter(|row| row.step / per_period >= LEFT_OUT)
            .collect();
        let errors_mm: Vec<f64> = counted
            .chunk_by(|a, b| a.step / per_period == b.step / per_period)
            .map(|period| {
                let errors = period
                    .iter()
                    .map(|row| [row.reference_x_m - row.x_m, row.reference_y_m - row.y_m]);
                METRIC.of(&PeriodError::mean(errors)) * 1e3
            })
            .collect();
        let mean_mm = mean(errors_mm.iter().copied());
        let mut late_ms: Vec<f64> = counted
            .iter()
            .map(|row| (row.actual_ns - row.scheduled_ns) as f64 / 1e6)
            .collect();
        late_ms.sort_by(f64::total_cmp);
        let pairs = counted.windows(2);
        let steps = counted.len() as f64;
        let lost: u64 = pairs.clone().map(|pair| pair[1].step - pair[0].step - 1).sum();
        Self {
            n: errors_mm.len(),
            mean_mm,
            sd_mm: mean(errors_mm.iter().map(|error| (error - mean_mm).powi(2))).sqrt(),
            mean_age_ms: mean(
                counted
                    .iter()
                    .map(|row| (row.actual_ns - row.state_stamp_ns) as f64 / 1e6),
            ),
            stale: pairs
                .filter(|pair| pair[1].state_seq == pair[0].state_seq)
                .count() as f64
                / steps,
            lost: lost as f64 / steps,
            late_mean_ms: mean(late_ms.iter().copied()),
            late_99_percent_ms: late_ms.get(late_ms.len() * 99 / 100).copied().unwrap_or_default(),
            errors_mm,
        }
    }

    /// What windows come to on average.
    fn mean(windows: &[Self]) -> Self {
        let of = |value: fn(&Self) -> f64| mean(windows.iter().map(value));
        Self {
            n: windows.first().map_or(0, |window| window.n),
            mean_mm: of(|it| it.mean_mm),
            sd_mm: of(|it| it.sd_mm),
            mean_age_ms: of(|it| it.mean_age_ms),
            stale: of(|it| it.stale),
            lost: of(|it| it.lost),
            late_mean_ms: of(|it| it.late_mean_ms),
            late_99_percent_ms: of(|it| it.late_99_percent_ms),
            errors_mm: Vec::new(),
        }
    }
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    sum / count
}
