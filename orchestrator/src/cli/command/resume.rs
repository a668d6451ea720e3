//! `matrix resume RUN`: goes on with a run that was interrupted or killed.

use std::path::PathBuf;

use clap::Args;
use record::{
    exit::matrix::Exit,
    run_directory::{PlanRecord, PlannedScenario, RunState},
};
use schemars::JsonSchema;
use serde::Serialize;

use crate::{
    cli::{
        command::{options::OutputArguments, report},
        completion,
        run_argument::run_argument,
        session::{self, JobArguments, RunOptions},
        terminal::{self, CommandError},
    },
    provider::Catalogue,
    run::{keep::Keep, recorded::RecordedRun, session::lock},
    state_directory::StateDirectory,
};

/// What it takes.
#[derive(Debug, Args)]
pub struct ResumeArguments {
    /// The run directory.
    #[arg(value_parser = run_argument(), add = completion::runs())]
    run: PathBuf,
    /// Say what would be done, create nothing.
    #[arg(long)]
    dry_run: bool,
    /// Which environments to keep when they have done their work, for `matrix shell`.
    #[arg(long, value_enum, value_name = "WHEN", default_value = "never")]
    keep: Keep,
    #[command(flatten)]
    jobs: JobArguments,
    #[command(flatten)]
    pub(crate) output: OutputArguments,
}

/// Goes on and reports.
///
/// # Errors
/// When the run directory cannot be read, another process works on it, or the run cannot go on.
pub async fn execute(arguments: &ResumeArguments, catalogue: Catalogue) -> Result<Exit, CommandError> {
    // Read before locking: a folder that is not a run must not get a lock file.
    let directory = RecordedRun::directory(&arguments.run)?;
    let recorded = RecordedRun::read_unpruned(&directory)?;
    recorded.is_here(&directory, &StateDirectory::of_this_user())?;
    if arguments.dry_run {
        let state = recorded.state_in(&directory);
        let left = what_is_left(&recorded.plan, &state);
        match arguments.output.json {
            true => terminal::json(&document(&recorded.manifest.run, &left)),
            false => terminal::result(&as_text(&left)),
        }
        return Ok(Exit::Done);
    }
    let _lock = lock(&directory, &recorded.manifest.run)?;
    let recorded = RecordedRun::read_unpruned(&directory)?;
    let carried = session::carry_out(
        &directory,
        &recorded.manifest,
        &recorded.plan,
        &recorded.providers(catalogue)?,
        recorded.state,
        RunOptions {
            resumed: true,
            show: arguments.output.progress(),
            keep: arguments.keep,
            patience: arguments.jobs.patience(),
        },
    )
    .await?;
    report::after_run(&directory, carried, arguments.output)
}

/// What `matrix resume` would do.
#[derive(Debug, Serialize, JsonSchema)]
#[schemars(title = "matrix resume --dry-run --json")]
pub struct ResumeDocument<'a> {
    /// The run's name.
    run: &'a str,
    /// The scenarios that are not done.
    scenarios: Vec<LeftRecord<'a>>,
}

/// A scenario that is not done.
#[derive(Debug, Serialize, JsonSchema)]
struct LeftRecord<'a> {
    /// Its letter.
    id: &'a str,
    /// Its name in files.
    slug: &'a str,
    /// Name of the host that runs it.
    host: Option<&'a str>,
    /// Numbers of the windows that are not in the run directory.
    windows: &'a [u32],
    /// The environment that may exist and is looked for first; null if there is none.
    environment: Option<&'a str>,
}

/// A scenario that a run is not done with.
struct Left<'a> {
    scenario: &'a PlannedScenario,
    /// The windows that are not in the run directory.
    windows: Vec<u32>,
    /// The environment that may exist and is looked for first.
    environment: Option<String>,
}

fn what_is_left<'a>(plan: &'a PlanRecord, state: &RunState) -> Vec<Left<'a>> {
    let running = plan.scenarios.iter().filter(|planned| planned.runs());
    let left = running.filter_map(|scenario| {
        let state = state.scenario(&scenario.slug);
        (!state.is_settled(scenario.rounds())).then(|| Left {
            scenario,
            windows: state.wanted(1..=scenario.settings.all_windows()),
            environment: state.open().next().map(|open| open.environment.clone()),
        })
    });
    left.collect()
}

fn document<'a>(run: &'a str, left: &'a [Left<'a>]) -> ResumeDocument<'a> {
    let scenarios = left.iter().map(|left| LeftRecord {
        id: &left.scenario.id,
        slug: &left.scenario.slug,
        host: left.scenario.host.as_deref(),
        windows: &left.windows,
        environment: left.environment.as_deref(),
    });
    ResumeDocument {
        run,
        scenarios: scenarios.collect(),
    }
}

fn as_text(left: &[Left<'_>]) -> String {
    if left.is_empty() {
        return "nothing is left to do\n".to_owned();
    }
    let line = |left: &Left<'_>| {
        let windows: Vec<String> = left.windows.iter().map(u32::to_string).collect();
        let environment = left
            .environment
            .as_ref()
            .map(|environment| format!(", after looking for {environment}"));
        format!(
            "{}: windows {}{}\n",
            left.scenario.slug,
            windows.join(", "),
            environment.unwrap_or_default()
        )
    };
    left.iter().map(line).collect()
}
