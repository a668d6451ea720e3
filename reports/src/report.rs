//! What a run showed, before it is drawn in any medium: every scenario with how it ended, every comparison, the paper's
//! tables, and what a reader must know before believing them. The main type is [`Report`], made by [`analyse`].

use std::{collections::BTreeSet, fmt};

use serde_json::{Map, Value};
use workload::{
    record::window::Verdict,
    settings::{Dynamics, NetworkBackend},
};

use crate::{
    comparison::{Comparisons, FrameError, LISTED, Tally, compare, pairs_of},
    conclusion::{Conclusion, conclusions},
    contrast::Contrasts,
    declaration,
    family::{Family, Member},
    figure,
    health::Health,
    ks::{Method, Procedure},
    run::{BrokenWindow, Ending, MissingWindow, Run, RunPart, ScenarioRun, Window, WindowState},
    run_directory::{Difference, EnvironmentRecord, Outcome, Revision},
    sample::{Sample, samples},
    settings::{ErrorOf, ReportSettings, WarmUp},
    setup::Unlike,
    table::{self, Table},
    traffic::{self, Explanation, Traffic, TrafficTally},
    within::WithinWindows,
};

/// The axis that the paper contrasts on each platform.
pub(crate) const VIRTUALIZATION: &str = "virtualization";
/// Its value where there is none.
pub(crate) const NATIVE: &str = "native";

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
    /// Every scenario of the plan, in letter order.
    pub scenarios: Vec<ScenarioReport>,
    /// The samples, by scenario and window.
    pub samples: Vec<Sample>,
    /// Every two windows compared; empty if there are more of them than are listed.
    pub comparisons: Comparisons,
    /// The counts, of each scenario with itself and with each other.
    pub tallies: Vec<Tally>,
    /// Scenarios that did not run the same experiment: what is different of them is not the platform's alone.
    pub unlike: Vec<Unlike>,
    /// The pairs of the declared family, with the window as the unit.
    pub contrasts: Contrasts,
    /// Virtualizations over all platforms, and operating systems, each two of them.
    pub conclusions: Vec<Conclusion>,
    /// What became of the packets; empty without captures.
    pub traffic: Traffic,
    /// The counts of the packets' quantities.
    pub traffic_tallies: Vec<TrafficTally>,
    /// What of the packets goes with the differences in error.
    pub explanations: Vec<Explanation>,
    /// What a reader must know before believing the tables.
    pub remarks: Vec<String>,
    /// The paper's tables, and how well each platform held its schedule.
    pub tables: Vec<Table>,
}

/// One scenario in the report.
#[derive(Debug, Clone, PartialEq)]
pub struct ScenarioReport {
    /// Its letter.
    pub id: String,
    /// Its slug.
    pub slug: String,
    /// Axis to value.
    pub axes: Map<String, Value>,
    /// How its network was to be made.
    pub network: NetworkBackend,
    /// Which rules plant, controller and messages followed.
    pub dynamics: Dynamics,
    /// The settings that were not as the dynamics has them, as dotted paths.
    pub overridden: Vec<String>,
    /// Whether it is one of the experimental controls.
    pub is_control: bool,
    /// Whether its numbers were made up by the `fake` provider.
    pub is_simulated: bool,
    /// How it ended.
    pub standing: Standing,
    /// Why, if not completed.
    pub reason: Option<String>,
    /// What to do about it.
    pub hint: Option<String>,
    /// One for each window of the plan.
    pub windows: Vec<WindowReport>,
    /// What broke on the way.
    pub broken: Vec<BrokenWindow>,
    /// What its platform was, if it came so far.
    pub environment: Option<EnvironmentRecord>,
    /// What its values within windows have to do with each other; none without a window that counts.
    pub within: Option<WithinWindows>,
    /// How well its platform held the schedule; none without a window that counts.
    pub health: Option<Health>,
}

/// How a scenario stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Standing {
    /// All windows are there.
    Completed,
    /// The workload said that the experiment went wrong.
    Failed,
    /// The infrastructure failed.
    Errored,
    /// It could not run.
    Infeasible,
    /// It was left out of this run.
    NotSelected,
    /// It was asked to stop.
    Interrupted,
    /// It began, and nothing says that it ended.
    Unfinished,
    /// It has not begun.
    NotStarted,
}

impl Standing {
    /// Its name in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Completed => Outcome::Completed.name(),
            Self::Failed => Outcome::Failed.name(),
            Self::Errored => Outcome::Errored.name(),
            Self::Infeasible => "infeasible",
            Self::Interrupted => Outcome::Interrupted.name(),
            Self::Unfinished => "unfinished",
            Self::NotSelected => "not selected",
            Self::NotStarted => "not started",
        }
    }
}

