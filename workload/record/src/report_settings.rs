//! How the tables are made: the `report:` section of a matrix file. The main type is [`ReportSettings`].

mod drawn;
mod expected;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

pub use self::{
    drawn::{DrawnPair, DrawnScenario, NoWindow},
    expected::{Amount, Expectation, Expectations, HOST, Several, Tolerance},
};
use crate::{
    family::Family,
    quantity::Length,
    run_directory::{PeriodError, PlannedScenario},
    window::Impossible,
};

/// The name of the one metric of the ball on the plate, where metrics are named.
pub const TRACKING_ERROR: &str = "error";

/// How samples are taken and compared. Printed with every table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct ReportSettings {
    /// A comparison is rejected when its p-value is below this.
    pub alpha: f64,
    /// How p-values are computed.
    pub method: Method,
    /// What is averaged over each period.
    pub metric: Metric,
    /// Which positions the error is of: those that the controller received, or the true ones of `plant.csv`.
    #[serde(skip_serializing_if = "ErrorOf::is_default")]
    pub error: ErrorOf,
    /// Periods left out at the start of each run of the loop, where it begins with the transient.
    pub discard_periods: u32,
    /// What is done about a window that warms up for longer than that.
    #[serde(skip_serializing_if = "WarmUp::is_default")]
    pub warm_up: WarmUp,
    /// The scenarios that the others are compared with, by axis values.
    #[serde(alias = "control")]
    pub baseline: BTreeMap<String, String>,
    /// Pairs of scenarios to draw, by letter or slug, and of which windows, such as `[[b, h], [d/1, f/2]]`. When left out:
    /// the baseline scenarios beside each other, and the scenarios that differ in virtualization alone.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub figures: Vec<DrawnPair>,
    /// The pairs of scenarios that are asked about: p-values are adjusted for as many.
    #[serde(skip_serializing_if = "Family::is_default")]
    pub family: Family,
    /// A shift of the error that is smaller does not matter; a verdict says so.
    #[serde(alias = "matters", skip_serializing_if = "Option::is_none")]
    pub equivalence_margin: Option<Length>,
    /// What metrics are expected to be, by their names, such as `error: {value: 120mm, below: 5%, above: 5%}`. A scenario whose mean
    /// is beyond that ends `matrix run` and `matrix report` with exit code 7.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub expect: Expectations,
    /// Seed of the relabellings and resamples that are drawn where there are too many to look at each.
    #[serde(skip_serializing_if = "is_zero")]
    pub seed: u64,
}

/// Settings that an earlier version does not know are written only where they are used.
#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
fn is_zero(seed: &u64) -> bool {
    *seed == 0
}

impl ReportSettings {
    /// The settings that had another name in earlier versions: that name, which `alias` reads too, and the setting's own.
    pub const RENAMED: [(&str, &str); 2] = [("control", "baseline"), ("matters", "equivalence_margin")];

    /// The settings that are of the ball on the plate alone.
    pub const OF_THE_BALL: [&str; 5] = [
        "metric",
        "error",
        "discard_periods",
        "warm_up",
        "equivalence_margin",
    ];

    /// Looks whether statistics can be computed with them: of a matrix file as of a run directory.
    ///
    /// # Errors
    /// The first with which they cannot.
    pub fn check(&self) -> Result<(), Impossible> {
        match self.alpha > 0.0 && self.alpha < 1.0 {
            true => Ok(()),
            false => Err(Impossible {
                field: "report.alpha",
                value: self.alpha.to_string(),
            }),
        }
    }

    /// What a metric is expected to be in a scenario, if anything is.
    #[must_use]
    pub fn expected(&self, metric: &str, scenario: &PlannedScenario) -> Option<&Expectation> {
        let expected = self.expect.get(metric)?;
        expected.0.iter().find(|it| it.is_of(scenario))
    }

    /// Whether a scenario belongs to the baseline.
    #[must_use]
    pub fn is_baseline(&self, scenario: &PlannedScenario) -> bool {
        let mut axes = self.baseline.iter();
        !self.baseline.is_empty() && axes.all(|(axis, value)| scenario.axis(axis).as_ref() == Some(value))
    }

