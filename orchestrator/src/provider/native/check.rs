//! Whether this machine can run the experiment as it is, by asking the very binary that would run it. The main function
//! is [`check`].

use std::{process::Stdio, time::Duration};

use tokio::process::Command;
use workload::{
    record::check::{Check, CheckRecord},
    settings::NetworkBackend,
};

use super::{ProviderError, refused};
use crate::{provider::Availability, state_directory::StateDirectory, workload_binary};

/// It makes some namespaces and devices: milliseconds, a second on a slow machine.
const PATIENCE: Duration = Duration::from_secs(20);
/// The check of [`workload::survey::check`] that depends on the network.
const NETWORK: &str = "network";
const ACTION: &str = "asking the workload whether it can run";

/// Runs `workload check` on this machine, for one of the networks.
///
/// # Errors
/// When the binary cannot be put in the state directory or started, or does not answer in time and as agreed.
pub async fn check(state: &StateDirectory, backend: NetworkBackend) -> Result<CheckRecord, ProviderError> {
    let binary = workload_binary::installed(state)?;
    let mut command = Command::new(binary);
    command
        .args(["check", "--settings"])
        .arg(serde_json::json!({"network": {"backend": backend}}).to_string())
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

/// What a check means for a scenario, whatever its network: what is required and missing makes it infeasible.
pub fn availability(record: &CheckRecord) -> Availability {
    judge(record, |check| check.name != NETWORK)
}

/// What a check means for a scenario with the network that was asked for.
pub fn network(record: &CheckRecord) -> Availability {
    judge(record, |check| check.name == NETWORK)
}

fn judge(record: &CheckRecord, counts: impl Fn(&Check) -> bool) -> Availability {
    match record
        .checks
        .iter()
        .find(|check| check.required && !check.available && counts(check))
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
    use super::*;

    fn record(name: &str, required: bool) -> CheckRecord {
        let missing = Check {
            name: name.to_owned(),
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
            reason: "clock is missing".to_owned(),
            fix: Some("run as root".to_owned()),
        };
        assert_eq!(availability(&record("clock", true)), infeasible);
        assert!(matches!(
            availability(&record("clock", false)),
            Availability::Available { .. }
        ));
    }

    #[test]
    fn a_network_that_cannot_be_had_is_in_the_way_of_those_who_want_it() {
        let without = record("network", true);
        assert!(matches!(network(&without), Availability::Unavailable { .. }));
        assert!(matches!(availability(&without), Availability::Available { .. }));
    }
}
