//! Whether this machine can run the experiment as it is, by asking the very binary that would run it. The main function
//! is [`check`].

use std::process::Stdio;

use tokio::process::Command;
use workload::record::check::CheckRecord;

use super::{ProviderError, refused};
use crate::{provider::Availability, state_directory::StateDirectory, workload_binary};

/// Runs `workload check` on this machine.
///
/// # Errors
/// When the binary cannot be put in the state directory or started, or does not answer as agreed.
pub async fn check(state: &StateDirectory) -> Result<CheckRecord, ProviderError> {
    let binary = workload_binary::installed(state)?;
    let output = Command::new(binary)
        .arg("check")
        .env_clear()
        .current_dir("/")
        .stdin(Stdio::null())
        .output()
        .await
        .map_err(|error| refused("starting the workload", error))?;
    serde_json::from_slice(&output.stdout).map_err(|error| ProviderError::Data {
        what: "the answer of `workload check`".to_owned(),
        reason: error.to_string(),
    })
}

/// What a check means for a scenario: what is required and missing makes it infeasible.
pub fn availability(record: &CheckRecord) -> Availability {
    match record
        .checks
        .iter()
        .find(|check| check.required && !check.available)
    {
        Some(missing) => Availability::Unavailable {
            reason: missing
                .reason
                .clone()
                .unwrap_or_else(|| format!("{} is missing", missing.name)),
            fix: missing.fix.clone(),
        },
        None => Availability::Available {
            detail: format!("Linux {}", rustix::system::uname().release().to_string_lossy()),
        },
    }
}
