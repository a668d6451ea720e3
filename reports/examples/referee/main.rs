//! Whether the statistics hold what docs/statistics.md promises of them, on made-up data whose truth is known:
//!
//! ```text
//! cargo run -p reports --example referee [SECTION ...]
//! ```
//!
//! Prints every section, or those that are named, as tables in Markdown. A column `before` has what commit b553eaf did on data
//! made in the same way. CI runs the same simulations small, as tests of the crate `statistics`.

#![allow(clippy::print_stdout, clippy::print_stderr)]

mod baselines;
mod contrasts;
mod drift;
mod peers;
mod power;
mod replicates;

use std::process::ExitCode;

/// A part of what is promised.
struct Section {
    name: &'static str,
    about: &'static str,
    print: fn(),
}

/// Every section, in the order of printing.
const SECTIONS: &[Section] = &[
    Section {
        name: "contrasts",
        about: "two scenarios and families of them: coverage, false rejections, the margin, max-T, whole numbers",
        print: contrasts::print,
    },
    Section {
        name: "power",
        about: "what a plan promises to find, and what calibration says of windows that share something",
        print: power::print,
    },
    Section {
        name: "replicates",
        about: "environments as the unit: false rejections under what windows of one environment share",
        print: replicates::print,
    },
    Section {
        name: "drift",
        about: "the watch over nights: false changes, delay, place, and time, beside a CUSUM",
        print: drift::print,
    },
    Section {
        name: "baselines",
        about: "a candidate against a baseline: false alarms and what is found",
        print: baselines::print,
    },
    Section {
        name: "peers",
        about: "the watch over nights beside Apache Otava, Perfherder, PELT and a CUSUM",
        print: peers::print,
    },
];

fn main() -> ExitCode {
    let wanted: Vec<String> = std::env::args().skip(1).collect();
    if let Some(unknown) = wanted
        .iter()
        .find(|name| SECTIONS.iter().all(|it| it.name != **name))
    {
        eprintln!("there is no section `{unknown}`; the sections are:");
        for section in SECTIONS {
            eprintln!("  {}: {}", section.name, section.about);
        }
        return ExitCode::FAILURE;
    }
    let is_wanted = |section: &&Section| wanted.is_empty() || wanted.iter().any(|name| *name == section.name);
    for section in SECTIONS.iter().filter(is_wanted) {
        println!("# {}: {}\n", section.name, section.about);
        (section.print)();
    }
    ExitCode::SUCCESS
}