/// One window in the report.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WindowReport {
    /// Its number, from 1.
    pub number: u32,
    /// `valid`, `suspect`, `invalid`, `broken` or `missing`.
    pub verdict: &'static str,
    /// Values in its sample; 0 if it does not count.
    pub n: usize,
    /// Why, if not valid.
    pub reasons: Vec<String>,
}

/// What was found of some windows in a row that are not valid. Displayed, one remark without the reasons.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct VerdictReport<'a> {
    /// Which, such as `windows 2 to 3`.
    pub windows: String,
    /// As [`WindowReport::verdict`].
    pub verdict: &'static str,
    /// Whether they count all the same.
    pub counted: bool,
    /// Why.
    pub reasons: &'a [String],
}

impl fmt::Display for VerdictReport<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let counted = if self.counted { "counted" } else { "not counted" };
        write!(f, "{} {}, {counted}", self.windows, self.verdict)
    }
}

impl ScenarioReport {
    /// Windows that count.
    #[must_use]
    pub fn windows_counted(&self) -> usize {
        self.windows.iter().filter(|window| window.n > 0).count()
    }

    /// What to say of the windows that are not valid, a remark for each run of the same verdict for the same reasons;
    /// empty for a scenario that was never begun.
    #[must_use]
    pub fn verdicts(&self) -> Vec<VerdictReport<'_>> {
        if self.standing == Standing::NotStarted {
            return Vec::new();
        }
        let same = |a: &WindowReport, b: &WindowReport| a.verdict == b.verdict && a.reasons == b.reasons;
        let runs = self.windows.chunk_by(same).filter_map(|run| {
            let (first, last) = (run.first()?, run.last()?);
            (first.verdict != Verdict::Valid.name()).then(|| VerdictReport {
                windows: match run.len() {
                    1 => format!("window {}", first.number),
                    _ => format!("windows {} to {}", first.number, last.number),
                },
                verdict: first.verdict,
                counted: first.n > 0,
                reasons: &first.reasons,
            })
        });
        runs.collect()
    }

    /// Whether the plan has a way to run it.
    #[must_use]
    pub fn can_run(&self) -> bool {
        self.standing != Standing::Infeasible
    }

    /// Its virtualization: natively where it has no such axis.
    #[must_use]
    pub fn virtualization(&self) -> String {
        self.axis(VIRTUALIZATION).unwrap_or_else(|| NATIVE.to_owned())
    }

    /// What it runs on: the values of all axes but virtualization.
    #[must_use]
    pub fn platform(&self) -> String {
        let others = self.axes.iter().filter(|(axis, _)| *axis != VIRTUALIZATION);
        let values: Vec<String> = others.map(|(_, value)| text_of(value)).collect();
        match values.is_empty() {
            true => "this machine".to_owned(),
            false => values.join(" "),
        }
    }

    /// The value of an axis as text, if the scenario has that axis.
    #[must_use]
    pub fn axis(&self, name: &str) -> Option<String> {
        self.axes.get(name).map(text_of)
    }
}

/// An axis value as text.
pub(crate) fn text_of(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}

