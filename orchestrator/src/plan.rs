//! Matrix file and what the hosts can do -> every scenario, feasible or not and why, and the order they run in. The main
//! function is [`plan`], the main type [`Plan`]. [`ExpandedMatrix`] is half of the way: it is known what the hosts are, and not
//! what they can do.
//!
//! Pure: no clock, no host, no randomness but that of the seed. The same file, facts, selection and seed give the same
//! plan, on every machine and in every version.

pub mod attainable;
pub mod expansion;
pub mod naming;
pub mod order;
pub mod placement;
pub(crate) mod report_names;
pub mod selection;
mod units;

use std::collections::{BTreeMap, BTreeSet};

use record::{
    axis::SIMULATED,
    connection::Connection,
    run_directory::{FORMAT, PlanRecord, PlannedScenario},
    settings::{Need, Settings},
};
use serde_json::Value;
use sha2::{Digest as _, Sha256};

pub use attainable::Attainable;
use order::Order;
pub use placement::{HostFacts, Obstacle, ProviderFacts};
pub use selection::Selection;
pub use units::{Design, DesignPower, LevelSpread, PowerPoint, Unit};

use attainable::{fewest_values, smallest_p};
use expansion::{Combination, expand};
use placement::{HostCapabilities, fitting, place};
use selection::Candidate;

use crate::{
    matrix_file::{Code, Diagnostic, Diagnostics, FEWER, Host, MatrixFile, PlatformFiles},
    provider::{AskedRight, Availability},
};

/// What will happen.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// As it stands in the run directory.
    pub record: PlanRecord,
    /// The smallest p that its comparisons can reach; none if there is nothing to compare.
    pub attainable: Option<Attainable>,
    /// What it can say with the window as the unit; none without a pair.
    pub windows: Option<Design>,
    /// What it can say with the environment as the unit, which then decides; none without a pair, and where each scenario has one.
    pub environments: Option<Design>,
    /// The hosts that could not be asked what they can do, and why.
    pub silent: BTreeMap<String, String>,
    /// What the batch systems of hosts that are clusters say, such as when a job would run; of those that measure something.
    pub batch_systems: BTreeMap<String, String>,
    /// The hosts that stand for nodes of a cluster that was not asked which they are.
    pub unknown_nodes: Vec<String>,
    /// What environments of scenarios that run may do beyond what every environment of ours may.
    pub rights: Vec<AskedRight>,
    /// What is odd and yet no error, the file's own warnings among it.
    pub warnings: Diagnostics,
}

/// What to ask of a host's providers, by their names: the needs of the scenarios that could run there, each once.
pub type Questions = BTreeMap<String, BTreeSet<Need>>;

/// A matrix, expanded: every scenario with its settings, before a host is chosen. [`Self::questions`] lists what to ask the
/// hosts, [`Self::plan`] places the scenarios by the answers.
#[derive(Debug, Clone)]
pub struct ExpandedMatrix<'a> {
    file: &'a MatrixFile,
    /// What the hosts are, not what they can do.
    offers: Vec<HostCapabilities>,
    combinations: Vec<Combination>,
    /// Of each combination, in the same order.
    settings: Vec<Settings>,
    /// What is odd, and what is wrong with settings. [`Self::plan`] adds its own: all mistakes are reported together.
    found: Diagnostics,
}

impl<'a> ExpandedMatrix<'a> {
    /// Expands the matrix of a file, for hosts of which `facts` are known, by host name. Of these, only what the hosts are is
    /// read.
    ///
    /// # Errors
    /// All that is wrong with the axes, excludes and includes, and what the file has of a host and is false.
    pub fn of(file: &'a MatrixFile, facts: &BTreeMap<String, HostFacts>) -> Result<Self, Diagnostics> {
        let mut found = file.warnings.clone();
        let offers = offers(file, facts);
        let combinations = expand(file, &offers, &mut found);
        check_nodes(file, &mut found);
        check_hosts(file, &combinations, &offers, &mut found);
        let (combinations, mut found) = found.unless_errors(combinations)?;
        let settings = combinations
            .iter()
            .map(|combination| settings(file, combination, &mut found))
            .collect();
        Ok(Self {
            file,
            offers,
            combinations,
            settings,
            found,
        })
    }

