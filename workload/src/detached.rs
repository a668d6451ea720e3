//! `workload detached`: a workload that goes on by itself while its user comes and goes, and its agent. The same commands
//! serve this machine, a host over SSH and a VM, wherever this binary can be started.
//!
//! ```text
//! start ──starts── supervise ──starts── run --environment NAME --data ROOT/NAME/data
//!                   waits for it, writes ended.json
//! follow, ended, stop, remove, list, collect: each finds what it needs by itself, and may be cut at any moment
//!
//! prepare                     job, in a batch system's job ──starts── run --environment NAME --data ROOT/NAME/data
//!                               waits for it, writes ended.json
//! look: what there is by now, from a machine that sees the same folder
//! ```
//!
//! Nothing else has to live: the workload is found by its command line, and an end that the supervisor did not live to
//! see is noticed all the same. Each command is a file. [`record::call::Detached`] has the commands, and [`record::detached`] what they
//! read and answer; a failure is one line of JSON on standard error. The main function is [`run`].

mod collect;
mod container;
mod descriptor;
mod ended;
mod error;
mod folder;
mod follow;
mod job;
mod lease;
mod list;
mod look;
mod platform;
mod process;
mod remove;
mod start;
mod stop;
mod stream;
mod supervise;

use std::{
    io::{self, Write as _},
    process::ExitCode,
};

use record::{
    call::{Detached, Which},
    causes::with_causes,
    detached::Failure,
    exit::workload::Exit,
};

pub use self::{error::DetachedError, folder::EnvironmentFolder};

/// The folder of an environment.
fn folder(which: &Which) -> Result<EnvironmentFolder, DetachedError> {
    EnvironmentFolder::of(&which.root.root, &which.environment)
}

/// Does what is asked for: answers on standard output, fails on standard error.
#[must_use]
pub fn run(call: &Detached) -> ExitCode {
    match perform(call) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let failure = error.relayed().unwrap_or_else(|| Failure {
                error: with_causes(&error),
                hint: error.hint(),
            });
            // Nobody may be there any more to be told.
            let _ = stream::write_line(&mut io::stderr(), &failure);
            let exit = if error.is_of_call() {
                Exit::WrongCall
            } else {
                Exit::Failed
            };
            exit.into()
        }
    }
}

fn perform(call: &Detached) -> Result<(), DetachedError> {
    match call {
        Detached::Start(which) => answer(&start::start(&folder(which)?)?),
        Detached::Supervise(which) => supervise::supervise(&folder(which)?),
        Detached::Prepare(which) => start::prepare(&folder(which)?),
        Detached::Job(call) => job::job(&folder(&call.which)?, call),
        Detached::Look(call) => look::look(&folder(&call.which)?, call.from),
        Detached::Follow(call) => follow::follow(&folder(&call.which)?, call.from),
        Detached::Ended(which) => answer(&ended::ended(&folder(which)?)?),
        Detached::Stop(which) => answer(&stop::stop(&folder(which)?)?),
        Detached::Remove(call) => answer(&remove::remove(&folder(&call.which)?, call.grace.duration())?),
        Detached::List(root) => answer(&list::list(&root.root)?),
        Detached::RemoveBridge { name } => answer(&list::remove_bridge(name)?),
        Detached::Collect(which) => collect::collect(&folder(which)?),
        Detached::Lease(call) => lease::lease(&call.path, call.beat.duration()),
        Detached::Platform(root) => answer(&platform::platform(&root.root)?),
    }
}

fn answer(answer: &impl serde::Serialize) -> Result<(), DetachedError> {
    let mut out = io::stdout();
    stream::write_line(&mut out, answer)
        .and_then(|()| out.flush())
        .map_err(DetachedError::system("answer"))
}
