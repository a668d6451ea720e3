//! What was judged, for people and for programs: methods of [`Drift`].

mod github;
mod json;
mod junit;
mod text;

pub use json::DriftDocument;

use super::{Cause, Change, Drift, Finding, Judgement, Kind, Metric, Verdict};
use crate::explain::Found;

impl Drift {
    /// The verdict in one sentence.
    #[must_use]
    pub fn headline(&self) -> String {
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
    /// What changed, in a sentence.
    fn in_words(&self, metric: &Metric) -> String {
        let cause = self.cause.in_words();
        let level = match &self.change {
            Change::Level(level) => level,
            Change::Content(change) => {
                return format!(
                    "has other bytes than before in {} ({} of {} windows, the first is {}); {cause}",
                    self.since, change.changed, change.compared, change.first_window
                );
            }
        };
        let (from, to) = (metric.text(level.before), metric.text(level.since));
        let change = match self.kind {
            Kind::Jump => format!("jumped from {from} to {to}"),
            Kind::Slope => format!("went little by little from {from} to {to}"),
            Kind::FromBaseline => format!("is {to}, and was {from} in the baseline"),
        };
        let explained = match &self.explained {
            None => String::new(),
            Some(Found::Explanation(explained)) => format!(". {}", explained.cause_in_words()),
            Some(Found::Reason(reason)) => format!(". What it comes from cannot be said: {reason}"),
        };
        format!(
            "{change} in {} (p = {:.2e}); {cause}{explained}",
            self.since, level.p
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

/// Differences of environments that are named.
const MOST_NAMED: usize = 5;

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
        let few = |mut all: Vec<String>| {
            let more = all.len().saturating_sub(MOST_NAMED);
            all.truncate(MOST_NAMED);
            match more {
                0 => all.join(", "),
                more => format!("{} and {more} more", all.join(", ")),
            }
        };
        match self {
            Self::Configuration(fields) => {
                format!("what was asked for changed with it: {}", few(fields.clone()))
            }
            Self::Infrastructure(differences) => {
                let value = |value: &Option<String>| value.clone().unwrap_or_else(|| "nothing".to_owned());
                let told = differences
                    .iter()
                    .map(|it| format!("{} {} → {}", it.field, value(&it.first), value(&it.second)));
                format!("what it runs on changed with it: {}", few(told.collect()))
            }
            Self::Unexplained => "nothing else that is recorded changed with it".to_owned(),
        }
    }
}

fn capitalised(text: &str) -> String {
    let mut letters = text.chars();
    letters
        .next()
        .map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}
