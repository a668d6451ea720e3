//! How often the watch over nights tells of a change that is not there, when it tells of one that is, where it places it, and how
//! long it takes, beside a CUSUM: the tables of docs/drift.md. Nights are made up ([`statistics::nights`]), nine series share 0.01 a
//! night.

use std::time::Instant;

use rayon::prelude::*;
use statistics::{
    nights::{Change, Cusum, Nights, changed, delay, false_changes, observed},
    watch::watch,
};

const SERIES: usize = 9;
const LEVEL: f64 = 0.01 / SERIES as f64;
/// Of changes that are none, in a year.
const PROMISE: f64 = 3.65;
/// Nights without a change before one, and after it.
const BEFORE: usize = 60;
const AFTER: usize = 100;

const STEADY: [Nights; 7] = [
    Nights::Normal,
    Nights::HeavyTails,
    Nights::Autoregression(0.3),
    Nights::Autoregression(0.5),
    Nights::Autoregression(0.7),
    Nights::Weekends(1.0),
    Nights::Weekends(2.0),
];
const MOVING: [Nights; 3] = [Nights::Sine(0.5), Nights::Sine(1.0), Nights::RandomWalk(0.05)];
const CHANGES: [Change; 8] = [
    Change::Jump(1.0),
    Change::Jump(1.5),
    Change::Jump(2.0),
    Change::Jump(3.0),
    Change::Jump(5.0),
    Change::Jump(8.0),
    Change::Slope(0.05),
    Change::Slope(0.1),
];

/// Prints the tables, in some minutes.
pub fn print() {
    const REPETITIONS: u64 = 1000;
    years(REPETITIONS);
    delays(REPETITIONS, careful_cusum(REPETITIONS));
    places(REPETITIONS / 2);
    after_a_known_change(REPETITIONS / 4);
    speed();
}

fn years(years: u64) {
    println!(
        "| nights | changes a year | in the first 30 nights, a night | CUSUM, changes a year |\n|---|---:|---:|---:|"
    );
    for nights in STEADY.into_iter().chain(MOVING) {
        let told: Vec<Vec<usize>> = (0..years)
            .into_par_iter()
            .map(|seed| false_changes(nights, LEVEL, seed))
            .collect();
        let all = told.iter().map(Vec::len).sum::<usize>() as f64;
        let young = told.iter().flatten().filter(|night| **night < 30).count() as f64;
        let of_nine = SERIES as f64 / years as f64;
        println!(
            "| {} | {:.2} | {:.4} | {:.1} |",
            nights.name(),
            all * of_nine,
            young * of_nine / 25.0,
            of_a_cusum(Cusum::OF_INDEPENDENT_NIGHTS, nights, years)
        );
    }
}

/// How many times a year it alarms where nothing changes, in all series.
fn of_a_cusum(chart: Cusum, nights: Nights, years: u64) -> f64 {
    let alarms: usize = (0..years)
        .into_par_iter()
        .map(|seed| chart.false_changes(nights, seed))
        .sum();
    SERIES as f64 * alarms as f64 / years as f64
}

/// The CUSUM with the lowest limit, in steps of a half, that keeps the watch's promise for all nights for which the watch gives it.
fn careful_cusum(years: u64) -> Cusum {
    let keeps = |chart: &Cusum| {
        STEADY
            .into_iter()
            .all(|nights| of_a_cusum(*chart, nights, years) <= PROMISE)
    };
    let mut charts = (17_u32..400).map(|halves| Cusum {
        limit: f64::from(halves) / 2.0,
    });
    let chart = charts.find(keeps);
    let chart = chart.unwrap_or(Cusum::OF_INDEPENDENT_NIGHTS);
    println!(
        "\na CUSUM keeps {PROMISE} changes a year in all of the first seven rows from h = {} on",
        chart.limit
    );
    chart
}

