//! Rights that a matrix file asks for. The type is [`AskedRight`].

use schemars::JsonSchema;
use serde::Serialize;

/// Something that a matrix file asks for, for a provider's environments, beyond what every environment of ours may do.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, JsonSchema)]
pub struct AskedRight {
    /// Where it stands in the file, such as `providers.docker.capabilities`.
    pub setting: &'static str,
    /// What is asked for, such as `SETGID`.
    pub asked: String,
    /// What that means for the host.
    pub means: &'static str,
}
