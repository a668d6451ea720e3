//! Why the errors of two scenarios differ: what comes from late ticks, stalls, delays and losses. The function is [`explain`].
//!
//! ```text
//! scenario a ─► platform and links of a, unit by unit ┐  16 mixtures of both,       ┌ Shapley's value of each factor
//!                                                     ├► each simulated with the ───┤
//! scenario b ─► platform and links of b, unit by unit ┘  same seeds                 └ what they leave of the measured difference
//! ```
//!
//! Units are environments where both scenarios have several, else windows. Each unit of one is paired with one of the other, so that an
//! interval says what other units would have given: they differ by what they were fitted to as well as by chance.

mod mixtures;
mod side;

use record::{causes::with_causes, report_settings::Method, run_directory::ReadError};
use serde::{Deserialize, Serialize};
use statistics::{effect::student_quantile, ks::Procedure};

pub use self::side::Source;
use self::{
    mixtures::{DELAYS, Design, FACTORS, Factor, MIXTURES, Mixed, OfMixtures, shapley},
    side::{Observed, Side},
};
use crate::fit::FitError;

const CONFIDENCE: f64 = 0.95;

/// How much is simulated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Effort {
    /// Of the simulations.
    pub seed: u64,
    /// Control steps of all simulations together, or a few more.
    pub steps: u64,
}

impl Default for Effort {
    /// Some 25 s on two processors.
    fn default() -> Self {
        Self {
            seed: 1,
            steps: 24_000_000,
        }
    }
}

/// Why two scenarios differ.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Explanation {
    /// The runs of both scenarios.
    pub runs: [String; 2],
    /// The letters of both scenarios.
    pub scenarios: [String; 2],
    /// The letters of those that were computed and not measured.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub computed: Vec<String>,
    /// By how much the mean error of the second is larger, over all windows that count, in metres.
    pub difference_m: f64,
    /// Its interval; none with one unit.
    pub difference_interval_m: Option<[f64; 2]>,
    /// The Kolmogorov-Smirnov distance of both distributions of a period's error.
    pub difference_d: f64,
    /// By how much the mean error is larger in the simulations.
    pub simulated_m: f64,
    /// Its interval.
    pub simulated_interval_m: [f64; 2],
    /// The distance in the simulations.
    pub simulated_d: f64,
    /// What each factor has of what is simulated; parts add up to it.
    pub parts: Vec<Part>,
    /// What is left of the measured difference.
    pub unexplained_m: f64,
    /// Its interval; none with one unit.
    pub unexplained_interval_m: Option<[f64; 2]>,
    /// What differs by itself from one to the next, and what intervals are over.
    pub unit: Unit,
    /// How many of them each scenario has, or is divided into.
    pub units: usize,
    /// Simulations of each mixture for each unit, and periods of each.
    pub simulations: [u64; 2],
    /// What a reader must know.
    pub remarks: Vec<String>,
}

/// What intervals are over.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Unit {
    /// Both scenarios have several.
    Environments,
    /// Each is fitted by itself.
    Windows,
    /// There is one window a side, so that nothing is known of others.
    Simulations,
}

impl Unit {
    /// Its name in sentences.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Environments => "environments",
            Self::Windows => "windows",
            Self::Simulations => "simulations",
        }
    }
}

/// What a factor has of the difference.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Part {
    /// Which: `lateness`, `stalls`, `delays` or `losses`.
    pub factor: String,
    /// The same, for people.
    pub words: String,
    /// Its part of the difference of the means, in metres.
    pub part_m: f64,
    /// Its interval.
    pub interval_m: [f64; 2],
    /// Its part of the distance of the distributions.
    pub part_d: f64,
}

impl Part {
    /// Whether its interval tells it from none.
    #[must_use]
    pub fn is_told(&self) -> bool {
        self.interval_m[0] > 0.0 || self.interval_m[1] < 0.0
    }
}

/// A line of the table of an explanation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line<'a> {
    /// Which factor, for people, or `simulated`, `unexplained` or `measured`.
    pub words: &'a str,
    /// Of the difference of the means, in metres.
    pub m: f64,
    /// Its interval; none with one unit.
    pub interval_m: Option<[f64; 2]>,
    /// Of the distance of the distributions; none of what is unexplained.
    pub d: Option<f64>,
}

/// A pair of scenarios and why they differ.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ExplainedPair {
    /// Letter of the first scenario.
    pub a: String,
    /// Letter of the second.
    pub b: String,
    /// The explanation, or why there is none.
    #[serde(flatten)]
    pub found: Found,
}

