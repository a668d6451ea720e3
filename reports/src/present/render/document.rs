//! `report.json`, type by type, in the order in which its fields are written. A field's comment is its description in the JSON
//! Schema that `matrix schema report` prints. The main type is [`ReportDocument`]; `json` fills it.

pub(super) mod packets;
pub(super) mod replicates;

use std::collections::BTreeMap;

use record::{
    family::Family,
    report_settings::{ErrorOf, Method, Metric, WarmUp},
    run_directory::{EnvironmentRecord, Revision},
    settings::Dynamics,
    window::ReleaseRecord,
};
use serde::{Serialize, Serializer};
use serde_json::{Map, Value};
use statistics::shape::ShapeTests;

use self::{
    packets::{PacketCount, PacketExplanation, ScenarioPackets},
    replicates::ReplicatesEntry,
};
use crate::{
    analysis::{comparison::Comparison, conclusion::Stratum, report::Report},
    explain::ExplainedPair,
    replay::ScenarioReplay,
};

/// What a run showed: `report.json` of a run directory, and the output of `matrix report --json`.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(title = "report.json"))]
pub struct ReportDocument<'a> {
    /// The run's name.
    pub run: &'a str,
    /// When the run was requested, RFC 3339.
    pub created: &'a str,
    /// The run directories that the report is made of.
    pub runs: Vec<RunEntry<'a>>,
    /// Whether any number was computed and not measured.
    pub simulated: bool,
    /// The significance level: a comparison with a smaller p is rejected.
    pub alpha: f64,
    /// How p-values are computed.
    pub method: Method,
    /// What the values of the samples are, in whose unit all shifts, distances and margins are.
    pub quantity: QuantityEntry<'a>,
    /// The names of all metrics of the experiment. `report/metrics/NAME/report.json` has each of the others whose distributions are
    /// compared.
    pub metrics: &'a [String],
    /// How the values of the ball on the plate are made; only of that experiment.
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    pub periods: Option<PeriodsEntry>,
    /// The metrics that are compared byte for byte.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub agreements: Vec<AgreementEntry<'a>>,
    /// The baseline: the scenarios that the others are compared with, by axis values.
    pub control: &'a BTreeMap<String, String>,
    /// What was found, in sentences: the conclusion, then what is open and what would settle it, then what to doubt.
    pub findings: Vec<String>,
    /// What to know before believing the rest.
    pub remarks: &'a [String],
    /// Every scenario of the plan, in letter order.
    pub scenarios: Vec<ScenarioEntry<'a>>,
    /// The scenarios that cannot run here.
    pub infeasible: Vec<Unmeasured<'a>>,
    /// The scenarios for which the infrastructure failed.
    pub errored: Vec<Unmeasured<'a>>,
    /// The counts of rejected window pairs of one scenario; only where two windows were compared.
    pub within: Vec<CountWithin<'a>>,
    /// The counts of rejected window pairs of two scenarios; `a` comes before `b` in the plan.
    pub between: Vec<CountBetween<'a>>,
    /// Every two scenarios that did not run the same experiment.
    pub unlike: Vec<UnlikePair<'a>>,
    /// The declared family of pairs, with the window as the unit.
    pub family: FamilyEntry<'a>,
    /// Every pair of the family with data, with the window as the unit.
    pub contrasts: Vec<ContrastEntry<'a>>,
    /// The same pairs with the environment as the unit, and what adds to the variance; only of runs with several environments a
    /// scenario.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub replicates: Option<ReplicatesEntry<'a>>,
    /// What the metric is in the scenarios of which something is expected (`report.expect`); absent where nothing is.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub expected: Vec<ExpectedEntry<'a>>,
    /// Every two virtualizations over all platforms, every two operating systems, and each node with the others, as a stratified test.
    pub conclusions: Vec<ConclusionEntry<'a>>,
    /// What became of the packets, for each scenario with captures.
    pub packets: Vec<ScenarioPackets<'a>>,
    /// The counts of rejected window pairs for each quantity of the packets.
    pub packet_counts: Vec<PacketCount<'a>>,
    /// Which quantities of the packets go with the differences in error.
    pub packet_explanations: Vec<PacketExplanation<'a>>,
    /// Why pairs that differ do; only with `--explain`.
    #[serde(skip_serializing_if = "<[_]>::is_empty")]
    pub causes: &'a [ExplainedPair],
    /// By how much each window differs from what its own recorded times give; only with `--replay`.
    #[serde(skip_serializing_if = "<[_]>::is_empty")]
    pub replays: &'a [ScenarioReplay],
    /// Every two windows; empty if there are more pairs than are listed.
    #[cfg_attr(feature = "schema", schemars(with = "Vec<ComparisonEntry<'static>>"))]
    pub comparisons: ComparisonList<'a>,
}

