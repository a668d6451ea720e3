//! `environment.json` of a scenario: what its platform was. The main type is [`EnvironmentRecord`].

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::ClockDrift;
use crate::{
    name::name,
    platform::{PlatformChange, RealtimeGrant},
};

/// What a scenario's platform was, from the outside and from the inside. That of an earlier environment, whose windows
/// may count, stands beside it as `environment-<name>.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct EnvironmentRecord {
    /// The environment's name.
    #[serde(deserialize_with = "name")]
    pub environment: String,
    /// The provider that made it.
    pub provider: String,
    /// The host that it was on, by its name in the matrix file.
    #[serde(default)]
    pub host: String,
    /// What the provider knows of it: engine version, image digest, limits.
    #[serde(default)]
    pub facts: Map<String, Value>,
    /// What the workload saw from inside, a [`crate::platform::PlatformRecord`] as it wrote it; none if it
    /// never came to look. Kept as it is, so that a report never fails for a fact that it does not need.
    #[serde(default)]
    pub platform: Option<Value>,
}

/// What is not the same of two environments.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Difference {
    /// The field, such as `platform.cpu_governor`.
    pub field: String,
    /// Its value in the first; none where it has no such field.
    pub first: Option<String>,
    /// Its value in the second.
    pub second: Option<String>,
}

/// What differs between any two environments and says nothing: names, moments, and what stands elsewhere.
const ALWAYS_DIFFERENT: [&str; 12] = [
    ClockDrift::FACT,
    "hostname",
    "load_1min",
    "memory_available_bytes",
    "clock_offset",
    "offset_ns",
    "image_id",
    "container",
    "after",
    "changes",
    "kernel_command_line",
    "machine_id",
];

/// What explains most, first.
const TELLING: [&str; 24] = [
    "provider",
    "host",
    "platform.cpu_model",
    "platform.machine",
    "platform.kernel",
    "platform.clock_source",
    "platform.cpu_governor",
    "platform.cpus_allowed",
    "platform.realtime.priority_granted",
    "platform.tcp_congestion_control",
    "platform.hypervisor",
    "platform.os",
    "platform.workload_version",
    "facts.box.sha256",
    "facts.box.version",
    "facts.libvirt",
    "facts.qemu",
    "facts.virtualbox",
    "facts.engine_version",
    "facts.engine_parts.storage_driver",
    "facts.engine_parts.default_runtime",
    "facts.engine_parts.runc_version",
    "facts.engine_parts.cgroup_version",
    "facts.engine_parts.cgroup_driver",
];

impl EnvironmentRecord {
    /// What is not the same of this environment and another, the most telling first.
    #[must_use]
    pub fn differences(&self, other: &Self) -> Vec<Difference> {
        let (first, second) = (self.fields(), other.fields());
        let mut names: Vec<&String> = first.keys().chain(second.keys()).collect();
        names.sort();
        names.dedup();
        let mut differences: Vec<Difference> = names
            .into_iter()
            .filter(|name| first.get(*name) != second.get(*name))
            .map(|name| Difference {
                field: name.clone(),
                first: first.get(name).cloned(),
                second: second.get(name).cloned(),
            })
            .collect();
        let place = |field: &str| {
            TELLING
                .iter()
                .position(|name| *name == field)
                .unwrap_or(TELLING.len())
        };
        differences.sort_by_key(|difference| place(&difference.field));
        differences
    }

    /// The version of the workload that ran here, where it is known.
    #[must_use]
    pub fn workload_version(&self) -> Option<&str> {
        self.platform.as_ref()?.get("workload_version")?.as_str()
    }

    /// Every field with a value, by its dotted path, but for those that always differ.
    fn fields(&self) -> BTreeMap<String, String> {
        let mut fields = BTreeMap::from([
            ("provider".to_owned(), self.provider.clone()),
            ("host".to_owned(), self.host.clone()),
        ]);
        for (name, value) in &self.facts {
            flatten(&format!("facts.{name}"), value, &mut fields);
        }
        if let Some(platform) = &self.platform {
            flatten("platform", platform, &mut fields);
        }
        // Said by `provider` already.
        fields.remove("facts.provider");
        fields
    }