impl From<Explanation> for ExplainedPair {
    fn from(explained: Explanation) -> Self {
        let [a, b] = explained.scenarios.clone();
        Self {
            a,
            b,
            found: Found::Explanation(Box::new(explained)),
        }
    }
}

/// An explanation, or why there is none.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Found {
    /// What the difference comes from.
    Explanation(Box<Explanation>),
    /// Why that cannot be said.
    Reason(String),
}

impl Found {
    /// What an attempt gave.
    #[must_use]
    pub fn of(attempt: Result<Explanation, ExplainError>) -> Self {
        match attempt {
            Ok(explained) => Self::Explanation(Box::new(explained)),
            Err(error) => Self::Reason(with_causes(&error)),
        }
    }
}

/// Why there is no explanation.
#[derive(Debug, thiserror::Error)]
pub enum ExplainError {
    /// The run directory.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// A platform cannot be fitted.
    #[error(transparent)]
    Fit(#[from] FitError),
    /// No scenario of that name.
    #[error("the run has no scenario `{asked}`")]
    NoSuchScenario {
        /// What was asked for.
        asked: String,
        /// What there is.
        known: Vec<String>,
    },
    /// It has no window that counts, or is of a command.
    #[error("scenario {scenario} has no window of the ball on the plate that counts")]
    NoWindow {
        /// Its letter.
        scenario: String,
    },
    /// They are not the same experiment.
    #[error("{} and {} differ in {}, which no platform explains", scenarios[0], scenarios[1], fields.join(", "))]
    OtherExperiment {
        /// Their letters.
        scenarios: [String; 2],
        /// The settings.
        fields: Vec<String>,
    },
    /// The loop leaves all numbers behind.
    #[error("the simulated loop is not stable on a mixture of both platforms")]
    Unstable,
}

impl ExplainError {
    /// What to do about it.
    #[must_use]
    pub fn hint(&self) -> String {
        match self {
            Self::Read(error) => error.hint(),
            Self::Fit(error) => error.hint(),
            Self::NoSuchScenario { known, .. } => format!("write one of {}", known.join(", ")),
            Self::NoWindow { .. } => "explain scenarios of the built-in experiment that were measured".to_owned(),
            Self::OtherExperiment { .. } => {
                "explain two scenarios that differ in hardware, system, virtualization, or the network's delay, jitter, loss and \
                 bandwidth"
                    .to_owned()
            }
            Self::Unstable => "compare scenarios of a loop that is stable on both".to_owned(),
        }
    }
}

/// Explains by how much the error of the second scenario is larger than that of the first, each named by letter or slug.
///
/// # Errors
/// When there are no such scenarios, they are not the same experiment, or a log cannot be read.
pub fn explain(asked: [(&Source<'_>, &str); 2], effort: Effort) -> Result<Explanation, ExplainError> {
    let [a, b] = asked.map(|(source, asked)| Side::of(source, asked));
    let (a, b) = (a?, b?);
    Side::check_the_same([&a, &b])?;
    let (unit, [groups_a, groups_b]) = Side::groups([&a, &b]);
    let (observed_a, observed_b) = (a.observe(&groups_a)?, b.observe(&groups_b)?);
    let pairs: Vec<[Observed; 2]> = observed_a
        .into_iter()
        .zip(observed_b)
        .map(|(a, b)| [a, b])
        .collect();
    let (settings, report) = (&a.planned.settings, a.report());
    let design = Design::of(settings, report, (effort.seed, effort.steps), pairs.len());
    let mixed: Vec<Mixed> = (0..)
        .zip(&pairs)
        .map(|(nth, pair)| design.mix(nth, &pair.each_ref().map(|observed| &observed.platform)))
        .collect();
    let values: Vec<OfMixtures> = match mixed.as_slice() {
        [only] => only.means_m.clone(),
        several => several
            .iter()
            .map(|mixed| mixtures::mean(&mixed.means_m))
            .collect(),
    };
    if values.iter().flatten().any(|value| !value.is_finite()) {
        return Err(ExplainError::Unstable);
    }
    let distances = distances(&mixed);
    let differences_m: Vec<f64> = pairs.iter().map(|[a, b]| b.error_m - a.error_m).collect();
    let simulated_m: Vec<f64> = values.iter().map(mixtures::total).collect();
    let left_m: Vec<f64> = differences_m
        .iter()
        .zip(&simulated_m)
        .map(|(difference_m, simulated_m)| difference_m - simulated_m)
        .collect();
    let difference_m = b.error_m() - a.error_m();
    let is_one = pairs.len() == 1;
    let of_units = |centre_m: f64, each_m: &[f64]| (!is_one).then(|| interval(centre_m, each_m));
    let has_captures = pairs.iter().flatten().all(|observed| observed.has_captures);
    let mean_m = |each_m: &[f64]| each_m.iter().sum::<f64>() / each_m.len() as f64;
    let parts = FACTORS
        .iter()
        .enumerate()
        .map(|(factor, Factor { name, words, .. })| {
            let each_m: Vec<f64> = values.iter().map(|of| shapley(of, factor)).collect();
            let words = match *name == DELAYS && !has_captures {
                true => "delays of links alone",
                false => words,
            };
            Part {
                factor: (*name).to_owned(),
                words: words.to_owned(),
                part_m: mean_m(&each_m),
                interval_m: interval(mean_m(&each_m), &each_m),
                part_d: shapley(&distances, factor),
            }
        });
    let unexplained_m = difference_m - mean_m(&simulated_m);
    let mut remarks: Vec<String> = Vec::new();
    for remark in pairs.iter().flatten().flat_map(|it| &it.remarks) {
        if !remarks.contains(remark) {
            remarks.push(remark.clone());
        }
    }
    if is_one {
        remarks.push(
            "One window of a scenario: the intervals are over simulations of the platforms as they were fitted, and do not say what \
             other windows would give."
                .to_owned(),
        );
    }
    Ok(Explanation {
        runs: [&a, &b].map(|side| side.run().to_owned()),
        scenarios: [&a, &b].map(|side| side.planned.id.clone()),
        computed: [&a, &b]
            .into_iter()
            .filter(|side| side.is_simulated())
            .map(|side| side.planned.id.clone())
            .collect(),
        difference_m,
        difference_interval_m: of_units(difference_m, &differences_m),
        difference_d: distance(&a.errors_m(), &b.errors_m()),
        simulated_m: mean_m(&simulated_m),
        simulated_interval_m: interval(mean_m(&simulated_m), &simulated_m),
        simulated_d: mixtures::total(&distances),
        parts: parts.collect(),
        unexplained_m,
        unexplained_interval_m: of_units(unexplained_m, &left_m),
        unit: if is_one { Unit::Simulations } else { unit },
        units: pairs.len(),
        simulations: [design.seeds, design.periods],
        remarks,
    })
}

/// Explains pairs of scenarios of one run, each with why it cannot be explained where that is so. The effort is of all together.
#[must_use]
pub fn explain_pairs(source: &Source<'_>, pairs: Vec<[String; 2]>, effort: Effort) -> Vec<ExplainedPair> {
    let effort = effort.divided(pairs.len());
    let explained = pairs.into_iter().map(|[a, b]| ExplainedPair {
        found: Found::of(explain([(source, &a), (source, &b)], effort)),
        a,
        b,
    });
    explained.collect()
}

impl Effort {
    /// Of each of so many.
    #[must_use]
    pub fn divided(self, among: usize) -> Self {
        Self {
            steps: self.steps / among.max(1) as u64,
            ..self
        }
    }
}

impl Explanation {
    /// The parts, what is simulated, what is left of what was measured, and that.
    #[must_use]
    pub fn lines(&self) -> Vec<Line<'_>> {
        let parts = self.parts.iter().map(|part| Line {
            words: &part.words,
            m: part.part_m,
            interval_m: Some(part.interval_m),
            d: Some(part.part_d),
        });
        let whole = [
            Line {
                words: "simulated",
                m: self.simulated_m,
                interval_m: Some(self.simulated_interval_m),
                d: Some(self.simulated_d),
            },
            Line {
                words: "unexplained",
                m: self.unexplained_m,
                interval_m: self.unexplained_interval_m,
                d: None,
            },
            Line {
                words: match self.computed.as_slice() {
                    [] => "measured",
                    [_] => "difference",
                    _ => "computed",
                },
                m: self.difference_m,
                interval_m: self.difference_interval_m,
                d: Some(self.difference_d),
            },
        ];
        parts.chain(whole).collect()
    }

    /// The difference and its largest part, as two sentences.
    #[must_use]
    pub fn sentence(&self) -> String {
        let [a, b] = self.names();
        let (difference_mm, cause) = (self.difference_m * 1e3, self.cause_in_words());
        let difference = match self.difference_interval_m {
            Some([low, high]) if low <= 0.0 && high >= 0.0 => format!(
                "The errors of {a} and {b} cannot be told apart: that of {b} is {difference_mm:+.2} mm [{:+.2}, {:+.2}] larger",
                low * 1e3,
                high * 1e3
            ),
            interval => {
                let compared = if difference_mm < 0.0 { "smaller" } else { "larger" };
                let difference_mm = difference_mm.abs();
                let whose = match interval {
                    Some(_) => "The error",
                    None => "One window says nothing of others; in those that are compared, the error",
                };
                format!("{whose} of {b} is {difference_mm:.2} mm {compared} than that of {a}")
            }
        };
        let mark = match self.computed.as_slice() {
            [] => String::new(),
            [one] => format!("{one} is simulated, not measured: "),
            _ => "Simulated, not measured: ".to_owned(),
        };
        format!("{mark}{difference}. {cause}.")
    }

    /// The largest part, as a sentence without its full stop.
    #[must_use]
    pub fn cause_in_words(&self) -> String {
        let mm = |m: f64| format!("{:+.2}", m * 1e3);
        let told = self.parts.iter().filter(|part| part.is_told());
        let largest = told.max_by(|a, b| a.part_m.abs().total_cmp(&b.part_m.abs()));
        largest.map_or_else(
            || "No factor has a part that can be told from none".to_owned(),
            |part| {
                let [low, high] = part.interval_m.map(mm);
                let (part_m, words) = (mm(part.part_m), &part.words);
                // A part of two hundredths is no answer by itself.
                let left = match self.unexplained_m.abs() > part.part_m.abs() {
                    true => format!("; the unexplained rest is larger: {} mm", mm(self.unexplained_m)),
                    false => String::new(),
                };
                format!("The largest part is {words}: {part_m} mm [{low}, {high}]{left}")
            },
        )
    }

    /// The scenarios, each with its run where they are of two.
    fn names(&self) -> [String; 2] {
        let [run_a, run_b] = &self.runs;
        let [a, b] = &self.scenarios;
        match run_a == run_b {
            true => [a.clone(), b.clone()],
            false => [format!("{a} in {run_a}"), format!("{b} in {run_b}")],
        }
    }

    /// What was simulated and what intervals are over, in two sentences.
    #[must_use]
    pub fn method(&self) -> String {
        let [simulations, periods] = self.simulations;
        let over = match self.unit {
            Unit::Simulations => "simulations".to_owned(),
            unit => format!("{} {} of each scenario", self.units, unit.name()),
        };
        let count = match simulations {
            1 => "1 simulation".to_owned(),
            several => format!("{several} simulations"),
        };
        format!(
            "{count} of {periods} periods of each mixture for each unit. Intervals are 95 %, over {over}."
        )
    }
}

/// The distance of each mixture's errors from those of the first platform, all pairs of platforms together.
fn distances(mixed: &[Mixed]) -> OfMixtures {
    let pooled = |mixture: usize| -> Vec<f64> {
        let of_one = mixed.iter().filter_map(|mixed| mixed.errors_m.get(mixture));
        of_one.flatten().copied().collect()
    };
    let first = pooled(0);
    let mut distances = [0.0; MIXTURES];
    for (mixture, place) in distances.iter_mut().enumerate().skip(1) {
        *place = distance(&first, &pooled(mixture));
    }
    distances
}

/// The Kolmogorov-Smirnov distance; NaN of what has no order.
fn distance(x: &[f64], y: &[f64]) -> f64 {
    // Of the test only its statistic is wanted.
    let procedure = Procedure {
        method: Method::Asymptotic,
        ..Procedure::default()
    };
    procedure.test(x, y).map_or(f64::NAN, |test| test.d)
}

/// By Student's distribution, of the mean of these around a centre; of one it is everything.
fn interval(centre: f64, each: &[f64]) -> [f64; 2] {
    let n = each.len() as f64;
    let mean = each.iter().sum::<f64>() / n;
    let squares: f64 = each.iter().map(|value| (value - mean).powi(2)).sum();
    let freedom = (n - 1.0).max(1.0);
    let error = match each.len() {
        0 | 1 => f64::INFINITY,
        _ => (squares / freedom / n).sqrt(),
    };
    let reach = student_quantile(freedom, CONFIDENCE).unwrap_or(f64::INFINITY) * error;
    [centre - reach, centre + reach]
}
