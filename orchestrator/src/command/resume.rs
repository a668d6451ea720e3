//! `matrix resume RUN`: goes on with a run that was interrupted or killed.

use std::path::PathBuf;

use clap::Args;
use reports::run_directory::{PlanRecord, PlannedScenario};
use serde_json::{Value, json};

use crate::{
    arguments::OutputArguments,
    command::report,
    exit::Exit,
    run::{
        keep::Keep,
        record::RecordedRun,
        session::{self, Show, Wishes},
        state::RunState,
    },
    state_directory::StateDirectory,
    terminal::{self, Complaint},
};

/// What it takes.
#[derive(Debug, Args)]
pub struct ResumeArguments {
    /// The run directory.
    run: PathBuf,
    /// Say what would be done, create nothing.
    #[arg(long)]
    dry_run: bool,
    /// Which environments to keep when they have done their work, for `matrix shell`.
    #[arg(long, value_enum, value_name = "WHEN", default_value = "never")]
    keep: Keep,
    #[command(flatten)]
    pub(crate) output: OutputArguments,
}

/// Goes on and reports.
///
/// # Errors
/// When the run directory cannot be read, another process works on it, or the run cannot go on.
pub async fn execute(arguments: &ResumeArguments) -> Result<Exit, Complaint> {
    // Read before locking: a folder that is not a run must not get a lock file.
    let directory = RecordedRun::directory(&arguments.run)?;
    let recorded = RecordedRun::read(&directory)?;
    recorded.is_here(&directory, &StateDirectory::of_this_user())?;
    if arguments.dry_run {
        let state = recorded.state_in(&directory);
        let left = what_is_left(&recorded.plan, &state);
        match arguments.output.json {
            true => terminal::json(&as_json(&recorded.manifest.run, &left)),
            false => terminal::result(&as_text(&left)),
        }
        return Ok(Exit::Done);
    }
    let _lock = session::lock(&directory, &recorded.manifest.run)?;
    let recorded = RecordedRun::read(&directory)?;
    let show = if arguments.output.quiet {
        Show::Nothing
    } else {
        Show::Progress
    };
    let exit = session::carry_out(
        &directory,
        &recorded.manifest,
        &recorded.plan,
        &recorded.roster()?,
        recorded.state,
        Wishes {
            resumed: true,
            show,
            keep: arguments.keep,
        },
    )
    .await?;
    report::after_run(&directory, exit, arguments.output)
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
        (!state.is_settled()).then(|| Left {
            scenario,
            windows: state.wanted(scenario.settings.windows),
            environment: state.open.map(|open| open.environment),
        })
    });
    left.collect()
}

fn as_json(run: &str, left: &[Left<'_>]) -> Value {
    json!({
        "run": run,
        "scenarios": left.iter().map(|left| json!({
            "id": left.scenario.id,
            "slug": left.scenario.slug,
            "host": left.scenario.host,
            "windows": left.windows,
            "environment": left.environment,
        })).collect::<Vec<_>>(),
    })
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
