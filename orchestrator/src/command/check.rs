//! `matrix check FILE`: whether a matrix file is right, and, asked for, what of it cannot run.
//!
//! Unless it is asked for, nothing that the file names is reached or started: the file may be somebody else's.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;

use super::plan::{self, plan, plan_unasked};
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
    /// Ask the hosts and engines that the file names what they can do, as `matrix plan` does: this logs in to them and starts
    /// the file's images.
    #[arg(long)]
    hosts: bool,
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
    let plan = match arguments.hosts {
        true => {
            plan(&arguments.file, &arguments.selection, arguments.output)
                .await?
                .plan
        }
        false => plan_unasked(&arguments.file, &arguments.selection, arguments.output)?,
    };
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