    /// What a reader of its windows must know, in words.
    #[must_use]
    pub fn remarks(&self) -> Vec<String> {
        let drift = self.facts.get(ClockDrift::FACT);
        let drift = drift.and_then(|drift| ClockDrift::deserialize(drift).ok());
        let of_the_clock = drift.and_then(|drift| drift.remark());
        self.foreign_workload()
            .into_iter()
            .chain(of_the_clock)
            .chain(self.refusals())
            .chain(self.changes())
            .collect()
    }

    /// What was not the same after the windows as before them, in words; empty if nothing changed.
    fn changes(&self) -> Vec<String> {
        let changes = self
            .platform
            .as_ref()
            .and_then(|platform| platform.get("changes"));
        let changes = changes.and_then(|changes| Vec::<PlatformChange>::deserialize(changes).ok());
        let changes = changes.unwrap_or_default();
        changes
            .iter()
            .map(|change| format!("the platform changed while it was measured: {change}"))
            .collect()
    }

    /// That the workload was not built for the machine that the kernel says it is, in words; none where it was, or where
    /// the record does not say.
    fn foreign_workload(&self) -> Option<String> {
        let platform = self.platform.as_ref()?;
        let name = |field: &str| platform.get(field).and_then(Value::as_str);
        let (built_for, kernel) = (name("workload_machine")?, name("machine")?);
        (built_for != kernel)
            .then(|| format!("the workload is a program for {built_for}, on a kernel for {kernel}"))
    }

    /// What the loops asked of the operating system and did not get, in words; empty if all was granted.
    fn refusals(&self) -> Vec<String> {
        let grant = self
            .platform
            .as_ref()
            .and_then(|platform| platform.get("realtime"));
        let grant = grant
            .and_then(|grant| RealtimeGrant::deserialize(grant).ok())
            .unwrap_or_default();
        let because = |refusal: Option<String>| refusal.map(|why| format!(": {why}")).unwrap_or_default();
        let mut refusals = Vec::new();
        if grant.priority_granted < grant.priority_asked {
            refusals.push(format!(
                "real-time priority {} was asked for and {} granted{}",
                grant.priority_asked,
                grant.priority_granted,
                because(grant.priority_refusal)
            ));
        }
        if grant.lock_asked && !grant.locked {
            refusals.push(format!("memory is not locked{}", because(grant.lock_refusal)));
        }
        refusals
    }
}

fn flatten(path: &str, value: &Value, fields: &mut BTreeMap<String, String>) {
    let last = path.rsplit('.').next().unwrap_or(path);
    if ALWAYS_DIFFERENT.contains(&last) {
        return;
    }
    match value {
        Value::Null => {}
        Value::Object(entries) => {
            for (name, value) in entries {
                flatten(&format!("{path}.{name}"), value, fields);
            }
        }
        Value::String(text) => {
            fields.insert(path.to_owned(), text.clone());
        }
        other => {
            fields.insert(path.to_owned(), other.to_string());
        }
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn record(provider: &str, platform: Value) -> EnvironmentRecord {
        EnvironmentRecord {
            environment: "e".to_owned(),
            provider: provider.to_owned(),
            host: "here".to_owned(),
            facts: Map::new(),
            platform: Some(platform),
        }
    }

    #[test]
    fn what_two_machines_differ_in_is_told_with_the_most_telling_first() {
        let a = record(
            "native",
            json!({"zram": true, "kernel": "6.1", "hostname": "x", "governor": null}),
        );
        let b = record(
            "docker",
            json!({"zram": false, "kernel": "6.8", "hostname": "y", "swap": 1}),
        );
        let fields: Vec<String> = a.differences(&b).into_iter().map(|d| d.field).collect();
        assert_eq!(
            fields,
            ["provider", "platform.kernel", "platform.swap", "platform.zram"]
        );
        assert!(a.differences(&a).is_empty());
        let engine = |runc: &str| EnvironmentRecord {
            facts: serde_json::from_value(json!({"engine_parts": {"runc_version": runc}, "box": null}))
                .unwrap(),
            ..record("docker", json!({"zram": true}))
        };
        let [differing] = engine("1.1.5").differences(&engine("1.2.0")).try_into().unwrap();
        assert_eq!(differing.field, "facts.engine_parts.runc_version");
        let swap = &a.differences(&b)[2];
        assert_eq!((swap.first.as_deref(), swap.second.as_deref()), (None, Some("1")));
    }
}
