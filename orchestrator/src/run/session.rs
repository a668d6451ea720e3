//! What `matrix run` and `matrix resume` have in common: signals, observers, execution, and what is said afterwards.
//! The main function is [`carry_out`].

use std::{io::IsTerminal, path::Path};

use reports::run_directory::{Manifest, Outcome, PlanRecord, RunDirectory};
use tokio::{
    signal::unix::{SignalKind, signal},
    sync::RwLock,
};

use super::{
    Run,
    keep::Keep,
    register::{self, AtWork, Entry},
    state::RunState,
    stop::{self, StopSwitch},
};
use crate::{
    exit::Exit,
    journal::Journal,
    lease::{self, Holder, Lease, LeaseError},
    observer::{Events, Observer, plain_log::PlainLog, progress_bars::ProgressBars},
    provider::Roster,
    state_directory::{self, StateDirectory},
    terminal::{self, Complaint},
};

/// How a run is shown while it runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Show {
    /// Bars on a terminal, lines elsewhere.
    Progress,
    /// Nothing.
    Nothing,
}

/// How a run is to be carried out.
#[derive(Debug, Clone, Copy)]
pub struct Wishes {
    /// Whether it goes on with an earlier start.
    pub resumed: bool,
    /// How it is shown.
    pub show: Show,
    /// Which environments stay.
    pub keep: Keep,
}

/// A run that this process works on: by its directory, and by its name, should the directory be moved meanwhile.
#[derive(Debug)]
pub struct Locked {
    _directory: Lease,
    _name: AtWork,
}

/// Locks a run for this process.
///
/// # Errors
/// When another process works on it, or it cannot be locked.
pub fn lock(directory: &RunDirectory, run: &str) -> Result<Locked, Complaint> {
    let holder = Holder::this_process(directory.path());
    let wrong = |error: LeaseError, hint: Option<&str>| {
        Complaint::new(Exit::Infrastructure, &error, hint.map(str::to_owned))
    };
    let held = |holder: String| Complaint {
        what: format!("{} is being worked on by {holder}", directory.path().display()).into(),
        hint: Some("wait for it, or end it with Ctrl-C and `matrix resume`".to_owned()),
        exit: Exit::Infrastructure,
    };
    let by_directory = lease::ask(&directory.lock(), &holder)
        .map_err(|error| wrong(error, None))?
        .granted()
        .map_err(held)?;
    let by_name = register::take(&StateDirectory::of_this_user(), &holder, run)
        .map_err(|error| wrong(error, Some(state_directory::CHOOSE)))?
        .map_err(held)?;
    Ok(Locked {
        _directory: by_directory,
        _name: by_name,
    })
}

/// Carries out what is left to do of a plan, from `state` on; how it ended, as an exit code.
///
/// # Errors
/// When the run cannot go on.
pub async fn carry_out(
    directory: &RunDirectory,
    manifest: &Manifest,
    plan: &PlanRecord,
    roster: &Roster,
    state: RunState,
    wishes: Wishes,
) -> Result<Exit, Complaint> {
    let journal = Journal::open(&directory.journal())
        .map_err(|error| Complaint::new(Exit::Infrastructure, &error, Some(error.hint())))?;
    // Before anything is created there.
    if let Some(entry) = Entry::of(manifest, plan, directory.path()) {
        entry
            .enter(&StateDirectory::of_this_user())
            .map_err(|error| Complaint::new(Exit::Infrastructure, &error, None))?;
    }
    let (switch, stop) = stop::stop_switch();
    tokio::spawn(listen(switch, directory.path().to_owned()));
    let run = Run {
        name: manifest.run.clone(),
        directory: directory.clone(),
        plan,
        events: Events::new(journal, state, observers(plan, wishes.show)),
        fleet: roster,
        stop,
        keep: wishes.keep,
        this_machine: RwLock::default(),
    };
    run.execute(wishes.resumed)
        .await
        .map_err(|error| Complaint::new(Exit::Infrastructure, &error, error.hint()))?;
    Ok(exit(&run.events.state(), plan))
}

fn observers(plan: &PlanRecord, show: Show) -> Vec<Box<dyn Observer>> {
    match show {
        Show::Nothing => Vec::new(),
        Show::Progress if std::io::stderr().is_terminal() => vec![Box::new(ProgressBars::new(plan))],
        Show::Progress => vec![Box::new(PlainLog::new(std::io::stderr()))],
    }
}

/// The first Ctrl-C or SIGTERM asks to stop in order; the second leaves at once, with everything as it is.
async fn listen(switch: StopSwitch, directory: std::path::PathBuf) {
    let (Ok(mut interrupt), Ok(mut terminate)) =
        (signal(SignalKind::interrupt()), signal(SignalKind::terminate()))
    else {
        return;
    };
    for first in [true, false] {
        tokio::select! {
            _ = interrupt.recv() => {}
            _ = terminate.recv() => {}
        }
        if first {
            switch.request();
            terminal::remark("stopping: complete windows are collected; once more to leave at once");
        } else {
            terminal::remark(&how_to_go_on(&directory));
            std::process::exit(i32::from(Exit::Interrupted.code()));
        }
    }
}

/// How to go on with a run, and how to clean up after it.
#[must_use]
pub fn how_to_go_on(directory: &Path) -> String {
    format!(
        "`matrix resume {}` goes on, `matrix clean` removes what is left behind",
        terminal::pasted(directory)
    )
}

/// The exit code of a run, as docs/exit-codes.md has it.
fn exit(state: &RunState, plan: &PlanRecord) -> Exit {
    let outcomes: Vec<Option<Outcome>> = plan
        .scenarios
        .iter()
        .filter(|planned| planned.runs())
        .map(|planned| state.scenario(&planned.slug).outcome)
        .collect();
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
