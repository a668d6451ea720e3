//! Whether what was measured night after night has changed, and what else changed with it.
//!
//! ```text
//! Run -> Night::of                         one run, brought down to a few numbers a window
//! run directory -> digest::night_of        the same, from what was kept of it while that is true
//! nights -> series_of -> Series            one scenario and metric along the nights
//! Series -> history::judge -> Judgement    each night after those before it: jumps and slopes
//!        -> baseline::judge -> Judgement   against nights that were chosen
//! nights -> content          -> Judgement   of a metric that is compared byte for byte, either way
//! Drift                                    all judgements, with one verdict
//! ```
//!
//! The unit is the night. Windows of one night share what the night had, and two nights always differ by a little: what
//! counts as drift is more than nights differ anyway. The main type is [`Drift`].

mod acknowledgement;
pub mod baseline;
mod compact;
mod content;
pub mod contrasts;
pub mod digest;
pub mod history;
mod metric;
pub mod night;
pub mod pruning;
mod render;
mod series;

#[cfg(test)]
mod tests;

use std::{collections::BTreeMap, path::PathBuf};

#[cfg(feature = "schema")]
pub use acknowledgement::schema;
pub use acknowledgement::{Acknowledgement, Acknowledgements, Baseline};
pub use compact::Compact;
pub use metric::Metric;
pub use night::{MissingData, Night};
pub use render::{DriftDocument, series as series_for_programs};
pub use series::{Cause, Series, series_of};

use crate::explain::Found;

/// What is found where everything is judged.
#[derive(Debug, Clone, PartialEq)]
pub struct Drift {
    /// The runs that are judged against each other, the earliest first.
    pub nights: Vec<String>,
    /// When the newest of them was asked for, RFC 3339; empty without one.
    pub newest: String,
    /// One for each scenario and metric.
    pub judgements: Vec<Judgement>,
    /// What a reader must know beside.
    pub remarks: Vec<String>,
}

impl Drift {
    /// What is said of these nights, the newest last.
    fn of(nights: &[Night], judgements: Vec<Judgement>, remarks: Vec<String>) -> Self {
        let newest = nights.last().map(|night| night.created.clone());
        Self {
            nights: nights.iter().map(|night| night.run.clone()).collect(),
            newest: newest.unwrap_or_default(),
            judgements,
            remarks,
        }
    }
}

/// What is said of one scenario and metric.
#[derive(Debug, Clone, PartialEq)]
pub struct Judgement {
    /// The scenario's slug.
    pub scenario: String,
    /// What was measured.
    pub metric: Metric,
    /// What is to be held of it.
    pub verdict: Verdict,
    /// Nights with a number.
    pub nights: usize,
    /// What changed, whether or not it was acknowledged.
    pub findings: Vec<Finding>,
}

/// The four things that can be said, from the best to the worst that can be known. They are never mixed.
#[derive(Debug, Clone, PartialEq)]
pub enum Verdict {
    /// Nothing was found that is not acknowledged, where this would have been found.
    NoDrift {
        /// A change that would have been found with a probability of 80 %, in the metric's unit; none of a metric that is compared byte
        /// for byte, where any is.
        detectable: Option<f64>,
    },
    /// Something changed.
    Drift,
    /// It was measured, and the measurement's own checks found that it is worth nothing.
    Invalid {
        /// What was wrong with the measurement.
        reason: String,
    },
    /// There is no number, or there are too few to say anything.
    TooLittle {
        /// What is missing.
        reason: String,
    },
}

impl Verdict {
    /// Its name in reports.
    #[must_use]
    pub const fn name(&self) -> &'static str {
        match self {
            Self::NoDrift { .. } => "no drift found",
            Self::Drift => "drift",
            Self::Invalid { .. } => "invalid measurement",
            Self::TooLittle { .. } => "too little data",
        }
    }

    /// Why there is nothing to judge.
    #[must_use]
    pub fn reason(&self) -> Option<&str> {
        match self {
            Self::Invalid { reason } | Self::TooLittle { reason } => Some(reason),
            Self::NoDrift { .. } | Self::Drift => None,
        }
    }

    /// Drift is worse than an invalid measurement, that worse than too little data, and that worse than no drift.
    const fn rank(&self) -> u8 {
        match self {
            Self::NoDrift { .. } => 0,
            Self::TooLittle { .. } => 1,
            Self::Invalid { .. } => 2,
            Self::Drift => 3,
        }
    }
}

