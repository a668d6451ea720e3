//! Power of a design and calibration, before and after: the tables of docs/statistics/calibration.md. The function is [`print`].

use rayon::prelude::*;
use statistics::{
    dependence::{Ar1, Dependence},
    effect, ks,
    noise_model::{Noise, Shared, Tails},
    permutation,
    power::{Beyond, Comparison, Levels, POWER, Power, REPEATS, Spread},
    relabelling::Effort,
};

const REPORT: Effort = Effort::of_a_report(1);

/// Prints all of them as Markdown; some minutes.
pub fn print() {
    designs();
    pilots();
    sharing();
    pairs_that_share_windows();
    levels_beyond_values();
    halvings();
}

/// In how many of `trials` something holds, in percent.
fn percent(trials: u64, holds: impl Fn(&mut Noise) -> bool + Sync) -> f64 {
    let found = (0..trials)
        .into_par_iter()
        .filter(|seed| holds(&mut Noise::new(9_000_000 + seed)));
    found.count() as f64 * 100.0 / trials as f64
}

/// How often the report's own test finds a shift, in percent.
fn found(
    comparison: Comparison,
    tails: Tails,
    shift: f64,
    deviation: impl Fn(&mut Noise) -> f64 + Sync,
) -> f64 {
    percent(20_000, |noise| {
        let deviation = deviation(noise);
        let mut group = |size: usize, shift: f64| -> Vec<f64> {
            (0..size).map(|_| shift + deviation * noise.of(tails)).collect()
        };
        let (a, b) = (group(comparison.n, 0.0), group(comparison.m, shift));
        permutation::mean_difference(&a, &b, REPORT).is_some_and(|test| test.p < comparison.alpha)
    })
}

/// B2: the shift that is said to be found with 80 %, and how often it is.
fn designs() {
    println!("### The shift said to be found with 80 % power, in standard deviations of levels\n");
    println!(
        "| windows | α | pairs | Student's formula says | found | simulated | found | with heavy tails |"
    );
    println!("|---|---|---:|---:|---:|---:|---:|---:|");
    // The shift before: (t(1 − α/2) + t(0.8)) √(1/n + 1/m), with Student's quantiles at n + m − 2 degrees of freedom.
    let designs = [
        (4, 4, 0.05, 1, 2.371),
        (7, 7, 0.001, 1, 2.774),
        (8, 8, 0.001, 1, 2.504),
        (9, 9, 0.001, 21, 3.005),
        (10, 10, 0.001, 21, 2.761),
        (12, 12, 0.001, 21, 2.409),
        (13, 13, 0.001, 21, 2.276),
        (16, 16, 0.001, 21, 1.980),
        (10, 10, 0.05, 1, 1.325),
        (17, 17, 0.05, 1, 0.991),
        (4, 9, 0.01, 1, 2.392),
    ];
    for (n, m, level, pairs, before) in designs {
        let comparison = Comparison {
            n,
            m,
            alpha: level / f64::from(pairs),
        };
        let Some(power) = Power::simulated(comparison, Levels::NORMAL, REPEATS) else {
            println!("| {n} : {m} | {level} | {pairs} | {before:.3} | | cannot | | |");
            continue;
        };
        let after = power.shift(POWER);
        let normal = |shift| found(comparison, Tails::Normal, shift, |_| 1.0);
        println!(
            "| {n} : {m} | {level} | {pairs} | {before:.3} | {:.1} % | {after:.3} | {:.1} % | {:.1} % |",
            normal(before),
            normal(after),
            found(comparison, Tails::Heavy, after, |_| 1.0),
        );
    }
}

/// B2: the same where the spread is a pilot's estimate.
fn pilots() {
    println!("\n### The same after a pilot: how often what is said to be found with 80 % is found\n");
    println!("| windows | α | ν of the pilot | spread taken to be known | with its uncertainty |");
    println!("|---|---|---:|---:|---:|");
    for (n, alpha) in [(4, 0.05), (7, 0.001), (10, 0.05)] {
        for freedom in [3, 6, 18] {
            let comparison = Comparison { n, m: n, alpha };
            let said = |freedom| {
                let levels = Levels {
                    freedom,
                    ..Levels::NORMAL
                };
                Power::simulated(comparison, levels, REPEATS).map_or(f64::NAN, |power| power.shift(POWER))
            };
            // The true spread, of pilots that estimated 1.
            let of_pilots = |noise: &mut Noise| (freedom as f64 / noise.chi_squared(freedom)).sqrt();
            let found = |shift| found(comparison, Tails::Normal, shift, of_pilots);
            println!(
                "| {n} : {n} | {alpha} | {freedom} | {:.1} % | {:.1} % |",
                found(said(None)),
                found(said(Some(freedom)))
            );
        }
    }
}