    /// How many periods of a window are left out.
    #[must_use]
    pub const fn discarded(&self, starts_run: bool) -> u32 {
        if starts_run { self.discard_periods } else { 0 }
    }
}

impl Default for ReportSettings {
    fn default() -> Self {
        Self {
            alpha: 0.001,
            method: Method::Exact,
            metric: Metric::MeanAbsSum,
            error: ErrorOf::default(),
            discard_periods: 1,
            warm_up: WarmUp::default(),
            baseline: BTreeMap::from([("virtualization".to_owned(), "native".to_owned())]),
            figures: Vec::new(),
            family: Family::default(),
            equivalence_margin: None,
            expect: Expectations::new(),
            seed: 0,
        }
    }
}

/// What is done about a window that warms up beyond the periods that are left out anyway.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum WarmUp {
    /// It is said, and nothing is cut for it.
    #[default]
    Flag,
    /// Its periods are left out of the sample, and that is said.
    Cut,
}

impl WarmUp {
    #[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
    fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

/// The positions of the ball that the error is of.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum ErrorOf {
    /// As the controller received them, late and after what was lost: the paper's.
    #[default]
    Received,
    /// Where the ball was when the controller computed, by the plant's log.
    TruePosition,
}

impl ErrorOf {
    #[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
    fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

/// What is averaged over each period; e is reference minus position ([`ErrorOf`]).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Metric {
    /// mean |e_x| + mean |e_y|: the paper's.
    MeanAbsSum,
    /// mean |e_x|.
    MeanAbsX,
    /// mean |e_y|.
    MeanAbsY,
    /// mean of √(e_x² + e_y²).
    MeanDistance,
    /// √(mean of e_x² + e_y²).
    RootMeanSquare,
}

impl Metric {
    /// All of them.
    pub const ALL: [Self; 5] = [
        Self::MeanAbsSum,
        Self::MeanAbsX,
        Self::MeanAbsY,
        Self::MeanDistance,
        Self::RootMeanSquare,
    ];

    /// The error of one period, in metres.
    #[must_use]
    pub fn of(self, period: &PeriodError) -> f64 {
        match self {
            Self::MeanAbsSum => period.mean_abs_x_m + period.mean_abs_y_m,
            Self::MeanAbsX => period.mean_abs_x_m,
            Self::MeanAbsY => period.mean_abs_y_m,
            Self::MeanDistance => period.mean_distance_m,
            Self::RootMeanSquare => period.mean_square_m2.sqrt(),
        }
    }

    /// What it is, for people.
    #[must_use]
    pub const fn formula(self) -> &'static str {
        match self {
            Self::MeanAbsSum => "mean |e_x| + mean |e_y|",
            Self::MeanAbsX => "mean |e_x|",
            Self::MeanAbsY => "mean |e_y|",
            Self::MeanDistance => "mean of the distance from the target",
            Self::RootMeanSquare => "root mean square distance from the target",
        }
    }
}

/// How a p-value is computed. It decides verdicts, so it is printed with each.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// Exact, conditional on the ties; Kolmogorov's limit where that would take too long.
    #[default]
    Exact,
    /// Kolmogorov's limit for large samples, which knows nothing of ties.
    Asymptotic,
    /// The limit with Stephens's correction, as the usual tools computed it in the paper's time.
    Paper,
}

impl Method {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Exact, Self::Asymptotic, Self::Paper];

    /// Its name in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Exact => "exact",
            Self::Asymptotic => "asymptotic",
            Self::Paper => "paper",
        }
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn a_setting_is_read_under_the_name_that_it_had_and_written_under_its_own() {
        let former = json!({"control": {"os": "debian"}, "matters": "2mm", "family": "against-controls"});
        let settings: ReportSettings = serde_json::from_value(former).unwrap();
        let written = serde_json::to_value(settings).unwrap();
        assert_eq!(written["baseline"], json!({"os": "debian"}));
        assert_eq!(written["equivalence_margin"], "2mm");
        assert_eq!(written["family"], "against-baseline");
        for (former, own) in ReportSettings::RENAMED {
            assert!(written.get(former).is_none(), "{written:#}");
            let mut both = written.clone();
            both[former] = both[own].clone();
            assert!(
                serde_json::from_value::<ReportSettings>(both).is_err(),
                "{former}"
            );
        }
    }
}
