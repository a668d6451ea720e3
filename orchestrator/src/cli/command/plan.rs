//! `matrix plan FILE`: every scenario, whether it can run here and why not, the order, the duration, what can be found.

mod sensitivity;

use std::{collections::BTreeMap, fmt::Write, path::PathBuf, time::Duration};

use clap::Args;
use record::{exit::matrix::Exit, quantity::Length, run_directory::PlannedScenario, settings::Settings};
use reports::analysis::{quantity::Quantity, replicates, sample};
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
        run_argument::run_argument,
        terminal::{self, CommandError},
    },
    disk_space,
    matrix_file::{DiagnosticRecord, Diagnostics},
    plan::{Attainable, Design, DesignPower, LevelSpread, Plan, PowerPoint, Unit},
    preparation,
    provider::{AskedRight, Catalogue},
};

/// What it takes.
#[derive(Debug, Args)]
pub struct PlanArguments {
    /// The matrix file.
    file: PathBuf,
    #[command(flatten)]
    selection: SelectionArguments,
    /// A run to learn from how much the levels of windows or the means of environments spread; the plan then says what it would find.
    #[arg(long, value_name = "RUN", conflicts_with_all = ["window_sd", "environment_sd"], value_parser = run_argument(), add = completion::runs())]
    pilot: Option<PathBuf>,
    /// The standard deviation that window levels are assumed to have, such as 1mm.
    #[arg(long, value_name = "LENGTH", alias = "spread")]
    window_sd: Option<Length>,
    /// The standard deviation that environment means within a round are assumed to have, where scenarios have several environments.
    #[arg(long, value_name = "LENGTH", conflicts_with = "window_sd")]
    environment_sd: Option<Length>,
    /// Simulate what a pair of windows would detect: more delay, more loss, late ticks. Takes a minute or more for each
    /// distinct experiment.
    #[arg(long)]
    sensitivity: bool,
    #[command(flatten)]
    pub(crate) output: OutputArguments,
}

/// Plans and shows it.
///
/// # Errors
/// All that is wrong with the file.
pub async fn execute(arguments: &PlanArguments, catalogue: Catalogue) -> Result<Exit, CommandError> {
    let request = arguments.selection.request(&arguments.file);
    let mut planned = preparation::prepare(&request, catalogue).await?;
    show_warnings(&planned.plan, arguments.output);
    // Where scenarios have several environments, the verdicts are by these, and what windows would show decides nothing.
    let design = planned.plan.environments.or(planned.plan.windows);
    let warning = design.and_then(|design| design.warning(&planned.file));
    if let Some(warning) = warning {
        let mut found = Diagnostics::default();
        found.push(warning.clone());
        if !arguments.output.quiet {
            terminal::print_diagnostics(&found);
        }
        planned.plan.warnings.push(warning);
    }
    let report = &planned.file.report;
    let settings = planned
        .plan
        .record
        .scenarios
        .iter()
        .map(|scenario| &scenario.settings);
    let quantity = Quantity::main(&Quantity::all(settings, report), report);
    let power = match design {
        Some(design) => {
            let spread = spread_of_levels(arguments, design.unit, &quantity)?;
            Some((design, design.power(spread)))
        }
        None => None,
    };
    let scenarios = planned.plan.record.scenarios.iter();
    let sensitivity = arguments
        .sensitivity
        .then(|| sensitivity::of(scenarios, &planned.file.report, arguments.selection.seed));
    if arguments.output.json {
        let mut document = document(&planned.plan);
        document.sensitivity = sensitivity.as_deref().map(sensitivity::records);
        if let Some((design, power)) = &power {
            document.detectable_shift = power.spread.map(|_| {
                let planned = power.at(design.units);
                planned.and_then(|point| point.shift)
            });
            document.spread = power.spread;
        }
        document.power = power.map(|(_, power)| power);
        terminal::json(&document);
    } else {
        let mut text = as_text(&planned.plan);
        if let Some((design, power)) = &power {
            text.push_str(&what_would_be_found(design, power, &quantity));
        }
        if let Some(found) = &sensitivity {
            text.push_str(&sensitivity::as_text(found));
        }
        terminal::result(&text);
    }
    Ok(Exit::Done)
}

/// Shows what is odd in the file and no error.
pub fn show_warnings(plan: &Plan, output: OutputArguments) {
    if !plan.warnings.is_empty() && !output.quiet {
        terminal::print_diagnostics(&plan.warnings);
    }
}

