//! What a run showed, as data: every scenario with how it ended, every comparison with the counts, what the windows and the
//! packets show. [`Report::present`] makes remarks and tables of it. The main type is [`Report`], made by [`analyse`].

use captures::traffic::Traffic;
use record::{
    experiment::Compare, family::Member, report_settings::ReportSettings, run_directory::Difference,
};

use crate::{
    analysis::{
        agreement::Agreement,
        changed_settings::ChangedSetting,
        comparison::{Comparisons, FrameError, Tally, compare},
        conclusion::{Conclusion, conclusions},
        contrast::{Contrasts, Verdict},
        expectation::ExpectedMean,
        other_ways::Way,
        packet_counts::{self, TrafficTally},
        packet_explanations::{self, Explanation},
        pairs::Pairs,
        quantity::Quantity,
        replicates::Replicates,
        sample::{Sample, levels, samples},
        scenario::{ScenarioReport, scenario_report},
        setup::SetupDifference,
    },
    explain::ExplainedPair,
    input::run::{Run, RunPart},
    replay::ScenarioReplay,
};

/// What a run showed.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// The run's name.
    pub run: String,
    /// When it was asked for, RFC 3339.
    pub created: String,
    /// The run directories that it is made of.
    pub parts: Vec<RunPart>,
    /// How samples were taken and compared.
    pub settings: ReportSettings,
    /// What the samples are of: the first metric whose distributions are compared, or the first one.
    pub quantity: Quantity,
    /// The names of all metrics, in the order of the matrix file.
    pub metrics: Vec<String>,
    /// The metrics that are compared byte for byte.
    pub agreements: Vec<Agreement>,
    /// The reports of the other metrics whose distributions are compared; each has none itself, and neither packets nor agreements.
    pub others: Vec<Report>,
    /// Every scenario of the plan, in letter order.
    pub scenarios: Vec<ScenarioReport>,
    /// The samples, by scenario and window.
    pub samples: Vec<Sample>,
    /// Every two windows compared; empty if there are more of them than are listed.
    pub comparisons: Comparisons,
    /// The counts, of each scenario with itself and with each other.
    pub tallies: Pairs<Tally>,
    /// Scenarios that did not run the same experiment: what is different of them is not the platform's alone.
    pub setup_differences: Pairs<SetupDifference>,
    /// The pairs of the declared family, with the window as the unit.
    pub contrasts: Contrasts,
    /// The same pairs with the environment as the unit, which then decides; none where each scenario has one environment.
    pub replicates: Option<Replicates>,
    /// What the metric is in each scenario for which the settings say what is expected of it.
    pub expected: Vec<ExpectedMean>,
    /// Virtualizations over all platforms, and operating systems, each two of them.
    pub conclusions: Vec<Conclusion>,
    /// What became of the packets; empty without captures.
    pub traffic: Traffic,
    /// The counts of the packets' quantities.
    pub traffic_tallies: Vec<TrafficTally>,
    /// What of the packets goes with the differences in error.
    pub explanations: Vec<Explanation>,
    /// Why pairs differ, of those that were explained: [`explain_pairs`](crate::explain::explain_pairs) simulates them, which takes
    /// its time.
    pub causes: Vec<ExplainedPair>,
    /// The windows put through the loop again, if they were: [`replay`](crate::replay::replay) reads all logs.
    pub replays: Vec<ScenarioReplay>,
    /// The run decided in other ways, if it was: each takes as long as the report itself.
    pub other_ways: Vec<Way>,
    /// The `report:` section of the matrix file that was run; [`Self::settings`] may be others.
    pub declared: ReportSettings,
    /// What of the scenarios' settings is not as it is by default.
    pub changed_settings: Vec<ChangedSetting>,
    /// What reading the run directories found, a sentence each.
    pub reading: Vec<String>,
    /// What could not be computed, a sentence each: faults of `matrix`.
    pub faults: Vec<String>,
}

/// Compares every window of a run with every other in each metric, and counts the rejections. Pure: the same run, traffic and
/// settings give the same report.
#[must_use]
pub fn analyse(run: &Run, traffic: Traffic, settings: &ReportSettings) -> Report {
    // Of the positions that the logs were read for.
    let settings = &ReportSettings {
        error: run.error,
        ..settings.clone()
    };
    let quantities = Quantity::of_run(run, settings);
    let first = Quantity::main(&quantities, settings);
    let others: Vec<Report> = quantities
        .iter()
        .filter(|it| it.compare == Compare::Ks && it.name != first.name)
        .map(|quantity| of_a_metric(run, quantity.clone(), Traffic::default(), settings))
        .collect();
    Report {
        metrics: quantities.iter().map(|it| it.name.clone()).collect(),
        agreements: Agreement::all(run, &quantities),
        others,
        ..of_a_metric(run, first, traffic, settings)
    }
}

