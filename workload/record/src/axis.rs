//! The axes that every matrix has, and their values as text.

use serde_json::Value;

/// What a host is made of, such as `x86_64`.
pub const HARDWARE: &str = "hardware";
/// What a host runs, such as `debian-12`.
pub const OS: &str = "os";
/// Which node of a cluster, where each is a host of its own (`nodes: each`).
pub const NODE: &str = "node";
/// What stands between the workload and its host: the name of a provider.
pub const VIRTUALIZATION: &str = "virtualization";
/// The value of [`VIRTUALIZATION`] where nothing does.
pub const NATIVE: &str = "native";

/// The value of [`VIRTUALIZATION`] where nothing is measured and all is computed: the name of a provider, too.
pub const SIMULATED: &str = "simulated";

/// The value of an axis as text.
#[must_use]
pub fn axis_text(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}
