//! `matrix clean`: lists what earlier runs left behind on this machine and on the others that they went to, then removes only
//! that.
//!
//! Elsewhere only what belongs to the runs of this user is ours: others may use the same account. Here ours is what
//! carries our labels or lies in our state folder, and belongs to this user. What a live `matrix` works with is never
//! touched: it has locked its run by directory and by name.

use std::{collections::BTreeSet, path::Path, sync::Arc};

use clap::Args;
use record::{
    axis::NATIVE, causes::with_causes, connection::Connection, exit::matrix::Exit, name::is_name,
    run_directory::RunDirectory,
};
use schemars::JsonSchema;
use serde::Serialize;

use crate::{
    cli::{
        command::options::OutputArguments,
        terminal::{self, CommandError},
    },
    host::{self, Here, Host},
    lease::{self, Holder},
    provider::{Catalogue, Leftover, Provider, ProviderError},
    run::{
        recorded::of_record,
        run_index::{self, Entry},
    },
    state_directory::StateDirectory,
    workload_binary,
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

/// What earlier runs left behind, and what became of it.
#[derive(Debug, Serialize, JsonSchema)]
#[schemars(title = "matrix clean --json")]
pub struct CleanDocument<'a> {
    /// Each thing that was left behind.
    leftovers: Vec<LeftoverRecord<'a>>,
    /// The providers that could not be asked what they have.
    not_asked: Vec<NotAskedRecord<'a>>,
}

/// A thing that was left behind.
#[derive(Debug, Serialize, JsonSchema)]
struct LeftoverRecord<'a> {
    /// The host that it is on.
    host: &'a str,
    /// What it is, such as `container`, `volume`, `image`, `process` or `directory`.
    kind: &'a str,
    name: &'a str,
    /// The run that it was created for; null for what runs share, such as an image.
    run: Option<&'a str>,
    /// That run's directory, where it is known.
    run_directory: Option<&'a Path>,
    /// The slug of the scenario that it was created for, where it is known.
    scenario: Option<&'a str>,
    /// Whether a workload runs in it now.
    running: bool,
    /// The number of its job in the batch system, which is cancelled with it; null where there is none, or it has ended.
    job: Option<&'a str>,
    /// `in use`, `left behind` (it was only listed), `removed` or `could not be removed`.
    fate: &'static str,
    /// Why it could not be removed; null otherwise.
    reason: Option<String>,
}

/// A provider that could not be asked.
#[derive(Debug, Serialize, JsonSchema)]
struct NotAskedRecord<'a> {
    /// The host.
    host: &'a str,
    /// The provider.
    provider: &'static str,
    reason: String,
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

/// A host that is asked.
struct Asked {
    host: Arc<dyn Host>,
    /// The runs of this user that went there; none on this machine, where all is ours.
    runs: Option<BTreeSet<String>>,
}

impl Asked {
    fn is_ours(&self, leftover: &Leftover) -> bool {
        match (&self.runs, &leftover.run) {
            (Some(runs), Some(run)) => runs.contains(run),
            // What runs share, and what is on this machine.
            (_, None) | (None, _) => true,
        }
    }
}

/// This machine and those that the runs went to, each once however they call it.
fn hosts(entries: &[Entry], state: &StateDirectory) -> Vec<Asked> {
    let mut elsewhere: Vec<(&Connection, Asked)> = Vec::new();
    for entry in entries {
        for host in &entry.hosts {
            let (Some(connection), Some(there)) = (host.connect.known(), of_record(host, state)) else {
                continue;
            };
            if !elsewhere.iter().any(|(known, _)| *known == connection) {
                let asked = Asked {
                    host: there,
                    runs: Some(BTreeSet::new()),
                };
                elsewhere.push((connection, asked));
            }
            let known = elsewhere.iter_mut().find(|(known, _)| *known == connection);
            if let Some(runs) = known.and_then(|(_, asked)| asked.runs.as_mut()) {
                runs.insert(entry.run.clone());
            }
        }
    }
    let here = Asked {
        host: Arc::new(Here::new("localhost", state.clone())),
        runs: None,
    };
    std::iter::once(here)
        .chain(elsewhere.into_iter().map(|(_, asked)| asked))
        .collect()
}

/// Lists and removes.
///
/// # Errors
/// When something of ours could not be removed.
pub async fn execute(arguments: &CleanArguments, catalogue: Catalogue) -> Result<Exit, CommandError> {
    let mut found = Vec::new();
    let mut silent = Vec::new();
    let state = StateDirectory::of_this_user();
    let entries = run_index::entries(&state);
    for asked in hosts(&entries, &state) {
        for provider in catalogue.all(&asked.host) {
            let mut leftovers = match provider.leftovers().await {
                Ok(leftovers) => leftovers,
                // No engine, no leftovers that could be reached: worth a remark, not a failure.
                Err(error) => {
                    silent.push(Silent::of(&asked, provider.name(), error));
                    continue;
                }
            };
            // A folder without an owner on record may be listed by more than one.
            let is_known = |it: &Leftover| {
                found
                    .iter()
                    .any(|found: &Found| found.leftover.resource == it.resource)
            };
            leftovers.retain(|leftover| asked.is_ours(leftover) && !is_known(leftover));
            for leftover in leftovers {
                let fate = fate(&asked, &state, provider.as_ref(), &leftover, arguments.dry_run).await;
                if !arguments.output.json {
                    terminal::result(&line(&asked, &leftover, &fate));
                }
                found.push(Found { leftover, fate });
            }
        }
    }
    forget(&entries, &state, &found, &silent);
    if !arguments.dry_run {
        workload_binary::remove_unfinished(&state);
    }
    if arguments.output.json {
        terminal::json(&document(&found, &silent));
    } else if !arguments.output.quiet {
        for Silent { place, error, .. } in &silent {
            terminal::print_note(&format!("{place} could not be asked: {error}"));
        }
        match (found.is_empty(), silent.is_empty()) {
            (true, true) => terminal::print_note("nothing of ours is left"),
            (true, false) => terminal::print_note("nothing of ours is left where it could be asked"),
            (false, _) => {}
        }
    }
    match found.iter().find_map(|found| found.fate.refusal()) {
        // The list has it already.
        Some(_) if arguments.output.json => Ok(Exit::Infrastructure),
        Some(error) => Err(CommandError::new(Exit::Infrastructure, error, error.hint())),
        None => Ok(Exit::Done),
    }
}

