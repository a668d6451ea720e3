//! How fast the experiment is in virtual time, without logs and captures: seconds of the experiment in each second.
//!
//! `cargo bench -p workload --bench virtual_time`. It is not a test and has no bound; docs/performance.md has the last figures.

#![allow(clippy::unwrap_used, clippy::print_stdout)]

use std::{hint::black_box, time::Instant};

use record::settings::{Dynamics, Settings};
use simulation::closed_loop::{Platform, Simulation};

/// Half an hour of the experiment.
const STEPS: usize = 90_000;
const ROUNDS: usize = 7;

fn main() {
    for dynamics in Dynamics::ALL {
        let settings = Settings::of(dynamics);
        let platform = Platform::of(&settings);
        let mut seconds: Vec<f64> = (0..ROUNDS)
            .map(|round| {
                let begun = Instant::now();
                let steps = Simulation::new(&settings, &platform, round as u64).take(STEPS);
                steps.for_each(|step| {
                    black_box(step);
                });
                begun.elapsed().as_secs_f64()
            })
            .collect();
        seconds.sort_by(f64::total_cmp);
        let median = seconds[ROUNDS / 2];
        let experiment_s = settings.rate.step().as_secs_f64() * STEPS as f64;
        println!(
            "{dynamics:?}: {:.2} µs a step, {:.0} times real time (median of {ROUNDS})",
            median * 1e6 / STEPS as f64,
            experiment_s / median
        );
    }
}
