//! `matrix status RUN`: where a run stands, from its journal.

use std::path::PathBuf;

use clap::Args;
use reports::run_directory::{PlannedScenario, RunDirectory};
use serde_json::json;

use crate::{
    arguments::OutputArguments,
    exit::Exit,
    lease,
    run::{record::RecordedRun, state::ScenarioState},
    terminal::{self, Complaint},
};

/// What it takes.
#[derive(Debug, Args)]
pub struct StatusArguments {
    /// The run directory.
    run: PathBuf,
    #[command(flatten)]
    pub(crate) output: OutputArguments,
}

/// Prints it.
///
/// # Errors
/// When the run directory cannot be read.
pub fn execute(arguments: &StatusArguments) -> Result<Exit, Complaint> {
    let directory = RunDirectory::new(&arguments.run);
    let recorded = RecordedRun::read(&directory)?;
    let live = lease::is_held(&directory.lock());
    let rows: Vec<(&PlannedScenario, ScenarioState)> = recorded
        .plan
        .scenarios
        .iter()
        .map(|planned| (planned, recorded.state.scenario(&planned.slug)))
        .collect();
    if arguments.output.json {
        terminal::json(&json!({
            "run": recorded.manifest.run,
            "live": live,
            "finished": recorded.state.finished,
            "scenarios": rows.iter().map(|(planned, state)| json!({
                "id": planned.id,
                "slug": planned.slug,
                "feasible": planned.feasible,
                "state": word(planned, state, live),
                "reason": planned.reason.as_ref().or(state.reason.as_ref()),
                "windows": planned.settings.windows,
                "windows_complete": state.completed.union(&state.collected).count(),
                "windows_collected": state.collected.len(),
                "environment": state.open.as_ref().map(|open| &open.environment),
            })).collect::<Vec<_>>(),
        }));
        return Ok(Exit::Done);
    }
    let mut text = format!(
        "run {}{}\n",
        recorded.manifest.run,
        if live { ", live" } else { "" }
    );
    for (planned, state) in &rows {
        let reason = planned.reason.as_ref().or(state.reason.as_ref());
        text.push_str(&format!(
            "  {} {}: {}, {} of {} windows{}\n",
            planned.id,
            planned.slug,
            word(planned, state, live),
            state.collected.len(),
            planned.settings.windows,
            reason.map(|reason| format!(": {reason}")).unwrap_or_default(),
        ));
    }
    if !live && !recorded.state.finished {
        text.push_str(&format!(
            "not finished: `matrix resume {}` goes on\n",
            arguments.run.display()
        ));
    }
    terminal::result(&text);
    Ok(Exit::Done)
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
