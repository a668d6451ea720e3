//! The `providers:` section of a matrix file. The main type is [`ProviderSettings`].
//!
//! What only one provider knows stands with that provider: this is the list of them.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{docker::DockerSettings, fake::FakeSettings, vagrant::VagrantSettings};

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
}

impl ProviderSettings {
    /// Those of the providers that Vagrant drives, with their names.
    #[must_use]
    pub const fn of_vagrant(&self) -> [(&'static str, &VagrantSettings); 6] {
        [
            ("libvirt", &self.libvirt),
            ("virtualbox", &self.virtualbox),
            ("vmware_desktop", &self.vmware_desktop),
            ("parallels", &self.parallels),
            ("hyperv", &self.hyperv),
            ("qemu", &self.qemu),
        ]
    }
}
