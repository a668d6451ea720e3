//! `matrix clean`: lists what earlier runs left behind on this machine, then removes only that.
//!
//! Ours is what carries our labels or lies in our state folder, and belongs to this user. What a live `matrix` works
//! with is never touched: its run directory is locked.

use clap::Args;
use serde_json::json;
use workload::causes::with_causes;

use crate::{
    arguments::OutputArguments,
    exit::Exit,
    lease,
    provider::{self, Leftover, Provider, ProviderError},
    terminal::{self, Complaint},
};

/// What it takes.
#[derive(Debug, Args)]
pub struct CleanArguments {
    /// Only list.
    #[arg(long)]
    dry_run: bool,
    #[command(flatten)]
    pub(crate) output: OutputArguments,
}

/// One leftover and what became of it.
struct Found {
    leftover: Leftover,
    fate: Fate,
}

enum Fate {
    InUse,
    Listed,
    Removed,
    Refused(ProviderError),
}

impl Fate {
    fn word(&self) -> &'static str {
        match self {
            Self::InUse => "in use",
            Self::Listed => "left behind",
            Self::Removed => "removed",
            Self::Refused(_) => "could not be removed",
        }
    }

    fn refusal(&self) -> Option<&ProviderError> {
        match self {
            Self::Refused(error) => Some(error),
            Self::InUse | Self::Listed | Self::Removed => None,
        }
    }
}

/// Lists and removes.
///
/// # Errors
/// When something of ours could not be removed.
pub async fn execute(arguments: &CleanArguments) -> Result<Exit, Complaint> {
    let mut found = Vec::new();
    let mut silent = Vec::new();
    for provider in provider::all() {
        match provider.leftovers().await {
            Ok(leftovers) => {
                for leftover in leftovers {
                    let fate = fate(provider.as_ref(), &leftover, arguments.dry_run).await;
                    if !arguments.output.json {
                        terminal::result(&line(&leftover, &fate));
                    }
                    found.push(Found { leftover, fate });
                }
            }
            // No engine, no leftovers that could be reached: worth a remark, not a failure.
            Err(error) => silent.push((provider.name(), error)),
        }
    }
    if arguments.output.json {
        terminal::json(&json!({
            "leftovers": found.iter().map(|found| json!({
                "host": found.leftover.resource.host,
                "kind": found.leftover.resource.kind,
                "name": found.leftover.resource.name,
                "run": found.leftover.run,
                "run_directory": found.leftover.run_directory,
                "scenario": found.leftover.scenario,
                "running": found.leftover.running,
                "fate": found.fate.word(),
                "reason": found.fate.refusal().map(|error| with_causes(error)),
            })).collect::<Vec<_>>(),
            "not_asked": silent.iter().map(|(name, error)| json!({
                "provider": name, "reason": error.to_string(),
            })).collect::<Vec<_>>(),
        }));
    } else if !arguments.output.quiet {
        if found.is_empty() {
            terminal::remark("nothing of ours is left on this machine");
        }
        for (name, error) in &silent {
            terminal::remark(&format!("{name} could not be asked: {error}"));
        }
    }
    match found.iter().find_map(|found| found.fate.refusal()) {
        // The list has it already.
        Some(_) if arguments.output.json => Ok(Exit::Infrastructure),
        Some(error) => Err(Complaint::new(Exit::Infrastructure, error, error.hint())),
        None => Ok(Exit::Done),
    }
}

async fn fate(provider: &dyn Provider, leftover: &Leftover, only_list: bool) -> Fate {
    let run = leftover
        .run_directory
        .as_deref()
        .map(reports::run_directory::RunDirectory::new);
    // What runs share belongs to whichever runs now.
    let in_use = match run {
        Some(run) => lease::is_held(&run.lock()),
        None => lease::is_held(&lease::of_this_machine()),
    };
    if in_use {
        return Fate::InUse;
    }
    if only_list {
        return Fate::Listed;
    }
    match provider.remove(leftover).await {
        Ok(()) => Fate::Removed,
        Err(error) => Fate::Refused(error),
    }
}

fn line(leftover: &Leftover, fate: &Fate) -> String {
    let resource = &leftover.resource;
    let run = leftover
        .run
        .as_deref()
        .map(|run| format!(" of run {run}"))
        .unwrap_or_default();
    let running = if leftover.running { ", still measuring" } else { "" };
    format!(
        "{}: {} {}{run}{running}",
        fate.word(),
        resource.kind,
        resource.name
    )
}