/// Compares every window of a run with every other and tables the counts. Pure: the same run, traffic and settings give the
/// same report.
#[must_use]
pub fn analyse(run: &Run, traffic: Traffic, settings: &ReportSettings) -> Report {
    // Of the positions that the logs were read for.
    let settings = &ReportSettings {
        error: run.error,
        ..settings.clone()
    };
    let samples = samples(run, settings);
    let mut faults = Vec::new();
    let (comparisons, tallies) = or_fault(compare(&samples, settings), &mut faults);
    let scenarios: Vec<ScenarioReport> = run
        .scenarios
        .iter()
        .map(|scenario| scenario_report(scenario, settings, &samples))
        .collect();
    let unlike = Unlike::all(&run.scenarios);
    let pairs = family_pairs(&scenarios, &unlike, settings);
    let contrasts = Contrasts::of(&pairs, &samples, settings);
    let mut report = Report {
        run: run.manifest.run.clone(),
        created: run.manifest.created.clone(),
        parts: run.parts.clone(),
        settings: settings.clone(),
        traffic_tallies: or_fault(traffic::compared(&traffic, &samples, settings), &mut faults),
        explanations: traffic::explanations(&contrasts.pairs, &samples, &traffic, settings),
        traffic,
        conclusions: conclusions(&scenarios, &samples, &unlike, settings.seed),
        unlike,
        contrasts,
        scenarios,
        tallies,
        samples,
        comparisons,
        remarks: Vec::new(),
        tables: Vec::new(),
    };
    report.remarks = remarks(run, &report);
    report.tables = or_fault(table::of_the_paper(&report), &mut faults);
    report.tables.extend(table::beside(&report));
    report.remarks.extend(faults);
    report
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
    unlike: &[Unlike],
    settings: &ReportSettings,
) -> Vec<(String, String)> {
    let members: Vec<Member<'_>> = scenarios
        .iter()
        .map(|scenario| Member::new(&scenario.id, &scenario.slug, scenario.is_control, &scenario.axes))
        .collect();
    let letters = |(a, b): (usize, usize)| Some((members.get(a)?.id, members.get(b)?.id));
    let is_unlike = |a: usize, b: usize| {
        letters((a, b)).is_some_and(|(a, b)| unlike.iter().any(|unlike| unlike.is_of(a, b)))
    };
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
        self.tallies
            .iter()
            .find(|tally| (tally.a == a && tally.b == b) || (tally.a == b && tally.b == a))
    }

    /// The experimental controls.
    pub fn controls(&self) -> impl Iterator<Item = &ScenarioReport> {
        self.scenarios.iter().filter(|scenario| scenario.is_control)
    }

    /// What is not the same of the experiments that two scenarios ran; empty if they ran the same.
    #[must_use]
    pub fn unlike(&self, a: &str, b: &str) -> &[String] {
        let found = self.unlike.iter().find(|unlike| unlike.is_of(a, b));
        found.map_or(&[], |unlike| &unlike.fields)
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

    /// Whether some of the numbers were made up by the `fake` provider.
    #[must_use]
    pub fn is_simulated(&self) -> bool {
        self.scenarios.iter().any(|scenario| scenario.is_simulated)
    }

    /// Which rules the experiment followed, in one sentence.
    fn dynamics(&self) -> String {
        let mut kinds: Vec<(&str, &[String], Vec<&str>)> = Vec::new();
        for scenario in &self.scenarios {
            let (name, overridden) = (scenario.dynamics.name(), scenario.overridden.as_slice());
            match kinds
                .iter_mut()
                .find(|kind| (kind.0, kind.1) == (name, overridden))
            {
                Some((.., letters)) => letters.push(&scenario.id),
                None => kinds.push((name, overridden, vec![&scenario.id])),
            }
        }
        let several = kinds.len() > 1;
        let described = kinds.iter().map(|(name, overridden, letters)| {
            let but = match overridden {
                [] => String::new(),
                _ => format!(" but for {}", overridden.join(", ")),
            };
            let of = if several {
                format!(" ({})", letters.join(", "))
            } else {
                String::new()
            };
            format!("{name}{but}{of}")
        });
        format!("Dynamics: {}.", described.collect::<Vec<_>>().join("; "))
    }

    /// Which run directories it is made of, and which `matrix` wrote them, a sentence for each.
    #[must_use]
    pub fn origins(&self) -> Vec<String> {
        let origin = |part: &RunPart| {
            let revision = part.matrix_revision.as_ref();
            let revision = revision.map_or_else(|| "unknown".to_owned(), Revision::to_string);
            let scenarios = match self.parts.len() {
                1 => String::new(),
                _ if part.scenarios.is_empty() => ": no scenario".to_owned(),
                _ => format!(": {}", part.scenarios.join(", ")),
            };
            format!(
                "Run {} of {} by matrix {}, revision {revision}{scenarios}.",
                part.run, part.created, part.matrix_version
            )
        };
        self.parts.iter().map(origin).collect()
    }

    /// How samples were taken and compared, in three sentences. Stands with every table.
    #[must_use]
    pub fn method(&self) -> String {
        let ReportSettings {
            alpha,
            metric,
            error,
            discard_periods,
            warm_up,
            ..
        } = &self.settings;
        let error = match error {
            ErrorOf::Received => "",
            ErrorOf::TruePosition => " of the ball's true position",
        };
        let discarded = match discard_periods {
            0 => "no period left out".to_owned(),
            1 => "the first period of each run left out".to_owned(),
            many => format!("the first {many} periods of each run left out"),
        };
        let cut = match warm_up {
            WarmUp::Flag => "",
            WarmUp::Cut => ", and those in which a window warms up (MSER)",
        };
        let in_the_limit: usize = self.tallies.iter().map(|tally| tally.in_the_limit).sum();
        let test = match (self.settings.method, in_the_limit) {
            (Method::Exact, 0) => "exact given the ties",
            (Method::Exact, _) => "exact given the ties, asymptotic where `comparisons.csv` says so",
            (Method::Asymptotic, _) => "p asymptotic (Kolmogorov's limit, ties not regarded)",
            (Method::Paper, _) => {
                "p as the paper's tools had it (limit with Stephens's correction, ties not regarded)"
            }
        };
        format!(
            "{} Metric: {}{error} over each period, in metres, {discarded}{cut}. Test: two-sample Kolmogorov-Smirnov, {test}; \
             rejected at p < {alpha}.",
            self.dynamics(),
            metric.formula()
        )
    }
}

