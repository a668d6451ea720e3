//! `matrix check FILE`: whether a matrix file is right, and what of it cannot run here.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;

use super::plan::{self, Planned, plan};
use crate::{
    arguments::{OutputArguments, SelectionArguments},
    exit::Exit,
    terminal::{self, Complaint},
};

/// What it takes.
#[derive(Debug, Args)]
pub struct CheckArguments {
    /// The matrix file.
    file: PathBuf,
    #[command(flatten)]
    selection: SelectionArguments,
    #[command(flatten)]
    pub(crate) output: OutputArguments,
}

/// Checks and says so.
///
/// # Errors
/// All that is wrong with the file.
pub async fn execute(arguments: &CheckArguments) -> Result<Exit, Complaint> {
    let Planned { plan, .. } = plan(&arguments.file, &arguments.selection, arguments.output).await?;
    let scenarios = plan.record.scenarios.len();
    let infeasible = || plan.record.scenarios.iter().filter(|scenario| !scenario.feasible);
    if arguments.output.json {
        terminal::json(&json!({
            "ok": true,
            "scenarios": scenarios,
            "infeasible": infeasible().map(|scenario| json!({
                "id": scenario.id,
                "slug": scenario.slug,
                "reason": scenario.reason,
                "fix": scenario.fix,
            })).collect::<Vec<_>>(),
            "warnings": plan.warnings.to_json(),
        }));
    } else {
        terminal::result(&format!(
            "{}: right, {scenarios} scenarios",
            arguments.file.display()
        ));
        if infeasible().next().is_some() {
            terminal::result(&plan::lines(infeasible(), &plan.silent));
        }
    }
    Ok(Exit::Done)
}