/// Every comparison. There may be half a million: each is made as it is written.
pub struct ComparisonList<'a>(pub &'a Report);

impl Serialize for ComparisonList<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(
            self.0
                .comparisons
                .rows()
                .map(|one| ComparisonEntry::of(self.0, &one)),
        )
    }
}

/// A run directory.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RunEntry<'a> {
    /// The run's name.
    pub run: &'a str,
    /// When the run was requested, RFC 3339.
    pub created: &'a str,
    /// The version of `matrix` that wrote it.
    pub matrix_version: &'a str,
    /// The revision of its sources; null where it is not known.
    pub matrix_revision: Option<&'a Revision>,
    /// Letters of the scenarios of which it has windows that count.
    pub scenarios: &'a [String],
}

/// A scenario of the plan.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ScenarioEntry<'a> {
    /// Its letter.
    pub id: &'a str,
    /// Its name in files, such as `x86-64-debian-12-native`.
    pub slug: &'a str,
    /// Axis to value.
    pub axes: &'a Map<String, Value>,
    /// Whether it belongs to the baseline.
    pub is_control: bool,
    /// Which rules plant, controller and messages followed; only of the ball on the plate.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dynamics: Option<Dynamics>,
    /// Dotted paths of the settings that are not as `dynamics` sets them; only of the ball on the plate.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub overridden: Option<&'a [String]>,
    /// The experiment's name; only of a command.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub experiment: Option<&'a str>,
    /// Whether its numbers were computed and not measured.
    pub simulated: bool,
    /// `completed`, `failed` (the workload reported a failure), `errored` (the infrastructure failed), `infeasible`,
    /// `interrupted`, `not-selected`, `unfinished` (it started, and no end is recorded) or `not-started`.
    pub outcome: String,
    /// Why, if it is not completed.
    pub reason: Option<&'a str>,
    /// What to do about it.
    pub hint: Option<&'a str>,
    /// One for each window of the plan.
    pub windows: Vec<WindowEntry<'a>>,
    /// The windows that broke on the way, also if they were measured again.
    pub broken: Vec<BrokenEntry<'a>>,
    /// What its platform was; null if no record was written.
    pub environment: Option<&'a EnvironmentRecord>,
    /// How the values within its windows depend on each other; null without a window that counts.
    pub within: Option<WithinEntry<'a>>,
    /// How well its platform held the schedule; null without a window that counts, and of a command.
    pub health: Option<HealthEntry>,
    /// What the calls of the command came to; only of a command, with a window that counts.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub calls: Option<CallsEntry>,
}

/// A metric.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct QuantityEntry<'a> {
    /// Its name.
    pub name: &'a str,
    /// Its unit; empty for numbers without one.
    pub unit: &'a str,
    /// Where its values come from, in a sentence.
    pub origin: &'a str,
}

/// How the values of the ball on the plate are made.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PeriodsEntry {
    /// What is averaged over each period.
    pub metric: Metric,
    /// The positions that the error is of.
    pub error: ErrorOf,
    /// Periods left out at the start of each run of the loop.
    pub discard_periods: u32,
    /// What is done about a window that warms up for longer than that.
    pub warm_up: WarmUp,
}

