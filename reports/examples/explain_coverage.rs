//! How often the intervals of `matrix explain` hold, on differences that were made:
//!
//! ```text
//! cargo run -p reports --example explain_coverage -- MATRIX FOLDER REPETITIONS
//! ```
//!
//! MATRIX is the program. Each difference is simulated REPETITIONS times, with other seeds, in FOLDER, and each repetition is explained. A
//! part's true value is taken to be that of one explanation of 16 times as many windows and simulations: its own interval stands beside.
//! Prints a table of docs/twin.md.

#![allow(clippy::print_stdout)]

use std::{
    env,
    error::Error,
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use rayon::prelude::*;
use record::run_directory::RunDirectory;
use reports::explain::{Effort, Explanation, Source, explain};

type Outcome<T> = Result<T, Box<dyn Error + Send + Sync>>;

/// Windows of a scenario in a repetition.
const WINDOWS: u32 = 8;
/// How many times as many the true values are taken from.
const TIMES: u32 = 16;
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
        words: "stalls of a busy neighbour: 600 an hour of up to 400 ms, in place of 6",
        axis: "simulation.platform.stalls.per_hour: [6, 600]",
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
    let [matrix, folder, repetitions] = arguments.as_slice() else {
        return Err("explain_coverage MATRIX FOLDER REPETITIONS".into());
    };
    let repetitions: u32 = repetitions.parse()?;
    let matrix = fs::canonicalize(matrix)?;
    for (nth, made) in (0..).zip(&MADE) {
        let at = |seed: u32| Path::new(folder).join(format!("{nth}-{seed}"));
        let truth = explained(&matrix, &at(0), made, 0, TIMES)?;
        let all: Vec<Explanation> = (1..=repetitions)
            .into_par_iter()
            .map(|seed| explained(&matrix, &at(seed), made, seed, 1))
            .collect::<Outcome<_>>()?;
        print(made, &truth, &all);
    }
    Ok(())
}

/// Simulates both scenarios and explains their difference. What was simulated is removed.
fn explained(matrix: &Path, folder: &PathBuf, made: &Made, seed: u32, times: u32) -> Outcome<Explanation> {
    fs::create_dir_all(folder)?;
    let windows = WINDOWS * times;
    let (axis, file) = (made.axis, folder.join("m.yaml"));
    fs::write(
        &file,
        format!(
            "matrix: {{virtualization: [simulated], {axis}}}\n\
             workload: {{dynamics: author, windows: {windows}, window: 80s, period: 4s, reference: {{amplitude_m: 0.03}}, \
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
        steps: STEPS * u64::from(times),
    };
    let explained = explain([(&source, "a"), (&source, "b")], effort)?;
    fs::remove_dir_all(folder)?;
    Ok(explained)
}

fn print(made: &Made, truth: &Explanation, all: &[Explanation]) {
    println!("\n{} ({} repetitions)\n", made.words, all.len());
    println!("| | true part, mm | mean of the parts | interval has it | without 0 |");
    println!("|---|---|---|---|---|");
    for (at, part) in truth.parts.iter().enumerate() {
        let found = all.iter().filter_map(|explained| explained.parts.get(at));
        let count =
            |is_it: &dyn Fn([f64; 2]) -> bool| found.clone().filter(|it| is_it(it.interval_m)).count();
        let holds = count(&|[low, high]| (low..=high).contains(&part.part_m));
        let told = count(&|[low, high]| low > 0.0 || high < 0.0);
        let mean_m = found.clone().map(|it| it.part_m).sum::<f64>() / all.len() as f64;
        let [low, high] = part.interval_m;
        let mark = if part.factor == made.factor { "**" } else { "" };
        println!(
            "| {mark}{}{mark} | {:+.2} [{:+.2}, {:+.2}] | {:+.2} | {holds} | {told} |",
            part.words,
            part.part_m * 1e3,
            low * 1e3,
            high * 1e3,
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