/// B3: what windows share is taken for a difference.
fn sharing() {
    const TRIALS: u64 = 2_000;
    println!("\n### Share of alike pairs rejected / of families with a rejected pair (max-T), at 0.05\n");
    println!("| | 2 × 8 windows | 7 × 4 | 3 × 7 |\n|---|---:|---:|---:|");
    let rows = [
        ("independent windows", Shared::Nothing(Tails::Normal)),
        ("the same, heavy tails", Shared::Nothing(Tails::Heavy)),
        ("memory of 0.3 from window to window", Shared::Memory(0.3)),
        ("memory of 0.6", Shared::Memory(0.6)),
        ("drift of 2 window-sd over the run", Shared::Drift(2.0)),
        ("environments of 0.5 window-sd", Shared::Environment(0.5)),
        ("environments of 1 window-sd", Shared::Environment(1.0)),
        ("environments of 2 window-sd", Shared::Environment(2.0)),
    ];
    // Rates to a percent need no p to more than a thousandth.
    let effort = Effort {
        enumerate: 2_000,
        draws: 999,
        seed: 1,
    };
    for (name, shared) in rows {
        let cells = [(2, 8), (7, 4), (3, 7)].map(|(scenarios, windows)| {
            let pairs: Vec<(usize, usize)> = (0..scenarios)
                .flat_map(|a| (a + 1..scenarios).map(move |b| (a, b)))
                .collect();
            let (rejected, any) = (0..TRIALS)
                .into_par_iter()
                .map(|seed| {
                    let levels = shared.levels(scenarios, windows, &mut Noise::new(seed));
                    let levels: Vec<&[f64]> = levels.iter().map(Vec::as_slice).collect();
                    let tests = pairs
                        .iter()
                        .filter_map(|(a, b)| permutation::mean_difference(levels[*a], levels[*b], effort));
                    let rejected = tests.filter(|test| test.p < 0.05).count();
                    let family = permutation::max_t(&levels, &pairs, effort);
                    let any = family.is_some_and(|family| family.p.iter().any(|p| *p < 0.05));
                    (rejected, usize::from(any))
                })
                .reduce(|| (0, 0), |a, b| (a.0 + b.0, a.1 + b.1));
            let share = rejected as f64 / (TRIALS as usize * pairs.len()) as f64;
            format!("{share:.3} / {:.3}", any as f64 / TRIALS as f64)
        });
        println!("| {name} | {} |", cells.join(" | "));
    }
}

/// B11: how often calibration says "too often" of a test that is not.
fn pairs_that_share_windows() {
    println!(
        "\n### Runs of independent values of whose pairs KS is said to err \"too often\" at 0.05, of 4000\n"
    );
    println!(
        "| scenarios × windows | pairs taken for independent | w / 2 independent ones |\n|---|---:|---:|"
    );
    for (scenarios, windows) in [(3, 4), (1, 8), (1, 16)] {
        let too_often = |independent: fn(usize) -> usize| {
            percent(4_000, |noise| {
                let mut rejected = 0;
                for _ in 0..scenarios {
                    let values: Vec<Vec<f64>> = (0..windows).map(|_| noise.ar1(30, 0.0)).collect();
                    for (at, x) in values.iter().enumerate() {
                        let others = values.iter().skip(at + 1);
                        rejected += others
                            .filter(|y| ks::test(x, y).is_ok_and(|test| test.p < 0.05))
                            .count();
                    }
                }
                let pairs = scenarios * windows * (windows - 1) / 2;
                let share = rejected as f64 / pairs as f64;
                wilson_low(share, (scenarios * independent(windows)) as f64) > 0.05
            })
        };
        println!(
            "| {scenarios} × {windows} | {:.1} % | {:.1} % |",
            too_often(|windows| windows * (windows - 1) / 2),
            too_often(|windows| windows / 2)
        );
    }
}

fn wilson_low(share: f64, n: f64) -> f64 {
    const Z: f64 = 1.959_963_984_540_054;
    let half = Z * (share * (1.0 - share) / n + Z * Z / (4.0 * n * n)).sqrt();
    (share + Z * Z / (2.0 * n) - half) / (1.0 + Z * Z / n)
}

