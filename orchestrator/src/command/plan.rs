//! `matrix plan FILE`: every scenario, whether it can run here and why not, the order, the duration, what can be found.

use std::{
    collections::BTreeMap,
    fmt::Write,
    path::{Path, PathBuf},
    time::Duration,
};

use clap::Args;
use reports::run_directory::PlannedScenario;
use serde_json::{Value, json};

use crate::{
    arguments::{OutputArguments, SelectionArguments},
    exit::Exit,
    matrix_file::MatrixFile,
    plan::{self, HostFacts, Plan, Selection},
    provider::Roster,
    survey,
    terminal::{self, Complaint},
};

/// What it takes.
#[derive(Debug, Args)]
pub struct PlanArguments {
    /// The matrix file.
    file: PathBuf,
    #[command(flatten)]
    selection: SelectionArguments,
    #[command(flatten)]
    pub(crate) output: OutputArguments,
}

/// A matrix file and its plan for the hosts as they are now.
pub struct Planned {
    /// The file.
    pub file: MatrixFile,
    /// The plan.
    pub plan: Plan,
    /// The hosts and providers that were asked.
    pub roster: Roster,
    /// What they said, by the hosts' names.
    pub facts: BTreeMap<String, HostFacts>,
}

/// Plans and shows it.
///
/// # Errors
/// All that is wrong with the file.
pub async fn execute(arguments: &PlanArguments) -> Result<Exit, Complaint> {
    let planned = plan(&arguments.file, &arguments.selection, arguments.output).await?;
    if arguments.output.json {
        terminal::json(&as_json(&planned.plan));
    } else {
        terminal::result(&as_text(&planned.plan));
    }
    Ok(Exit::Done)
}

/// Reads a matrix file, asks the hosts, plans, and shows the warnings.
///
/// # Errors
/// All that is wrong with the file.
pub async fn plan(
    path: &Path,
    selection: &SelectionArguments,
    output: OutputArguments,
) -> Result<Planned, Complaint> {
    let file = MatrixFile::read(path, selection.profile.as_deref()).map_err(Complaint::of_mistakes)?;
    let roster = survey::roster(&file);
    let facts = survey::survey(&file, &roster).await;
    let selected = Selection {
        only: selection.only.clone(),
        skip: selection.skip.clone(),
    };
    let plan = plan::plan(&file, &facts, &selected, selection.order, selection.seed)
        .map_err(Complaint::of_mistakes)?;
    if !plan.warnings.is_empty() && !output.quiet {
        terminal::mistakes(&plan.warnings);
    }
    Ok(Planned {
        file,
        plan,
        roster,
        facts,
    })
}

/// The plan as JSON.
#[must_use]
pub fn as_json(plan: &Plan) -> Value {
    let record = &plan.record;
    json!({
        "scenarios": record.scenarios.iter().map(|scenario| json!({
            "id": scenario.id,
            "slug": scenario.slug,
            "axes": scenario.axes,
            "host": scenario.host,
            "feasible": scenario.feasible,
            "reason": scenario.reason,
            "not_selected": scenario.not_selected,
            "fix": scenario.fix,
            "settings": scenario.settings,
        })).collect::<Vec<_>>(),
        "order": record.order,
        "measuring_s": record.measuring_s,
        "smallest_attainable_p": plan.attainable.as_ref().map(|attainable| json!({
            "alpha": attainable.alpha,
            "best": {"n": attainable.best.n, "m": attainable.best.m, "p": attainable.best.p},
            "worst": {"n": attainable.worst.n, "m": attainable.worst.m, "p": attainable.worst.p},
        })),
        "warnings": plan.warnings.to_json(),
    })
}

/// The plan for a person.
#[must_use]
pub fn as_text(plan: &Plan) -> String {
    let record = &plan.record;
    let mut text = lines(record.scenarios.iter());
    if record.order.is_empty() {
        text.push_str("nothing can run here\n");
        return text;
    }
    let measuring = humantime::format_duration(Duration::from_secs_f64(record.measuring_s));
    let _ = writeln!(
        text,
        "order: {}; {measuring} of measuring",
        record.order.join(", ")
    );
    if let Some(attainable) = &plan.attainable {
        let worst = &attainable.worst;
        let can = if worst.p < attainable.alpha {
            "below"
        } else {
            "NOT below"
        };
        let _ = writeln!(
            text,
            "smallest attainable p: {:.2e} at n = {}, m = {}, {can} alpha = {}",
            worst.p, worst.n, worst.m, attainable.alpha
        );
    }
    text
}

/// Scenarios for a person: where each runs, or why it does not.
#[must_use]
pub fn lines<'a>(scenarios: impl Iterator<Item = &'a PlannedScenario> + Clone) -> String {
    let mut text = String::new();
    let width = scenarios.clone().map(|scenario| scenario.slug.len()).max();
    let width = width.unwrap_or(0);
    for scenario in scenarios {
        let standing = match (&scenario.reason, &scenario.not_selected) {
            (Some(reason), _) => format!("infeasible: {reason}"),
            (None, Some(why)) => why.clone(),
            (None, None) => format!("on {}", scenario.host.as_deref().unwrap_or("this machine")),
        };
        let _ = writeln!(text, "{:>2}  {:width$}  {standing}", scenario.id, scenario.slug);
        if let Some(fix) = &scenario.fix {
            let _ = writeln!(text, "    {:width$}  fix: {fix}", "");
        }
    }
    text
}