/// A metric that is compared byte for byte.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct AgreementEntry<'a> {
    /// Its name.
    pub metric: &'a str,
    /// The windows of the first scenario that are compared with those of others.
    pub windows: &'a [u32],
    /// The scenarios that have the same in every window that both have; the first group has the first scenario.
    pub groups: Vec<GroupEntry<'a>>,
    /// The scenarios without a window that counts.
    pub without_data: &'a [String],
}

/// Scenarios that have the same.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct GroupEntry<'a> {
    /// Their letters.
    pub scenarios: &'a [String],
    /// How many windows the first of them and the first scenario both have.
    pub compared: usize,
    /// In how many of these it has the same as the first scenario.
    pub same_as_first: usize,
    /// The first place where they have something else; null for the first group.
    pub parts: Option<PartingEntry<'a>>,
}

/// Where two files part.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PartingEntry<'a> {
    /// The window.
    pub window: u32,
    /// The byte, from 0; null after the first MiB.
    pub byte: Option<u64>,
    /// The line of that byte, from 1.
    pub line: u64,
    /// The characters of the first group there.
    pub first: &'a str,
    /// The characters of this group there.
    pub this: &'a str,
}

/// What the calls of a command came to, over the windows of a scenario that count.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct CallsEntry {
    /// How long a call took, mean, in seconds.
    pub mean_s: f64,
    /// How long the longest took, in seconds.
    pub longest_s: f64,
    /// Mean use of the processor, as a share of one core.
    pub cpu_share: f64,
    /// The largest memory of a process, in bytes.
    pub peak_memory_bytes: u64,
    /// Processes that were ended since they were still there when the command had ended.
    pub left_behind: u64,
}

/// A window of the plan.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct WindowEntry<'a> {
    /// Its number, from 1.
    pub window: u32,
    /// `valid`, `suspect`, `invalid`, `broken` or `missing`.
    pub verdict: &'static str,
    /// Whether it counts.
    pub counted: bool,
    /// Values in its sample; 0 if it does not count.
    pub n: usize,
    /// Why, if it is not valid.
    pub reasons: &'a [String],
}

/// A window that broke.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct BrokenEntry<'a> {
    /// Its number, from 1.
    pub window: u32,
    /// The environment that measured it.
    pub environment: &'a str,
    /// How it broke.
    pub reason: &'a str,
}

/// How the values within the windows of a scenario depend on each other, and whether its windows are steady.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct WithinEntry<'a> {
    /// Autocorrelation of lag 1, 2, … periods; null where no two values differ.
    pub autocorrelation: Option<&'a [f64]>,
    /// Integrated autocorrelation time, in periods, at least 1.
    pub autocorrelation_time_periods: Option<f64>,
    /// How many independent values the values are worth.
    pub effective_n: Option<f64>,
    /// The windows of which a warm-up was cut; only if `warm_up` is `cut`.
    pub cut: Vec<CutWindow>,
    /// The windows that are not steady.
    pub unsteady: Vec<UnsteadyWindow>,
    /// Periods in a block when a change of level is looked for.
    pub change_block_periods: usize,
    /// What could not be looked for in which window.
    pub not_looked_for: Vec<UnseenEntry>,
}

/// A window of which a warm-up was cut.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct CutWindow {
    /// Its number, from 1.
    pub window: u32,
    /// Periods that were cut, beyond `discard_periods`.
    pub periods: u32,
}

/// A window that is not steady.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct UnsteadyWindow {
    /// Its number, from 1.
    pub window: u32,
    /// Its warm-up, in periods; null if it has none.
    pub warm_up_periods: Option<f64>,
    /// Periods before its change of level; null if it has none.
    pub change_after_periods: Option<usize>,
    /// By how much the level changes.
    pub change: Option<f64>,
    /// The p-value of that change.
    pub change_p: Option<f64>,
}

/// What could not be looked for in a window.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct UnseenEntry {
    /// Its number, from 1.
    pub window: u32,
    /// `warm-up` or `change of level`.
    pub look: &'static str,
    /// Why not.
    pub reason: String,
}

