//! What was judged, for people and for programs: methods of [`Drift`].

mod github;
mod json;
mod junit;
mod page;
mod text;

pub use json::{DriftDocument, series};

use std::time::Duration;

use serde_json::json;

use super::{Cause, Change, Drift, Finding, Judgement, Kind, Metric, Verdict};
use crate::{
    explain::Found,
    present::{listing::listed, table::p_in_words},
};

impl Drift {
    /// The verdict, what changed, and what is withdrawn: some sentences.
    #[must_use]
    pub fn headline(&self) -> String {
        format!(
            "{}{}{}",
            self.verdict_in_words(),
            self.first_news(),
            self.told_before()
        )
    }

    /// The verdict in one sentence.
    fn verdict_in_words(&self) -> String {
        let verdict = self.verdict();
        let count = |wanted: &str| {
            let is_it = |it: &&Judgement| it.verdict.name() == wanted;
            self.judgements.iter().filter(is_it).count()
        };
        let parts: Vec<String> = [
            "drift",
            "invalid measurement",
            "too little data",
            "no drift found",
        ]
        .into_iter()
        .filter(|name| count(name) > 0)
        .map(|name| format!("{name}: {}", count(name)))
        .collect();
        format!(
            "{} in {}, against {} earlier runs ({}).",
            capitalised(verdict.name()),
            self.nights.last().map_or("no run", String::as_str),
            self.nights.len().saturating_sub(1),
            match parts.is_empty() {
                true => "nothing was judged".to_owned(),
                false => parts.join(", "),
            }
        )
    }

    /// The first change to be told of, and how many more there are.
    fn first_news(&self) -> String {
        let mut news = self.news();
        let Some((judgement, finding)) = news.next() else {
            return String::new();
        };
        let more = match news.count() {
            0 => String::new(),
            1 => ", and 1 more change".to_owned(),
            many => format!(", and {many} more changes"),
        };
        format!(
            " The {} of {} {} in {}{more}.",
            judgement.metric.name(),
            judgement.scenario,
            finding.change_in_words(&judgement.metric),
            finding.since
        )
    }

    /// What was told before, was withdrawn, and nobody has acknowledged.
    fn told_before(&self) -> String {
        let findings = self.judgements.iter().flat_map(|judgement| &judgement.findings);
        let withdrawn =
            findings.filter(|it| it.withdrawn.is_some() && it.acknowledged.is_none() && !it.immaterial);
        match withdrawn.count() {
            0 => String::new(),
            1 => " 1 change that was told before is withdrawn.".to_owned(),
            many => format!(" {many} changes that were told before are withdrawn."),
        }
    }

    /// The entry of `drift.yaml` that would acknowledge a change for some months, but for who says so and why.
    fn acknowledgement(&self, judgement: &Judgement, finding: &Finding) -> String {
        /// A change that stays is looked at again after so long.
        const MONTHS: Duration = Duration::from_secs(90 * 24 * 3600);
        // Text in JSON is text in YAML.
        let text = |text: &str| json!(text).to_string();
        let newest = humantime::parse_rfc3339(&self.newest).ok();
        let day = newest.and_then(|newest| newest.checked_add(MONTHS));
        let day = day.map_or_else(String::new, |day| {
            humantime::format_rfc3339_seconds(day).to_string()
        });
        format!(
            "acknowledged:\n  - scenario: {}\n    metric: {}\n    since: {}\n    reason: why it is as it is\n    person: who says so\n    \
             expires: {}\n    baseline: keep\n",
            text(&judgement.scenario),
            text(judgement.metric.name()),
            text(&finding.since),
            day.get(..10).unwrap_or("YYYY-MM-DD")
        )
    }

    /// What is to be told of, with its scenario and metric.
    pub(super) fn news(&self) -> impl Iterator<Item = (&Judgement, &Finding)> {
        self.judgements.iter().flat_map(|judgement| {
            let news = judgement.findings.iter().filter(|finding| finding.is_news());
            news.map(move |finding| (judgement, finding))
        })
    }
}