/// B12: the spread of window levels beyond that of their values, where there is none.
fn levels_beyond_values() {
    const TRIALS: u64 = 1_000;
    println!("\n### Levels beyond values, where there is nothing beyond: before / after\n");
    println!(
        "| φ | τ | τ estimated | φ estimated | mean sd beyond | above 0.1 | mean variance beyond | interval without 0 |"
    );
    println!("|---:|---:|---:|---:|---:|---:|---:|---:|");
    for phi in [0.0, 0.5, 0.7, 0.9] {
        let found: Vec<([Found; 2], bool)> = (0..TRIALS)
            .into_par_iter()
            .filter_map(|seed| {
                let mut noise = Noise::new(seed);
                let windows: Vec<Vec<f64>> = (0..12).map(|_| noise.ar1(60, phi)).collect();
                let windows: Vec<&[f64]> = windows.iter().map(Vec::as_slice).collect();
                let spread = Spread::pooled(windows.chunks(4).map(effect::levels))?;
                let (geyer, fit) = (Dependence::of(&windows)?, Ar1::of(&windows)?);
                let squares = |window: &&[f64]| {
                    let mean = window.iter().sum::<f64>() / window.len() as f64;
                    window.iter().map(|value| (value - mean).powi(2)).sum::<f64>()
                };
                let variance = windows.iter().map(squares).sum::<f64>() / geyer.n as f64;
                let before = variance * geyer.time / 60.0;
                let after = fit.variance_of_mean(60);
                let of = |time, phi, explained| Found {
                    time,
                    phi,
                    beyond: spread.deviation.powi(2) - explained,
                };
                let is_beyond = Beyond::of(spread, after).low > 0.0;
                Some((
                    [
                        of(geyer.time, geyer.lag_one(), before),
                        of(fit.time(), fit.phi, after),
                    ],
                    is_beyond,
                ))
            })
            .collect();
        let mean = |of: &dyn Fn(&Found) -> f64| {
            [0, 1]
                .map(|which| found.iter().map(|(both, _)| of(&both[which])).sum::<f64>() / found.len() as f64)
        };
        let pair = |[before, after]: [f64; 2]| format!("{before:.2} / {after:.2}");
        let sd = |found: &Found| found.beyond.max(0.0).sqrt();
        let above = mean(&|found| f64::from(sd(found) > 0.1)).map(|share| share * 100.0);
        let beyond = found.iter().filter(|(_, is_beyond)| *is_beyond).count();
        println!(
            "| {phi} | {:.2} | {} | {} | {} | {:.0} / {:.0} % | {} | – / {:.1} % |",
            (1.0 + phi) / (1.0 - phi),
            pair(mean(&|found| found.time)),
            pair(mean(&|found| found.phi)),
            pair(mean(&sd)),
            above[0],
            above[1],
            {
                let [before, after] = mean(&|found| found.beyond);
                format!("{before:.3} / {after:.3}")
            },
            beyond as f64 * 100.0 / found.len() as f64
        );
    }
}

/// What one run says of its windows.
struct Found {
    time: f64,
    phi: f64,
    beyond: f64,
}

/// The level of the window at a place.
type Level = fn(usize, &mut Noise) -> f64;

/// B10: of all halvings of eight windows, each tested against all, the share below 0.05: whatever was measured.
fn halvings() {
    println!(
        "\n### All halvings of 8 windows of one scenario: the share with p below 0.05, and the p of their order\n"
    );
    println!(
        "| windows | halvings (the row that is gone) | runs with a p of the order below 0.05, of 2000 |\n|---|---:|---:|"
    );
    let rows: [(&str, Level); 3] = [
        ("independent", |_, noise| noise.normal()),
        ("5 sd of drift a window", |at, noise| {
            5.0 * at as f64 + noise.normal()
        }),
        ("half of them 5 sd elsewhere", |at, noise| {
            f64::from(u8::from(at >= 4)) * 5.0 + noise.normal()
        }),
    ];
    for (name, level) in rows {
        let mut noise = Noise::new(1);
        let levels: Vec<f64> = (0..8).map(|at| level(at, &mut noise)).collect();
        let halvings: Vec<u32> = (0_u32..1 << 7)
            .filter(|chosen| chosen.count_ones() == 4)
            .collect();
        let rejected = halvings.iter().filter(|chosen| {
            let side = |is_first: bool| -> Vec<f64> {
                let levels = levels.iter().enumerate();
                let of_side = levels.filter(|(at, _)| (**chosen & (1 << at) != 0) == is_first);
                of_side.map(|(_, level)| *level).collect()
            };
            permutation::mean_difference(&side(true), &side(false), REPORT).is_some_and(|test| test.p < 0.05)
        });
        let in_order = percent(2_000, |noise| {
            let levels: Vec<f64> = (0..8).map(|at| level(at, noise)).collect();
            statistics::serial::SerialDependence::of(&[&levels], 1).is_some_and(|found| found.p < 0.05)
        });
        println!(
            "| {name} | {} of {} | {in_order:.1} % |",
            rejected.count(),
            halvings.len()
        );
    }
}
