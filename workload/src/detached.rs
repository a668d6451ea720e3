//! `workload detached`: a workload that goes on by itself while its user comes and goes, and its agent. The same verbs
//! serve this machine, a host over SSH and a VM, wherever this binary can be started.
//!
//! ```text
//! start ──starts── supervise ──starts── run --environment NAME --data ROOT/NAME/data
//!                   waits for it, writes ended.json
//! follow, ended, stop, remove, list, collect: each finds what it needs by itself, and may be cut at any moment
//! ```
//!
//! Nothing else has to live: the workload is found by its command line, and an end that the supervisor did not live to
//! see is noticed all the same. Each verb is a file. What is said and answered is in [`record::detached`]; a
//! failure is one line of JSON on standard error. The main type is [`Verb`].

mod collect;
mod descriptor;
mod ended;
mod error;
mod folder;
mod follow;
mod lease;
mod list;
mod platform;
mod process;
mod receive;
mod remove;
mod start;
mod stop;
mod stream;
mod supervise;

use std::{
    io::{self, Write as _},
    path::PathBuf,
    process::ExitCode,
};

use clap::{Args, Subcommand};
use record::{causes::with_causes, detached::Failure, exit::Exit, quantity::TimeSpan};

pub use self::{
    collect::send,
    error::DetachedError,
    folder::EnvironmentFolder,
    receive::{Receiver, receive},
};

/// What a keeper is asked for.
#[derive(Debug, Subcommand)]
pub enum Verb {
    /// Make an environment and start its workload, which outlives this call. Standard input has its owner and settings.
    Start(Which),
    /// The workload's keeper, as `start` starts it. Standard input has the settings.
    #[command(hide = true)]
    Supervise(Which),
    /// Pass the workload's lines on until it has ended.
    Follow(Follow),
    /// Say whether the workload runs, how it ended and what it said last.
    Ended(Which),
    /// Ask the workload to end in order.
    Stop(Which),
    /// End the workload and remove the environment.
    Remove(Remove),
    /// Say which environments there are, and which bridges killed workloads left in Open vSwitch.
    List(Root),
    /// Remove such a bridge.
    RemoveBridge {
        /// Its name, as `list` says it.
        name: String,
    },
    /// Send the data folder as LZ4 of tar. Standard input says how much of each file is already there.
    Collect(Which),
    /// Hold a lease until standard input ends. Its first line says who asks.
    Lease(Lease),
    /// Say what the host is, how much room its disk has and what time it is.
    Platform(Root),
}

/// Where environments are.
#[derive(Debug, Args)]
pub struct Root {
    /// The folder that has a folder for each environment.
    #[arg(long)]
    root: PathBuf,
}

/// Which environment.
#[derive(Debug, Args)]
pub struct Which {
    #[command(flatten)]
    root: Root,
    /// Its name.
    #[arg(long)]
    environment: String,
}

/// From where on lines are passed on.
#[derive(Debug, Args)]
pub struct Follow {
    #[command(flatten)]
    which: Which,
    /// How many bytes of them are known already.
    #[arg(long, default_value_t = 0)]
    from: u64,
}

/// What is removed, and how.
#[derive(Debug, Args)]
pub struct Remove {
    #[command(flatten)]
    which: Which,
    /// How long the workload may take to end in order before it is ended by force.
    #[arg(long, default_value = "10s")]
    patience: TimeSpan,
}

/// Which lease.
#[derive(Debug, Args)]
pub struct Lease {
    /// The file whose lock it is; made if it is not there.
    #[arg(long)]
    path: PathBuf,
    /// End when nothing, not even an empty line, has come on standard input for that long.
    #[arg(long, default_value = "5min")]
    beat: TimeSpan,
}

impl Which {
    fn folder(&self) -> Result<EnvironmentFolder, DetachedError> {
        EnvironmentFolder::of(&self.root.root, &self.environment)
    }
}

/// Does what is asked for: answers on standard output, fails on standard error.
#[must_use]
pub fn run(verb: &Verb) -> ExitCode {
    match perform(verb) {
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

fn perform(verb: &Verb) -> Result<(), DetachedError> {
    match verb {
        Verb::Start(which) => answer(&start::start(&which.folder()?)?),
        Verb::Supervise(which) => supervise::supervise(&which.folder()?),
        Verb::Follow(call) => follow::follow(&call.which.folder()?, call.from),
        Verb::Ended(which) => answer(&ended::ended(&which.folder()?)?),
        Verb::Stop(which) => answer(&stop::stop(&which.folder()?)?),
        Verb::Remove(call) => answer(&remove::remove(&call.which.folder()?, call.patience.duration())?),
        Verb::List(root) => answer(&list::list(&root.root)?),
        Verb::RemoveBridge { name } => answer(&list::remove_bridge(name)?),
        Verb::Collect(which) => collect::collect(&which.folder()?),
        Verb::Lease(call) => lease::lease(&call.path, call.beat.duration()),
        Verb::Platform(root) => answer(&platform::platform(&root.root)?),
    }
}

fn answer(answer: &impl serde::Serialize) -> Result<(), DetachedError> {
    let mut out = io::stdout();
    stream::write_line(&mut out, answer)
        .and_then(|()| out.flush())
        .map_err(DetachedError::system("answer"))
}