/// A change.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    /// How it showed.
    pub kind: Kind,
    /// The last night before it.
    pub before: String,
    /// The first night with it.
    pub since: String,
    /// What it was.
    pub change: Change,
    /// What else changed.
    pub cause: Cause,
    /// Who knows of it.
    pub acknowledged: Option<Acknowledgement>,
    /// Whether it is smaller than the equivalence margin.
    pub immaterial: bool,
    /// The run with which it was withdrawn: the night of `since` was alone, and those after it are as those before.
    pub withdrawn: Option<String>,
    /// What the change of the tracking error comes from; only of what [`Drift::explain`] was asked about.
    pub explained: Option<Found>,
    /// Where the report of the first night with it is; only where [`Drift::find_reports`] found it.
    pub report: Option<PathBuf>,
}

impl Finding {
    /// Whether it is to be told of: nobody has acknowledged it, it matters, and it was not withdrawn.
    #[must_use]
    pub const fn is_news(&self) -> bool {
        self.acknowledged.is_none() && !self.immaterial && self.withdrawn.is_none()
    }
}

/// What changed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Change {
    /// The level of numbers.
    Level(LevelChange),
    /// Bytes.
    Content(ContentChange),
}

/// A change of a level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LevelChange {
    /// The level before, in the metric's unit.
    pub before: f64,
    /// The level since.
    pub since: f64,
    /// The p, for as many scenarios and metrics as were looked at.
    pub p: f64,
}

/// A change of what is compared byte for byte.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ContentChange {
    /// The first window that has other bytes than before.
    pub first_window: u32,
    /// How many windows have.
    pub changed: usize,
    /// How many were there before, too.
    pub compared: usize,
}

/// How a change showed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// From one night to the next.
    Jump,
    /// Little by little.
    Slope,
    /// Against nights that were chosen as the baseline.
    FromBaseline,
}

impl Kind {
    /// Its name in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Jump => "jump",
            Self::Slope => "slope",
            Self::FromBaseline => "against the baseline",
        }
    }
}

/// How drift is judged.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// The probability, each night, of a false finding among all scenarios and metrics.
    pub alpha: f64,
    /// A change of these metrics that is smaller does not matter, each in its unit.
    pub equivalence_margins: BTreeMap<Metric, f64>,
    /// What is known.
    pub acknowledgements: Acknowledgements,
    /// Seed of the permutations of windows, where few runs are the baseline.
    pub seed: u64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            alpha: 0.01,
            equivalence_margins: BTreeMap::new(),
            acknowledgements: Acknowledgements::default(),
            seed: 0,
        }
    }
}

impl Settings {
    fn is_immaterial(&self, metric: &Metric, change: f64) -> bool {
        let margin = self.equivalence_margins.get(metric);
        margin.is_some_and(|margin| change.abs() < *margin)
    }
}

impl Drift {
    /// Asks what the tracking error's changes come from that are to be told of: of a scenario, in the last run before and the first since,
    /// with how many are asked about.
    pub fn explain(&mut self, mut ask: impl FnMut(&str, [&str; 2], usize) -> Found) {
        let of_error = |it: &&mut Judgement| it.metric == Metric::TrackingError;
        let asked = self
            .news()
            .filter(|(judgement, _)| judgement.metric == Metric::TrackingError)
            .count();
        for judgement in self.judgements.iter_mut().filter(of_error) {
            for finding in judgement.findings.iter_mut().filter(|it| it.is_news()) {
                finding.explained = Some(ask(&judgement.scenario, [&finding.before, &finding.since], asked));
            }
        }
    }

    /// Says with each change where the report of its first night is. `of_run` is given a run's name.
    pub fn find_reports(&mut self, of_run: impl Fn(&str) -> Option<PathBuf>) {
        for finding in self.judgements.iter_mut().flat_map(|it| &mut it.findings) {
            finding.report = of_run(&finding.since);
        }
    }

    /// Where the newest night is not the one that was asked for, such as tonight's: what nights before it say is no pass.
    #[must_use]
    pub fn without_the_night(mut self, reason: &str) -> Self {
        for judgement in &mut self.judgements {
            if matches!(judgement.verdict, Verdict::NoDrift { .. }) {
                judgement.verdict = Verdict::TooLittle {
                    reason: reason.to_owned(),
                };
            }
        }
        self
    }

    /// The one verdict: drift if any, and no drift only if nothing else is to be said of any. With nothing judged at all there
    /// is too little.
    #[must_use]
    pub fn verdict(&self) -> Verdict {
        let worst = self.judgements.iter().max_by_key(|it| it.verdict.rank());
        worst.map_or_else(
            || Verdict::TooLittle {
                reason: "no scenario was planned in any of the runs".to_owned(),
            },
            |judgement| judgement.verdict.clone(),
        )
    }
}