/// How well a platform held the schedule, over the windows that count.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct HealthEntry {
    /// Mean use of the processor by the workload, as a share of one core.
    pub cpu_share: f64,
    /// Share of the steps of both loops that began more than a tenth of a step late.
    pub late_share: f64,
    /// Steps of both loops that began a whole step late or more.
    pub missed_deadlines: u64,
    /// Ticks of both loops that were lost, because earlier ones had not ended.
    pub lost_ticks: u64,
    /// Share of control steps that had no newer state than the step before.
    pub stale_share: f64,
    /// Mean age of the state when it was used, in seconds; null if no state arrived.
    pub state_age_s: Option<f64>,
    /// The latest start of a step after it was due, in nanoseconds.
    pub worst_lateness_ns: i64,
    /// Packets that the kernel dropped before a capture had read them.
    pub capture_dropped: u64,
    /// How late the network emulator released packets; null without an emulator.
    pub releases: Option<ReleaseRecord>,
}

/// A scenario that has no result.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Unmeasured<'a> {
    /// Its letter.
    pub id: &'a str,
    /// Its name in files.
    pub slug: &'a str,
    pub reason: Option<&'a str>,
    /// What to do about it.
    pub hint: Option<&'a str>,
}

/// How many window pairs of one scenario were rejected.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct CountWithin<'a> {
    /// The scenario's letter.
    pub id: &'a str,
    /// Window pairs compared.
    pub pairs: usize,
    /// Those of them that were rejected.
    pub rejected: usize,
}

/// How many window pairs of two scenarios were rejected.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct CountBetween<'a> {
    /// Letter of the first scenario.
    pub a: &'a str,
    /// Letter of the second.
    pub b: &'a str,
    /// Window pairs compared.
    pub pairs: usize,
    /// Those of them that were rejected.
    pub rejected: usize,
    /// What of the two experiments is not the same; empty if they ran the same.
    pub unlike: &'a [String],
}

/// Two scenarios that did not run the same experiment.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct UnlikePair<'a> {
    /// Letter of the first.
    pub a: &'a str,
    /// Letter of the second.
    pub b: &'a str,
    /// What is not the same, such as `network.delay`.
    pub fields: &'a [String],
}

/// A declared family of pairs of scenarios.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct FamilyEntry<'a> {
    /// What was declared.
    pub declared: &'a Family,
    /// Pairs with data.
    pub pairs: usize,
    /// Letters of the pairs without data.
    pub without_data: &'a [(String, String)],
    /// The equivalence margin: the smallest shift of the error that matters; null if none was declared.
    pub equivalence_margin: Option<f64>,
    /// Seed of the relabellings and resamples that are drawn.
    pub seed: u64,
    /// The dealings of the whole family; null without a pair.
    pub max_t: Option<MaxTEntry>,
    /// The confidence of each pair's simultaneous interval, 0 to 1: all hold together with 1 − alpha.
    pub simultaneous_confidence: f64,
    /// How the windows of a scenario depend on the windows before and after them; null where no scenario has three.
    pub serial: Option<SerialEntry>,
}

/// Whether successive windows are alike, over all scenarios.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SerialEntry {
    /// Correlation of a window's level with the next one's, less what independent windows have on the mean.
    pub lag_one: f64,
    /// The share of orders of the windows with as large a correlation.
    pub p: f64,
    /// Windows that were looked at.
    pub windows: usize,
}

/// The dealings of a whole family: each scenario's windows around their mean, dealt anew over all of them.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct MaxTEntry {
    /// Dealings examined, the observed one included.
    pub labellings: u64,
    /// `monte-carlo`: they are drawn.
    pub method: &'static str,
    /// The smallest p that a pair can have.
    pub smallest_p: f64,
}

