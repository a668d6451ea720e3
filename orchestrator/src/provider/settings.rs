//! The `providers:` section of a matrix file. The main type is [`ProviderSettings`].
//!
//! What only one provider knows stands with that provider: this is the list of them.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::{
    docker::DockerSettings, fake::FakeSettings, simulated::SimulatedSettings, vagrant::VagrantSettings,
};

/// Settings that belong to one provider alone, each under the provider's name.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ProviderSettings {
    /// Of `virtualization: docker`.
    pub docker: DockerSettings,
    /// Of `virtualization: libvirt`, through Vagrant.
    pub libvirt: VagrantSettings,
    /// Of `virtualization: virtualbox`, through Vagrant.
    pub virtualbox: VagrantSettings,
    /// Of `virtualization: vmware_desktop`, through Vagrant.
    pub vmware_desktop: VagrantSettings,
    /// Of `virtualization: parallels`, through Vagrant.
    pub parallels: VagrantSettings,
    /// Of `virtualization: hyperv`, through Vagrant.
    pub hyperv: VagrantSettings,
    /// Of `virtualization: qemu`, through Vagrant.
    pub qemu: VagrantSettings,
    /// Of `virtualization: fake`.
    pub fake: FakeSettings,
    /// Of `virtualization: simulated`.
    #[serde(skip_serializing_if = "SimulatedSettings::is_empty")]
    pub simulated: SimulatedSettings,
    /// Of providers from outside this crate, by their names and as the file has them: only they can read them.
    #[serde(skip)]
    #[schemars(skip)]
    pub outside: BTreeMap<String, Value>,
}

impl ProviderSettings {
    /// As a manifest has them: each section by its provider's name.
    ///
    /// # Errors
    /// When they cannot be written as JSON.
    pub fn to_record(&self) -> Result<Map<String, Value>, serde_json::Error> {
        let built_in: Map<String, Value> = serde_json::from_value(serde_json::to_value(self)?)?;
        Ok(built_in.into_iter().chain(self.outside.clone()).collect())
    }
}