impl Judgement {
    /// The verdict with what belongs to it, in a clause.
    fn in_words(&self) -> String {
        match &self.verdict {
            Verdict::NoDrift { detectable: None } => {
                format!(
                    "no drift found in {} nights; any other byte would have been",
                    self.nights
                )
            }
            Verdict::NoDrift {
                detectable: Some(detectable),
            } => format!(
                "no drift found in {} nights; {} would have been",
                self.nights,
                self.metric.text(*detectable)
            ),
            Verdict::Drift => "drift".to_owned(),
            Verdict::Invalid { reason } => format!("invalid measurement: {reason}"),
            Verdict::TooLittle { reason } => format!("too little data: {reason}"),
        }
    }
}

impl Finding {
    /// What changed, as what the metric of the scenario did.
    fn change_in_words(&self, metric: &Metric) -> String {
        let level = match &self.change {
            Change::Level(level) => level,
            Change::Content(_) => return "has other bytes than before".to_owned(),
        };
        let (from, to) = (metric.text(level.before), metric.text(level.since));
        let percent = match level.before {
            0.0 => String::new(),
            before => format!(" ({:+.1} %)", (level.since - before) / before.abs() * 100.0),
        };
        match self.kind {
            Kind::Jump => format!("jumped from {from} to {to}{percent}"),
            Kind::Slope => format!("went little by little from {from} to {to}{percent}"),
            Kind::FromBaseline => format!("is {to}, and was {from} in the baseline{percent}"),
        }
    }

    /// What changed, in a sentence.
    fn in_words(&self, metric: &Metric) -> String {
        let cause = self.cause.in_words();
        let change = self.change_in_words(metric);
        let level = match &self.change {
            Change::Level(level) => level,
            Change::Content(content) => {
                return format!(
                    "{change} in {} ({} of {} windows, the first is {}); {cause}",
                    self.since, content.changed, content.compared, content.first_window
                );
            }
        };
        let report = match &self.report {
            None => String::new(),
            Some(report) => format!(". Its report: {}", report.display()),
        };
        let explained = match &self.explained {
            None => String::new(),
            Some(Found::Explanation(explained)) => format!(". {}", explained.cause_in_words()),
            Some(Found::Reason(reason)) => format!(". What it comes from cannot be said: {reason}"),
        };
        format!(
            "{change} in {} ({}); {cause}{explained}{report}",
            self.since,
            p_in_words(level.p)
        )
    }

    /// Why it is not told of, if it is not.
    fn silence(&self) -> Option<String> {
        if let Some(known) = &self.acknowledged {
            return Some(format!(
                "acknowledged by {} until {}: {}",
                known.person, known.expires, known.reason
            ));
        }
        if let Some(run) = &self.withdrawn {
            return Some(match self.change {
                Change::Level(_) => {
                    format!("withdrawn with {run}: the nights since are nearer to the level before")
                }
                Change::Content(_) => {
                    format!("withdrawn with {run}, which has the same bytes as before again")
                }
            });
        }
        self.immaterial
            .then(|| "less than what was declared to matter".to_owned())
    }
}

impl Cause {
    /// Its name for programs.
    const fn name(&self) -> &'static str {
        match self {
            Self::Configuration(_) => "configuration",
            Self::Infrastructure(_) => "infrastructure",
            Self::Unexplained => "unexplained",
        }
    }

    fn in_words(&self) -> String {
        let parts = parts_of(self);
        match self {
            Self::Configuration(_) => format!("what was asked for changed with it: {parts}"),
            Self::Infrastructure(_) => format!("what it runs on changed with it: {parts}"),
            Self::Unexplained => "nothing else that is recorded changed with it".to_owned(),
        }
    }
}

/// What of it changed, the first of it; empty where nothing that is recorded did.
fn parts_of(cause: &Cause) -> String {
    let value = |value: &Option<String>| value.clone().unwrap_or_else(|| "nothing".to_owned());
    match cause {
        Cause::Configuration(fields) => listed(fields),
        Cause::Infrastructure(differences) => listed(
            differences
                .iter()
                .map(|it| format!("{} {} → {}", it.field, value(&it.first), value(&it.second))),
        ),
        Cause::Unexplained => String::new(),
    }
}

fn capitalised(text: &str) -> String {
    let mut letters = text.chars();
    letters
        .next()
        .map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}
