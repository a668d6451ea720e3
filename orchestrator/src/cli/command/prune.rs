//! `matrix prune DIR --keep N`: removes what was measured in all runs but the newest, and keeps of each what `matrix drift` needs.

use std::path::PathBuf;

use clap::{Args, ValueHint};
use record::{causes::with_causes, exit::matrix::Exit, run_directory::RunDirectory};
use reports::drift::{Night, pruning::Measurements};
use schemars::JsonSchema;
use serde::Serialize;

use super::drift::History;
use crate::{
    cli::{
        command::options::OutputArguments,
        session,
        terminal::{self, CommandError},
    },
    disk_space::in_words,
    escaping,
    journal::now,
    run::{recorded::RecordedRun, session::lock},
};

/// What it takes.
#[derive(Debug, Args)]
pub struct PruneArguments {
    /// The folder that the run directories are in.
    #[arg(value_hint = ValueHint::DirPath)]
    folder: PathBuf,
    /// Leave that many of the newest runs as they are.
    #[arg(long, value_name = "N")]
    keep: usize,
    /// Only say what would be removed.
    #[arg(long)]
    dry_run: bool,
    #[command(flatten)]
    pub(crate) output: OutputArguments,
}

/// What became of each run.
#[derive(Debug, Serialize, JsonSchema)]
#[schemars(title = "matrix prune --json")]
pub struct PruneDocument {
    /// The earliest first.
    runs: Vec<PrunedRecord>,
    /// Run directories that cannot be read, and why. They stay as they are.
    unreadable: Vec<String>,
}

/// A run.
#[derive(Debug, Serialize, JsonSchema)]
struct PrunedRecord {
    /// Its run directory.
    directory: PathBuf,
    /// `pruned`, `would be pruned` (with `--dry-run`), `nothing to prune`, `kept` or `not pruned` (or only in part).
    fate: &'static str,
    /// Why it is kept or not pruned; null otherwise.
    reason: Option<String>,
    /// Files that were removed, or would be.
    files: usize,
    /// Their bytes.
    bytes: u64,
}

/// What became of a run.
enum Fate {
    Pruned,
    WouldBePruned,
    NothingLeft,
    /// It stays as it is, and why.
    Kept(String),
    /// It could not be removed, or only in part, and why.
    NotPruned(String),
}

impl Fate {
    const fn name(&self) -> &'static str {
        match self {
            Self::Pruned => "pruned",
            Self::WouldBePruned => WOULD_BE,
            Self::NothingLeft => "nothing to prune",
            Self::Kept(_) => "kept",
            Self::NotPruned(_) => NOT_PRUNED,
        }
    }

    fn reason(self) -> Option<String> {
        match self {
            Self::Kept(reason) | Self::NotPruned(reason) => Some(reason),
            Self::Pruned | Self::WouldBePruned | Self::NothingLeft => None,
        }
    }
}

const WOULD_BE: &str = "would be pruned";
const NOT_PRUNED: &str = "not pruned";

/// Removes it.
///
/// # Errors
/// When there is no such folder, or no run in it, or when its `drift.yaml` cannot be read.
pub fn execute(arguments: &PruneArguments) -> Result<Exit, CommandError> {
    let History {
        nights,
        told_of,
        unreadable,
    } = History::read(&arguments.folder)?;
    let first_kept = nights.len().saturating_sub(arguments.keep);
    let runs = nights.into_iter().enumerate().map(|(at, (night, directory))| {
        let path = directory.path().to_owned();
        let kept = |reason: &str| (Fate::Kept(reason.to_owned()), 0, 0);
        let (fate, files, bytes) = if at >= first_kept {
            kept("it is one of the newest")
        } else if told_of.contains(&night.run) {
            kept("`matrix drift` found a change there that nobody has acknowledged")
        } else {
            match prune(directory, &night, arguments.dry_run) {
                Ok(pruned) => pruned,
                Err(error) => (Fate::NotPruned(error.to_string()), 0, 0),
            }
        };
        PrunedRecord {
            directory: path,
            fate: fate.name(),
            reason: fate.reason(),
            files,
            bytes,
        }
    });
    let document = PruneDocument {
        runs: runs.collect(),
        unreadable,
    };
    match arguments.output.json {
        true => terminal::json(&document),
        false => terminal::result(&document.as_text()),
    }
    Ok(match document.runs.iter().any(|run| run.fate == NOT_PRUNED) {
        true => Exit::Infrastructure,
        false => Exit::Done,
    })
}

/// Why a run could not be pruned.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct NotPruned(String);

impl NotPruned {
    fn of(error: &dyn std::error::Error) -> Self {
        Self(with_causes(error))
    }
}

/// Removes what was measured in one run, while nobody else works on it; how many files, and their bytes.
fn prune(directory: RunDirectory, night: &Night, only_say: bool) -> Result<(Fate, usize, u64), NotPruned> {
    let _lock = lock(&directory, &night.run).map_err(|error| NotPruned::of(&error))?;
    let recorded = RecordedRun::read(&directory).map_err(|error| NotPruned::of(&error))?;
    if session::exit(&recorded.state, &recorded.plan) == Exit::Interrupted {
        let reason = format!(
            "it is not finished: `matrix resume {}` goes on with it",
            escaping::pasted(directory.path())
        );
        return Ok((Fate::Kept(reason), 0, 0));
    }
    let measured = Measurements::of(directory).map_err(|error| NotPruned::of(&error))?;
    let (files, bytes) = (measured.files(), measured.bytes());
    let fate = match () {
        () if files == 0 => Fate::NothingLeft,
        () if only_say => Fate::WouldBePruned,
        () => {
            measured
                .remove(night, &now())
                .map_err(|error| NotPruned::of(&error))?;
            Fate::Pruned
        }
    };
    Ok((fate, files, bytes))
}

impl PruneDocument {
    fn as_text(&self) -> String {
        let mut text = String::new();
        for run in &self.runs {
            let what = match &run.reason {
                Some(reason) => format!(": {reason}"),
                None if run.files == 1 => format!(": 1 file, {}", in_words(run.bytes)),
                None if run.files > 1 => format!(": {} files, {}", run.files, in_words(run.bytes)),
                None => String::new(),
            };
            text += &format!("{}  {}{what}\n", run.directory.display(), run.fate);
        }
        for reason in &self.unreadable {
            text += &format!("{reason}\n");
        }
        let bytes = self.runs.iter().map(|run| run.bytes).sum();
        let word = match self.runs.iter().any(|run| run.fate == WOULD_BE) {
            true => "would be",
            false => "were",
        };
        text + &format!(
            "{} {word} removed. Of a pruned run its records, its report and its night for\n`matrix drift` stay. Its logs and captures are gone for ever, and with \
             them new\nreports, `matrix explain`, `matrix replay` and `matrix messages` of it.\n",
            in_words(bytes)
        )
    }
}