fn of_a_metric(run: &Run, quantity: Quantity, traffic: Traffic, settings: &ReportSettings) -> Report {
    let samples = samples(run, settings, &quantity);
    let mut faults = Vec::new();
    let (comparisons, tallies) = or_fault(compare(&samples, settings), &mut faults);
    let scenarios: Vec<ScenarioReport> = run
        .scenarios
        .iter()
        .map(|scenario| scenario_report(scenario, settings, &quantity, &samples))
        .collect();
    let setup_differences = Pairs::new(SetupDifference::all(&run.scenarios));
    let pairs = family_pairs(&scenarios, &setup_differences, settings);
    let mut contrasts = Contrasts::of(&pairs, &samples, settings, quantity.equivalence_margin);
    let replicates = Replicates::of(run, &pairs, &samples, settings, quantity.equivalence_margin);
    if let Some(replicates) = &replicates {
        // Windows of one environment are not independent: where there are several, environments decide.
        for pair in &mut contrasts.pairs {
            let by_environments = replicates.find(&pair.a, &pair.b);
            pair.verdict = by_environments.map_or(Verdict::CannotTell, |found| found.verdict);
        }
    }
    Report {
        run: run.manifest.run.clone(),
        created: run.manifest.created.clone(),
        parts: run.parts.clone(),
        settings: settings.clone(),
        metrics: vec![quantity.name.clone()],
        agreements: Vec::new(),
        others: Vec::new(),
        traffic_tallies: or_fault(packet_counts::compared(&traffic, &samples, settings), &mut faults),
        explanations: packet_explanations::explanations(&contrasts.pairs, &samples, &traffic),
        causes: Vec::new(),
        replays: Vec::new(),
        other_ways: Vec::new(),
        traffic,
        conclusions: conclusions(&scenarios, &samples, &setup_differences, settings.seed),
        expected: ExpectedMean::all(run, &quantity, &samples, settings),
        setup_differences,
        contrasts,
        replicates,
        scenarios,
        tallies: Pairs::new(tallies),
        samples,
        comparisons,
        quantity,
        declared: run.manifest.report.clone(),
        changed_settings: ChangedSetting::all(run.scenarios.iter().map(|scenario| &scenario.planned)),
        reading: run.remarks.clone(),
        faults,
    }
}

/// What was asked for, or nothing and a remark: what else there is to report is reported all the same.
pub(crate) fn or_fault<T: Default>(asked: Result<T, FrameError>, faults: &mut Vec<String>) -> T {
    asked.unwrap_or_else(|error| {
        faults.push(format!(
            "{error}. This is a fault of matrix: please report it with this run directory."
        ));
        T::default()
    })
}

/// The letters of the pairs that belong to the declared family. Scenarios that did not run the same experiment do only if
/// they are named.
fn family_pairs(
    scenarios: &[ScenarioReport],
    setup_differences: &Pairs<SetupDifference>,
    settings: &ReportSettings,
) -> Vec<(String, String)> {
    let members: Vec<Member<'_>> = scenarios
        .iter()
        .map(|scenario| Member::new(&scenario.id, &scenario.slug, scenario.is_baseline, &scenario.axes))
        .collect();
    let letters = |(a, b): (usize, usize)| Some((members.get(a)?.id, members.get(b)?.id));
    let is_unlike =
        |a: usize, b: usize| letters((a, b)).is_some_and(|(a, b)| setup_differences.find(a, b).is_some());
    let asked = settings.family.asked(&members, is_unlike).into_iter();
    asked
        .filter_map(letters)
        .map(|(a, b)| (a.to_owned(), b.to_owned()))
        .collect()
}

impl Report {
    /// The count of two scenarios, in either order, or of one with itself; none if no two windows were compared.
    #[must_use]
    pub fn tally(&self, a: &str, b: &str) -> Option<&Tally> {
        self.tallies.find(a, b)
    }

    /// The means of a scenario's windows that count, by its letter.
    #[must_use]
    pub fn levels(&self, id: &str) -> Vec<f64> {
        levels(&self.samples, id)
    }

    /// The letters of the pairs of the family that differ.
    #[must_use]
    pub fn differing_pairs(&self) -> Vec<[String; 2]> {
        let pairs = self.contrasts.pairs.iter();
        let differing = pairs.filter(|pair| pair.verdict.is_difference());
        differing.map(|pair| [pair.a.clone(), pair.b.clone()]).collect()
    }

    /// The baseline scenarios.
    pub fn baseline(&self) -> impl Iterator<Item = &ScenarioReport> {
        self.scenarios.iter().filter(|scenario| scenario.is_baseline)
    }

    /// What is not the same of the experiments that two scenarios ran; empty if they ran the same.
    #[must_use]
    pub fn setup_differences(&self, a: &str, b: &str) -> &[String] {
        self.setup_differences
            .find(a, b)
            .map_or(&[], |difference| &difference.fields)
    }

    /// What is recorded to be different of two scenarios' environments; empty where one has no record.
    #[must_use]
    pub fn differences(&self, a: &str, b: &str) -> Vec<Difference> {
        let environment = |id: &str| {
            let scenario = self.scenarios.iter().find(|scenario| scenario.id == id);
            scenario.and_then(|scenario| scenario.environment.as_ref())
        };
        environment(a)
            .zip(environment(b))
            .map(|(a, b)| a.differences(b))
            .unwrap_or_default()
    }

    /// Whether a mean of this metric, or of another, is not what is expected of it.
    #[must_use]
    pub fn has_unexpected(&self) -> bool {
        let is_missed = |it: &ExpectedMean| it.miss().is_some();
        self.expected.iter().any(is_missed) || self.others.iter().any(Self::has_unexpected)
    }

    /// Whether some of the numbers were computed and not measured.
    #[must_use]
    pub fn is_simulated(&self) -> bool {
        self.scenarios.iter().any(|scenario| scenario.is_simulated)
    }
}
