//! For programs, and for the body of a webhook.

use serde_json::{Value, json};

use crate::drift::{Cause, Drift, Finding, Judgement, Verdict};

impl Drift {
    /// All that was judged. Numbers are in the unit that stands beside.
    #[must_use]
    pub fn json(&self) -> Value {
        json!({
            "verdict": self.verdict().name(),
            "headline": self.headline(),
            "nights": self.nights,
            "judgements": self.judgements.iter().map(judgement).collect::<Vec<_>>(),
            "remarks": self.remarks,
        })
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
                finding.in_words(judgement.metric)
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

fn judgement(judgement: &Judgement) -> Value {
    let (reason, detectable) = match &judgement.verdict {
        Verdict::NoDrift { detectable } => (None, Some(*detectable)),
        Verdict::Drift => (None, None),
        Verdict::Invalid { reason } | Verdict::TooLittle { reason } => (Some(reason), None),
    };
    json!({
        "scenario": judgement.scenario,
        "metric": judgement.metric.name(),
        "unit": judgement.metric.unit(),
        "verdict": judgement.verdict.name(),
        "reason": reason,
        "detectable": detectable,
        "nights": judgement.nights,
        "findings": judgement.findings.iter().map(finding).collect::<Vec<_>>(),
    })
}

fn finding(finding: &Finding) -> Value {
    let details: Vec<Value> = match &finding.cause {
        Cause::Configuration(fields) => fields.iter().map(|field| json!({"field": field})).collect(),
        Cause::Infrastructure(differences) => differences
            .iter()
            .map(|it| json!({"field": it.field, "before": it.first, "since": it.second}))
            .collect(),
        Cause::Unexplained => Vec::new(),
    };
    json!({
        "kind": finding.kind.name(),
        "before": finding.before,
        "since": finding.since,
        "level_before": finding.level_before,
        "level_since": finding.level_since,
        "p": finding.p,
        "cause": {"kind": finding.cause.name(), "fields": details},
        "acknowledged": finding.acknowledged,
        "immaterial": finding.immaterial,
    })
}
