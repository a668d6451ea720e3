//! Whether this machine can run the experiment as it is, by asking the very binary that would run it. The main function
//! is [`check`].

use std::{process::Stdio, time::Duration};

use tokio::process::Command;
use workload::record::check::CheckRecord;

use super::{ProviderError, refused};
use crate::{provider::Availability, state_directory::StateDirectory, workload_binary};

/// It makes some namespaces and devices: milliseconds, a second on a slow machine.
const PATIENCE: Duration = Duration::from_secs(20);
const ACTION: &str = "asking the workload whether it can run";

/// Runs `workload check` on this machine.
///
/// # Errors
/// When the binary cannot be put in the state directory or started, or does not answer in time and as agreed.
pub async fn check(state: &StateDirectory) -> Result<CheckRecord, ProviderError> {
    let binary = workload_binary::installed(state)?;
    let mut command = Command::new(binary);
    command
        .arg("check")
        .env_clear()
        .current_dir("/")
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .kill_on_drop(true);
    let child = workload_binary::start(|| command.spawn()).map_err(|error| refused(ACTION, error))?;
    let output = tokio::time::timeout(PATIENCE, child.wait_with_output())
        .await
        .map_err(|_| ProviderError::TimedOut {
            action: ACTION.to_owned(),
            after: PATIENCE,
        })?
        .map_err(|error| refused(ACTION, error))?;
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

#[cfg(test)]
mod tests {
    use workload::record::check::Check;

    use super::*;

    fn record(required: bool) -> CheckRecord {
        let missing = Check {
            name: "network".to_owned(),
            required,
            available: false,
            reason: None,
            fix: Some("run as root".to_owned()),
        };
        CheckRecord {
            format: 1,
            workload_version: "1".to_owned(),
            can_run: !required,
            checks: vec![missing],
        }
    }

    #[test]
    fn only_what_is_required_makes_a_scenario_infeasible() {
        let infeasible = Availability::Unavailable {
            reason: "network is missing".to_owned(),
            fix: Some("run as root".to_owned()),
        };
        assert_eq!(availability(&record(true)), infeasible);
        assert!(matches!(
            availability(&record(false)),
            Availability::Available { .. }
        ));
    }
}
