//! `matrix check FILE`: whether a matrix file is right, and, asked for, what of it cannot run.
//!
//! Unless it is asked for, nothing that the file names is reached or started: the file may be somebody else's.

use std::path::PathBuf;

use clap::Args;
use record::exit::matrix::Exit;
use schemars::JsonSchema;
use serde::Serialize;

use super::plan;
use crate::{
    cli::{
        command::options::{OutputArguments, SelectionArguments},
        terminal::{self, CommandError},
    },
    matrix_file::DiagnosticRecord,
    preparation,
    provider::Catalogue,
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

/// That a matrix file is right, and what of it cannot run.
#[derive(Debug, Serialize, JsonSchema)]
#[schemars(title = "matrix check --json")]
pub struct CheckDocument<'a> {
    /// `true`: the file is right. If it is not, the output is an error.
    ok: bool,
    /// How many scenarios it has.
    scenarios: usize,
    /// The scenarios that cannot run, as far as that was asked.
    infeasible: Vec<InfeasibleRecord<'a>>,
    /// What is odd in the file and no error.
    warnings: Vec<DiagnosticRecord<'a>>,
}

/// A scenario that cannot run.
#[derive(Debug, Serialize, JsonSchema)]
struct InfeasibleRecord<'a> {
    /// Its letter.
    id: &'a str,
    /// Its name in files.
    slug: &'a str,
    /// Why it cannot run.
    reason: Option<&'a str>,
    /// What would make it feasible, where something would.
    fix: Option<&'a str>,
}

/// Checks and says so.
///
/// # Errors
/// All that is wrong with the file.
pub async fn execute(arguments: &CheckArguments, catalogue: Catalogue) -> Result<Exit, CommandError> {
    let request = arguments.selection.request(&arguments.file);
    let plan = match arguments.hosts {
        true => preparation::prepare(&request, catalogue).await?.plan,
        false => preparation::prepare_offline(&request, catalogue)?,
    };
    plan::show_warnings(&plan, arguments.output);
    let scenarios = plan.record.scenarios.len();
    let infeasible = || plan.record.scenarios.iter().filter(|scenario| !scenario.feasible);
    if arguments.output.json {
        terminal::json(&CheckDocument {
            ok: true,
            scenarios,
            infeasible: infeasible()
                .map(|scenario| InfeasibleRecord {
                    id: &scenario.id,
                    slug: &scenario.slug,
                    reason: scenario.reason.as_deref(),
                    fix: scenario.fix.as_deref(),
                })
                .collect(),
            warnings: plan.warnings.to_json(),
        });
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
