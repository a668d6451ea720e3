//! What a matrix file can say of virtual machines: `providers.libvirt`, `providers.virtualbox` and the others. The main
//! type is [`VagrantSettings`].

use std::collections::BTreeMap;

use record::quantity::{Bytes, TimeSpan};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::options::{self, Allowed, Refusal};

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
    /// Settings of the provider itself, by the names that its documentation gives them, such as `driver: qemu` for libvirt: those
    /// that say how the guest is made, and none by which its host runs programs or shares files. `customize` is a list of
    /// VirtualBox's commands, with `:id` for the machine.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub options: BTreeMap<String, Value>,
}

impl VagrantSettings {
    /// What of it a matrix file may not set: where it stands below the provider's name, and why.
    #[must_use]
    pub fn refusals(&self, provider: &str, allowed: Allowed) -> Vec<(String, Refusal)> {
        let mut refusals = Vec::new();
        let is_name = |part: &str| options::is_word(part) && !part.starts_with('.');
        // Vagrant takes an address or a file for a box, too, and runs what is in it.
        let parts: Vec<&str> = self.name.split('/').collect();
        if parts.len() > 2 || !parts.into_iter().all(is_name) {
            refusals.push((
                "box".to_owned(),
                Refusal {
                    reason: format!("`{}` is not the name of a box", self.name),
                    instead: "`vagrant box add` it first, and write its name, such as `matrix/debian-12`"
                        .to_owned(),
                },
            ));
        }
        if let Some(card) = self.network_card.as_ref().filter(|card| !is_name(card)) {
            refusals.push((
                "network_card".to_owned(),
                Refusal {
                    reason: format!("`{card}` is not the model of a network card"),
                    instead: "write one word, such as `virtio`".to_owned(),
                },
            ));
        }
        let options = self.options.iter().filter_map(|(name, value)| {
            let refusal = options::refusal(allowed, provider, name, value)?;
            Some((format!("options.{name}"), refusal))
        });
        refusals.extend(options);
        refusals
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[rstest::rstest]
    #[case::ordinary("{box: matrix/debian-12, network_card: virtio, options: {driver: qemu}}", &[])]
    #[case::address("{box: 'https://example.org/a.box'}", &["box"])]
    #[case::file("{box: ./b.box}", &["box"])]
    #[case::deeper_file("{box: a/b/c.box}", &["box"])]
    #[case::xml("{network_card: \"x'/><disk/>\", options: {uri: x}}", &["network_card", "options.uri"])]
    fn what_may_not_be_set_is_told_with_its_place(#[case] yaml: &str, #[case] places: &[&str]) {
        let settings: VagrantSettings = serde_yaml::from_str(yaml).unwrap();
        let refusals = settings.refusals("libvirt", options::LIBVIRT);
        let told: Vec<&str> = refusals.iter().map(|(place, _)| place.as_str()).collect();
        assert_eq!(told, places);
    }
}
