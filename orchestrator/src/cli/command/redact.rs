//! `matrix redact RUN… --output DIR`: copies of runs that name nobody, for a review in which nobody is to know who measured.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
};

use clap::Args;
use record::{
    exit::matrix::Exit,
    run_directory::{ReadError, RunDirectory, RunRecords},
};
use reports::redaction::{self, CopyError, Redaction};
use schemars::JsonSchema;
use serde::Serialize;

use super::report::{ensure_all_can_be_open, redaction, unreadable, word_of_the_format};
use crate::cli::{
    command::options::OutputArguments,
    completion,
    run_argument::run_argument,
    terminal::{self, CommandError},
};

/// What it takes.
#[derive(Debug, Args)]
pub struct RedactArguments {
    /// The run directories. A name gets the same other name in all of them.
    #[arg(required = true, value_name = "RUN", value_parser = run_argument(), add = completion::runs())]
    runs: Vec<PathBuf>,
    /// The folder in which the copies are made, each under its run's name.
    #[arg(long = "output", value_name = "DIR")]
    into: PathBuf,
    /// Another name to go. May be repeated.
    #[arg(long, value_name = "NAME")]
    also: Vec<String>,
    #[command(flatten)]
    pub(crate) output: OutputArguments,
}

/// Copies of runs, and the names that were replaced in them.
#[derive(Debug, Serialize, JsonSchema)]
#[schemars(title = "matrix redact --json")]
pub struct RedactDocument<'a> {
    /// The copies' run directories.
    copies: &'a [PathBuf],
    /// Each name that was replaced, with the name in its place.
    names: BTreeMap<&'a str, &'a str>,
    /// The names that were not replaced, because an axis has them.
    kept: &'a BTreeSet<String>,
}

/// Makes the copies and says what was replaced.
///
/// # Errors
/// When a run cannot be read, or its copy not be written or read again.
pub fn execute(arguments: &RedactArguments) -> Result<Exit, CommandError> {
    let runs: Vec<RunDirectory> = arguments.runs.iter().map(RunDirectory::new).collect();
    ensure_all_can_be_open(&runs)?;
    let redaction = redaction(&runs, &arguments.also)?;
    let copies = runs
        .iter()
        .map(|run| copy(run, &arguments.into, &redaction))
        .collect::<Result<Vec<_>, _>>()?;
    if arguments.output.json {
        terminal::json(&RedactDocument {
            copies: &copies,
            names: redaction.names(),
            kept: redaction.kept(),
        });
    } else {
        terminal::result(&as_text(&copies, &redaction));
    }
    Ok(Exit::Done)
}

/// Makes one copy, and reads it as a report would, so that its checksums hold.
fn copy(run: &RunDirectory, into: &Path, names: &Redaction) -> Result<PathBuf, CommandError> {
    let records = RunRecords::read_unpruned(run).map_err(|error| unreadable(&error))?;
    let name = names.text(&records.manifest.run);
    let to = into.join(name);
    redaction::copy(run, &to, names).map_err(|error| refused(&error))?;
    match reports::load(&to) {
        Ok(_) => Ok(to),
        Err(error @ ReadError::Json { .. }) => Err(word_of_the_format(&error)),
        Err(error) => Err(unreadable(&error)),
    }
}

fn refused(error: &CopyError) -> CommandError {
    let exit = match error {
        CopyError::Io { source, .. } => terminal::exit_of_writing(source),
        CopyError::Read(_) => Exit::Wrong,
        CopyError::Word(_) => return word_of_the_format(error),
    };
    CommandError::new(exit, error, Some(error.hint()))
}

fn as_text(copies: &[PathBuf], redaction: &Redaction) -> String {
    let replaced = redaction
        .names()
        .into_iter()
        .map(|(name, other)| format!("{name} is {other}\n"));
    let kept = redaction
        .kept()
        .iter()
        .map(|name| format!("{name} stays: an axis has it\n"));
    let copies = copies.iter().map(|copy| format!("{}\n", copy.display()));
    replaced.chain(kept).chain(copies).collect()
}
