//! `matrix watch RUN`: follows a run that this or another process carries out, until it ends. It only reads: it can be begun and left
//! at any time.

use std::{
    io::{self, IsTerminal as _},
    path::PathBuf,
    time::Duration,
};

use clap::Args;
use record::{
    exit::matrix::Exit,
    run_directory::{Journal, RunState},
};
use tokio::time::sleep;

use super::{
    report::unreadable,
    status::{self, RunStanding},
};
use crate::{
    cli::{
        completion,
        plain_log::PlainLog,
        progress_bars::ProgressBars,
        run_argument::run_argument,
        terminal::{self, CommandError},
    },
    escaping, lease,
    observer::Observer as _,
    run::recorded::RecordedRun,
};

/// How often the journal is looked at. It has a line or two for each window.
const LOOK: Duration = Duration::from_secs(1);

/// What it takes.
#[derive(Debug, Args)]
pub struct WatchArguments {
    /// The run directory.
    #[arg(default_value = "latest", value_parser = run_argument(), add = completion::runs())]
    run: PathBuf,
}

/// Bars on a terminal, lines elsewhere.
enum View {
    Bars(ProgressBars),
    Lines(PlainLog<io::Stderr>),
}

/// Follows it, and says where it stands when it has ended.
///
/// # Errors
/// When the run directory cannot be read.
pub async fn execute(arguments: &WatchArguments) -> Result<Exit, CommandError> {
    let directory = RecordedRun::directory(&arguments.run)?;
    let mut recorded = RecordedRun::read(&directory)?;
    let mut view = match io::stderr().is_terminal() {
        true => View::Bars(ProgressBars::new(&recorded.plan, &RunState::default())),
        false => View::Lines(PlainLog::new(io::stderr())),
    };
    let journal = directory.journal();
    let (mut read, mut seen) = (None, 0);
    let mut state = RunState::default();
    loop {
        // Before the journal: what is written after this is seen next time.
        let live = lease::is_held(&directory.lock());
        let length = journal.bytes().ok();
        if length != read {
            read = length;
            let entries = Journal::read(&journal)
                .map_err(|error| unreadable(&error))?
                .entries;
            for entry in entries.iter().skip(seen) {
                state.apply(entry);
                match &mut view {
                    View::Bars(bars) => bars.observe(&entry.event),
                    View::Lines(lines) => lines.observe(&entry.event),
                }
            }
            seen = entries.len();
        }
        // The lock of another user's run looks held for ever.
        if !live || state.finished {
            break;
        }
        if let View::Bars(bars) = &mut view {
            for (slug, scenario) in &state.scenarios {
                if let Some((window, since)) = scenario.under_way() {
                    bars.estimate(slug, window, status::elapsed(since));
                }
            }
        }
        sleep(LOOK).await;
    }
    drop(view);
    recorded.state = state;
    let standing = RunStanding::of(&directory, &recorded);
    let (run, windows) = (escaping::pasted(directory.path()), standing.windows());
    let measured = format!(
        "{} of {windows} windows are measured",
        standing.windows_complete()
    );
    terminal::print_note(&match standing.finished {
        true => format!("the run has ended, {measured}: `matrix report {run}` says what was found"),
        false => format!("nobody works on this run any more, {measured}: `matrix resume {run}` goes on"),
    });
    Ok(Exit::Done)
}