/// Every scenario of a matrix file, whether it can run here, the order and the duration.
#[derive(Debug, Serialize, JsonSchema)]
#[schemars(title = "matrix plan --json")]
pub struct PlanDocument<'a> {
    /// Every scenario, in letter order.
    scenarios: Vec<ScenarioRecord<'a>>,
    /// Letters of the scenarios that run, in the order in which they run: in the first round, if there are several.
    order: &'a [String],
    /// The order of each further round, in which every scenario of it has a new environment.
    later_rounds: &'a [Vec<String>],
    /// Time that measuring takes, in seconds: windows only, on the host that has most of them.
    measuring_s: f64,
    /// The smallest p that the comparisons can reach; null if there is nothing to compare.
    smallest_attainable_p: Option<Attainable>,
    /// What the plan can show with the window as the unit; null without a pair.
    windows_as_units: Option<Design>,
    /// What the plan can show with the environment as the unit; null without a pair, or if each scenario has one environment.
    environments_as_units: Option<Design>,
    /// About how many bytes the windows leave in the run directory, before compression.
    data_bytes: u64,
    /// What containers may do beyond what every container of `matrix` may.
    rights: &'a [AskedRight],
    /// What the batch systems of hosts that are clusters say, such as when a job would run, by host; absent without such hosts.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    batch_systems: &'a BTreeMap<String, String>,
    /// What is odd in the file and no error.
    warnings: Vec<DiagnosticRecord<'a>>,
    /// What a pair of windows would detect; only with `--sensitivity`.
    #[serde(skip_serializing_if = "Option::is_none")]
    sensitivity: Option<Vec<SensitivityRecord<'a>>>,
    /// The shift of levels that would be found, by the number of windows, or of environments if scenarios have several; only of
    /// `matrix plan` with a pair.
    #[serde(skip_serializing_if = "Option::is_none")]
    power: Option<DesignPower>,
    /// The shift that would be found with 80 % power, in the unit of the metric, null if none would; only with `--pilot`, `--window-sd` or
    /// `--environment-sd`.
    #[serde(skip_serializing_if = "Option::is_none")]
    detectable_shift: Option<Option<f64>>,
    /// The standard deviation for it, as `power` has it; only with one of these options.
    #[serde(skip_serializing_if = "Option::is_none")]
    spread: Option<f64>,
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
    /// The hosts of its pool that take turns with its rounds; empty if one host runs them all.
    pool: &'a [String],
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
        pool: &scenario.pool,
        feasible: scenario.feasible,
        reason: scenario.reason.as_deref(),
        not_selected: scenario.not_selected.as_deref(),
        fix: scenario.fix.as_deref(),
        settings: &scenario.settings,
    });
    PlanDocument {
        scenarios: scenarios.collect(),
        order: &record.order,
        later_rounds: &record.later_rounds,
        measuring_s: record.measuring_s,
        smallest_attainable_p: plan.attainable,
        windows_as_units: plan.windows,
        environments_as_units: plan.environments,
        data_bytes: data_bytes(plan),
        rights: &plan.rights,
        batch_systems: &plan.batch_systems,
        warnings: plan.warnings.to_json(),
        sensitivity: None,
        power: None,
        detectable_shift: None,
        spread: None,
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
    for (host, said) in &plan.batch_systems {
        let _ = writeln!(text, "{host}: {said}");
    }
    let measuring = humantime::format_duration(Duration::from_secs_f64(record.measuring_s));
    // A command is known by its timeout alone.
    let has_commands = record.scenarios.iter().any(|it| it.settings.experiment.is_some());
    let orders: Vec<String> = record.rounds().map(|(_, order)| order.join(", ")).collect();
    let _ = writeln!(
        text,
        "order: {}; {}{measuring} of measuring, about {} of data",
        orders.join(" | "),
        if has_commands { "at most " } else { "" },
        disk_space::in_words(data_bytes(plan))
    );
    if orders.len() > 1 {
        let environments: usize = record.rounds().map(|(_, order)| order.len()).sum();
        let _ = writeln!(
            text,
            "{environments} environments, made anew in each of {} rounds",
            orders.len()
        );
    }
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
    let mut designs = [&plan.environments, &plan.windows]
        .into_iter()
        .flatten()
        .peekable();
    let running = record.scenarios.iter().filter(|scenario| scenario.runs());
    if designs.peek().is_none() && running.count() > 1 {
        text.push_str(
            "the family (`report.family`) has no pair of scenarios that run the same experiment, so that none is tested; name pairs \
             there to have them tested all the same\n",
        );
    }
    for design in designs {
        text.push_str(&design.as_text());
    }
    text
}