fn scenario_report(scenario: &ScenarioRun, settings: &ReportSettings, samples: &[Sample]) -> ScenarioReport {
    let (standing, reason, hint) = standing(&scenario.ending);
    let planned = &scenario.planned;
    let n = |window: u32| {
        let sample = samples
            .iter()
            .find(|sample| sample.scenario == planned.id && sample.window == window);
        sample.map_or(0, |sample| sample.errors_m.len())
    };
    ScenarioReport {
        id: planned.id.clone(),
        slug: planned.slug.clone(),
        axes: planned.axes.clone(),
        network: planned.settings.network.backend,
        dynamics: planned.settings.dynamics,
        overridden: planned.settings.overridden(),
        is_control: settings.is_control(planned),
        is_simulated: scenario.is_simulated(),
        standing,
        reason,
        hint,
        windows: scenario
            .windows
            .iter()
            .map(|window| window_report(window, n(window.number)))
            .collect(),
        broken: scenario.broken.clone(),
        environment: scenario.environment.clone(),
        within: WithinWindows::of(scenario, samples, settings),
        health: Health::of(scenario),
    }
}

fn standing(ending: &Ending) -> (Standing, Option<String>, Option<String>) {
    let resume = || Some("`matrix resume` goes on with it".to_owned());
    match ending {
        Ending::Infeasible { reason, fix } => (Standing::Infeasible, Some(reason.clone()), fix.clone()),
        Ending::NotSelected { reason } => (Standing::NotSelected, Some(reason.clone()), None),
        Ending::NotStarted => (
            Standing::NotStarted,
            Some("its turn had not come when the run ended".to_owned()),
            resume(),
        ),
        Ending::Unfinished => {
            let reason = "it is being measured, or whatever measured it was killed";
            (Standing::Unfinished, Some(reason.to_owned()), resume())
        }
        Ending::Ended {
            outcome,
            reason,
            hint,
        } => {
            let standing = match outcome {
                Outcome::Completed => Standing::Completed,
                Outcome::Failed => Standing::Failed,
                Outcome::Errored => Standing::Errored,
                Outcome::Interrupted => Standing::Interrupted,
            };
            (standing, reason.clone(), hint.clone())
        }
    }
}

fn window_report(window: &Window, n: usize) -> WindowReport {
    let (verdict, mut reasons) = match &window.state {
        WindowState::Counted { record, .. } | WindowState::Invalid { record } => {
            (record.verdict.name(), record.reasons.clone())
        }
        WindowState::Broken { reason } => ("broken", vec![reason.clone()]),
        WindowState::Missing { known } => ("missing", vec![words_for(*known).to_owned()]),
    };
    if matches!(window.state, WindowState::Counted { .. }) && n == 0 {
        reasons.push("all its periods are left out".to_owned());
    }
    WindowReport {
        number: window.number,
        verdict,
        n,
        reasons,
    }
}

/// Why a window is not there.
const fn words_for(missing: MissingWindow) -> &'static str {
    match missing {
        MissingWindow::NotMeasured => "it was not measured",
        MissingWindow::NotCollected => "it was measured, and has not been collected",
        MissingWindow::Lost => "it was collected, and is not there any more",
    }
}

