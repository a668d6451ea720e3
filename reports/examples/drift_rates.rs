//! How often drift is told where there is none, in a year of nights, and how much of what there is is found and when:
//!
//! ```text
//! cargo run -p reports --example drift_rates
//! ```
//!
//! Nights are made up: independent levels around a constant, normal or with the heavy tails of Student's t with 3 degrees
//! of freedom, of standard deviation 1. Prints the table of docs/drift.md.

#![allow(clippy::print_stdout)]

use std::collections::BTreeMap;

use rayon::prelude::*;
use reports::{
    drift::{Metric, Night, Settings, Verdict, baseline, history, night::Measured},
    statistics::noise_model::Noise,
};
use serde_json::Value;

const SCENARIOS: usize = 9;
const YEAR: usize = 365;
/// Nights that are there before the first judgement.
const FIRST: usize = 14;
/// Of the two tables.
const YEARS: u64 = 10;
const HISTORIES: u64 = 100;
const CANDIDATES: u64 = 2000;

/// What nights are like.
#[derive(Debug, Clone, Copy)]
enum Tails {
    Normal,
    /// Of Student's t with 3 degrees of freedom.
    Heavy,
}

const NIGHTS: [(&str, Tails); 2] = [("normal", Tails::Normal), ("heavy tails", Tails::Heavy)];

fn main() {
    years();
    jumps();
    baselines();
}

fn years() {
    println!(
        "| nights | changes told in a year of {SCENARIOS} scenarios, of which none is there |\n|---|---:|"
    );
    for (name, tails) in NIGHTS {
        let told: usize = (0..YEARS)
            .into_par_iter()
            .map(|year| told_in_a_year(year, tails))
            .sum();
        println!("| {name} | {:.2} |", told as f64 / YEARS as f64);
    }
}

fn jumps() {
    println!(
        "\n| jump, in standard deviations of nights | told in its night | within 5 nights | within 20 |\n|---:|---:|---:|---:|"
    );
    for jump in [1.0, 2.0, 3.0, 5.0, 8.0] {
        let delays: Vec<Option<usize>> = (0..HISTORIES)
            .into_par_iter()
            .map(|seed| delay(seed, jump))
            .collect();
        let within = |nights: usize| {
            let found = delays.iter().flatten().filter(|delay| **delay < nights).count();
            100.0 * found as f64 / HISTORIES as f64
        };
        println!(
            "| {jump} | {:.0} % | {:.0} % | {:.0} % |",
            within(1),
            within(5),
            within(20)
        );
    }
}

/// One candidate, with all its scenarios, against so many nights.
fn baselines() {
    println!(
        "\n| runs of the baseline | nights | alike | 5 off | 10 off | 20 off |\n|---:|---|---:|---:|---:|---:|"
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

/// New changes in a year of nights that are alike: a change that was told the night before is not new.
fn told_in_a_year(seed: u64, tails: Tails) -> usize {
    let mut noise = Noise::new(seed);
    let all: Vec<Night> = (0..YEAR)
        .map(|number| night(number, (0..SCENARIOS).map(|_| value(&mut noise, tails)).collect()))
        .collect();
    let mut before: Vec<(usize, String)> = Vec::new();
    let mut told = 0;
    for newest in FIRST..YEAR {
        let judged = history::judge(&all[..=newest], &Settings::default());
        let now: Vec<(usize, String)> = judged
            .judgements
            .iter()
            .enumerate()
            .flat_map(|(nth, judgement)| {
                let findings = judgement.findings.iter();
                findings.map(move |finding| (nth, finding.since.clone()))
            })
            .collect();
        told += now
            .iter()
            .filter(|(nth, _)| before.iter().all(|(other, _)| other != nth))
            .count();
        before = now;
    }
    told
}

/// How many nights after a jump it is told, after 60 nights alike, in a history of as many scenarios.
fn delay(seed: u64, jump: f64) -> Option<usize> {
    const BEFORE: usize = 60;
    let mut noise = Noise::new(10_000 + seed);
    let all: Vec<Night> = (0..BEFORE + 20)
        .map(|number| {
            let mut levels: Vec<f64> = (0..SCENARIOS).map(|_| noise.normal()).collect();
            levels[0] += if number >= BEFORE { jump } else { 0.0 };
            night(number, levels)
        })
        .collect();
    (0..20).find(|after| {
        let judged = history::judge(&all[..=BEFORE + after], &Settings::default());
        judged.judgements[0].verdict == Verdict::Drift
    })
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
            configuration: Value::Null,
            environment: None,
            // Above 0, as errors are.
            values: BTreeMap::from([(Metric::TrackingError, vec![100.0 + level])]),
            lack: None,
        };
        (format!("scenario-{nth}"), measured)
    });
    Night {
        run: format!("night-{number:03}"),
        created: format!("2026-{number:03}"),
        is_simulated: false,
        matters_m: None,
        scenarios: scenarios.collect(),
    }
}