    /// What to ask the hosts before planning, by their names. Nothing where something is wrong: [`Self::plan`] then fails.
    #[must_use]
    pub fn questions(&self) -> BTreeMap<String, Questions> {
        let mut questions: BTreeMap<_, Questions> = BTreeMap::new();
        if self.found.has_errors() {
            return questions;
        }
        let scenarios = std::iter::zip(&self.combinations, &self.settings);
        for (combination, settings) in scenarios.filter(|(one, _)| one.excluded.is_none()) {
            let need = Need::of(settings);
            for offer in fitting(combination, &self.offers) {
                questions
                    .entry(offer.host.clone())
                    .or_default()
                    .entry(self.file.provider_of(combination.virtualization()).to_owned())
                    .or_default()
                    .extend(need.clone());
            }
        }
        questions
    }

    /// Places the scenarios. The `facts` are of the same hosts, now with what their providers can do.
    ///
    /// # Errors
    /// All that is wrong with settings, with the file as a whole, and with the selection.
    pub fn plan(
        self,
        facts: &BTreeMap<String, HostFacts>,
        selection: &Selection,
        order: Order,
        seed: u64,
    ) -> Result<Plan, Diagnostics> {
        let Self {
            file,
            combinations,
            settings,
            mut found,
            ..
        } = self;
        let offers = offers(file, facts);
        let mut scenarios = scenarios(file, &combinations, settings, &offers, &mut found);
        placement::share(&mut scenarios, &offers);
        report_names::check(&file.places(), &file.report, &scenarios, &mut found);
        let (left_out, mut found) = match selection.apply(&candidates(&scenarios)) {
            Ok(left_out) => found.unless_errors(left_out)?,
            Err(nothing) => {
                found.extend(nothing);
                return Err(found);
            }
        };
        for (scenario, why) in std::iter::zip(&mut scenarios, left_out) {
            scenario.not_selected = why;
        }
        let attainable = attainable(file, &combinations, &scenarios);
        let windows = Design::by_windows(&scenarios, &file.report);
        if let Some(attainable) = attainable {
            check_attainable(file, attainable, &mut found);
        }
        let running: Vec<_> = scenarios.iter().filter(|scenario| scenario.runs()).collect();
        // Hosts are at work side by side: the last to be done decides.
        let mut measuring_s = BTreeMap::<_, f64>::new();
        for scenario in &running {
            let in_each =
                measuring_seconds(&scenario.settings) / f64::from(scenario.settings.environments.max(1));
            for round in scenario.rounds() {
                *measuring_s.entry(scenario.host_in(round)).or_default() += in_each;
            }
        }
        check_windows(file, &scenarios, &mut found);
        let used: BTreeSet<_> = running.iter().map(|it| it.provider()).collect();
        let kinds = file.catalogue.kinds().filter(|kind| used.contains(kind.name));
        let rights = kinds.flat_map(|kind| (kind.rights)(&file.providers)).collect();
        let mut orders = order.rounds(&running, seed).into_iter();
        let record = PlanRecord {
            format: FORMAT,
            order: orders.next().unwrap_or_default(),
            later_rounds: orders.collect(),
            measuring_s: measuring_s.into_values().fold(0.0, f64::max),
            scenarios,
        };
        let (record, warnings) = found.unless_errors(record)?;
        let environments =
            windows.and_then(|windows| windows.by_environments(&record.scenarios, &file.report));
        Ok(Plan {
            batch_systems: batch_systems(file, facts, &record.scenarios),
            record,
            attainable,
            environments,
            windows,
            unknown_nodes: file
                .hosts
                .iter()
                .filter(|host| host.is_each_node())
                .map(|host| host.name.value.clone())
                .collect(),
            silent: offers
                .iter()
                .filter_map(|offer| Some((offer.host.clone(), offer.silence()?.reason.clone())))
                .collect(),
            rights,
            warnings,
        })
    }
}

/// Plans the scenarios of a matrix file on hosts of which `facts` are known, by host name.
///
/// # Errors
/// All that is wrong with the file as a whole, and with the selection.
pub fn plan(
    file: &MatrixFile,
    facts: &BTreeMap<String, HostFacts>,
    selection: &Selection,
    order: Order,
    seed: u64,
) -> Result<Plan, Diagnostics> {
    ExpandedMatrix::of(file, facts)?.plan(facts, selection, order, seed)
}