fn document<'a>(found: &'a [Found], silent: &'a [Silent]) -> CleanDocument<'a> {
    let leftovers = found.iter().map(|found| LeftoverRecord {
        host: &found.leftover.resource.host,
        kind: &found.leftover.resource.kind,
        name: &found.leftover.resource.name,
        run: found.leftover.run.as_deref(),
        run_directory: found.leftover.run_directory.as_deref(),
        scenario: found.leftover.scenario.as_deref(),
        running: found.leftover.running,
        job: found.leftover.job.as_deref(),
        fate: found.fate.word(),
        reason: found.fate.refusal().map(|error| with_causes(error)),
    });
    let not_asked = silent.iter().map(|silent| NotAskedRecord {
        host: &silent.host,
        provider: silent.provider,
        reason: silent.error.to_string(),
    });
    CleanDocument {
        leftovers: leftovers.collect(),
        not_asked: not_asked.collect(),
    }
}

/// A provider that could not be asked.
struct Silent {
    host: String,
    provider: &'static str,
    /// The runs that went to that host.
    runs: BTreeSet<String>,
    /// In words.
    place: String,
    error: ProviderError,
}

impl Silent {
    fn of(asked: &Asked, provider: &'static str, error: ProviderError) -> Self {
        let host = asked.host.name().to_owned();
        Self {
            place: match asked.host.is_this_machine() {
                true => provider.to_owned(),
                false => format!("{provider} on {host}"),
            },
            host,
            provider,
            runs: asked.runs.clone().unwrap_or_default(),
            error,
        }
    }
}

/// Strikes the runs of which nothing is left anywhere, as far as all could be asked that had a part in them.
fn forget(entries: &[Entry], state: &StateDirectory, found: &[Found], silent: &[Silent]) {
    for entry in entries {
        let is_left = |found: &Found| {
            found.leftover.run.as_ref() == Some(&entry.run) && !matches!(found.fate, Fate::Removed)
        };
        // One without an engine has no containers of ours, unless there was one.
        let is_silent = |silent: &Silent| {
            silent.runs.contains(&entry.run)
                && (silent.provider == NATIVE || entry.providers.contains(silent.provider))
        };
        let goes_on = run_index::is_taken(state, &entry.run)
            || lease::is_held(&RunDirectory::new(&entry.run_directory).lock());
        if !goes_on
            && entry.hosts.iter().all(|host| host.connect.known().is_some())
            && !found.iter().any(is_left)
            && !silent.iter().any(is_silent)
        {
            // One that stays is only asked for once more.
            let _ = entry.strike(state);
        }
    }
}

async fn fate(
    asked: &Asked,
    state: &StateDirectory,
    provider: &dyn Provider,
    leftover: &Leftover,
    only_list: bool,
) -> Fate {
    if is_in_use(asked, state, leftover).await {
        return Fate::InUse;
    }
    if only_list {
        return Fate::Listed;
    }
    // Nobody is to go on with it while it is removed.
    let here = Holder::this_process(state.path());
    let _taken = match named(leftover).map(|run| run_index::take(state, &here, run)) {
        Some(Ok(Err(_))) => return Fate::InUse,
        Some(Ok(Ok(taken))) => Some(taken),
        // Without a state folder nobody else takes it, either.
        Some(Err(_)) | None => None,
    };
    match provider.remove(leftover).await {
        Ok(()) => Fate::Removed,
        Err(error) => Fate::Refused(error),
    }
}

/// The run of a leftover, if it is the name of one: others write labels, too.
fn named(leftover: &Leftover) -> Option<&str> {
    leftover.run.as_deref().filter(|run| is_name(run))
}

async fn is_in_use(asked: &Asked, state: &StateDirectory, leftover: &Leftover) -> bool {
    // Its directory may have been moved since.
    if named(leftover).is_some_and(|run| run_index::is_taken(state, run)) {
        return true;
    }
    match leftover.run_directory.as_deref().map(RunDirectory::new) {
        Some(run) => lease::is_held(&run.lock()),
        // What runs share belongs to whichever runs now. A host without a workload to ask by has no lease, either. What is in
        // use after all its platform does not remove.
        None => host::lease::is_held(asked.host.as_ref()).await.unwrap_or(false),
    }
}

fn line(asked: &Asked, leftover: &Leftover, fate: &Fate) -> String {
    let resource = &leftover.resource;
    let run = leftover
        .run
        .as_deref()
        .map(|run| format!(" of run {run}"))
        .unwrap_or_default();
    let running = match (&leftover.job, fate) {
        (Some(job), Fate::Removed) => format!(", whose job {job} was cancelled"),
        (Some(job), _) => format!(", with job {job} in the queue"),
        (None, _) if leftover.running => ", still running".to_owned(),
        (None, _) => String::new(),
    };
    let place = match asked.host.is_this_machine() {
        true => String::new(),
        false => format!(" on {}", asked.host.name()),
    };
    format!(
        "{}: {} {}{place}{run}{running}",
        fate.word(),
        resource.kind,
        resource.name
    )
}
