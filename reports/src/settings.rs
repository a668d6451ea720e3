//! How the tables are made: the `report:` section of a matrix file. The main type is [`ReportSettings`].

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// How samples are taken and compared. Printed with every table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct ReportSettings {
    /// A comparison is rejected when its p-value is below this.
    pub alpha: f64,
    /// What is averaged over each period.
    pub metric: Metric,
    /// Periods left out at the start of each run of the loop, where it begins with the transient.
    pub discard_periods: u32,
    /// The scenarios that are the experimental controls, by axis values.
    pub control: BTreeMap<String, String>,
    /// Pairs of scenarios to draw, by letter or slug; the controls against the others when left out.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub figures: Vec<(String, String)>,
}

impl Default for ReportSettings {
    fn default() -> Self {
        Self {
            alpha: 0.001,
            metric: Metric::MeanAbsSum,
            discard_periods: 1,
            control: BTreeMap::from([("virtualization".to_owned(), "native".to_owned())]),
            figures: Vec::new(),
        }
    }
}

/// What is averaged over each period; e is reference minus received position.
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
