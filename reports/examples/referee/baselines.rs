//! How often a candidate is told of against a baseline, if nothing changed and if it did: the table of baselines of docs/drift.md.
//!
//! Nights are made up: independent levels around a constant, normal or with the heavy tails of Student's t with 3 degrees
//! of freedom, of standard deviation 1.

use std::collections::BTreeMap;

use rayon::prelude::*;
use reports::drift::{Compact, Metric, Night, Settings, Verdict, baseline, night::Measured};
use serde_json::Value;
use statistics::noise_model::Noise;

const SCENARIOS: usize = 9;
const CANDIDATES: u64 = 2000;

/// What nights are like.
#[derive(Debug, Clone, Copy)]
enum Tails {
    Normal,
    /// Of Student's t with 3 degrees of freedom.
    Heavy,
}

const NIGHTS: [(&str, Tails); 2] = [("normal", Tails::Normal), ("heavy tails", Tails::Heavy)];

/// Prints the table: one candidate, with all its scenarios, against so many nights.
pub fn print() {
    println!(
        "| runs of the baseline | nights | alike | 5 off | 10 off | 20 off |\n|---:|---|---:|---:|---:|---:|"
    );
    for nights in [4, 6, 10, 20, 60] {
        for (name, tails) in NIGHTS {
            let told = |jump: f64| {
                let drifts = (0..CANDIDATES)
                    .into_par_iter()
                    .filter(|seed| is_told(*seed, nights, tails, jump))
                    .count();
                100.0 * drifts as f64 / CANDIDATES as f64
            };
            println!(
                "| {nights} | {name} | {:.1} % | {:.0} % | {:.0} % | {:.0} % |",
                told(0.0),
                told(5.0),
                told(10.0),
                told(20.0)
            );
        }
    }
}

/// Whether a candidate is told, of which one scenario is off by a jump.
fn is_told(seed: u64, nights: usize, tails: Tails, jump: f64) -> bool {
    let mut noise = Noise::new(20_000 + seed);
    let all: Vec<Night> = (0..=nights)
        .map(|number| {
            let mut levels: Vec<f64> = (0..SCENARIOS).map(|_| value(&mut noise, tails)).collect();
            levels[0] += if number == nights { jump } else { 0.0 };
            night(number, levels)
        })
        .collect();
    baseline::judge(&all, &Settings::default()).verdict() == Verdict::Drift
}

/// Of standard deviation 1.
fn value(noise: &mut Noise, tails: Tails) -> f64 {
    let normal = noise.normal();
    match tails {
        Tails::Normal => normal,
        Tails::Heavy => {
            let chi_squared: f64 = (0..3).map(|_| noise.normal().powi(2)).sum();
            normal / (chi_squared / 3.0).sqrt() / 3.0_f64.sqrt()
        }
    }
}

fn night(number: usize, levels: Vec<f64>) -> Night {
    let scenarios = levels.into_iter().enumerate().map(|(nth, level)| {
        let measured = Measured {
            configuration: Compact::of(&Value::Null),
            environment: None,
            // Above 0, as errors are.
            values: BTreeMap::from([(Metric::TrackingError, vec![100.0 + level])]),
            lack: None,
            contents: BTreeMap::new(),
        };
        (format!("scenario-{nth}"), measured)
    });
    Night {
        run: format!("night-{number:03}"),
        created: format!("2026-{number:03}"),
        is_simulated: false,
        metric: Metric::TrackingError,
        equivalence_margin_m: None,
        equivalence_margins: BTreeMap::new(),
        scenarios: scenarios.collect(),
    }
}