fn remarks(run: &Run, report: &Report) -> Vec<String> {
    let mut remarks = run.remarks.clone();
    let simulated: Vec<&str> = report
        .scenarios
        .iter()
        .filter(|s| s.is_simulated)
        .map(|s| s.id.as_str())
        .collect();
    if !simulated.is_empty() {
        remarks.push(format!(
            "SIMULATED, NOT MEASURED: {} made up by the provider `fake`. These numbers say nothing about any platform.",
            match simulated.as_slice() {
                [one] => format!("scenario {one} was"),
                many => format!("scenarios {} were", many.join(", ")),
            }
        ));
    }
    remarks.extend(declaration::remark(&run.manifest.report, &report.settings));
    if let Some((n, m, p)) = hopeless(report) {
        remarks.push(format!(
            "With {n} and {m} values the smallest p-value is {p:.2e}, and α is {}: such windows are never told apart, \
             and a count of 0 says nothing. Measure more periods in a window.",
            report.settings.alpha
        ));
    }
    let pairs = pairs_of(report.samples.len());
    if pairs > LISTED {
        remarks.push(format!(
            "{pairs} comparisons were made and counted. They are not listed one by one, since they are more than \
             {LISTED}: `comparisons.csv` and `report.json` have none of them."
        ));
    }
    remarks.extend(figure::chosen(report).remarks);
    let names = report.settings.family.names();
    for name in names.filter(|name| !report.scenarios.iter().any(|s| s.id == *name || s.slug == *name)) {
        remarks.push(format!(
            "`report.family` names `{name}`, which is no scenario's letter or slug."
        ));
    }
    for (id, found) in &report.traffic.scenarios {
        for (window, reason) in &found.unreadable {
            remarks.push(format!(
                "The captures of {id}, window {window}, are left out of the tables of packets: {reason}."
            ));
        }
        for window in found.windows.iter().filter(|window| window.dropped > 0) {
            remarks.push(format!(
                "{} packets of {id}, window {}, were dropped before they were captured: as many may be taken for lost.",
                window.dropped, window.window
            ));
        }
    }
    remarks.extend(unlike_remark(report));
    for (part, line) in run
        .parts
        .iter()
        .flat_map(|part| part.cut_lines.iter().map(move |line| (part, line)))
    {
        let journal = match run.parts.len() {
            1 => "events.jsonl".to_owned(),
            _ => format!("events.jsonl of {}", part.run),
        };
        remarks.push(format!(
            "Line {line} of {journal} is cut, as a crash leaves it; what it was to announce had not been done."
        ));
    }
    remarks.extend(unchecked_remark(run));
    remarks
}

/// That nobody can say whether the run's files are as they were written.
fn unchecked_remark(run: &Run) -> Option<String> {
    let unchecked: Vec<&str> = run
        .parts
        .iter()
        .filter(|part| !part.is_checked)
        .map(|part| part.run.as_str())
        .collect();
    let whose = match run.parts.len() {
        1 => "The run directory".to_owned(),
        _ => format!("The run directory of {}", unchecked.join(", ")),
    };
    (!unchecked.is_empty()).then(|| {
        format!(
            "{whose} is of an earlier version of matrix and has no checksums of its manifest, plan, journal, environments and \
             window records: whether they are as they were written is not known."
        )
    })
}

/// That not all scenarios ran the same experiment, and what the report makes of it.
fn unlike_remark(report: &Report) -> Option<String> {
    const MOST: usize = 6;
    let fields: BTreeSet<&str> = report
        .unlike
        .iter()
        .flat_map(|unlike| unlike.fields.iter().map(String::as_str))
        .collect();
    let fields = Vec::from_iter(fields).join(", ");
    let mut pairs: Vec<String> = report
        .unlike
        .iter()
        .take(MOST)
        .map(|unlike| format!("{} / {}", unlike.a, unlike.b))
        .collect();
    if let Some(more @ 1..) = report.unlike.len().checked_sub(MOST) {
        pairs.push(format!("{more} more"));
    }
    let family = match report.settings.family {
        Family::Pairs(_) => "`report.family` names some of them, so they are in it all the same",
        _ => "they are left out of the family; to have them in it, name them in `report.family`",
    };
    (!report.unlike.is_empty()).then(|| {
        format!(
            "NOT THE SAME EXPERIMENT: {} differ in {fields}. What is different of them is not the platform's alone. Their \
             counts are marked with *, and {family}.",
            pairs.join(", ")
        )
    })
}

/// Sizes at which no pair of windows can be rejected, if there are any among the comparisons.
fn hopeless(report: &Report) -> Option<(usize, usize, f64)> {
    let procedure = Procedure {
        method: report.settings.method,
        ..Procedure::default()
    };
    let mut sizes: Vec<usize> = report
        .samples
        .iter()
        .map(|sample| sample.errors_m.len())
        .collect();
    // The fewer values, the larger the smallest p-value: the two smallest samples have the largest.
    sizes.sort_unstable();
    let &[n, m] = sizes.first_chunk()?;
    let p = procedure.smallest_p(n, m);
    (p >= report.settings.alpha).then_some((n, m, p))
}
