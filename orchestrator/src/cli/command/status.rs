//! `matrix status RUN`: where a run stands, from its journal, and with `--verify` whether its files are as they were written.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    time::{Duration, SystemTime},
};

use clap::Args;
use record::{
    exit::matrix::Exit,
    run_directory::{JobStanding, PlannedScenario, RoundState, RunDirectory, ScenarioState, Standing},
};
use reports::input::verification::{Verification, verify};
use schemars::JsonSchema;
use serde::Serialize;

use super::report::unreadable;
use crate::{
    cli::{
        command::options::OutputArguments,
        completion, plain_log,
        run_argument::run_argument,
        terminal::{self, CommandError},
    },
    disk_space, escaping,
    lease::{self, Holder},
    run::recorded::RecordedRun,
    state_directory::StateDirectory,
};

/// What it takes.
#[derive(Debug, Args)]
pub struct StatusArguments {
    /// The run directory.
    #[arg(default_value = "latest", value_parser = run_argument(), add = completion::runs())]
    run: PathBuf,
    /// Read every file that has a checksum, captures too, and list those that are damaged.
    #[arg(long)]
    verify: bool,
    /// Ask the clusters of the run where the jobs stand now. Without it they stand as they did when `matrix` last worked on the run.
    #[arg(long)]
    hosts: bool,
    #[command(flatten)]
    pub(crate) output: OutputArguments,
}

/// Where a run stands.
#[derive(Debug, Serialize, JsonSchema)]
#[schemars(title = "matrix status --json")]
pub struct StatusDocument<'a> {
    /// The run's name.
    run: &'a str,
    /// Whether a `matrix` works on it now.
    live: bool,
    /// The process that works on it; null if none does, or if it has not said who it is.
    holder: Option<HolderRecord<'a>>,
    /// Whether nothing is left to measure.
    finished: bool,
    /// Windows that are planned of the scenarios that run.
    windows: u32,
    /// Windows of them that are measured, collected or not.
    windows_complete: usize,
    /// Windows of them that are collected and do not count.
    windows_invalid: usize,
    /// How long measuring the others takes, in seconds: windows only, on the host that has most of them left.
    measuring_left_s: f64,
    /// Every scenario of the plan, in letter order.
    scenarios: Vec<ScenarioRecord<'a>>,
    /// Whether the files are as they were written; null without `--verify`.
    verified: Option<VerifiedRecord<'a>>,
}

/// A process that works on a run.
#[derive(Debug, Serialize, JsonSchema)]
struct HolderRecord<'a> {
    /// Its number.
    pid: u32,
    /// The machine that it runs on.
    machine: &'a str,
    /// Since when it works on the run, RFC 3339.
    since: &'a str,
}

/// Where a scenario stands.
#[derive(Debug, Serialize, JsonSchema)]
struct ScenarioRecord<'a> {
    /// Its letter.
    id: &'a str,
    /// Its name in files.
    slug: &'a str,
    /// Whether it can run.
    feasible: bool,
    /// Whether its windows are simulated, not measured.
    simulated: bool,
    /// `completed`, `failed`, `errored`, `interrupted`, `infeasible`, `not selected`, `running`, `left behind` (its environment
    /// may exist, and no `matrix` works on the run), `queued` (its job waits for its turn), `to collect` (its
    /// job has ended, and `matrix resume` takes what it measured) or `waiting`.
    state: &'static str,
    /// Why, where there is a reason.
    reason: Option<&'a str>,
    /// Windows that are planned.
    windows: u32,
    /// Windows that are measured, collected or not.
    windows_complete: usize,
    /// Windows that are in the run directory.
    windows_collected: usize,
    /// The window that is being measured; null if none is.
    window_under_way: Option<u32>,
    /// Since when, RFC 3339; null if none is.
    under_way_since: Option<&'a str>,
    /// For how long its workload has reported nothing, in seconds; null if it reports, or if the run is not live.
    silent_for_s: Option<u64>,
    /// The environment that exists or may exist; null if none does.
    environment: Option<&'a str>,
    /// The job that this is, of the first round that has one; null if none has.
    job: Option<JobRecord<'a>>,
    /// Its environment of each round, in the order of the rounds.
    environments: Vec<EnvironmentOfRound<'a>>,
}