/// Two scenarios compared, with the window as the unit.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ContrastEntry<'a> {
    /// Letter of the first scenario.
    pub a: &'a str,
    /// Letter of the second.
    pub b: &'a str,
    /// Windows of the first that count.
    pub n: usize,
    /// Windows of the second that count.
    pub m: usize,
    /// p-value of the permutation test of the windows' levels.
    pub p: f64,
    /// The smallest p that any labelling of these values can have.
    pub smallest_p: f64,
    /// Labellings examined, the observed one included.
    pub labellings: u64,
    /// `exact`, or `monte-carlo` if labellings were drawn.
    pub method: &'static str,
    /// A p-value for each distance of whole distributions.
    #[serde(flatten)]
    pub shape: ShapeEntry<'a>,
    /// Labellings examined for each of these.
    pub shape_labellings: u64,
    /// The count of rejected window pairs with blocks in place of values; null if there are too many pairs.
    pub blocks: Option<BlocksEntry>,
    /// `p` adjusted by Holm's method.
    pub p_holm: f64,
    /// `p` adjusted by Benjamini and Yekutieli's method.
    pub p_benjamini_yekutieli: f64,
    /// The levels' differences adjusted by the largest of the family, step by step.
    pub p_max_t: f64,
    /// p-value of equal mean levels, whatever the spreads: the larger one of the studentised permutation test's and Welch's; null
    /// with a single window.
    pub p_shift: Option<f64>,
    /// `p_shift` adjusted by Holm's method.
    pub p_shift_holm: Option<f64>,
    /// An interval of the shift of the mean level that holds for all pairs of the family at once; null where so few windows
    /// cannot have it.
    pub simultaneous: Option<IntervalEntry>,
    /// `cannot tell`, `not told apart`, `immaterial`, `differ`, `differ, matters`, `differ, size open` or `differ, level open`.
    pub verdict: &'static str,
    /// What of the two experiments is not the same; empty if they ran the same.
    pub unlike: &'a [String],
    /// How large the difference is, from the first to the second.
    pub effect: EffectEntry,
    /// What differs between the two environments, the most telling first.
    pub differences: Vec<DifferenceEntry>,
}

/// A field for each row of [`shape::DISTANCES`](statistics::shape::DISTANCES): the p-value of its permutation test.
pub struct ShapeEntry<'a>(pub &'a ShapeTests);

impl Serialize for ShapeEntry<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.0.each().map(|(distance, test)| (distance.column, test.p)))
    }
}

#[cfg(feature = "schema")]
impl schemars::JsonSchema for ShapeEntry<'_> {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> std::borrow::Cow<'static, str> {
        "ShapeEntry".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        use statistics::shape::{DISTANCES, Distance};
        let field = |distance: &Distance| {
            let description = format!("p-value of the permutation test of {}.", distance.name);
            let schema =
                schemars::json_schema!({"description": description, "type": "number", "format": "double"});
            (distance.column.to_owned(), schema.to_value())
        };
        let fields: Map<String, Value> = DISTANCES.iter().map(field).collect();
        let required: Vec<&str> = DISTANCES.iter().map(|distance| distance.column).collect();
        schemars::json_schema!({"type": "object", "properties": fields, "required": required})
    }
}

/// The count of rejected window pairs, with blocks of neighbouring values permuted.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct BlocksEntry {
    /// Periods in a block.
    pub block: usize,
    /// Window pairs with a block on each side.
    pub pairs: usize,
    /// Those of them that were rejected.
    pub rejected: usize,
    /// Those of them with blocks enough to be rejected.
    pub possible: usize,
}

/// How large a difference is; positive, or above one half, where the second has the larger errors.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct EffectEntry {
    /// The difference of the mean window levels.
    pub shift: EstimateEntry,
    /// Wasserstein-1 distance of the pooled values.
    pub wasserstein: EstimateEntry,
    /// Probability that a value of the second is larger than one of the first.
    pub superiority: EstimateEntry,
}

/// An estimate with its interval.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct EstimateEntry {
    /// The estimate.
    pub value: f64,
    /// Lower end of the interval; null with too few windows.
    pub low: Option<f64>,
    /// Upper end of the interval; null with too few windows.
    pub high: Option<f64>,
    /// The confidence of the interval, 0 to 1; null with too few windows.
    pub confidence: Option<f64>,
}

