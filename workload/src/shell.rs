//! A program of a person's in a virtual host of a network that is made for it: the experiment is rehearsed by another process, and
//! ends with the program. The function is [`run`].

use std::{
    env,
    ffi::OsStr,
    io::{self, BufRead, BufReader, Lines},
    process::{Child, ChildStdout, Command, ExitStatus, Stdio},
    thread,
};

use nix::sys::signal::{Signal, kill};
use record::{
    call::{Rehearse, Shell},
    progress::Progress,
    settings::Settings,
};

use crate::child_process::{self, pid};

/// What a person gets who names no program.
const SHELL: &str = "/bin/sh";

/// Why there is nothing to be in.
#[derive(Debug, thiserror::Error)]
pub enum ShellError {
    /// This program, or the person's, could not be started.
    #[error("{program} could not be started")]
    Start {
        /// Which.
        program: String,
        /// What the kernel said.
        source: io::Error,
    },
    /// The experiment could not be rehearsed.
    #[error("the experiment could not be rehearsed: {reason}")]
    NotRehearsed {
        /// What failed.
        reason: String,
        /// What to do about it.
        hint: Option<String>,
    },
}

impl ShellError {
    /// What to do about it.
    #[must_use]
    pub fn hint(&self) -> Option<&str> {
        match self {
            Self::Start { .. } => None,
            Self::NotRehearsed { hint, .. } => hint.as_deref(),
        }
    }
}

/// Returns when the program has ended. The calling process must block SIGINT: Ctrl-C is the program's.
///
/// # Errors
/// When the experiment cannot be rehearsed here, or the program not be started.
pub fn run(call: &Shell, settings: &Settings) -> Result<ExitStatus, ShellError> {
    let own = env::current_exe().map_err(starting("the workload"))?;
    let mut rehearsing = Command::new(&own);
    // In no group that a terminal sends signals to.
    rehearsing
        .args(Rehearse::of(settings).arguments())
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::null());
    std::os::unix::process::CommandExt::process_group(&mut rehearsing, 0);
    let mut rehearsal = child_process::spawn(&mut rehearsing).map_err(starting("the workload"))?;
    let outcome = enter(call, settings, &own, &mut rehearsal);
    // It has not been waited for, so that its number is nobody else's.
    let _ = kill(pid(&rehearsal), Signal::SIGTERM);
    let _ = rehearsal.wait();
    outcome
}

fn enter(
    call: &Shell,
    settings: &Settings,
    own: &std::path::Path,
    rehearsal: &mut Child,
) -> Result<ExitStatus, ShellError> {
    let mut lines = BufReader::new(rehearsal.stdout.take().ok_or_else(ended_early)?).lines();
    until_ready(&mut lines, settings)?;
    // Whoever writes to a pipe that nobody reads stands still.
    thread::spawn(move || lines.for_each(drop));
    let program = match call.program.as_slice() {
        [] => &[SHELL.into()],
        named => named,
    };
    let mut entering = Command::new(own);
    entering
        .args(["enter", &rehearsal.id().to_string(), call.host.name()])
        .args(program);
    let mut entered = child_process::spawn(&mut entering).map_err(starting("the workload"))?;
    entered.wait().map_err(starting(&program.first().map_or_else(
        || SHELL.to_owned(),
        |program| OsStr::new(program).to_string_lossy().into_owned(),
    )))
}

/// Until the hosts can be entered, and the experiment's own nodes run.
fn until_ready(lines: &mut Lines<BufReader<ChildStdout>>, settings: &Settings) -> Result<(), ShellError> {
    for line in lines.map_while(Result::ok) {
        match serde_json::from_str(&line) {
            Ok(Progress::Rehearsing { .. }) => return Ok(()),
            Ok(Progress::NetworkUp) if settings.experiment.is_some() => return Ok(()),
            Ok(Progress::Failed { reason, hint, .. }) => {
                return Err(ShellError::NotRehearsed { reason, hint });
            }
            _ => {}
        }
    }
    Err(ended_early())
}

fn ended_early() -> ShellError {
    ShellError::NotRehearsed {
        reason: "the workload ended before its network was up".to_owned(),
        hint: None,
    }
}

fn starting(program: &str) -> impl Fn(io::Error) -> ShellError {
    let program = program.to_owned();
    move |source| ShellError::Start {
        program: program.clone(),
        source,
    }
}