/// A job of a batch system.
#[derive(Debug, Serialize, JsonSchema)]
struct JobRecord<'a> {
    /// Its number.
    job: &'a str,
    /// The batch system's word for its state, such as `PENDING`.
    state: &'a str,
    /// Why it waits or has ended, in the batch system's words; null if it does not say.
    reason: Option<&'a str>,
    /// The node that it runs or ran on; null if it has none.
    node: Option<&'a str>,
    /// When it began or may begin, in the cluster's time zone; null if that is not known.
    start: Option<&'a str>,
}

impl<'a> JobRecord<'a> {
    fn of(job: &'a JobStanding) -> Self {
        Self {
            job: &job.job,
            state: &job.state,
            reason: job.reason.as_deref(),
            node: job.node.as_deref(),
            start: job.start.as_deref(),
        }
    }
}

/// Where a scenario stands in one round, which has one environment of it.
#[derive(Debug, Serialize, JsonSchema)]
struct EnvironmentOfRound<'a> {
    /// The round, from 1.
    round: u32,
    /// As a scenario's state.
    state: &'static str,
    /// Why, where there is a reason.
    reason: Option<String>,
    /// Windows that are planned.
    windows: u32,
    /// Windows that are in the run directory.
    windows_collected: usize,
    /// The environment that exists or may exist; null if none does.
    environment: Option<&'a str>,
}

/// Whether the files of a run directory are as they were written.
#[derive(Debug, Serialize, JsonSchema)]
struct VerifiedRecord<'a> {
    /// Files that were read.
    files: u64,
    /// Their size together, in bytes.
    bytes: u64,
    /// Whether the journal has checksums of itself and of the other files; `false` for runs of earlier versions.
    checked: bool,
    /// The files that are not as they were written.
    damaged: Vec<DamagedRecord<'a>>,
}

/// A file that is not as it was written.
#[derive(Debug, Serialize, JsonSchema)]
struct DamagedRecord<'a> {
    /// Where it is in the run directory.
    file: &'a Path,
    /// How the damage shows.
    what: &'a str,
}

/// A run as it stands.
pub(super) struct RunStanding<'a> {
    /// Whether a `matrix` works on it now.
    pub(super) live: bool,
    holder: Option<Holder>,
    /// Whether nothing is left to measure.
    pub(super) finished: bool,
    rows: Vec<(&'a PlannedScenario, ScenarioState)>,
}

impl<'a> RunStanding<'a> {
    pub(super) fn of(directory: &RunDirectory, recorded: &'a RecordedRun) -> Self {
        let found = recorded.state_in(directory);
        let scenarios = recorded.plan.scenarios.iter();
        let rows: Vec<_> = scenarios
            .map(|planned| (planned, found.scenario(&planned.slug)))
            .collect();
        Self {
            live: lease::is_held(&directory.lock()),
            holder: lease::holder(&directory.lock()),
            // Of an errored scenario windows are missing although the journal says that the run ended.
            finished: rows
                .iter()
                .all(|(planned, state)| !planned.runs() || state.is_settled(planned.rounds())),
            rows,
        }
    }

    fn running(&self) -> impl Iterator<Item = &(&'a PlannedScenario, ScenarioState)> {
        self.rows.iter().filter(|(planned, _)| planned.runs())
    }

    /// Windows that are planned of the scenarios that run.
    pub(super) fn windows(&self) -> u32 {
        let windows = self.running().map(|(planned, _)| planned.settings.all_windows());
        windows.fold(0, u32::saturating_add)
    }

    /// Those of them that are measured, collected or not.
    pub(super) fn windows_complete(&self) -> usize {
        self.running().map(|(_, state)| state.complete().len()).sum()
    }

    /// Those of them that are collected and do not count.
    pub(super) fn windows_invalid(&self) -> usize {
        self.running().map(|(_, state)| state.windows_invalid()).sum()
    }