/// An interval.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct IntervalEntry {
    /// Its lower end.
    pub low: f64,
    /// Its upper end.
    pub high: f64,
    /// Its confidence, 0 to 1.
    pub confidence: f64,
}

/// What differs between two environments.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct DifferenceEntry {
    /// The field, such as `platform.cpu_governor`.
    pub field: String,
    /// Its value in the first; null if it has none.
    pub a: Option<String>,
    /// Its value in the second; null if it has none.
    pub b: Option<String>,
}

/// What is expected of a scenario, beside what it is.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ExpectedEntry<'a> {
    /// Letter of the scenario.
    pub scenario: &'a str,
    /// What is expected.
    pub value: f64,
    /// The smallest mean that is as expected; null where there is no limit.
    pub low: Option<f64>,
    /// The largest.
    pub high: Option<f64>,
    /// Windows that count.
    pub windows: usize,
    /// The mean of their means, with an interval of 95 % over windows.
    pub mean: EstimateEntry,
    /// Whether the mean is within the limits.
    pub as_expected: bool,
    /// Whether the interval, too, lies on that side of the limits.
    pub sure: bool,
}

/// Two values of an axis, compared over all platforms that have both.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ConclusionEntry<'a> {
    /// `virtualization`, `os` or `node`.
    pub axis: &'static str,
    /// The first value; for a node where there are several others, `the other nodes`.
    pub first: &'a str,
    /// The second value.
    pub second: &'a str,
    /// Whether scenarios of a stratum also differ in hardware, because no hardware has both values.
    pub hardware_differs: bool,
    /// Where both values have windows that count.
    pub strata: &'a [Stratum],
    /// p-value of the stratified test.
    pub p: f64,
    /// `p` adjusted by Holm's method for all conclusions.
    pub p_holm: f64,
    /// The smallest p that so many windows in such strata can have.
    pub smallest_p: f64,
    /// Labellings examined, the observed one included.
    pub labellings: u64,
    /// `exact`, or `monte-carlo` if labellings were drawn.
    pub method: &'static str,
    /// By how much the window means of the second value are larger.
    pub shift: EstimateEntry,
}

/// One window compared with another.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ComparisonEntry<'a> {
    /// Letter of the first scenario.
    pub a: &'a str,
    /// Number of its window, from 1.
    pub a_window: u32,
    /// Letter of the second scenario; the same one within a scenario.
    pub b: &'a str,
    /// Number of its window, from 1.
    pub b_window: u32,
    /// Values of the first window.
    pub n: u64,
    /// Values of the second.
    pub m: u64,
    /// The Kolmogorov-Smirnov distance, 0 to 1: `h` / `lcm` to the nearest double.
    pub d: f64,
    /// The distance with its sign: positive where the first window's errors are the smaller ones.
    pub signed_d: f64,
    /// The error at which it is attained; null where it is 0.
    pub at: Option<f64>,
    /// The distance exactly, in units of 1 / `lcm`.
    pub h: u64,
    /// The least common multiple of `n` and `m`.
    pub lcm: u64,
    /// p-value, two-sided; 0 where a double cannot hold it.
    pub p: f64,
    /// Its decimal logarithm, also where `p` is 0.
    pub log10_p: f64,
    /// How p was computed.
    pub method: Method,
    /// Whether the comparison is rejected.
    pub rejected: bool,
    /// What of the two experiments is not the same; empty if they ran the same.
    pub unlike: &'a [String],
}

impl<'a> ComparisonEntry<'a> {
    fn of(report: &'a Report, comparison: &Comparison<'a>) -> Self {
        let test = &comparison.test;
        Self {
            a: comparison.a,
            a_window: comparison.a_window,
            b: comparison.b,
            b_window: comparison.b_window,
            n: test.n,
            m: test.m,
            d: test.d,
            signed_d: test.signed_d,
            at: test.at,
            h: test.h,
            lcm: test.lcm,
            p: test.p,
            log10_p: test.log10_p,
            method: test.method,
            rejected: comparison.rejected,
            unlike: report.setup_differences(comparison.a, comparison.b),
        }
    }
}