/// What the hosts offer, as far as it is known.
fn offers(file: &MatrixFile, facts: &BTreeMap<String, HostFacts>) -> Vec<HostCapabilities> {
    file.hosts
        .iter()
        .map(|host| HostCapabilities::of(host, facts.get(&host.name.value)))
        .collect()
}

fn batch_systems(
    file: &MatrixFile,
    facts: &BTreeMap<String, HostFacts>,
    scenarios: &[PlannedScenario],
) -> BTreeMap<String, String> {
    let said = |host: &Host| {
        let name = &host.name.value;
        let of_host = |it: &&PlannedScenario| it.runs() && it.host.as_ref() == Some(name);
        let scenario = scenarios.iter().find(of_host)?;
        match &facts.get(name)?.providers.get(&scenario.provider())?.availability {
            Availability::Available { detail } => Some((name.clone(), detail.clone())),
            Availability::Unavailable { .. } => None,
        }
    };
    let clusters = file
        .hosts
        .iter()
        .filter(|it| matches!(it.connection, Connection::Slurm(_)));
    clusters.filter_map(said).collect()
}

/// Each is a folder of the run directory.
fn check_windows(file: &MatrixFile, scenarios: &[PlannedScenario], found: &mut Diagnostics) {
    let windows: u64 = scenarios
        .iter()
        .map(|it| u64::from(it.settings.all_windows()))
        .sum();
    if windows > PlanRecord::MOST_WINDOWS {
        let most = PlanRecord::MOST_WINDOWS;
        let message = format!("these are {windows} windows in all, more than {most}");
        let span = file.place_of("workload.windows");
        found.push(Diagnostic::error(&file.source, Code::InvalidValue, span, message).help(FEWER));
    }
}

/// Without asking a cluster its nodes are not known.
fn check_nodes(file: &MatrixFile, found: &mut Diagnostics) {
    for host in file.hosts.iter().filter(|host| host.is_each_node()) {
        let message = format!(
            "which nodes `{}` stands for was not asked: it is planned as one host",
            host.name.value
        );
        let help = "`matrix plan` asks the cluster";
        found.push(Diagnostic::warning(&file.source, Code::SilentHost, host.name.span, message).help(help));
    }
}

/// What the file says of a host must be so, and one that is out of reach is worth a word. Of hosts that are to measure
/// something: what is played needs no machine.
fn check_hosts(
    file: &MatrixFile,
    combinations: &[Combination],
    offers: &[HostCapabilities],
    found: &mut Diagnostics,
) {
    let measured = |it: &&Combination| {
        it.excluded.is_none() && !file.catalogue.is_simulated(file.provider_of(it.virtualization()))
    };
    let wanted: BTreeSet<&str> = combinations
        .iter()
        .filter(measured)
        .flat_map(|combination| fitting(combination, offers))
        .map(|offer| offer.host.as_str())
        .collect();
    for offer in offers.iter().filter(|offer| wanted.contains(offer.host.as_str())) {
        if let Some(false_claim) = &offer.contradiction {
            let span = file.place_of(&format!("hosts.{}.{}", offer.host, false_claim.axis));
            let reason = &false_claim.reason;
            found
                .push(Diagnostic::error(&file.source, Code::FalseClaim, span, reason).help(&false_claim.fix));
        }
        if let Some(silence) = offer.silence() {
            let span = file.place_of_key(&format!("hosts.{}", offer.host));
            let tried = "its scenarios are tried all the same when their turn comes";
            let help = match &silence.fix {
                Some(fix) => format!("{fix}; {tried}"),
                None => tried.to_owned(),
            };
            let message = format!(
                "host `{}` cannot be asked what it can do: {}",
                offer.host, silence.reason
            );
            found.push(Diagnostic::warning(&file.source, Code::SilentHost, span, message).help(help));
        }
    }
}

