//! Does the crash campaign, prints its table and what was found, and exits with 1 unless nothing was:
//!
//! ```text
//! cargo run -p tests --example campaign -- [--tenth] [--list] [WORDS OF A CAMPAIGN'S NAME]...
//! ```
//!
//! As root, with what `tests/prepare` installs; the whole takes about an hour. `docs/crashes.md` says what it is.

use std::process::ExitCode;

use tests::campaign::{self, Extent};

fn main() -> ExitCode {
    let (options, only): (Vec<String>, Vec<String>) = std::env::args()
        .skip(1)
        .partition(|argument| argument.starts_with("--"));
    if options.iter().any(|option| option == "--list") {
        campaign::names().for_each(|name| println!("{name}"));
        return ExitCode::SUCCESS;
    }
    if let Some(unknown) = options.iter().find(|option| *option != "--tenth") {
        eprintln!("there is no option {unknown}: --tenth, --list, or words of a campaign's name");
        return ExitCode::from(2);
    }
    let extent = Extent {
        tenth: !options.is_empty(),
        only,
    };
    let rows = campaign::run(&extent, |row| {
        println!("{}: {} points in {:.0?}", row.name, row.points, row.took);
        for (point, fault, what) in &row.faults {
            println!("  {point}: {fault:?}: {what}");
        }
    });
    println!("\n{}", campaign::table(&rows));
    ExitCode::from(u8::from(rows.iter().any(|row| !row.faults.is_empty())))
}
