//! One way against another, and whether it is near enough. The main type is [`Comparison`].

use std::fs;

use tests::{Workplace, difference::Difference};

use crate::way::Measured;

/// What the emulator's mean round trip may be off netem's.
const ROUND_TRIP_BOUND_MS: f64 = 0.2;
/// Seconds of TCP that are one value: its rate remembers a loss for some round trips of 40 ms.
const TCP_BATCH: usize = 5;

/// How far a way is from the reference.
pub struct Comparison {
    reference: &'static str,
    name: &'static str,
    round_trip_ms: Difference,
    lost: Difference,
    swapped: Difference,
    tcp_mbit: Difference,
    round_trips_ks: String,
    there_ks: String,
    back_ks: String,
}

impl Comparison {
    pub fn of(reference: &Measured, other: &Measured, workplace: &Workplace) -> Self {
        let ks = |times: fn(&Measured) -> &Vec<f64>| ks(workplace, times(reference), times(other));
        Self {
            reference: reference.name,
            name: other.name,
            round_trip_ms: Difference::of_means(&reference.round_trip_ms, &other.round_trip_ms),
            lost: Difference::of_shares(reference.lost, other.lost),
            swapped: Difference::of_shares(reference.swapped, other.swapped),
            tcp_mbit: Difference::of_means(&batches(&reference.tcp_mbit), &batches(&other.tcp_mbit)),
            round_trips_ks: ks(|way| &way.round_trip_ms),
            there_ks: ks(|way| &way.there_ms),
            back_ks: ks(|way| &way.back_ms),
        }
    }

    /// What is too far off, in sentences.
    pub fn misses(&self) -> Vec<String> {
        let pair = format!("{} against {}", self.name, self.reference);
        let mut misses = Vec::new();
        if !self.round_trip_ms.is_within(ROUND_TRIP_BOUND_MS) {
            misses.push(format!(
                "{pair}: the mean round trip is off by {} ms; {ROUND_TRIP_BOUND_MS} ms are allowed",
                shown(self.round_trip_ms, 1.0, 3)
            ));
        }
        for (what, difference) in [("losses", self.lost), ("swapped pairs", self.swapped)] {
            if !difference.may_be_none() {
                misses.push(format!(
                    "{pair}: {what} differ by {} percentage points, which is no chance (p < 0.001)",
                    shown(difference, 100.0, 2)
                ));
            }
        }
        misses
    }
}

pub fn print(reference: &str, comparisons: &[Comparison]) {
    println!(
        "\n| against {reference}, ± 99.9 % | mean round trip | lost one way | pairs that swapped | TCP |"
    );
    println!("|---|---|---|---|---|");
    for way in comparisons {
        println!(
            "| {} | {} ms | {} points | {} points | {} Mbit/s |",
            way.name,
            shown(way.round_trip_ms, 1.0, 3),
            shown(way.lost, 100.0, 2),
            shown(way.swapped, 100.0, 2),
            shown(way.tcp_mbit, 1.0, 2),
        );
        println!(
            "| found in 9 of 10 tries | {:.3} ms | {:.2} points | {:.2} points | {:.2} Mbit/s |",
            way.round_trip_ms.visible(),
            100.0 * way.lost.visible(),
            100.0 * way.swapped.visible(),
            way.tcp_mbit.visible(),
        );
    }
    println!("\n| KS against {reference} | round trips | sta1 to sta2 | sta2 to sta1 |");
    println!("|---|---|---|---|");
    for way in comparisons {
        println!(
            "| {} | {} | {} | {} |",
            way.name, way.round_trips_ks, way.there_ks, way.back_ks
        );
    }
}

fn shown(difference: Difference, scale: f64, digits: usize) -> String {
    let (estimate, reach) = (scale * difference.estimate, scale * difference.reach());
    format!("{estimate:+.digits$} ± {reach:.digits$}")
}

fn batches(seconds: &[f64]) -> Vec<f64> {
    seconds
        .chunks_exact(TCP_BATCH)
        .map(tests::difference::mean)
        .collect()
}

/// The product's own test: distance and p.
fn ks(workplace: &Workplace, x: &[f64], y: &[f64]) -> String {
    for (name, values) in [("x", x), ("y", y)] {
        let lines: Vec<String> = values.iter().map(f64::to_string).collect();
        fs::write(workplace.path().join(name), lines.join("\n")).expect("the folder can be written");
    }
    let test = workplace.json(&["ks", "x", "y"]);
    let number = |name: &str| test[name].as_f64().expect("the test has a result");
    format!("D = {:.3}, p = {:.2}", number("d"), number("p"))
}
