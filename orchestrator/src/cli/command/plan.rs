//! `matrix plan FILE`: every scenario, whether it can run here and why not, the order, the duration, what can be found.

mod sensitivity;

use std::{
    collections::BTreeMap,
    fmt::Write,
    path::{Path, PathBuf},
    time::Duration,
};

use clap::Args;
use record::{quantity::Length, run_directory::PlannedScenario, settings::Settings};
use reports::analysis::{power, sample};
use schemars::JsonSchema;
use serde::Serialize;
use serde_json::{Map, Value};

use self::sensitivity::SensitivityRecord;
use crate::{
    cli::{
        command::{
            options::{OutputArguments, SelectionArguments},
            report::unreadable,
        },
        completion,
        exit::Exit,
        terminal::{self, CommandError},
    },
    disk_space,
    matrix_file::{DiagnosticRecord, Diagnostics, MatrixFile},
    plan::{self, Attainable, HostFacts, Plan, Selection, WindowDesign},
    provider::{AskedRight, Catalogue, Roster},
    survey,
};

/// What it takes.
#[derive(Debug, Args)]
pub struct PlanArguments {
    /// The matrix file.
    file: PathBuf,
    #[command(flatten)]
    selection: SelectionArguments,
    /// A run to learn from how much the levels of windows spread; the plan then says what it would find.
    #[arg(long, value_name = "RUN", conflicts_with = "spread", add = completion::runs())]
    pilot: Option<PathBuf>,
    /// How much window levels are assumed to spread (standard deviation), such as 1mm.
    #[arg(long, value_name = "LENGTH")]
    spread: Option<Length>,
    /// Simulate what a pair of windows would detect: more delay, more loss, late ticks. Takes a minute or more for each
    /// distinct experiment.
    #[arg(long)]
    sensitivity: bool,
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
pub async fn execute(arguments: &PlanArguments, catalogue: Catalogue) -> Result<Exit, CommandError> {
    let mut planned = plan(&arguments.file, &arguments.selection, arguments.output, catalogue).await?;
    let design = planned.plan.windows.as_ref();
    if let Some(warning) = design.and_then(|design| design.warning(&planned.file)) {
        let mut found = Diagnostics::default();
        found.push(warning.clone());
        if !arguments.output.quiet {
            terminal::mistakes(&found);
        }
        planned.plan.warnings.push(warning);
    }
    let spread_m = spread_of_levels(arguments)?;
    let scenarios = planned.plan.record.scenarios.iter();
    let sensitivity = arguments
        .sensitivity
        .then(|| sensitivity::of(scenarios, &planned.file.report, arguments.selection.seed));
    if arguments.output.json {
        let mut document = document(&planned.plan);
        document.sensitivity = sensitivity.as_deref().map(sensitivity::records);
        if let (Some(spread_m), Some(design)) = (spread_m, &planned.plan.windows) {
            document.detectable_shift_m = Some(design.detectable_shift_m(spread_m));
            document.spread_m = Some(spread_m);
        }
        terminal::json(&document);
    } else {
        let mut text = as_text(&planned.plan);
        if let (Some(spread_m), Some(design)) = (spread_m, &planned.plan.windows) {
            text.push_str(&what_would_be_found(design, spread_m));
        }
        if let Some(found) = &sensitivity {
            text.push_str(&sensitivity::as_text(found));
        }
        terminal::result(&text);
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
    catalogue: Catalogue,
) -> Result<Planned, CommandError> {
    let file = read(path, selection, catalogue)?;
    let roster = survey::roster(&file);
    let facts = survey::survey(&file, &roster).await;
    let plan = plan_on(&facts, &file, selection, output)?;
    Ok(Planned {
        file,
        plan,
        roster,
        facts,
    })
}

/// Reads a matrix file, asks nobody, plans, and shows the warnings.
///
/// # Errors
/// All that is wrong with the file.
pub fn plan_unasked(
    path: &Path,
    selection: &SelectionArguments,
    output: OutputArguments,
    catalogue: Catalogue,
) -> Result<Plan, CommandError> {
    let file = read(path, selection, catalogue)?;
    plan_on(&survey::unasked(&file), &file, selection, output)
}

fn read(
    path: &Path,
    selection: &SelectionArguments,
    catalogue: Catalogue,
) -> Result<MatrixFile, CommandError> {
    MatrixFile::read(path, selection.profile.as_deref(), catalogue).map_err(CommandError::of_mistakes)
}

fn plan_on(
    facts: &BTreeMap<String, HostFacts>,
    file: &MatrixFile,
    selection: &SelectionArguments,
    output: OutputArguments,
) -> Result<Plan, CommandError> {
    let selected = Selection {
        only: selection.only.clone(),
        skip: selection.skip.clone(),
    };
    let plan = plan::plan(file, facts, &selected, selection.order, selection.seed)
        .map_err(CommandError::of_mistakes)?;
    if !plan.warnings.is_empty() && !output.quiet {
        terminal::mistakes(&plan.warnings);
    }
    Ok(plan)
}

/// Every scenario of a matrix file, whether it can run here, the order and the duration.
#[derive(Debug, Serialize, JsonSchema)]
#[schemars(title = "matrix plan --json")]
pub struct PlanDocument<'a> {
    /// Every scenario, in letter order.
    scenarios: Vec<ScenarioRecord<'a>>,
    /// Letters of the scenarios that run, in the order in which they run.
    order: &'a [String],
    /// Time that measuring takes, in seconds: windows only, on the host that has most of them.
    measuring_s: f64,
    /// The smallest p that the comparisons can reach; null if there is nothing to compare.
    smallest_attainable_p: Option<Attainable>,
    /// What the plan can show with the window as the unit; null without a pair.
    windows_as_units: Option<WindowDesign>,
    /// About how many bytes the windows leave in the run directory, before compression.
    data_bytes: u64,
    /// What containers may do beyond what every container of `matrix` may.
    rights: &'a [AskedRight],
    /// What is odd in the file and no error.
    warnings: Vec<DiagnosticRecord<'a>>,
    /// What a pair of windows would detect; only with `--sensitivity`.
    #[serde(skip_serializing_if = "Option::is_none")]
    sensitivity: Option<Vec<SensitivityRecord<'a>>>,
    /// The shift that would be found, in metres, null if none would; only with `--pilot` or `--spread`.
    #[serde(skip_serializing_if = "Option::is_none")]
    detectable_shift_m: Option<Option<f64>>,
    /// The standard deviation of window levels for it, in metres; only with `--pilot` or `--spread`.
    #[serde(skip_serializing_if = "Option::is_none")]
    spread_m: Option<f64>,
}

/// A scenario of a plan.
#[derive(Debug, Serialize, JsonSchema)]
struct ScenarioRecord<'a> {
    /// Its letter.
    id: &'a str,
    /// Its name in files, such as `x86-64-debian-12-native`.
    slug: &'a str,
    /// Axis to value.
    axes: &'a Map<String, Value>,
    /// Name of the host that runs it; null if no host can.
    host: Option<&'a str>,
    /// Whether it can run.
    feasible: bool,
    /// Why it cannot run; null if it can.
    reason: Option<&'a str>,
    /// Why it is left out although it may be feasible; null if it is not left out.
    not_selected: Option<&'a str>,
    /// What would make it feasible, where something would.
    fix: Option<&'a str>,
    /// The workload's settings, with the axes' values.
    settings: &'a Settings,
}