/// Names and hosts for the combinations, each of which has its settings.
fn scenarios(
    file: &MatrixFile,
    combinations: &[Combination],
    settings: Vec<Settings>,
    offers: &[HostCapabilities],
    found: &mut Diagnostics,
) -> Vec<PlannedScenario> {
    let texts = |combination: &Combination| {
        let values = combination.axes.iter();
        values
            .map(|(axis, value)| (axis.clone(), value.text.clone()))
            .collect::<Vec<_>>()
    };
    let slugs = naming::slugs(&combinations.iter().map(texts).collect::<Vec<_>>());
    let mut platforms = file.platforms.as_ref().map(PlatformFiles::reader);
    let named = std::iter::zip(combinations, slugs).zip(settings).enumerate();
    named
        .map(|(index, ((combination, slug), mut settings))| {
            if let Some(simulation) = &mut settings.simulation {
                simulation.seed = seed_of(simulation.seed, &slug);
                let platforms = platforms.as_mut().filter(|_| combination.excluded.is_none());
                match platforms.map(|platforms| platforms.read(&slug)) {
                    Some(Ok(platform)) => simulation.platform = platform,
                    Some(Err(wrong)) => found.extend(wrong),
                    None => {}
                }
            }
            let provider = file.provider_of(combination.virtualization());
            let is_simulated = file.catalogue.is_simulated(provider);
            let mut placement = place(combination, provider, &settings, offers);
            if file.all_simulated {
                placement.compute_on(offers);
            }
            // Of two reasons the excluding one counts: it holds whatever the host can do.
            let (reason, fix) = match (&combination.excluded, placement.obstacle) {
                (Some(reason), _) => (Some(reason.clone()), None),
                (None, Some(obstacle)) => (Some(obstacle.reason), obstacle.fix),
                (None, None) if settings.experiment.is_some() && is_simulated => (
                    Some(format!(
                        "`{provider}` computes the ball on the plate, and no command's numbers"
                    )),
                    Some(
                        "measure it: take `--simulated` away, and the value off the axis `virtualization`"
                            .to_owned(),
                    ),
                ),
                (None, None) => (None, None),
            };
            PlannedScenario {
                id: naming::letter(index),
                slug,
                axes: texts(combination)
                    .into_iter()
                    .map(|(axis, text)| (axis, Value::String(text)))
                    .collect(),
                host: placement.host,
                pool: placement.pool,
                feasible: reason.is_none(),
                reason,
                fix,
                not_selected: None,
                simulated: is_simulated,
                settings,
            }
        })
        .collect()
}

/// Scenarios draw each for itself: with one seed for all, those with the same settings would have the same numbers.
fn seed_of(seed: u64, slug: &str) -> u64 {
    let digest = Sha256::digest(format!("{seed} {slug}"));
    // So that whoever reads it as a double has the same number.
    let first = digest.iter().take(6);
    first.fold(0, |seed, byte| (seed << 8) | u64::from(*byte))
}

/// The workload's settings with the combination's sweeps. What does not fit together matters only where it may run.
fn settings(file: &MatrixFile, combination: &Combination, found: &mut Diagnostics) -> Settings {
    match file.swept(combination.sweeps()) {
        Ok(mut swept) => {
            let is_computed = file.provider_of(combination.virtualization()) == SIMULATED;
            let simulation = swept.settings.simulation.take();
            swept.settings.simulation = is_computed.then(|| simulation.unwrap_or_default());
            if combination.excluded.is_none() {
                if !is_computed {
                    check_not_swept(file, combination, found);
                }
                let problems = swept.settings.problems();
                found.extend(problems.iter().map(|problem| swept.diagnose(file, problem)));
                check_discarded(file, &swept.settings, found);
            }
            swept.settings
        }
        Err(wrong) => {
            found.extend(wrong);
            file.workload.clone()
        }
    }
}

/// What only a computed scenario has would be an axis that makes no difference.
fn check_not_swept(file: &MatrixFile, combination: &Combination, found: &mut Diagnostics) {
    let of_simulation = |axis: &&str| axis.starts_with("simulation.");
    let mut axes = combination.sweeps().map(|(axis, _)| axis);
    if let Some(axis) = axes.find(of_simulation) {
        let span = file.place_of_key(&format!("matrix.{axis}"));
        let virtualization = combination.virtualization();
        let message = format!(
            "`{axis}` says nothing of a scenario that is measured, with `virtualization: {virtualization}`"
        );
        let help = "write `virtualization: [simulated]`, or exclude the others, or call with `--simulated`";
        found.push(Diagnostic::error(&file.source, Code::InvalidValue, span, message).help(help));
    }
}

