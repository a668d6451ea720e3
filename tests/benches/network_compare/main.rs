//! The same network in several ways: the paper's links by each backend, each in a guest of its own in virtual time, so
//! that what is compared are the networks and not what else this machine does.
//!
//! `cargo bench --profile dev --workspace --bench network_compare` takes all ways, `-- kernel mininet` those that it names.
//! The first is what the others are compared with. Prints the tables of `docs/network.md` and ends with 1 where a way is too
//! far from it: a mean round trip that may be more than 0.2 ms apart, or losses or reordering that can be told apart at
//! p < 0.001.

mod comparison;
mod way;

use std::{process::ExitCode, thread, time::Instant};

use tests::{
    Workplace,
    difference::{deviation, mean},
    matrix_binary, workload_example,
};

use crate::{
    comparison::Comparison,
    way::{Measured, WAYS, Way},
};

fn main() -> ExitCode {
    let wanted: Vec<String> = std::env::args()
        .skip(1)
        .filter(|word| !word.starts_with('-'))
        .collect();
    let chosen: Vec<&Way> = WAYS
        .iter()
        .filter(|way| wanted.is_empty() || wanted.iter().any(|name| name == way.name))
        .collect();
    let measured = measure(&chosen);
    let Some((reference, others)) = measured.split_first() else {
        panic!("no way is named {wanted:?}");
    };
    times(&measured, "round trip", |way| &way.round_trip_ms);
    times(&measured, "one way, sta1 to sta2", |way| &way.there_ms);
    times(&measured, "one way, sta2 to sta1", |way| &way.back_ms);
    counts(&measured);
    let workplace = Workplace::new();
    let comparisons: Vec<Comparison> = others
        .iter()
        .map(|other| Comparison::of(reference, other, &workplace))
        .collect();
    comparison::print(reference.name, &comparisons);
    let misses: Vec<String> = comparisons.iter().flat_map(Comparison::misses).collect();
    for miss in &misses {
        eprintln!("network_compare: {miss}");
    }
    ExitCode::from(u8::from(!misses.is_empty()))
}

/// All at once: a machine's virtual time does not notice the others.
fn measure(ways: &[&Way]) -> Vec<Measured> {
    eprintln!("building what is measured with");
    let probe = &workload_example("network_probe");
    matrix_binary();
    let begin = Instant::now();
    thread::scope(|scope| {
        let started: Vec<_> = ways
            .iter()
            .map(|way| {
                let tell = move |what: &str| {
                    eprintln!("[{:4.0} s] {}: {what}", begin.elapsed().as_secs_f64(), way.name);
                };
                scope.spawn(move || way.measure(probe, &tell))
            })
            .collect();
        started
            .into_iter()
            .map(|way| way.join().expect("every way is measured"))
            .collect()
    })
}

fn times(measured: &[Measured], what: &str, of: fn(&Measured) -> &Vec<f64>) {
    println!("\n| {what}, ms | n | mean | deviation | 1 % | 25 % | median | 75 % | 99 % | largest |");
    println!("|---|---|---|---|---|---|---|---|---|---|");
    for way in measured {
        let mut sorted = of(way).clone();
        sorted.sort_by(f64::total_cmp);
        let at = |share: f64| sorted[((sorted.len() - 1) as f64 * share).round() as usize];
        println!(
            "| {} | {} | {:.3} | {:.3} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} |",
            way.name,
            sorted.len(),
            mean(&sorted),
            deviation(&sorted),
            at(0.01),
            at(0.25),
            at(0.5),
            at(0.75),
            at(0.99),
            at(1.0)
        );
    }
}

fn counts(measured: &[Measured]) {
    println!("\n| | lost one way | pairs that swapped | gap of a pair | TCP, each second | full frames |");
    println!("|---|---|---|---|---|---|");
    for way in measured {
        let of = |(part, whole): (usize, usize)| {
            format!("{part} of {whole} ({:.2} %)", 100.0 * part as f64 / whole as f64)
        };
        println!(
            "| {} | {} | {} | {:.0} µs | {:.2} Mbit/s, deviation {:.2} | {:.3} Mbit/s |",
            way.name,
            of(way.lost),
            of(way.swapped),
            way.gap_us,
            mean(&way.tcp_mbit),
            deviation(&way.tcp_mbit),
            way.flood_mbit
        );
    }
}
