//! Asking the workload itself whether the place it is put in meets a need, by `workload check`: what it is called with and
//! what its answer means. Whoever can start a process there asks. The functions are [`call`] and [`availability`].

use std::time::Duration;

use record::{
    call::Check,
    check::{self, CheckRecord},
    settings::Need,
};

use super::{Availability, ProviderError};

/// It makes some namespaces and devices and starts what it needs for a moment: milliseconds. An engine on an emulated
/// processor took 26 s to make the container for it, while others used that processor, too.
pub const TIMEOUT: Duration = Duration::from_secs(120);
/// What is being done, for errors.
pub const ACTION: &str = "asking the workload whether it can run";

/// The call of the workload.
#[must_use]
pub fn call(need: &Need) -> Check {
    Check::of(&need.settings())
}

/// What the workload printed.
///
/// # Errors
/// When it is not what a workload prints.
pub fn answer(printed: &[u8]) -> Result<CheckRecord, ProviderError> {
    serde_json::from_slice(printed).map_err(|error| ProviderError::Data {
        what: "the answer of `workload check`".to_owned(),
        reason: error.to_string(),
    })
}

/// What the answer means for a scenario with that need: what is required and missing makes it infeasible.
#[must_use]
pub fn availability(record: &CheckRecord) -> Availability {
    let missing = |check: &&check::Check| check.required && !check.available;
    match record.checks.iter().find(missing) {
        Some(missing) => Availability::Unavailable {
            reason: missing
                .reason
                .clone()
                .unwrap_or_else(|| format!("{} is missing", missing.name)),
            fix: missing.fix.clone(),
        },
        None => Availability::Available {
            detail: String::new(),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(required: bool) -> CheckRecord {
        let missing = check::Check {
            name: "ros-master".to_owned(),
            required,
            available: false,
            reason: None,
            fix: Some("install it".to_owned()),
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
            reason: "ros-master is missing".to_owned(),
            fix: Some("install it".to_owned()),
        };
        assert_eq!(availability(&record(true)), infeasible);
        assert!(matches!(
            availability(&record(false)),
            Availability::Available { .. }
        ));
    }

    #[test]
    fn an_answer_that_no_workload_gives_is_not_believed() {
        let said = serde_json::to_vec(&record(true)).unwrap();
        assert_eq!(answer(&said).unwrap(), record(true));
        assert!(matches!(answer(b"yes"), Err(ProviderError::Data { .. })));
    }
}