fn delays(histories: u64, careful: Cusum) {
    println!(
        "\n| change | in its night | within 5 | within 10 | within 20 | median nights after | CUSUM | CUSUM with as few false changes |\n|---|---:|---:|---:|---:|---:|---|---|"
    );
    for change in CHANGES {
        let row = |delay: &(dyn Fn(u64) -> Option<usize> + Sync)| {
            let mut delays: Vec<usize> = (0..histories)
                .into_par_iter()
                .map(|seed| delay(20_000 + seed).unwrap_or(usize::MAX))
                .collect();
            delays.sort_unstable();
            let within = |nights: usize| {
                100.0 * delays.iter().filter(|delay| **delay < nights).count() as f64 / histories as f64
            };
            (
                [within(1), within(5), within(10), within(20)],
                delays.get(delays.len() / 2).copied(),
            )
        };
        let (own, median) = row(&|seed| delay(Nights::Normal, change, BEFORE, AFTER, LEVEL, seed));
        let of_a_cusum = |chart: Cusum| {
            let (within, median) = row(&|seed| chart.delay(Nights::Normal, change, BEFORE, AFTER, seed));
            let [first, five, ten, twenty] = within.map(|share| format!("{share:.0}"));
            let median = median.filter(|nights| *nights < AFTER);
            let median = median.map_or_else(|| "never".to_owned(), |nights| nights.to_string());
            format!("{first} {five} {ten} {twenty} %, {median}")
        };
        println!(
            "| {change:?} | {:.0} % | {:.0} % | {:.0} % | {:.0} % | {} | {} | {} |",
            own[0],
            own[1],
            own[2],
            own[3],
            median.unwrap_or_default(),
            of_a_cusum(Cusum::OF_INDEPENDENT_NIGHTS),
            of_a_cusum(careful)
        );
    }
}

fn places(histories: u64) {
    println!(
        "\n| jump | placed within 2 nights, 40 nights later | 84.6 % and 93.8 % are the most for 1.5 and 2 |\n|---:|---:|---|"
    );
    for jump in [1.0, 1.5, 2.0, 3.0] {
        let near = (0..histories)
            .into_par_iter()
            .filter(|seed| {
                let found = changed(
                    Nights::Normal,
                    Change::Jump(jump),
                    BEFORE,
                    41,
                    LEVEL,
                    50_000 + seed,
                );
                found.changes.iter().any(|change| change.at.abs_diff(BEFORE) <= 2)
            })
            .count();
        println!("| {jump} | {:.0} % | |", 100.0 * near as f64 / histories as f64);
    }
}

fn after_a_known_change(histories: u64) {
    let mut ratios: Vec<f64> = (0..histories)
        .into_par_iter()
        .filter_map(|seed| {
            let mut values = Nights::Normal.values(BEFORE + 4, 90_000 + seed);
            values.iter_mut().skip(BEFORE).for_each(|value| *value += 10.0);
            let mut nights = observed(&values, LEVEL, seed);
            nights.get_mut(BEFORE)?.is_known_change = true;
            Some(watch(&nights).detectable? / watch(nights.get(..BEFORE)?).detectable?)
        })
        .collect();
    ratios.sort_by(f64::total_cmp);
    let at = |share: f64| {
        ratios
            .get((share * ratios.len() as f64) as usize)
            .copied()
            .unwrap_or_default()
    };
    println!(
        "\nfour nights after a known change the detectable jump is {:.2} times what it was (median; 95 %: {:.2})",
        at(0.5),
        at(0.95)
    );
}

/// 1000 nights of 50 scenarios with 5 metrics, a jump in each, on one processor.
fn speed() {
    let begun = Instant::now();
    let found: usize = (0..250)
        .map(|seed| {
            let found = changed(Nights::Normal, Change::Jump(3.0), 500, 500, 0.01 / 250.0, seed);
            found.changes.len()
        })
        .sum();
    println!(
        "\n1000 nights of 250 series with a jump each: {:.1} s, {found} changes",
        begun.elapsed().as_secs_f64()
    );
}
