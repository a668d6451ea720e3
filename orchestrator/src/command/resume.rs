//! `matrix resume RUN`: goes on with a run that was interrupted or killed.

use std::path::PathBuf;

use clap::Args;

use crate::{
    arguments::OutputArguments,
    command::report,
    exit::Exit,
    run::{
        record::RecordedRun,
        session::{self, Show},
    },
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
    RecordedRun::read(&directory)?;
    if arguments.dry_run {
        terminal::result(&what_is_left(&RecordedRun::read(&directory)?));
        return Ok(Exit::Done);
    }
    let _lock = session::lock(&directory)?;
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
        true,
        show,
    )
    .await?;
    report::after_run(&directory, exit, arguments.output)
}

fn what_is_left(recorded: &RecordedRun) -> String {
    let mut text = String::new();
    for planned in recorded.plan.scenarios.iter().filter(|planned| planned.runs()) {
        let state = recorded.state.scenario(&planned.slug);
        if state.is_settled() {
            continue;
        }
        let windows: Vec<String> = state
            .wanted(planned.settings.windows)
            .iter()
            .map(u32::to_string)
            .collect();
        let open = state
            .open
            .map(|open| format!(", after looking for {}", open.environment));
        text.push_str(&format!(
            "{}: windows {}{}\n",
            planned.slug,
            windows.join(", "),
            open.unwrap_or_default()
        ));
    }
    if text.is_empty() {
        "nothing is left to do\n".to_owned()
    } else {
        text
    }
}
