//! For programs, and for the body of a webhook. The main type is [`DriftDocument`].

use std::path::Path;

use serde::Serialize;
use serde_json::{Value, json};

use crate::{
    drift::{
        Acknowledgement, Cause, Change, Drift, Finding, Judgement, Night, Verdict,
        contrasts::NightContrastsEntry,
        series::{Point, every_series},
    },
    explain::Found,
};

/// Whether what is measured night after night has changed: the output of `matrix drift --json`.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(feature = "schema", schemars(title = "matrix drift --json"))]
pub struct DriftDocument<'a> {
    /// The worst of the judgements: `no drift found`, `too little data`, `invalid measurement` or `drift`.
    verdict: &'static str,
    /// The verdict in one sentence.
    headline: String,
    /// The names of the runs that are judged against each other, the earliest first.
    nights: &'a [String],
    /// One for each scenario and metric.
    judgements: Vec<JudgementEntry<'a>>,
    /// What to know before believing the rest.
    remarks: &'a [String],
    /// The scenarios compared with each other, the night as a block; only with `--between-scenarios`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub between_scenarios: Option<NightContrastsEntry<'a>>,
    /// Each scenario and metric along the nights, as `--html` draws it; not in a webhook's body.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub series: Option<Vec<SeriesEntry>>,
}

/// A scenario and metric along the nights.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SeriesEntry {
    /// The scenario's slug.
    scenario: String,
    /// The metric, as in `judgements`.
    metric: String,
    /// The SI unit of its values.
    unit: String,
    /// The nights that have a number, the earliest first.
    nights: Vec<NightEntry>,
}

/// A night's number.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
struct NightEntry {
    /// The run's name.
    run: String,
    /// The median of its windows, or of its environments.
    level: f64,
    /// The lowest of them.
    lowest: f64,
    /// The highest of them.
    highest: f64,
}

/// Every scenario and metric along these nights.
#[must_use]
pub fn series(nights: &[Night]) -> Vec<SeriesEntry> {
    let of_each = every_series(nights).into_iter().map(|series| {
        let night = |point: &Point<'_>| {
            let [lowest, highest] = point.range(&series.metric).unwrap_or([point.level; 2]);
            NightEntry {
                run: point.run.to_owned(),
                level: point.level,
                lowest,
                highest,
            }
        };
        SeriesEntry {
            nights: series.points.iter().map(night).collect(),
            unit: series.metric.unit().to_owned(),
            metric: series.metric.name().to_owned(),
            scenario: series.scenario,
        }
    });
    of_each.filter(|series| !series.nights.is_empty()).collect()
}

/// The judgement of one scenario and metric.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
struct JudgementEntry<'a> {
    /// The scenario's slug.
    scenario: &'a str,
    /// `error`, `state-age`, `packet-delay`, `lateness` or `provisioning`, or a metric of the experiment.
    metric: &'a str,
    /// The SI unit of the metric's values.
    unit: &'a str,
    /// `no drift found`, `too little data`, `invalid measurement` or `drift`.
    verdict: &'static str,
    /// Why nothing can be judged; null where something can.
    reason: Option<&'a str>,
    /// A change that would have been found with a probability of 80 %, in `unit`; null unless no drift was found, and of a metric that is
    /// compared byte for byte.
    detectable: Option<f64>,
    /// Nights with a number.
    nights: usize,
    /// What changed, acknowledged or not.
    findings: Vec<FindingEntry<'a>>,
}

/// A change.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
struct FindingEntry<'a> {
    /// `jump`, `slope` or `against the baseline`.
    kind: &'static str,
    /// The last night before the change.
    before: &'a str,
    /// The first night with the change.
    since: &'a str,
    /// The level before, in the judgement's unit; null of a metric that is compared byte for byte.
    level_before: Option<f64>,
    /// The level since, in the judgement's unit.
    level_since: Option<f64>,
    /// The p-value, adjusted for all scenarios and metrics.
    p: Option<f64>,
    /// Which windows have other bytes than before; only of a metric that is compared byte for byte.
    #[serde(skip_serializing_if = "Option::is_none")]
    windows: Option<ChangedWindows>,
    /// What else changed.
    cause: CauseEntry<'a>,
    /// What the change comes from, as `matrix explain --json` has it, or why that cannot be said; only of a change of the tracking
    /// error that is to be told of.
    #[serde(skip_serializing_if = "Option::is_none")]
    explained: Option<&'a Found>,
    /// Who acknowledged the change; null if nobody did.
    acknowledged: Option<&'a Acknowledgement>,
    /// Whether the change is smaller than what was declared to matter.
    immaterial: bool,
    /// The run with which the change was withdrawn, since the nights after `since` are nearer to the level before; null if it was
    /// not.
    withdrawn: Option<&'a str>,
    /// Where the report of the run `since` is; null where it is not known.
    report: Option<&'a Path>,
    /// What to write into `drift.yaml` to acknowledge the change, but for who says so and why; null unless it is to be told of.
    acknowledgement: Option<String>,
}