fn candidates(scenarios: &[PlannedScenario]) -> Vec<Candidate> {
    let candidate = |scenario: &PlannedScenario| Candidate {
        letter: scenario.id.clone(),
        slug: scenario.slug.clone(),
        axes: scenario
            .axes
            .keys()
            .filter_map(|axis| Some((axis.clone(), scenario.axis(axis)?)))
            .collect(),
    };
    scenarios.iter().map(candidate).collect()
}

/// Of the design: what is excluded or not selected is no part of it, what cannot run here is.
fn attainable(
    file: &MatrixFile,
    combinations: &[Combination],
    scenarios: &[PlannedScenario],
) -> Option<Attainable> {
    let sizes = std::iter::zip(combinations, scenarios)
        .filter(|(combination, scenario)| combination.excluded.is_none() && scenario.not_selected.is_none())
        .flat_map(|(_, scenario)| sample_sizes(file, &scenario.settings));
    Attainable::of(file.report.alpha, sizes.collect())
}

/// Values in the sample of each window: the first of an environment loses what the transient spoils.
fn sample_sizes(file: &MatrixFile, settings: &Settings) -> Vec<u64> {
    // How many values a command writes is known once it has written them.
    if settings.experiment.is_some() {
        return Vec::new();
    }
    let periods = settings.periods_per_window();
    let first = periods.saturating_sub(u64::from(file.report.discard_periods));
    let (windows, firsts) = (settings.all_windows(), settings.environments);
    // Only the smallest and largest two matter: a million windows need no list of a million.
    let two = |number: u32| number.min(2) as usize;
    std::iter::repeat_n(first, two(firsts.min(windows)))
        .chain(std::iter::repeat_n(periods, two(windows.saturating_sub(firsts))))
        .collect()
}

fn measuring_seconds(settings: &Settings) -> f64 {
    f64::from(settings.all_windows()) * settings.longest_window().as_secs_f64()
}

/// A first window that is discarded altogether is no sample.
fn check_discarded(file: &MatrixFile, settings: &Settings, found: &mut Diagnostics) {
    let (periods, discarded) = (settings.periods_per_window(), file.report.discard_periods);
    if settings.experiment.is_none() && periods > 0 && u64::from(discarded) >= periods {
        let message = format!(
            "the first window has {periods} periods, of which {discarded} are left out: nothing is left"
        );
        let span = file.place_of("report.discard_periods");
        found.push(
            Diagnostic::error(&file.source, Code::InvalidValue, span, message).help(format!(
                "write at most `discard_periods: {}`, or make `workload.window` longer",
                periods - 1
            )),
        );
    }
}

/// A design that cannot reach its own α is told so before a machine spends a night on it.
fn check_attainable(file: &MatrixFile, attainable: Attainable, found: &mut Diagnostics) {
    let Attainable { alpha, best, worst } = attainable;
    if worst.p < alpha {
        return;
    }
    let span = file.place_of("workload.window");
    let (which, pair) = if best.p < alpha {
        ("some comparisons", worst)
    } else {
        ("no comparison", best)
    };
    let can = if best.p < alpha {
        "can never reject"
    } else {
        "can ever reject"
    };
    let message = format!(
        "{which} {can}: samples of {} and {} values reach p = {} at best, not below α = {alpha}",
        pair.n,
        pair.m,
        spell_p(pair.p)
    );
    let help = match fewest_values(alpha) {
        Some(fewest) => {
            let periods = fewest + u64::from(file.report.discard_periods);
            let window = file.workload.period.duration() * u32::try_from(periods).unwrap_or(u32::MAX);
            format!(
                "write `window: {}` under `workload:`, which is {periods} periods and reaches p = {}, or a larger `alpha`",
                record::quantity::TimeSpan::from(window),
                spell_p(smallest_p(fewest, fewest)),
            )
        }
        None => "write a larger `alpha` under `report:`".to_owned(),
    };
    found.push(Diagnostic::warning(&file.source, Code::NeverRejects, span, message).help(help));
}

/// Two digits, as a person writes them.
fn spell_p(p: f64) -> String {
    if p >= 0.001 {
        format!("{p:.3}")
    } else {
        format!("{p:.1e}")
    }
}

#[cfg(test)]
mod tests;
