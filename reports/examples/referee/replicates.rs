//! How often tests of alike scenarios find a difference where windows are not independent: by windows, and by environments within
//! rounds.

use statistics::replicate_model::{Design, FalseRejections, World, false_rejections};

const ALPHA: f64 = 0.05;
const RUNS: usize = 2_000;

/// Designs with as many windows a scenario, in one environment and in several.
const DESIGNS: [(&str, Design); 6] = [
    ("2 x 8 windows, one environment", design(2, 1, 8)),
    ("2 x 8 rounds of 1 window", design(2, 8, 1)),
    ("2 x 6 rounds of 4 windows", design(2, 6, 4)),
    ("3 x 7 windows, one environment", design(3, 1, 7)),
    ("3 x 8 rounds of 2 windows", design(3, 8, 2)),
    ("7 x 10 rounds of 2 windows", design(7, 10, 2)),
];

const fn design(scenarios: usize, rounds: usize, windows: usize) -> Design {
    Design {
        scenarios,
        rounds,
        windows,
    }
}

/// Prints the share of runs in which a test finds a difference, and its Monte-Carlo error: some minutes on one core.
pub fn print() {
    let error = FalseRejections::error(ALPHA, RUNS);
    println!("## Replicates: false rejections at {ALPHA}, {RUNS} runs each, Monte-Carlo error {error:.3}\n");
    for (name, design) in DESIGNS {
        println!("{name}\n");
        println!("| world | pair, windows | any, windows | pair, environments | any, environments |");
        println!("|---|---|---|---|---|");
        for (at, world) in World::ALL.into_iter().enumerate() {
            let found = false_rejections(design, world, ALPHA, RUNS, 100 + at as u64);
            println!(
                "| {} | {:.3} | {:.3} | {:.3} | {:.3} |",
                world.name,
                found.pair_by_windows,
                found.any_by_windows,
                found.pair_by_environments,
                found.any_by_environments
            );
        }
        println!();
    }
}
