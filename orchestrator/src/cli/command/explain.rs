//! `matrix explain RUN A B`: how much of the difference of two scenarios' errors comes from late ticks, stalls, delays and losses.

use std::{fmt::Write as _, path::PathBuf};

use clap::Args;
use record::{exit::matrix::Exit, run_directory::RunDirectory};
use reports::explain::{Effort, ExplainedPair, Explanation, Found, Source, explain, explain_pairs};
use schemars::JsonSchema;
use serde::Serialize;

use crate::cli::{
    command::{options::OutputArguments, report::unreadable},
    completion,
    run_argument::run_argument,
    terminal::{self, CommandError},
};

/// What it takes.
#[derive(Debug, Args)]
pub struct ExplainArguments {
    /// The run directory.
    #[arg(value_parser = run_argument(), add = completion::runs())]
    run: PathBuf,
    /// A scenario: its letter or slug. When both are left out, every pair is explained that the report says differs.
    #[arg(value_name = "A", requires = "second", add = completion::scenarios_of_run())]
    first: Option<String>,
    /// The scenario that is compared with it.
    #[arg(value_name = "B", add = completion::scenarios_of_run())]
    second: Option<String>,
    /// Seed of the simulations.
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u32,
    #[command(flatten)]
    pub(crate) output: OutputArguments,
}

/// What the differences of pairs of scenarios come from: the output of `matrix explain --json`.
#[derive(Serialize, JsonSchema)]
#[schemars(title = "matrix explain --json")]
pub(super) struct ExplainDocument<'a>(&'a [ExplainedPair]);

/// Simulates the mixtures of both platforms and prints the parts.
///
/// # Errors
/// When the run directory cannot be read, there are no such scenarios, or they are not the same experiment.
pub fn execute(arguments: &ExplainArguments) -> Result<Exit, CommandError> {
    let directory = RunDirectory::new(&arguments.run);
    let run = reports::load_from(&directory, None).map_err(|error| unreadable(&error))?;
    let source = Source::of(&directory, &run).map_err(|error| unreadable(&error))?;
    let effort = Effort {
        seed: arguments.seed.into(),
        ..Effort::default()
    };
    let explained = match (&arguments.first, &arguments.second) {
        (Some(a), Some(b)) => {
            let explained = explain([(&source, a), (&source, b)], effort)
                .map_err(|error| CommandError::new(Exit::Wrong, &error, Some(error.hint())))?;
            vec![ExplainedPair::from(explained)]
        }
        _ => {
            let report = reports::analyse(&run, Default::default(), &run.manifest.report);
            explain_pairs(&source, report.differing_pairs(), effort)
        }
    };
    if arguments.output.json {
        terminal::json(&ExplainDocument(&explained));
        return Ok(Exit::Done);
    }
    let texts = explained.iter().map(|ExplainedPair { a, b, found }| match found {
        Found::Explanation(explained) => text(explained),
        Found::Reason(reason) => format!("Why {a} and {b} differ cannot be said: {reason}.\n"),
    });
    terminal::result(&match explained.is_empty() {
        true => "No pair of the report's family differs. Name two scenarios to explain them all the same.\n"
            .to_owned(),
        false => texts.collect::<Vec<_>>().join("\n"),
    });
    Ok(Exit::Done)
}

fn text(explained: &Explanation) -> String {
    let mut text = format!(
        "{}\n\n{:<22}{:>12}{:>24}\n",
        explained.sentence(),
        "",
        "means",
        "distributions"
    );
    for line in explained.lines() {
        let interval = line.interval_m.map_or_else(String::new, |[low, high]| {
            format!("[{:+.2}, {:+.2}]", low * 1e3, high * 1e3)
        });
        let distance = line.d.map_or_else(String::new, |d| format!("D {d:+.3}"));
        let columns = format!(
            "{:<22}{:>+9.2} mm  {interval:<22}{distance}",
            line.words,
            line.m * 1e3
        );
        // Writing to a String cannot fail.
        let _ = writeln!(text, "{}", columns.trim_end());
    }
    let _ = writeln!(
        text,
        "\nParts by simulation on mixtures of both platforms, as the mean over all orders of exchanging them: {}",
        explained.method()
    );
    for remark in &explained.remarks {
        let _ = writeln!(text, "{remark}");
    }
    text
}
