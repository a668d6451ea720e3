//! `matrix status RUN`: where a run stands, from its journal, and with `--verify` whether its files are as they were written.

use std::path::{Path, PathBuf};

use clap::Args;
use reports::{
    run_directory::{PlannedScenario, RunDirectory},
    verification::{Verification, verify},
};
use serde_json::{Value, json};

use super::report::unreadable;
use crate::{
    arguments::OutputArguments,
    exit::Exit,
    lease, room,
    run::{record::RecordedRun, state::ScenarioState},
    terminal::{self, Complaint},
};

/// What it takes.
#[derive(Debug, Args)]
pub struct StatusArguments {
    /// The run directory.
    run: PathBuf,
    /// Read every file that has a checksum, captures too, and list those that are damaged.
    #[arg(long)]
    verify: bool,
    #[command(flatten)]
    pub(crate) output: OutputArguments,
}

/// Prints it.
///
/// # Errors
/// When the run directory cannot be read, or is to be verified while it is being measured.
pub fn execute(arguments: &StatusArguments) -> Result<Exit, Complaint> {
    let directory = RunDirectory::new(&arguments.run);
    let recorded = RecordedRun::read(&directory)?;
    let live = lease::is_held(&directory.lock());
    let found = recorded.state_in(&directory);
    let verified = match arguments.verify {
        true => Some(verification(&directory, live)?),
        false => None,
    };
    let is_damaged = verified.as_ref().is_some_and(|it| !it.damaged.is_empty());
    let exit = if is_damaged { Exit::Wrong } else { Exit::Done };
    let rows: Vec<(&PlannedScenario, ScenarioState)> = recorded
        .plan
        .scenarios
        .iter()
        .map(|planned| (planned, found.scenario(&planned.slug)))
        .collect();
    // Of an errored scenario windows are missing although the journal says that the run ended.
    let finished = rows
        .iter()
        .all(|(planned, state)| !planned.runs() || state.is_settled());
    if arguments.output.json {
        terminal::json(&json!({
            "run": recorded.manifest.run,
            "live": live,
            "finished": finished,
            "scenarios": rows.iter().map(|(planned, state)| json!({
                "id": planned.id,
                "slug": planned.slug,
                "feasible": planned.feasible,
                "state": word(planned, state, live),
                "reason": planned.reason.as_ref().or(state.reason.as_ref()),
                "windows": planned.settings.windows,
                "windows_complete": state.complete().len(),
                "windows_collected": state.collected.len(),
                "silent_for_s": state.silent_for_s.filter(|_| live),
                "environment": state.open.as_ref().map(|open| &open.environment),
            })).collect::<Vec<_>>(),
            "verified": verified.as_ref().map(as_json),
        }));
        return Ok(exit);
    }
    let mut text = format!(
        "run {}{}\n",
        recorded.manifest.run,
        if live { ", live" } else { "" }
    );
    for (planned, state) in &rows {
        let reason = planned.reason.as_ref().or(state.reason.as_ref());
        let silent = state
            .silent_for_s
            .filter(|_| live)
            .map(|for_s| format!(", nothing was heard of the workload for {for_s} s or more"));
        text.push_str(&format!(
            "  {} {}: {}, {} of {} windows{}{}{}\n",
            planned.id,
            planned.slug,
            word(planned, state, live),
            state.collected.len(),
            planned.settings.windows,
            silent.unwrap_or_default(),
            not_collected(state),
            reason.map(|reason| format!(": {reason}")).unwrap_or_default(),
        ));
    }
    if !live && !finished {
        text.push_str(&format!(
            "not finished: `matrix resume {}` goes on\n",
            terminal::pasted(&arguments.run)
        ));
    }
    if let Some(verified) = &verified {
        text.push_str(&as_text(verified, &arguments.run));
    }
    terminal::result(&text);
    Ok(exit)
}

/// Reads all of the run directory, unless that would disturb what is being measured.
fn verification(directory: &RunDirectory, live: bool) -> Result<Verification, Complaint> {
    if live {
        return Err(Complaint {
            what: format!("{} is being worked on", directory.path().display()).into(),
            hint: Some(
                "reading all of it would disturb what is measured: verify it when it has ended".to_owned(),
            ),
            exit: Exit::Infrastructure,
        });
    }
    verify(directory).map_err(|error| unreadable(&error))
}

fn as_json(verified: &Verification) -> Value {
    json!({
        "files": verified.files,
        "bytes": verified.bytes,
        "checked": verified.is_checked,
        "damaged": verified.damaged.iter().map(|damage| json!({
            "file": damage.file,
            "what": damage.what,
        })).collect::<Vec<_>>(),
    })
}

fn as_text(verified: &Verification, run: &Path) -> String {
    let size = room::in_words(verified.bytes);
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
            terminal::pasted(run)
        ));
    }
    text
}

/// Windows that are measured and still where they were measured, in words.
fn not_collected(state: &ScenarioState) -> String {
    match state.complete().len() - state.collected.len() {
        0 => String::new(),
        more => format!(", {more} more measured and not collected yet"),
    }
}

fn word(planned: &PlannedScenario, state: &ScenarioState, live: bool) -> &'static str {
    if planned.not_selected.is_some() {
        return "not selected";
    }
    match (planned.feasible, state.outcome, &state.open) {
        (false, ..) => "infeasible",
        (true, Some(outcome), _) => outcome.name(),
        (true, None, Some(_)) if live => "running",
        (true, None, Some(_)) => "left behind",
        (true, None, None) => "waiting",
    }
}
