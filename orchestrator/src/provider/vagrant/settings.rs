//! What a matrix file can say of virtual machines: `providers.libvirt`, `providers.virtualbox` and the others. The main
//! type is [`VagrantSettings`].

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use workload::quantity::{Bytes, TimeSpan};

/// How the machines of one of Vagrant's providers are made.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct VagrantSettings {
    /// The box, which Vagrant on the host has already: a run must not depend on what a registry answers today.
    #[serde(rename = "box")]
    pub name: String,
    /// The box's version; the newest that is there when left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub box_version: Option<String>,
    /// The machine's memory.
    pub memory: Bytes,
    /// The machine's processors.
    pub cpus: u32,
    /// The model of the network card, by the provider's own name for it, such as `virtio` or `82540EM`; the provider's
    /// choice when left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub network_card: Option<String>,
    /// How long the machine may take until it answers.
    pub boot_timeout: TimeSpan,
    /// What Vagrant is to take the guest for, such as `linux`; it finds out itself when left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub guest: Option<String>,
    /// Whether Vagrant puts a key of its own in place of the one that everybody has.
    pub insert_key: bool,
    /// Settings of the provider itself, by the names that its documentation gives them, such as `driver: qemu` for libvirt.
    /// `customize` is a list of VirtualBox's commands, with `:id` for the machine.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub options: BTreeMap<String, Value>,
}

impl Default for VagrantSettings {
    fn default() -> Self {
        Self {
            name: "matrix/debian-12".to_owned(),
            box_version: None,
            memory: Bytes::new(1 << 30),
            cpus: 2,
            network_card: None,
            boot_timeout: TimeSpan::from_secs(300),
            guest: None,
            insert_key: true,
            options: BTreeMap::new(),
        }
    }
}