    /// How long measuring the others takes: on the host that has most of them left. What the window under way has behind it does not
    /// count.
    fn measuring_left(&self) -> Duration {
        let mut by_host: BTreeMap<Option<&str>, f64> = BTreeMap::new();
        for (planned, state) in self.running() {
            let windows = planned.settings.all_windows() as usize;
            let left = windows.saturating_sub(state.complete().len());
            let window = planned.settings.longest_window().duration();
            let behind = state.under_way().filter(|_| self.live);
            let behind = behind.map_or(Duration::ZERO, |(_, since)| elapsed(since).min(window));
            let left_s = left as f64 * window.as_secs_f64() - behind.as_secs_f64();
            *by_host.entry(planned.host.as_deref()).or_default() += left_s.max(0.0);
        }
        let most = by_host.into_values().fold(0.0, f64::max);
        Duration::try_from_secs_f64(most).unwrap_or(Duration::MAX)
    }

    /// In one line or two, without the scenarios.
    fn head(&self, run: &str) -> String {
        let work = match (self.live, &self.holder) {
            (true, Some(holder)) => format!(
                ", live: process {} on {} since {}",
                holder.pid, holder.machine, holder.since
            ),
            (true, None) => ", live".to_owned(),
            (false, _) => String::new(),
        };
        let left = match self.finished {
            true => String::new(),
            false => format!(", about {} of measuring left", in_words(self.measuring_left())),
        };
        format!(
            "run {run}{work}\n  {} of {} windows measured{}{left}\n",
            self.windows_complete(),
            self.windows(),
            invalid(self.windows_invalid())
        )
    }
}

/// Since a time of the journal; nothing if it is not known.
pub(super) fn elapsed(since: &str) -> Duration {
    let since = humantime::parse_rfc3339(since).ok();
    let elapsed = since.and_then(|since| SystemTime::now().duration_since(since).ok());
    elapsed.unwrap_or_default()
}

fn in_words(duration: Duration) -> String {
    humantime::format_duration(Duration::from_secs(duration.as_secs())).to_string()
}

