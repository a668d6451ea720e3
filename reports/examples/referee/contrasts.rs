//! Pairs of scenarios: what their intervals cover, how often equal ones are rejected, and what holds for a family of them.

use statistics::{
    block_permutation::{self, DRAWS},
    coverage::{DESIGNS, Design, EQUAL_MEANS, Family, Levels, margin_errors},
    dependence::Dependence,
    explained_part, ks,
    noise_model::Noise,
    relabelling::Effort,
};

const SEED: u64 = 16;
/// The standard error of a share of 95 % is .5 points, and of 5 % as much.
const REPETITIONS: usize = 2_000;

/// What the intervals of [`DESIGNS`] covered before: of the shift, of W1 and of P(larger), in percent.
const COVERED_BEFORE: [&str; 14] = [
    "64, 72, 64",
    "90, 93, 88",
    "96, –, 92",
    "98, 96, 94",
    "97, 94, 81",
    "98, 80, 93",
    "97, 93, 90",
    "97, 93, 88",
    "97, 95, 89",
    "90, 91, 86",
    "89, 90, 88",
    "78, 81, 79",
    "96, 96, 94",
    "96, 96, 95",
];

/// The share of equal means of [`EQUAL_MEANS`] that was rejected before, where it is known.
const REJECTED_BEFORE: [&str; 8] = [".34", ".35", ".20", ".07", "", "", "", ""];

/// What the intervals of [`explained_part::DESIGNS`] covered before, in percent.
const COMPONENTS_BEFORE: [f64; 12] = [
    66.4, 90.0, 93.3, 92.5, 93.3, 92.7, 93.5, 94.0, 87.7, 86.5, 94.8, 94.4,
];

pub(super) fn print() {
    coverage();
    explained_parts();
    equal_means();
    margins();
    families();
    blocks();
    whole_numbers();
}

fn described(design: &Design) -> String {
    let ([n, m], [a, b]) = (design.windows, design.spread);
    format!(
        "{n} : {m} | {} | {a}, {b} | {}",
        design.levels.name(),
        design.shift
    )
}

/// Table C of issue 16.
fn coverage() {
    println!(
        "Coverage of the intervals, % ({REPETITIONS} pairs each, 60 values a window of standard deviation 1)\n\n\
         | windows | levels | their sd | shift | covers shift (says) | W1 (95) | P(larger) (95) | before |\n|---|---|---|---|---|---|---|---|"
    );
    for (design, before) in DESIGNS.iter().zip(COVERED_BEFORE) {
        let found = design.coverage(REPETITIONS, SEED);
        println!(
            "| {} | {:.1} ({:.1}) | {:.1} | {:.1} | {before} |",
            described(design),
            found.shift * 100.0,
            found.shift_confidence * 100.0,
            found.wasserstein * 100.0,
            found.superiority * 100.0
        );
    }
    println!();
}

fn explained_parts() {
    println!(
        "Coverage of the interval of the part that goes with a quantity, % ({REPETITIONS} pairs each, 60 values a window, whose quantity \
         has standard deviation 1 there)\n\n\
         | windows | their sd | difference | slope, its sd | φ | covers (95) | before |\n|---|---|---|---|---|---|---|"
    );
    for (design, before) in explained_part::DESIGNS.iter().zip(COMPONENTS_BEFORE) {
        let ([n, m], [a, b]) = (design.windows, design.spread);
        println!(
            "| {n} : {m} | {a}, {b} | {} | {}, {} | {} | {:.1} | {before:.1} |",
            design.difference,
            design.slope,
            design.slope_spread,
            design.phi,
            design.coverage(REPETITIONS, SEED) * 100.0
        );
    }
    println!();
}

/// B15.
fn equal_means() {
    println!(
        "Equal means rejected at a nominal .05 ({REPETITIONS} pairs each; `p_shift` is by both)\n\n\
         | windows | levels | their sd | shift | `p` | studentised | Welch | `p_shift` | before |\n|---|---|---|---|---|---|---|---|---|"
    );
    for (design, before) in EQUAL_MEANS.iter().zip(REJECTED_BEFORE) {
        let found = design.rejections(0.05, REPETITIONS, SEED);
        println!(
            "| {} | {:.3} | {:.3} | {:.3} | {:.3} | {before} |",
            described(design),
            found.difference,
            found.studentised,
            found.welch,
            found.both
        );
    }
    println!();
}

