//! What `report.json` has of runs with several environments a scenario.

use serde::Serialize;
use statistics::variance_components::{Component, Components};

use crate::analysis::replicates::{Advice, EnvironmentContrast, Replicates, ScenarioVariance};

/// The pairs of the family with the environment as the unit, and what adds to the variance.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ReplicatesEntry<'a> {
    /// Every pair of the family with a round in common. Their verdicts are those of `contrasts`, too.
    pub pairs: Vec<EnvironmentContrastEntry<'a>>,
    /// Letters of the pairs without.
    pub without_data: &'a [(String, String)],
    /// What adds to the variance of each scenario.
    pub scenarios: Vec<ScenarioVarianceEntry<'a>>,
    /// The same of all scenarios together, each around its own mean; null without data.
    pub together: Option<VarianceEntry>,
    /// Where the next hour of measuring goes furthest; null where that is not known.
    pub next_hour: Option<NextHourEntry>,
}

/// Two scenarios compared, with the environment as the unit.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct EnvironmentContrastEntry<'a> {
    /// Letter of the first scenario.
    pub a: &'a str,
    /// Letter of the second.
    pub b: &'a str,
    /// Rounds in which both have a window that counts.
    pub rounds: usize,
    /// Whether their environments were made in the same rounds of one run.
    pub interleaved: bool,
    /// p-value of the permutation test of environments within rounds; between scenarios, if they were not interleaved.
    pub p: f64,
    /// The smallest p that so many environments can have.
    pub smallest_p: f64,
    /// Labellings examined, the observed one included.
    pub labellings: u64,
    /// `exact`, or `monte-carlo` if labellings were drawn.
    pub method: &'static str,
    /// `p` adjusted by Holm's method.
    pub p_holm: f64,
    /// The mean difference of environment means, from the first to the second.
    pub shift: f64,
    /// The lower end of its interval; null if there is none.
    pub shift_low: Option<f64>,
    /// The upper end.
    pub shift_high: Option<f64>,
    /// The confidence of that interval for this pair alone.
    pub confidence: Option<f64>,
    /// Whether the intervals of all pairs hold together at 1 − alpha.
    pub simultaneous: bool,
    /// `cannot tell`, `not told apart`, `immaterial`, `differ`, `differ, matters` or `differ, size open`.
    pub verdict: &'static str,
}

/// What adds to the variance of a scenario.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ScenarioVarianceEntry<'a> {
    /// Its letter.
    pub id: &'a str,
    /// Environments with a window that counts.
    pub environments: usize,
    /// Windows that count.
    pub windows: usize,
    /// What each level adds.
    #[serde(flatten)]
    pub variance: VarianceEntry,
}

/// What each level adds to the variance.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct VarianceEntry {
    /// Values within a window; null if it is not known.
    pub within_windows: Option<ComponentEntry>,
    /// Windows within an environment; null if it is not known.
    pub between_windows: Option<ComponentEntry>,
    /// Environments within a scenario; null if it is not known.
    pub between_environments: Option<ComponentEntry>,
}

/// What a level adds to the variance.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ComponentEntry {
    /// The estimate, unbiased and so below 0 at times, in the square of the unit.
    pub variance: f64,
    /// The lower end of its 95 % interval, in the square of the unit; null if there is none.
    pub low: Option<f64>,
    /// The upper end.
    pub high: Option<f64>,
    /// Degrees of freedom of the level's mean square.
    pub degrees_of_freedom: f64,
}

/// Where the next hour of measuring makes the mean of a scenario most certain.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct NextHourEntry {
    /// `environments` or `windows`.
    pub best: &'static str,
    /// The share of the mean's variance that an hour of more windows takes off.
    pub by_windows: f64,
    /// The share of it that an hour of more environments takes off.
    pub by_environments: f64,
    /// The length of a window, in seconds.
    pub window_s: f64,
    /// What an environment took beside its windows, in seconds: the median.
    pub environment_s: f64,
    /// The windows in an environment that cost least for the same certainty; null where environments add no variance.
    pub best_windows: Option<u32>,
}

impl<'a> ReplicatesEntry<'a> {
    /// Of what the analysis found.
    pub(in super::super) fn of(replicates: &'a Replicates) -> Self {
        Self {
            pairs: replicates.pairs.iter().map(pair).collect(),
            without_data: &replicates.without,
            scenarios: replicates.scenarios.iter().map(scenario).collect(),
            together: replicates.together.as_ref().map(variance),
            next_hour: replicates.next_hour.as_ref().map(next_hour),
        }
    }
}

fn pair(pair: &EnvironmentContrast) -> EnvironmentContrastEntry<'_> {
    EnvironmentContrastEntry {
        a: &pair.a,
        b: &pair.b,
        rounds: pair.rounds,
        interleaved: pair.is_interleaved,
        p: pair.test.p,
        smallest_p: pair.smallest_p,
        labellings: pair.test.labellings,
        method: pair.test.coverage.name(),
        p_holm: pair.p_holm,
        shift: pair.shift,
        shift_low: pair.interval.map(|interval| interval.low),
        shift_high: pair.interval.map(|interval| interval.high),
        confidence: pair.interval.map(|interval| interval.confidence),
        simultaneous: pair.is_simultaneous,
        verdict: pair.verdict.name(),
    }
}

fn scenario(scenario: &ScenarioVariance) -> ScenarioVarianceEntry<'_> {
    ScenarioVarianceEntry {
        id: &scenario.id,
        environments: scenario.environments,
        windows: scenario.windows,
        variance: variance(&scenario.components),
    }
}

fn variance(components: &Components) -> VarianceEntry {
    let component = |component: &Component| ComponentEntry {
        variance: component.variance,
        low: component.interval.map(|interval| interval.low),
        high: component.interval.map(|interval| interval.high),
        degrees_of_freedom: component.freedom,
    };
    let level = |level: usize| components.level(level).map(component);
    VarianceEntry {
        within_windows: level(1),
        between_windows: level(2),
        between_environments: level(3),
    }
}

fn next_hour(advice: &Advice) -> NextHourEntry {
    NextHourEntry {
        best: match advice.next.prefers_environments() {
            true => "environments",
            false => "windows",
        },
        by_windows: advice.next.by_windows,
        by_environments: advice.next.by_environments,
        window_s: advice.costs.window_s,
        environment_s: advice.costs.environment_s,
        best_windows: advice.next.best_windows,
    }
}
