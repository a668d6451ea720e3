//! A run as a person or a pipe follows it: signals, what is shown, and the exit code. The main function is [`carry_out`].

use std::{
    io::IsTerminal as _,
    path::{Path, PathBuf},
};

use record::{
    exit::matrix::Exit,
    run_directory::{Manifest, Outcome, PlanRecord, RunDirectory, RunState},
};
use tokio::signal::unix::{Signal, SignalKind, signal};

use super::{
    plain_log::PlainLog,
    progress_bars::ProgressBars,
    terminal::{self, CommandError},
};
use crate::{
    escaping,
    observer::Observer,
    provider::Providers,
    run::{
        Patience,
        keep::Keep,
        recorded::RecordedRunError,
        session::{self, LockError, Options, SessionError},
        stop::{self, StopSwitch},
    },
};

/// How a run is shown while it runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ProgressDisplay {
    /// Bars on a terminal, lines elsewhere.
    Progress,
    /// Nothing.
    Nothing,
}

/// What the command line says of how a run is carried out.
#[derive(Debug, Clone, Copy)]
pub struct RunOptions {
    /// Whether it goes on with an earlier start.
    pub resumed: bool,
    /// How it is shown.
    pub show: ProgressDisplay,
    /// Which environments stay.
    pub keep: Keep,
    /// Whether jobs are waited for.
    pub patience: Patience,
}

/// What a user says of the jobs of clusters.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct JobArguments {
    /// Of hosts that are clusters, collect what has ended, submit the jobs that are missing, and leave. Other hosts measure nothing.
    #[arg(long)]
    submit: bool,
}

impl JobArguments {
    /// Whether jobs are waited for.
    #[must_use]
    pub const fn patience(self) -> Patience {
        match self.submit {
            true => Patience::LeavesJobs,
            false => Patience::WaitsForJobs,
        }
    }
}

/// How a process ended its work on a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Carried {
    /// There is nothing more to do, or it was asked to stop.
    Out(Exit),
    /// So many jobs are in their queues, and it does not wait for them.
    Left(usize),
}

/// Carries out what is left to do of a plan, from `state` on; how it ended, as an exit code. The first Ctrl-C or SIGTERM asks the
/// run to stop.
///
/// # Errors
/// When the run cannot go on.
pub async fn carry_out(
    directory: &RunDirectory,
    manifest: &Manifest,
    plan: &PlanRecord,
    providers: &Providers,
    state: RunState,
    options: RunOptions,
) -> Result<Carried, CommandError> {
    let (switch, stop) = stop::stop_switch();
    // From here on a signal is heard: in a task of its own it would be some time after the journal's first lines.
    if let (Ok(interrupt), Ok(terminate)) = (signal(SignalKind::interrupt()), signal(SignalKind::terminate()))
    {
        tokio::spawn(listen(
            [interrupt, terminate],
            switch,
            directory.path().to_owned(),
        ));
    }
    let options = Options {
        resumed: options.resumed,
        keep: options.keep,
        patience: options.patience,
        observers: observers(plan, &state, options.show),
        stop: stop.clone(),
    };
    let patience = options.patience;
    let state = session::carry_out(directory, manifest, plan, providers, state, options).await?;
    let exit = exit(&state, plan);
    if exit != Exit::Interrupted || patience == Patience::WaitsForJobs || stop.is_requested() {
        return Ok(Carried::Out(exit));
    }
    let open = state.scenarios.values().flat_map(|scenario| scenario.open());
    Ok(Carried::Left(open.count()))
}

/// What is to be known of a run that was left.
pub fn print_left(directory: &Path, jobs: usize) {
    let run = escaping::pasted(directory);
    terminal::print_note(&format!(
        "{jobs} jobs are submitted or measure; `matrix resume {run} --submit` collects what has ended and submits what is missing, \
         `matrix resume {run}` waits for all, `matrix clean` takes them back"
    ));
}

impl From<SessionError> for CommandError {
    fn from(error: SessionError) -> Self {
        Self::new(Exit::Infrastructure, &error, error.hint())
    }
}

impl From<LockError> for CommandError {
    fn from(error: LockError) -> Self {
        Self::new(Exit::Infrastructure, &error, error.hint())
    }
}

impl From<RecordedRunError> for CommandError {
    fn from(error: RecordedRunError) -> Self {
        let exit = match error {
            RecordedRunError::Create { .. } => Exit::Infrastructure,
            _ => Exit::Wrong,
        };
        Self::new(exit, &error, Some(error.hint()))
    }
}

fn observers(plan: &PlanRecord, state: &RunState, show: ProgressDisplay) -> Vec<Box<dyn Observer>> {
    match show {
        ProgressDisplay::Nothing => Vec::new(),
        ProgressDisplay::Progress if std::io::stderr().is_terminal() => {
            vec![Box::new(ProgressBars::new(plan, state))]
        }
        ProgressDisplay::Progress => vec![Box::new(PlainLog::new(std::io::stderr()))],
    }
}

/// The first Ctrl-C or SIGTERM asks to stop in order; the second leaves at once, with everything as it is.
async fn listen([mut interrupt, mut terminate]: [Signal; 2], switch: StopSwitch, directory: PathBuf) {
    for first in [true, false] {
        tokio::select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
        }
        if first {
            switch.request();
            terminal::print_note("stopping: complete windows are collected; once more to leave at once");
        } else {
            terminal::print_note(&how_to_go_on(&directory));
            std::process::exit(i32::from(Exit::Interrupted.code()));
        }
    }
}

/// How to go on with a run, and how to clean up after it.
#[must_use]
pub fn how_to_go_on(directory: &Path) -> String {
    format!(
        "`matrix resume {}` goes on, `matrix clean` removes what is left behind",
        escaping::pasted(directory)
    )
}

/// The exit code of a run, as docs/exit-codes.md has it.
#[must_use]
pub fn exit(state: &RunState, plan: &PlanRecord) -> Exit {
    let outcomes = state.outcomes(plan);
    let any = |outcome| outcomes.contains(&outcome);
    if state.is_interrupted(plan) {
        Exit::Interrupted
    } else if any(Some(Outcome::Errored)) || outcomes.is_empty() {
        Exit::Infrastructure
    } else if any(Some(Outcome::Failed)) {
        Exit::ScenarioFailed
    } else {
        Exit::Done
    }
}
