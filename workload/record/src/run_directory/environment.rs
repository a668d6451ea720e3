//! `environment.json` of a scenario: what its platform was. The main type is [`EnvironmentRecord`].

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::{ClockDrift, EngineParts, VagrantBox, fact};
use crate::{
    field,
    name::name,
    platform::{ClockRecord, PlatformChange, PlatformRecord, RealtimeGrant, SurveyRecord},
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
    /// What the provider knows of it: engine version, image digest, limits. Each provider has facts of its own; those that a
    /// reader knows are in [`fact`].
    #[serde(default)]
    pub facts: Map<String, Value>,
    /// What the workload saw from inside; none if it never came to look.
    #[serde(default)]
    pub platform: Option<RecordedPlatform>,
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

/// What differs between any two environments and says nothing: names, moments, and what stands elsewhere. Wherever the field is.
const ALWAYS_DIFFERENT: [&str; 13] = [
    ClockDrift::FACT,
    field!(PlatformRecord, hostname),
    field!(PlatformRecord, load_1min),
    field!(PlatformRecord, memory_available_bytes),
    field!(ClockRecord, offset_ns),
    fact::IMAGE_ID,
    fact::CONTAINER,
    fact::JOB,
    field!(SurveyRecord, after),
    field!(SurveyRecord, changes),
    field!(PlatformRecord, kernel_command_line),
    // Of the platform, in records of earlier versions.
    "clock_offset",
    "machine_id",
];

/// What explains most, first: the names from the record on.
const TELLING: [&[&str]; 26] = [
    &[field!(EnvironmentRecord, provider)],
    &[field!(EnvironmentRecord, host)],
    &[FACTS, fact::NODE],
    &[PLATFORM, field!(PlatformRecord, cpu_model)],
    &[PLATFORM, field!(PlatformRecord, machine)],
    &[PLATFORM, field!(PlatformRecord, kernel)],
    &[PLATFORM, field!(PlatformRecord, clock_source)],
    &[PLATFORM, field!(PlatformRecord, cpu_governor)],
    &[PLATFORM, field!(PlatformRecord, cpus_allowed)],
    &[
        PLATFORM,
        field!(PlatformRecord, realtime),
        field!(RealtimeGrant, priority_granted),
    ],
    &[PLATFORM, field!(PlatformRecord, tcp_congestion_control)],
    &[PLATFORM, field!(PlatformRecord, hypervisor)],
    &[PLATFORM, field!(PlatformRecord, os)],
    &[PLATFORM, field!(PlatformRecord, workload_version)],
    &[FACTS, fact::BOX, field!(VagrantBox, sha256)],
    &[FACTS, fact::BOX, field!(VagrantBox, version)],
    &[FACTS, fact::LIBVIRT],
    &[FACTS, fact::QEMU],
    &[FACTS, fact::VIRTUALBOX],
    &[FACTS, fact::BATCH_SYSTEM],
    &[FACTS, fact::ENGINE_VERSION],
    &[FACTS, fact::ENGINE_PARTS, field!(EngineParts, storage_driver)],
    &[FACTS, fact::ENGINE_PARTS, field!(EngineParts, default_runtime)],
    &[FACTS, fact::ENGINE_PARTS, field!(EngineParts, runc_version)],
    &[FACTS, fact::ENGINE_PARTS, field!(EngineParts, cgroup_version)],
    &[FACTS, fact::ENGINE_PARTS, field!(EngineParts, cgroup_driver)],
];
const PLATFORM: &str = field!(EnvironmentRecord, platform);
const FACTS: &str = field!(EnvironmentRecord, facts);

/// A workload's [`SurveyRecord`], as the workload wrote it. It is kept whole, since a workload of another version may have other
/// fields, and read field by field, so that a report never fails for a fact that it does not need.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(transparent)]
pub struct RecordedPlatform(Map<String, Value>);

impl RecordedPlatform {
    /// Every field as it was written.
    #[must_use]
    pub const fn fields(&self) -> &Map<String, Value> {
        &self.0
    }

    /// The machine that the workload was built for; that of the kernel where the record does not say.
    #[must_use]
    pub fn program_machine(&self) -> Option<&str> {
        self.workload_machine().or_else(|| self.machine())
    }

    /// How the kernel's TCP controls congestion, as Linux calls it.
    #[must_use]
    pub fn tcp_congestion_control(&self) -> Option<&str> {
        self.text(field!(PlatformRecord, tcp_congestion_control))
    }

    fn machine(&self) -> Option<&str> {
        self.text(field!(PlatformRecord, machine))
    }

    fn workload_machine(&self) -> Option<&str> {
        self.text(field!(PlatformRecord, workload_machine))
    }

    fn workload_version(&self) -> Option<&str> {
        self.text(field!(PlatformRecord, workload_version))
    }

    fn realtime(&self) -> RealtimeGrant {
        self.read(field!(PlatformRecord, realtime))
    }

    fn changes(&self) -> Vec<PlatformChange> {
        self.read(field!(SurveyRecord, changes))
    }

    fn text(&self, field: &str) -> Option<&str> {
        self.0.get(field)?.as_str()
    }

    /// A field; the default where it is not there or is something else.
    fn read<'a, T: Deserialize<'a> + Default>(&'a self, field: &str) -> T {
        let written = self.0.get(field);
        written
            .and_then(|value| T::deserialize(value).ok())
            .unwrap_or_default()
    }

    /// That the platform was not the same after the windows as before them, in words; empty if nothing changed.
    fn remarks_on_changes(&self) -> Vec<String> {
        let changes = self.changes();
        let remark =
            |change: &PlatformChange| format!("the platform changed while it was measured: {change}");
        changes.iter().map(remark).collect()
    }

    /// That the workload was not built for the machine that the kernel says it is, in words; none where it was, or where
    /// the record does not say.
    fn remark_on_foreign_workload(&self) -> Option<String> {
        let (built_for, kernel) = (self.workload_machine()?, self.machine()?);
        (built_for != kernel)
            .then(|| format!("the workload is a program for {built_for}, on a kernel for {kernel}"))
    }

    /// What the loops asked of the operating system and did not get, in words; empty if all was granted.
    fn remarks_on_refusals(&self) -> Vec<String> {
        let grant = self.realtime();
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
                .position(|names| field.split('.').eq(names.iter().copied()))
                .unwrap_or(TELLING.len())
        };
        differences.sort_by_key(|difference| place(&difference.field));
        differences
    }

    /// The node of a cluster that measured; none on a host that is a machine.
    #[must_use]
    pub fn node(&self) -> Option<&str> {
        self.facts.get(fact::NODE)?.as_str()
    }

    /// The version of the workload that ran here, where it is known.
    #[must_use]
    pub fn workload_version(&self) -> Option<&str> {
        self.platform.as_ref()?.workload_version()
    }

    /// Every field with a value, by its dotted path, but for those that always differ.
    fn fields(&self) -> BTreeMap<String, String> {
        let mut fields = BTreeMap::from([
            (
                field!(EnvironmentRecord, provider).to_owned(),
                self.provider.clone(),
            ),
            (field!(EnvironmentRecord, host).to_owned(), self.host.clone()),
        ]);
        // The provider's name is there already.
        let facts = self.facts.iter().filter(|(name, _)| *name != fact::PROVIDER);
        for (name, value) in facts {
            flatten(&format!("{FACTS}.{name}"), value, &mut fields);
        }
        for (name, value) in self.platform.iter().flat_map(RecordedPlatform::fields) {
            flatten(&format!("{PLATFORM}.{name}"), value, &mut fields);
        }
        fields
    }

    /// What a reader of its windows must know, in words.
    #[must_use]
    pub fn remarks(&self) -> Vec<String> {
        let drift = self.facts.get(ClockDrift::FACT);
        let drift = drift.and_then(|drift| ClockDrift::deserialize(drift).ok());
        let of_the_clock = drift.and_then(|drift| drift.remark());
        let platform = self.platform.as_ref();
        platform
            .and_then(RecordedPlatform::remark_on_foreign_workload)
            .into_iter()
            .chain(of_the_clock)
            .chain(
                platform
                    .into_iter()
                    .flat_map(RecordedPlatform::remarks_on_refusals),
            )
            .chain(
                platform
                    .into_iter()
                    .flat_map(RecordedPlatform::remarks_on_changes),
            )
            .collect()
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
            platform: Some(serde_json::from_value(platform).unwrap()),
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
        let job = |job: &str, node: &str| EnvironmentRecord {
            facts: serde_json::from_value(json!({"job": job, "node": node})).unwrap(),
            ..record("native", json!({"kernel": "6.1"}))
        };
        assert!(job("17", "n1").differences(&job("18", "n1")).is_empty());
        let [node] = job("17", "n1").differences(&job("18", "n2")).try_into().unwrap();
        assert_eq!(node.field, "facts.node");
        let swap = &a.differences(&b)[2];
        assert_eq!((swap.first.as_deref(), swap.second.as_deref()), (None, Some("1")));
    }

    /// serde could write a field under another name than the compiler knows.
    #[test]
    fn the_telling_fields_are_written_under_their_names() {
        let box_of_a_machine = json!({"name": "a", "version": "1", "sha256": null});
        let box_of_a_machine: VagrantBox = serde_json::from_value(box_of_a_machine).unwrap();
        let facts = json!({
            (fact::ENGINE_PARTS): EngineParts::default(),
            (fact::BOX): box_of_a_machine,
            (fact::LIBVIRT): "1",
            (fact::QEMU): "1",
            (fact::VIRTUALBOX): "1",
            (fact::ENGINE_VERSION): "1",
            (fact::NODE): "n1",
            (fact::BATCH_SYSTEM): "Slurm 23.11",
        });
        let written = EnvironmentRecord {
            facts: serde_json::from_value(facts).unwrap(),
            ..record("a", serde_json::to_value(PlatformRecord::default()).unwrap())
        };
        let written = serde_json::to_value(written).unwrap();
        for names in TELLING {
            let pointer: String = names.iter().map(|name| format!("/{name}")).collect();
            assert!(written.pointer(&pointer).is_some(), "{pointer}");
        }
    }

    #[test]
    fn a_platform_of_another_version_is_kept_as_it_was_written_and_read_as_far_as_it_is_known() {
        let written = json!({
            "machine": "x86_64", "workload_machine": "i686", "workload_version": 7, "new": [1, {"a": null}],
            "realtime": "refused", "changes": [{"what": "cpu_governor", "before": "a", "after": "b"}],
        });
        let platform: RecordedPlatform = serde_json::from_value(written.clone()).unwrap();
        assert_eq!(serde_json::to_value(&platform).unwrap(), written);
        assert_eq!(platform.program_machine(), Some("i686"));
        let record = EnvironmentRecord {
            platform: Some(platform),
            ..record("native", json!({}))
        };
        assert_eq!(record.workload_version(), None);
        assert_eq!(
            record.remarks(),
            [
                "the workload is a program for i686, on a kernel for x86_64",
                "the platform changed while it was measured: cpu_governor was `a` and is `b`",
            ]
        );
    }
}
