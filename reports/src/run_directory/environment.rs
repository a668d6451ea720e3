//! `environment.json` of a scenario: what its platform was. The main type is [`EnvironmentRecord`].

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use workload::record::platform::{PlatformChange, RealtimeGrant};

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
    /// What the workload saw from inside, a [`workload::record::platform::PlatformRecord`] as it wrote it; none if it
    /// never came to look. Kept as it is, so that a report never fails for a fact that it does not need.
    #[serde(default)]
    pub platform: Option<Value>,
}

impl EnvironmentRecord {
    /// Whether the numbers were made up by the `fake` provider: they say nothing about any platform.
    #[must_use]
    pub fn is_simulated(&self) -> bool {
        self.provider == "fake"
    }

    /// What was not the same after the windows as before them, in words; empty if nothing changed.
    #[must_use]
    pub fn changes(&self) -> Vec<String> {
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
    #[must_use]
    pub fn foreign_workload(&self) -> Option<String> {
        let platform = self.platform.as_ref()?;
        let name = |field: &str| platform.get(field).and_then(Value::as_str);
        let (built_for, kernel) = (name("workload_machine")?, name("machine")?);
        (built_for != kernel)
            .then(|| format!("the workload is a program for {built_for}, on a kernel for {kernel}"))
    }

    /// What the loops asked of the operating system and did not get, in words; empty if all was granted.
    #[must_use]
    pub fn refusals(&self) -> Vec<String> {
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