/// The spread of window levels or of environment means: assumed, or as the pilot run has it.
fn spread_of_levels(
    arguments: &PlanArguments,
    unit: Unit,
    quantity: &Quantity,
) -> Result<Option<LevelSpread>, CommandError> {
    let wrong = |what: String, hint: &str| CommandError {
        what: what.into(),
        hint: Some(hint.to_owned()),
        exit: Exit::Wrong,
    };
    let (assumed, other) = match unit {
        Unit::Window => (arguments.window_sd, arguments.environment_sd),
        Unit::Environment => (arguments.environment_sd, arguments.window_sd),
    };
    if other.is_some() {
        let what = format!("this plan compares {}, whose spread that is not", unit.plural());
        let hint = match unit {
            Unit::Window => "give `--window-sd`: each scenario has one environment",
            Unit::Environment => "give `--environment-sd`: scenarios have several environments",
        };
        return Err(wrong(what, hint));
    }
    if assumed.is_some() && !quantity.is_tracking_error {
        let what = format!("this plan measures {}, whose spread is no length", quantity.name);
        return Err(wrong(what, "give a run of the experiment as `--pilot RUN`"));
    }
    let Some(pilot) = &arguments.pilot else {
        return Ok(assumed.map(|assumed| LevelSpread {
            deviation: assumed.metres(),
            freedom: None,
        }));
    };
    let run = reports::load(pilot).map_err(|error| unreadable(&error))?;
    let report = &run.manifest.report;
    let samples = sample::samples(&run, report, &Quantity::main_of_run(&run, report));
    let pilot = pilot.display();
    let found = match unit {
        Unit::Window => sample::spread_of_levels(&samples).ok_or_else(|| {
            wrong(
                format!("no scenario of {pilot} has two windows that count"),
                "give a run with two windows or more a scenario, or `--window-sd 1mm`",
            )
        })?,
        Unit::Environment => replicates::spread_of_environments(&run, &samples).ok_or_else(|| {
            wrong(
                format!("{pilot} has no two scenarios with environments in two rounds that count"),
                "give a run with `environments: 2` or more, or `--environment-sd 1mm`",
            )
        })?,
    };
    Ok(Some(LevelSpread {
        deviation: found.deviation,
        freedom: Some(found.freedom),
    }))
}

/// Two lines: what the plan finds, and what more units would.
fn what_would_be_found(design: &Design, power: &DesignPower, quantity: &Quantity) -> String {
    let shift = |point: &PowerPoint| match point.shift {
        Some(shift) => quantity.magnitude_text(shift),
        None => format!("{:.2} sd", point.shift_sd),
    };
    let mut text = format!("found with {:.0} % power: ", power.power * 100.0);
    let planned = design.unit.against(design.units);
    let _ = match power.at(design.units) {
        Some(point) => write!(
            text,
            "a shift of {} at {planned} ({:.0} % with heavy tails)",
            shift(point),
            point.power_heavy_tails * 100.0,
        ),
        None => write!(text, "no shift at {planned}, however large"),
    };
    let more = power.curve.iter().filter(|point| point.units > design.units);
    let more: Vec<String> = more
        .map(|point| format!("{} at {}", shift(point), point.units))
        .collect();
    if !more.is_empty() {
        let _ = write!(text, "; {}", more.join(", "));
    }
    let levels = design.unit.levels();
    let _ = match (power.spread, power.spread_freedom) {
        (Some(spread), Some(freedom)) => writeln!(
            text,
            "\n  if {levels} spread by {}, as the pilot estimates with {freedom} degrees of freedom",
            quantity.magnitude_text(spread)
        ),
        (Some(spread), None) => writeln!(
            text,
            "\n  if {levels} spread by {}",
            quantity.magnitude_text(spread)
        ),
        (None, _) => writeln!(
            text,
            "\n  in standard deviations of {levels}; `--pilot RUN` gives the unit"
        ),
    };
    text
}

/// About how many bytes the windows of all scenarios that run leave in the run directory, before compression.
fn data_bytes(plan: &Plan) -> u64 {
    let running = plan.record.scenarios.iter().filter(|scenario| scenario.runs());
    running
        .map(|scenario| {
            disk_space::windows_take(&scenario.settings, scenario.settings.all_windows() as usize)
        })
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
                match (silent.get(host), scenario.pool.as_slice()) {
                    (Some(why), _) => format!("on {host}, once it answers: {why}"),
                    (None, []) => format!("on {host}"),
                    (None, pool) => format!("on {} in turn", pool.join(", ")),
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
