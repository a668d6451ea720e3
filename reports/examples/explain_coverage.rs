//! How often the intervals of `matrix explain` hold, on differences that were made:
//!
//! ```text
//! cargo run -p reports --example explain_coverage -- MATRIX FOLDER REPETITIONS [FACTOR...]
//! ```
//!
//! MATRIX is the program, and each FACTOR one of `delays`, `stalls` and `losses`; without one it is all of them. Each difference is simulated REPETITIONS times, with other seeds, in FOLDER, and each repetition is explained. The
//! true part of the factor that differs is the difference of the mean errors of both scenarios as they were set up, simulated at length, and
//! that of all other factors is 0. Prints a table of docs/twin.md.

#![allow(clippy::print_stdout)]

use std::{
    env,
    error::Error,
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use rayon::prelude::*;
use record::{report_settings::ReportSettings, run_directory::RunDirectory, settings::Settings};
use reports::{
    analysis::simulated_errors::period_errors_m,
    explain::{Effort, Explanation, Source, explain},
};
use simulation::closed_loop::Platform;

type Outcome<T> = Result<T, Box<dyn Error + Send + Sync>>;

/// Windows of a scenario in a repetition.
const WINDOWS: u32 = 8;
/// Windows that the true difference is computed from.
const TRUE_WINDOWS: u64 = 4000;
const STEPS: u64 = 1_000_000;
/// Of an ordinary machine.
const PLATFORM: &str = "controller: {late: [[0, 10us], [0.5, 60us], [0.99, 300us], [1, 4ms]], persistence: 20%}, \
    plant: {late: [[0, 10us], [0.5, 50us], [0.99, 250us], [1, 3ms]]}, stalls: {per_hour: 6, length: [[0, 20ms], [0.9, 100ms], [1, 400ms]]}, stack: 90us, reading: [[0, 10us], [0.99, 60us], [1, 500us]]";

/// A difference of two scenarios, by its axis.
struct Made {
    words: &'static str,
    axis: &'static str,
    /// The factor that it belongs to.
    factor: &'static str,
}

const MADE: [Made; 3] = [
    Made {
        words: "3 ms more delay on the way of a message",
        axis: "network.delay: [10ms, 11.5ms]",
        factor: "delays",
    },
    Made {
        words: "stalls of a busy neighbour: 3600 an hour of up to 400 ms, in place of 6",
        axis: "simulation.platform.stalls.per_hour: [6, 3600]",
        factor: "stalls",
    },
    Made {
        words: "twice the loss, 1 % to 2 % at each end",
        axis: "network.loss: [1%, 2%]",
        factor: "losses",
    },
];

fn main() -> Outcome<()> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let [matrix, folder, repetitions, factors @ ..] = arguments.as_slice() else {
        return Err("explain_coverage MATRIX FOLDER REPETITIONS [FACTOR...]".into());
    };
    let repetitions: u32 = repetitions.parse()?;
    let matrix = fs::canonicalize(matrix)?;
    let is_asked = |made: &Made| factors.is_empty() || factors.iter().any(|factor| factor == made.factor);
    for (nth, made) in (0..).zip(&MADE).filter(|(_, made)| is_asked(made)) {
        let at = |seed: u32| Path::new(folder).join(format!("{nth}-{seed}"));
        let all: Vec<Repetition> = (1..=repetitions)
            .into_par_iter()
            .map(|seed| Repetition::simulate(&matrix, &at(seed), made, seed))
            .collect::<Outcome<_>>()?;
        let first = all.first().ok_or("no repetition was asked for")?;
        let explained: Vec<&Explanation> = all.iter().map(|it| &it.explained).collect();
        print(made, Truth::of(&first.settings, &first.report), &explained);
    }
    Ok(())
}

/// The difference once.
struct Repetition {
    explained: Explanation,
    /// Of both scenarios.
    settings: [Settings; 2],
    report: ReportSettings,
}

