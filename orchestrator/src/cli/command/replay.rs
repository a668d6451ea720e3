//! `matrix replay RUN`: the times recorded in a run, put through the loop, give its errors again, or it says from where on they do not.

use std::{fmt::Write as _, path::PathBuf};

use clap::Args;
use record::{exit::matrix::Exit, run_directory::RunDirectory};
use reports::replay::{self, ReplayDocument, WindowReplay};

use crate::cli::{
    command::options::OutputArguments,
    completion, plain_log,
    run_argument::run_argument,
    terminal::{self, CommandError},
};

/// What it takes.
#[derive(Debug, Args)]
pub struct ReplayArguments {
    /// The run directory.
    #[arg(value_parser = run_argument(), add = completion::runs())]
    run: PathBuf,
    #[command(flatten)]
    pub(crate) output: OutputArguments,
}

/// Replays the run and prints what it comes to.
///
/// # Errors
/// When the run directory cannot be read, or has nothing to replay.
pub fn execute(arguments: &ReplayArguments) -> Result<Exit, CommandError> {
    let replayed = replay::replay(&RunDirectory::new(&arguments.run))
        .map_err(|error| CommandError::new(Exit::Wrong, &error, Some(error.hint())))?;
    match arguments.output.json {
        true => terminal::json(&replayed),
        false => terminal::result(&text(&replayed)),
    }
    let mut windows = replayed.scenarios.iter().flat_map(|scenario| &scenario.windows);
    Ok(match windows.all(WindowReplay::is_the_same) {
        true => Exit::Done,
        false => Exit::Wrong,
    })
}

fn text(replayed: &ReplayDocument) -> String {
    let mut text = format!("replay of {}\n", replayed.run);
    for scenario in &replayed.scenarios {
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "{} {}{}",
            scenario.id,
            scenario.slug,
            plain_log::if_simulated(scenario.simulated)
        );
        for window in &scenario.windows {
            let _ = writeln!(text, "  window {}: {}", window.window, line(window));
        }
    }
    text
}

fn line(window: &WindowReplay) -> String {
    let um = |m: f64| m * 1e6;
    let mut line = match window.periods {
        0 => "no period was replayed".to_owned(),
        periods => format!(
            "{periods} periods, their errors differ by at most {:.4} µm, {:.4} µm in the mean",
            um(window.largest_difference_m),
            um(window.mean_difference_m)
        ),
    };
    if let Some(doubt) = window.doubt() {
        let _ = write!(line, "; SUSPECT: {doubt}");
    }
    line
}