/// B8.
fn margins() {
    println!(
        "A true shift of exactly the margin: families with an untrue \"differ, matters\" or \"immaterial\"\n\n\
         | pairs | windows | α | by each pair's 95 % (before) | by intervals for all at once |\n|---|---|---|---|---|"
    );
    for (pairs, windows, alpha) in [
        (1, 8, 0.05),
        (8, 8, 0.05),
        (21, 8, 0.05),
        (36, 8, 0.05),
        (8, 8, 0.01),
    ] {
        let found = margin_errors(pairs, windows, alpha, 1_000, SEED);
        println!(
            "| {pairs} | {windows} : {windows} | {alpha} | {:.3} | {:.3} |",
            found.by_each, found.by_all
        );
    }
    println!();
}

/// B14.
fn families() {
    println!(
        "max-T at a nominal .05: families with a rejected pair of equal means, and the share of unequal pairs that is found\n\n\
         | scenarios' means | windows | levels | false | found |\n|---|---|---|---|---|"
    );
    let nine = [0.0; 9];
    let families: [(&str, &[f64], Levels); 7] = [
        ("0 0 0", &[0.0; 3], Levels::Normal),
        ("0 0 50", &[0.0, 0.0, 50.0], Levels::Normal),
        ("0 3 50", &[0.0, 3.0, 50.0], Levels::Normal),
        ("nine of 0", &nine, Levels::Normal),
        ("nine of 0", &nine, Levels::HeavyTails),
        ("nine of 0", &nine, Levels::Skewed),
        ("0 0", &[0.0; 2], Levels::Normal),
    ];
    for (name, means, levels) in families {
        let family = Family {
            windows: 4,
            levels,
            means,
        };
        let found = family.errors(0.05, 999, REPETITIONS, SEED);
        println!(
            "| {name} | 4 each | {} | {:.3} | {:.3} |",
            levels.name(),
            found.false_rejections,
            found.found
        );
    }
    println!();
}

/// The last of B16.
fn blocks() {
    println!(
        "Pairs of AR(1) windows of 60 values alike, rejected at .05 by blocks (of those that can be)\n\n| φ | rejected | before |\n|---|---|---|"
    );
    for (phi, before) in [
        (0.0, ".038"),
        (0.3, ".057"),
        (0.5, ".063"),
        (0.7, ".069"),
        (0.9, ".116"),
    ] {
        let mut random = Noise::new(SEED);
        let effort = Effort {
            enumerate: 10_000,
            draws: DRAWS,
            seed: SEED,
        };
        let (mut possible, mut rejected) = (0_u32, 0_u32);
        for _ in 0..1_500 {
            let windows: Vec<Vec<f64>> = (0..8).map(|_| random.ar1(60, phi)).collect();
            let windows: Vec<&[f64]> = windows.iter().map(Vec::as_slice).collect();
            let block = Dependence::block_of(&windows[..4]).max(Dependence::block_of(&windows[4..]));
            let (x, y) = (windows[0], windows[4]);
            if block_permutation::smallest_p(x, y, block, effort) < 0.05 {
                possible += 1;
                let test = block_permutation::test(x, y, block, effort);
                rejected += u32::from(test.is_some_and(|test| test.p < 0.05));
            }
        }
        println!(
            "| {phi} | {:.3} of {possible} | {before} |",
            f64::from(rejected) / f64::from(possible)
        );
    }
    println!();
}

/// The last row of A.
fn whole_numbers() {
    let found = ks::read_numbers("9007199254740992\n9007199254740993\n");
    println!(
        "Whole numbers beyond 2^53 in `matrix ks` (before: merged, D = 0): {}\n",
        found.map_or_else(
            |error| error.to_string(),
            |numbers| format!("read as {numbers:?}")
        )
    );
}