/// Which windows have other bytes than before.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
struct ChangedWindows {
    /// The number of the first of them.
    first: u32,
    /// How many have.
    changed: usize,
    /// How many were there before, too.
    compared: usize,
}

/// What else changed.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
struct CauseEntry<'a> {
    /// `configuration`, `infrastructure` or `unexplained`.
    kind: &'static str,
    /// What differs; empty where nothing that is recorded does.
    fields: Vec<ChangedField<'a>>,
}

/// A field that is not the same.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
struct ChangedField<'a> {
    /// Its dotted path.
    field: &'a str,
    /// Its value before the change, null if it had none; only of the infrastructure.
    #[serde(skip_serializing_if = "Option::is_none")]
    before: Option<Option<&'a str>>,
    /// Its value since the change, null if it has none; only of the infrastructure.
    #[serde(skip_serializing_if = "Option::is_none")]
    since: Option<Option<&'a str>>,
}

impl Drift {
    /// All that was judged. Numbers are in the unit that stands beside.
    #[must_use]
    pub fn json(&self) -> DriftDocument<'_> {
        DriftDocument {
            verdict: self.verdict().name(),
            headline: self.headline(),
            nights: &self.nights,
            judgements: self.judgements.iter().map(|it| judgement(self, it)).collect(),
            remarks: &self.remarks,
            between_scenarios: None,
            series: None,
        }
    }

    /// What chat services of the usual kind take at an incoming webhook: `text`, and beside it all that was judged.
    #[must_use]
    pub fn webhook(&self) -> Value {
        let mut lines = vec![self.headline()];
        for (judgement, finding) in self.news() {
            lines.push(format!(
                "• {} {} {}",
                judgement.scenario,
                judgement.metric.name(),
                finding.in_words(&judgement.metric)
            ));
        }
        json!({"text": plain(&lines.join("\n")), "drift": self.json()})
    }
}

/// Text that chat services show as it is: what a host says of itself mentions nobody and links to nothing. In all of them the three
/// characters are written as in HTML, as in
/// <https://api.slack.com/reference/surfaces/formatting#escaping>.
fn plain(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}

fn judgement<'a>(drift: &Drift, judgement: &'a Judgement) -> JudgementEntry<'a> {
    let detectable = match judgement.verdict {
        Verdict::NoDrift { detectable } => detectable,
        Verdict::Drift | Verdict::Invalid { .. } | Verdict::TooLittle { .. } => None,
    };
    JudgementEntry {
        scenario: &judgement.scenario,
        metric: judgement.metric.name(),
        unit: judgement.metric.unit(),
        verdict: judgement.verdict.name(),
        reason: judgement.verdict.reason(),
        detectable,
        nights: judgement.nights,
        findings: judgement
            .findings
            .iter()
            .map(|it| finding(drift, judgement, it))
            .collect(),
    }
}

fn finding<'a>(drift: &Drift, judgement: &Judgement, finding: &'a Finding) -> FindingEntry<'a> {
    let fields: Vec<ChangedField<'_>> = match &finding.cause {
        Cause::Configuration(fields) => fields
            .iter()
            .map(|field| ChangedField {
                field,
                before: None,
                since: None,
            })
            .collect(),
        Cause::Infrastructure(differences) => differences
            .iter()
            .map(|it| ChangedField {
                field: &it.field,
                before: Some(it.first.as_deref()),
                since: Some(it.second.as_deref()),
            })
            .collect(),
        Cause::Unexplained => Vec::new(),
    };
    let (level, windows) = match finding.change {
        Change::Level(level) => (Some(level), None),
        Change::Content(change) => (
            None,
            Some(ChangedWindows {
                first: change.first_window,
                changed: change.changed,
                compared: change.compared,
            }),
        ),
    };
    FindingEntry {
        kind: finding.kind.name(),
        before: &finding.before,
        since: &finding.since,
        level_before: level.map(|level| level.before),
        level_since: level.map(|level| level.since),
        p: level.map(|level| level.p),
        windows,
        cause: CauseEntry {
            kind: finding.cause.name(),
            fields,
        },
        explained: finding.explained.as_ref(),
        acknowledged: finding.acknowledged.as_ref(),
        immaterial: finding.immaterial,
        withdrawn: finding.withdrawn.as_deref(),
        report: finding.report.as_deref(),
        acknowledgement: finding
            .is_news()
            .then(|| drift.acknowledgement(judgement, finding)),
    }
}