/// Prints it.
///
/// # Errors
/// When the run directory cannot be read, or is to be verified while it is being measured.
pub async fn execute(arguments: &StatusArguments) -> Result<Exit, CommandError> {
    let directory = RunDirectory::new(&arguments.run);
    let mut recorded = RecordedRun::read(&directory)?;
    if arguments.hosts {
        for (host, silence) in recorded.ask_clusters(&StateDirectory::of_this_user()).await? {
            terminal::print_note(&format!("host {host} did not answer: {silence}"));
        }
    }
    let standing = RunStanding::of(&directory, &recorded);
    let RunStanding {
        live,
        finished,
        ref rows,
        ..
    } = standing;
    let verified = match arguments.verify {
        true => Some(verification(&directory, live)?),
        false => None,
    };
    let is_damaged = verified.as_ref().is_some_and(|it| !it.damaged.is_empty());
    let exit = if is_damaged { Exit::Wrong } else { Exit::Done };
    if arguments.output.json {
        let scenarios = rows.iter().map(|(planned, state)| ScenarioRecord {
            id: &planned.id,
            slug: &planned.slug,
            feasible: planned.feasible,
            simulated: planned.simulated,
            state: word(planned, state, live),
            reason: reason(planned, state),
            windows: planned.settings.all_windows(),
            windows_complete: state.complete().len(),
            windows_collected: state.collected.len(),
            window_under_way: state.under_way().filter(|_| live).map(|(window, _)| window),
            under_way_since: state.under_way().filter(|_| live).map(|(_, since)| since),
            silent_for_s: state.silent_for_s.filter(|_| live),
            environment: state.open().last().map(|open| open.environment.as_str()),
            job: job(state).map(JobRecord::of),
            environments: environments(planned, state, live),
        });
        terminal::json(&StatusDocument {
            run: &recorded.manifest.run,
            live,
            holder: standing.holder.as_ref().map(|holder| HolderRecord {
                pid: holder.pid,
                machine: &holder.machine,
                since: &holder.since,
            }),
            finished,
            windows: standing.windows(),
            windows_complete: standing.windows_complete(),
            windows_invalid: standing.windows_invalid(),
            measuring_left_s: standing.measuring_left().as_secs_f64(),
            scenarios: scenarios.collect(),
            verified: verified.as_ref().map(record),
        });
        return Ok(exit);
    }
    let mut text = standing.head(&recorded.manifest.run);
    for (planned, state) in rows {
        let reason = reason(planned, state);
        let silent = state
            .silent_for_s
            .filter(|_| live)
            .map(|for_s| format!(", nothing was heard of the workload for {for_s} s or more"));
        let job = job(state).map(|job| format!(", {}", plain_log::job(job)));
        text.push_str(&format!(
            "  {} {}{}: {}, {} of {} windows{}{}{}{}{}{}\n",
            planned.id,
            planned.slug,
            plain_log::if_simulated(planned.simulated),
            word(planned, state, live),
            state.complete().len(),
            planned.settings.all_windows(),
            invalid(state.windows_invalid()),
            under_way(state, live),
            job.unwrap_or_default(),
            silent.unwrap_or_default(),
            not_collected(state),
            reason.map(|reason| format!(": {reason}")).unwrap_or_default(),
        ));
        text.push_str(&environments_as_text(&environments(planned, state, live)));
    }
    if !live && !arguments.hosts && rows.iter().any(|(_, state)| job(state).is_some()) {
        text.push_str(&format!(
            "the jobs stand here as `matrix` last saw them: `matrix status --hosts {}` asks the cluster\n",
            escaping::pasted(&arguments.run)
        ));
    }
    if !live && !finished {
        text.push_str(&format!(
            "not finished: `matrix resume {}` goes on\n",
            escaping::pasted(&arguments.run)
        ));
    }
    if let Some(verified) = &verified {
        text.push_str(&as_text(verified, &arguments.run));
    }
    terminal::result(&text);
    Ok(exit)
}

/// The job of the first round that has one.
fn job(state: &ScenarioState) -> Option<&JobStanding> {
    state.open().find_map(|open| open.job.as_ref())
}

/// Reads all of the run directory, unless that would disturb what is being measured.
fn verification(directory: &RunDirectory, live: bool) -> Result<Verification, CommandError> {
    if live {
        return Err(CommandError {
            what: format!("{} is being worked on", directory.path().display()).into(),
            hint: Some(
                "reading all of it would disturb what is measured: verify it when it has ended".to_owned(),
            ),
            exit: Exit::Infrastructure,
        });
    }
    verify(directory).map_err(|error| unreadable(&error))
}

fn record(verified: &Verification) -> VerifiedRecord<'_> {
    let damaged = verified.damaged.iter().map(|damage| DamagedRecord {
        file: &damage.file,
        what: &damage.what,
    });
    VerifiedRecord {
        files: verified.files,
        bytes: verified.bytes,
        checked: verified.is_checked,
        damaged: damaged.collect(),
    }
}

fn as_text(verified: &Verification, run: &Path) -> String {
    let size = disk_space::in_words(verified.bytes);
    let mut text = match verified.damaged.len() {
        0 => format!(
            "verified: {} files, {size}, all as they were written\n",
            verified.files
        ),
        damaged => format!("verified: {} files, {size}, {damaged} DAMAGED\n", verified.files),
    };
    for damage in &verified.damaged {
        text.push_str(&format!("  {}: {}\n", damage.file.display(), damage.what));
    }
    if !verified.is_checked {
        text.push_str(
            "  recorded by an earlier version of matrix, without checksums of the manifest, plan, journal, environments and \
             window records: these are not verified\n",
        );
    }
    if !verified.damaged.is_empty() {
        text.push_str(&format!(
            "restore them from a copy; or `matrix resume {}` measures windows again that are damaged\n",
            escaping::pasted(run)
        ));
    }
    text
}

