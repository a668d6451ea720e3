//! What a scenario depends on that is computed and not measured. The main type is [`SimulationSettings`].

use serde::{Deserialize, Serialize};

use crate::platform_model::PlatformModel;

/// How a scenario of `virtualization: simulated` is computed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct SimulationSettings {
    /// What losses, delays and lateness are drawn from. The same seed, settings and numbers of windows give the same data.
    pub seed: u64,
    /// What the platform does to the experiment; left out, nothing.
    pub platform: PlatformModel,
}

impl Default for SimulationSettings {
    fn default() -> Self {
        Self {
            seed: 1,
            platform: PlatformModel::default(),
        }
    }
}
