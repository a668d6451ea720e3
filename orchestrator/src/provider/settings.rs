//! The `providers:` section of a matrix file. The main type is [`ProviderSettings`].
//!
//! What only one provider knows stands with that provider: this is the list of them.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{docker::DockerSettings, fake::FakeSettings};

/// Settings that belong to one provider alone, each under the provider's name.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ProviderSettings {
    /// Of `virtualization: docker`.
    pub docker: DockerSettings,
    /// Of `virtualization: fake`.
    pub fake: FakeSettings,
}