/// Windows that do not count, in words.
pub(super) fn invalid(windows: usize) -> String {
    match windows {
        0 => String::new(),
        some => format!(", {some} of them invalid"),
    }
}

/// Windows that are measured and still where they were measured, in words.
fn not_collected(state: &ScenarioState) -> String {
    match state.complete().len() - state.collected.len() {
        0 => String::new(),
        some => format!(", {some} of them not collected yet"),
    }
}

/// The window that is being measured, in words.
fn under_way(state: &ScenarioState, live: bool) -> String {
    let under_way = state.under_way().filter(|_| live);
    under_way.map_or_else(String::new, |(window, since)| {
        format!(", window {window} for {}", in_words(elapsed(since)))
    })
}

/// The state of a scenario that has several environments is that of the one to look at first: one that is at work or was left, one
/// that has not ended as it should, and only then what all of them have come to.
fn word(planned: &PlannedScenario, state: &ScenarioState, live: bool) -> &'static str {
    const FIRST: [&str; 10] = [
        "running",
        "queued",
        "to collect",
        "left behind",
        "interrupted",
        "waiting",
        "errored",
        "failed",
        "completed",
        "infeasible",
    ];
    if planned.not_selected.is_some() {
        return "not selected";
    }
    let words = planned
        .rounds()
        .map(|round| word_of_round(planned, &state.round(round), live));
    let place = |word: &&str| FIRST.iter().position(|first| first == word);
    words.min_by_key(place).unwrap_or("waiting")
}

fn word_of_round(planned: &PlannedScenario, round: &RoundState, live: bool) -> &'static str {
    if planned.not_selected.is_some() {
        return "not selected";
    }
    match (planned.feasible, round.outcome, &round.open) {
        (false, ..) => "infeasible",
        (true, Some(outcome), _) => outcome.name(),
        (true, None, Some(open)) => match open.job.as_ref().map(|job| job.standing) {
            Some(Standing::Waits | Standing::WaitsForEver) => "queued",
            Some(Standing::Runs) => "running",
            Some(Standing::Ended | Standing::LostItsNode) if !live => "to collect",
            _ if live => "running",
            _ => "left behind",
        },
        (true, None, None) => "waiting",
    }
}

/// Why a scenario does not run, or did not end as it should in the first round of which there is a reason.
fn reason<'s>(planned: &'s PlannedScenario, state: &'s ScenarioState) -> Option<&'s str> {
    // What is left out is left out for that, whether or not it could run.
    if let Some(why) = planned.not_selected.as_deref().or(planned.reason.as_deref()) {
        return Some(why);
    }
    let mut reasons = planned
        .rounds()
        .filter_map(|round| state.rounds.get(&round)?.reason.as_deref());
    reasons.next()
}

fn environments<'s>(
    planned: &PlannedScenario,
    state: &'s ScenarioState,
    live: bool,
) -> Vec<EnvironmentOfRound<'s>> {
    let environment = |number: u32| {
        let round = state.rounds.get(&number);
        let windows = planned.settings.windows_of_round(number);
        EnvironmentOfRound {
            round: number,
            state: word_of_round(planned, &round.cloned().unwrap_or_default(), live),
            reason: round.and_then(|round| round.reason.clone()),
            windows: planned.settings.windows,
            windows_collected: windows
                .filter(|window| state.collected.contains_key(window))
                .count(),
            environment: round.and_then(|round| Some(round.open.as_ref()?.environment.as_str())),
        }
    };
    planned.rounds().map(environment).collect()
}

/// A line for each environment; none where a scenario has but one, whose line has it all.
fn environments_as_text(environments: &[EnvironmentOfRound<'_>]) -> String {
    if environments.len() < 2 {
        return String::new();
    }
    let line = |it: &EnvironmentOfRound<'_>| {
        let reason = it.reason.as_ref().map(|reason| format!(": {reason}"));
        format!(
            "    environment {}: {}, {} of {} windows{}\n",
            it.round,
            it.state,
            it.windows_collected,
            it.windows,
            reason.unwrap_or_default()
        )
    };
    environments.iter().map(line).collect()
}
