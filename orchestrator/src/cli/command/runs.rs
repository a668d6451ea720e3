//! `matrix runs [DIR]`: the runs in a folder, the newest first, each with how it ended.

use std::path::{Path, PathBuf};

use clap::{Args, ValueHint};
use record::{exit::matrix::Exit, run_directory::RunDirectory};
use schemars::JsonSchema;
use serde::Serialize;

use super::status::{self, RunStanding};
use crate::{
    cli::{
        command::options::OutputArguments,
        run_argument::{RUNS, is_run},
        session,
        terminal::{self, CommandError},
    },
    run::recorded::{RecordedRun, newest_first},
};

/// What it takes.
#[derive(Debug, Args)]
pub struct RunsArguments {
    /// The folder that the run directories are in.
    #[arg(default_value = RUNS, value_hint = ValueHint::DirPath)]
    folder: PathBuf,
    #[command(flatten)]
    pub(crate) output: OutputArguments,
}

/// The runs in a folder.
#[derive(Debug, Serialize, JsonSchema)]
#[schemars(title = "matrix runs --json")]
pub struct RunsDocument {
    /// The newest first.
    runs: Vec<RunRecord>,
}

/// A run.
#[derive(Debug, Serialize, JsonSchema)]
struct RunRecord {
    /// Its run directory.
    directory: PathBuf,
    /// When it was asked for, RFC 3339; null if its records cannot be read.
    created: Option<String>,
    /// `live` (a `matrix` works on it now), `completed`, `failed` (a workload said that the experiment went wrong), `errored` (the
    /// infrastructure failed), `not finished` or `unreadable`.
    state: &'static str,
    /// Why it cannot be read; null if it can.
    reason: Option<String>,
    /// Scenarios that were planned to run.
    scenarios: usize,
    /// Their windows.
    windows: u32,
    /// Those of them that are measured, collected or not.
    windows_complete: usize,
    /// Those of them that are collected and do not count.
    windows_invalid: usize,
    /// Whether `matrix prune` removed what was measured.
    pruned: bool,
    /// The matrix file.
    matrix_file: Option<String>,
}

impl RunRecord {
    fn of(path: &Path) -> Self {
        let directory = RunDirectory::new(path);
        let recorded = match RecordedRun::read(&directory) {
            Ok(recorded) => recorded,
            Err(error) => {
                return Self {
                    directory: path.to_owned(),
                    created: None,
                    state: "unreadable",
                    reason: Some(error.to_string()),
                    scenarios: 0,
                    windows: 0,
                    windows_complete: 0,
                    windows_invalid: 0,
                    pruned: false,
                    matrix_file: None,
                };
            }
        };
        let standing = RunStanding::of(&directory, &recorded);
        let running = recorded.plan.scenarios.iter().filter(|planned| planned.runs());
        Self {
            directory: path.to_owned(),
            state: match (standing.live, session::exit(&recorded.state, &recorded.plan)) {
                (true, _) => "live",
                (false, Exit::Done) => "completed",
                (false, Exit::ScenarioFailed) => "failed",
                (false, Exit::Interrupted) => "not finished",
                (false, _) => "errored",
            },
            reason: None,
            scenarios: running.count(),
            windows: standing.windows(),
            windows_complete: standing.windows_complete(),
            windows_invalid: standing.windows_invalid(),
            pruned: directory.pruned().exists(),
            created: Some(recorded.manifest.created),
            matrix_file: Some(recorded.manifest.matrix_file),
        }
    }

    fn as_text(&self) -> [String; 4] {
        let counted = |count: usize, noun: &str| match count {
            1 => format!("1 {noun}"),
            many => format!("{many} {noun}s"),
        };
        [
            self.directory.display().to_string(),
            self.state.to_owned(),
            match &self.reason {
                Some(reason) => reason.clone(),
                None => {
                    let pruned = if self.pruned { ", pruned" } else { "" };
                    let invalid = status::invalid(self.windows_invalid);
                    format!(
                        "{} of {} windows{invalid}{pruned}",
                        self.windows_complete, self.windows
                    )
                }
            },
            match &self.matrix_file {
                Some(file) => {
                    let name = Path::new(file).file_name().unwrap_or_default().to_string_lossy();
                    format!("{}, {name}", counted(self.scenarios, "scenario"))
                }
                None => String::new(),
            },
        ]
    }
}

/// Prints them.
///
/// # Errors
/// When there is no such folder.
pub fn execute(arguments: &RunsArguments) -> Result<Exit, CommandError> {
    let folder = &arguments.folder;
    if !folder.is_dir() {
        return Err(CommandError {
            what: format!("there is no folder {}", folder.display()).into(),
            hint: Some(
                "`matrix run` makes `runs/` where it is started: go there, or name the folder that your runs are in"
                    .to_owned(),
            ),
            exit: Exit::Wrong,
        });
    }
    let found = newest_first(folder).into_iter().filter(|path| is_run(path));
    let runs: Vec<RunRecord> = found.map(|path| RunRecord::of(&path)).collect();
    if arguments.output.json {
        terminal::json(&RunsDocument { runs });
        return Ok(Exit::Done);
    }
    let rows: Vec<[String; 4]> = runs.iter().map(RunRecord::as_text).collect();
    let width = |column: usize| {
        let cells = rows.iter().filter_map(|row| row.get(column));
        cells.map(|cell| cell.chars().count()).max().unwrap_or(0)
    };
    let widths = [width(0), width(1), width(2)];
    let line = |[directory, state, windows, rest]: &[String; 4]| {
        let [a, b, c] = widths;
        let line = format!("{directory:a$}  {state:b$}  {windows:c$}  {rest}");
        format!("{}\n", line.trim_end())
    };
    match rows.is_empty() {
        true => terminal::result(&format!("no run in {}\n", folder.display())),
        false => terminal::result(&rows.iter().map(line).collect::<String>()),
    }
    Ok(Exit::Done)
}
