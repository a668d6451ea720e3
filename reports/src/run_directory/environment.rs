//! `environment.json` of a scenario: what its platform was. The main type is [`EnvironmentRecord`].

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use workload::record::platform::PlatformRecord;

/// What a scenario's platform was, from the outside and from the inside. That of an earlier environment, whose windows
/// may count, stands beside it as `environment-<name>.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EnvironmentRecord {
    /// The environment's name.
    pub environment: String,
    /// The provider that made it.
    pub provider: String,
    /// The host that it was on, by its name in the matrix file.
    #[serde(default)]
    pub host: String,
    /// What the provider knows of it: engine version, image digest, limits.
    #[serde(default)]
    pub facts: Map<String, Value>,
    /// What the workload saw from inside; none if it never came to look.
    #[serde(default)]
    pub platform: Option<PlatformRecord>,
}

impl EnvironmentRecord {
    /// Whether the numbers were made up by the `fake` provider: they say nothing about any platform.
    #[must_use]
    pub fn is_simulated(&self) -> bool {
        self.provider == "fake"
    }
}
