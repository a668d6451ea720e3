//! What a matrix file can say of the fake platform: `providers.fake`. The main type is [`FakeSettings`].

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use workload::quantity::TimeSpan;

/// How the fake platform behaves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct FakeSettings {
    /// Seed of the noise; the same seed, scenario and window give the same files.
    pub seed: u64,
    /// Standard deviation of what is added to each period's received positions, in metres.
    pub noise_m: f64,
    /// How long a window takes, so that there is time to interrupt it.
    pub window_takes: TimeSpan,
    /// What is special about one scenario, by its slug.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub scenarios: BTreeMap<String, FakeScenario>,
}

impl Default for FakeSettings {
    fn default() -> Self {
        Self {
            seed: 1,
            noise_m: 0.002,
            window_takes: TimeSpan::default(),
            scenarios: BTreeMap::new(),
        }
    }
}

/// What is special about one scenario on the fake platform.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct FakeScenario {
    /// Added to every received position, in metres: an effect to be found.
    pub shift_m: f64,
    /// A fault to play.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fail: Option<Fault>,
}

/// A fault, and when it happens.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Fault {
    /// During what.
    pub at: FaultPoint,
    /// During which window's measuring; the first when left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub window: Option<u32>,
}

/// What can go wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum FaultPoint {
    /// The environment cannot be created.
    Create,
    /// The workload says, in a window, that the experiment failed.
    Measure,
    /// The workload is killed in a window.
    Kill,
    /// The platform stops answering in a window.
    Disconnect,
    /// The data cannot be copied.
    Collect,
    /// The environment cannot be removed.
    Discard,
}