/// The plan for a program.
#[must_use]
pub fn document(plan: &Plan) -> PlanDocument<'_> {
    let record = &plan.record;
    let scenarios = record.scenarios.iter().map(|scenario| ScenarioRecord {
        id: &scenario.id,
        slug: &scenario.slug,
        axes: &scenario.axes,
        host: scenario.host.as_deref(),
        feasible: scenario.feasible,
        reason: scenario.reason.as_deref(),
        not_selected: scenario.not_selected.as_deref(),
        fix: scenario.fix.as_deref(),
        settings: &scenario.settings,
    });
    PlanDocument {
        scenarios: scenarios.collect(),
        order: &record.order,
        measuring_s: record.measuring_s,
        smallest_attainable_p: plan.attainable,
        windows_as_units: plan.windows,
        data_bytes: data_bytes(plan),
        rights: &plan.rights,
        warnings: plan.warnings.to_json(),
        sensitivity: None,
        detectable_shift_m: None,
        spread_m: None,
    }
}

/// The plan for a person.
#[must_use]
pub fn as_text(plan: &Plan) -> String {
    let record = &plan.record;
    let mut text = lines(record.scenarios.iter(), &plan.silent);
    if record.order.is_empty() {
        text.push_str("nothing can run here\n");
        return text;
    }
    for right in &plan.rights {
        let _ = writeln!(text, "{}: {}: {}", right.setting, right.asked, right.means);
    }
    let measuring = humantime::format_duration(Duration::from_secs_f64(record.measuring_s));
    let _ = writeln!(
        text,
        "order: {}; {measuring} of measuring, about {} of data",
        record.order.join(", "),
        disk_space::in_words(data_bytes(plan))
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
    if let Some(design) = &plan.windows {
        let can = if design.can_reject() { "below" } else { "NOT below" };
        let _ = write!(
            text,
            "windows as units: smallest p {:.2e} at {w} : {w}, {:.2e} by Holm in a family of {}, {can} alpha = {}",
            design.smallest_p,
            design.smallest_p_holm,
            design.pairs,
            design.alpha,
            w = design.windows
        );
        match design.windows_needed {
            Some(windows) if !design.can_reject() => {
                let _ = writeln!(text, "; {windows} windows would do");
            }
            _ => text.push('\n'),
        }
    }
    text
}

/// The standard deviation of window levels, in metres: assumed, or as the pilot run has it.
fn spread_of_levels(arguments: &PlanArguments) -> Result<Option<f64>, CommandError> {
    let Some(pilot) = &arguments.pilot else {
        return Ok(arguments.spread.map(Length::metres));
    };
    let run = reports::load(pilot).map_err(|error| unreadable(&error))?;
    let samples = sample::samples(&run, &run.manifest.report);
    power::spread_of_levels(&samples)
        .map(Some)
        .ok_or_else(|| CommandError {
            what: format!("no scenario of {} has two windows that count", pilot.display()).into(),
            hint: Some("give a run with two windows or more a scenario, or `--spread 1mm`".to_owned()),
            exit: Exit::Wrong,
        })
}

fn what_would_be_found(design: &WindowDesign, spread_m: f64) -> String {
    let spread = format!("window levels that spread by {:.3} mm", spread_m * 1e3);
    match design.detectable_shift_m(spread_m) {
        Some(shift_m) => format!(
            "with {spread}: a shift of {:.3} mm is found with {:.0} % power (Student's t, Holm's first step)\n",
            shift_m * 1e3,
            power::POWER * 100.0
        ),
        None => format!("with {spread}: no shift is found by windows, however large it is\n"),
    }
}

/// About how many bytes the windows of all scenarios that run leave in the run directory, before compression.
fn data_bytes(plan: &Plan) -> u64 {
    let running = plan.record.scenarios.iter().filter(|scenario| scenario.runs());
    running
        .map(|scenario| disk_space::windows_take(&scenario.settings, scenario.settings.windows as usize))
        .sum()
}

/// Scenarios for a person: where each runs, or why it does not. Hosts that could not be asked are `silent`, each with why.
#[must_use]
pub fn lines<'a>(
    scenarios: impl Iterator<Item = &'a PlannedScenario> + Clone,
    silent: &BTreeMap<String, String>,
) -> String {
    let mut text = String::new();
    let width = scenarios.clone().map(|scenario| scenario.slug.len()).max();
    let width = width.unwrap_or(0);
    for scenario in scenarios {
        let standing = match (&scenario.reason, &scenario.not_selected) {
            (Some(reason), _) => format!("infeasible: {reason}"),
            (None, Some(why)) => why.clone(),
            (None, None) => {
                let host = scenario.host.as_deref().unwrap_or("this machine");
                match silent.get(host) {
                    Some(why) => format!("on {host}, once it answers: {why}"),
                    None => format!("on {host}"),
                }
            }
        };
        let _ = writeln!(text, "{:>2}  {:width$}  {standing}", scenario.id, scenario.slug);
        if let Some(fix) = &scenario.fix {
            let _ = writeln!(text, "    {:width$}  fix: {fix}", "");
        }
    }
    text
}