impl Repetition {
    /// Simulates both scenarios and explains their difference. What was simulated is removed.
    fn simulate(matrix: &Path, folder: &PathBuf, made: &Made, seed: u32) -> Outcome<Self> {
        fs::create_dir_all(folder)?;
        let (axis, file) = (made.axis, folder.join("m.yaml"));
        fs::write(
            &file,
            format!(
                "matrix: {{virtualization: [simulated], {axis}}}\n\
                 workload: {{dynamics: author, windows: {WINDOWS}, window: 400s, period: 4s, reference: {{amplitude_m: 0.03}}, \
                 simulation: {{seed: {seed}, platform: {{{PLATFORM}}}}}}}\n"
            ),
        )?;
        let ran = Command::new(matrix)
            .args(["run", "m.yaml", "--quiet"])
            .current_dir(folder)
            .output()?;
        if !ran.status.success() {
            return Err(String::from_utf8_lossy(&ran.stderr).into());
        }
        let path = fs::read_dir(folder.join("runs"))?
            .next()
            .ok_or("there is no run")??
            .path();
        let run = reports::load(&path)?;
        let directory = RunDirectory::new(&path);
        let source = Source::of(&directory, &run)?;
        let effort = Effort {
            seed: seed.into(),
            steps: STEPS,
        };
        let explained = explain([(&source, "a"), (&source, "b")], effort)?;
        let [a, b] = run.scenarios.as_slice() else {
            return Err("there are not two scenarios".into());
        };
        let settings = [a.planned.settings.clone(), b.planned.settings.clone()];
        fs::remove_dir_all(folder)?;
        Ok(Self {
            explained,
            settings,
            report: run.manifest.report,
        })
    }
}

/// By how much the mean error of the second scenario is larger, in metres, and half its interval.
#[derive(Clone, Copy)]
struct Truth {
    difference_m: f64,
    reach_m: f64,
}

impl Truth {
    /// Both with the same seeds, which are none of the repetitions'.
    fn of([a, b]: &[Settings; 2], report: &ReportSettings) -> Self {
        let mean_m = |settings: &Settings, seed: u64| {
            let steps = settings.periods_per_window() * settings.steps_per_period();
            let errors_m = period_errors_m(
                settings,
                report,
                report.error,
                &Platform::of(settings),
                (steps, seed),
            );
            errors_m.iter().sum::<f64>() / errors_m.len() as f64
        };
        let each_m: Vec<f64> = (0..TRUE_WINDOWS)
            .into_par_iter()
            .map(|number| (1 << 48) + number)
            .map(|seed| mean_m(b, seed) - mean_m(a, seed))
            .collect();
        let n = each_m.len() as f64;
        let difference_m = each_m.iter().sum::<f64>() / n;
        let squares: f64 = each_m.iter().map(|value| (value - difference_m).powi(2)).sum();
        Self {
            difference_m,
            reach_m: 1.96 * (squares / n / (n - 1.0)).sqrt(),
        }
    }
}

fn print(made: &Made, truth: Truth, all: &[&Explanation]) {
    println!("\n{} ({} repetitions)\n", made.words, all.len());
    println!("| | true part, mm | mean of the parts, mm | interval has the true part | interval without 0 |");
    println!("|---|---|---|---|---|");
    let parts = all.first().map_or(&[][..], |explained| &explained.parts);
    for (at, part) in parts.iter().enumerate() {
        let is_made = part.factor == made.factor;
        let (true_m, true_words) = match is_made {
            true => (
                truth.difference_m,
                format!("{:+.2} ± {:.2}", truth.difference_m * 1e3, truth.reach_m * 1e3),
            ),
            false => (0.0, "0".to_owned()),
        };
        let found = all.iter().filter_map(|explained| explained.parts.get(at));
        let count =
            |is_it: &dyn Fn([f64; 2]) -> bool| found.clone().filter(|it| is_it(it.interval_m)).count();
        let holds = count(&|[low, high]| (low..=high).contains(&true_m));
        let told = count(&|[low, high]| low > 0.0 || high < 0.0);
        let mean_m = found.clone().map(|it| it.part_m).sum::<f64>() / all.len() as f64;
        let mark = if is_made { "**" } else { "" };
        println!(
            "| {mark}{}{mark} | {true_words} | {:+.2} | {holds} | {told} |",
            part.words,
            mean_m * 1e3
        );
    }
    let largest = all.iter().filter(|explained| {
        let parts = explained.parts.iter();
        let largest = parts.max_by(|a, b| a.part_m.abs().total_cmp(&b.part_m.abs()));
        largest.is_some_and(|largest| largest.factor == made.factor)
    });
    println!(
        "\nThe largest part is that of {}: {} of {}.",
        made.factor,
        largest.count(),
        all.len()
    );
}
