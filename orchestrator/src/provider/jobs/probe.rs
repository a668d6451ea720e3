//! What a job prints that only looks at its node. The main type is [`ProbedNode`].

use record::{
    check::{Check, CheckRecord},
    detached,
};
use serde::Deserialize as _;

use crate::provider::ProviderError;

/// The check whether there is an engine for the user of the job.
pub const ENGINE: &str = "engine";

/// What a node is and has, as a job on it saw it.
#[derive(Debug, Clone, PartialEq)]
pub struct ProbedNode {
    /// What the experiment needs, and what else is worth to know.
    pub checks: Vec<Check>,
    /// What the node is.
    pub host: detached::Host,
}

/// What the job printed: what `workload check` and `workload detached platform` do, and whether there is an engine for this user.
pub(super) fn answer(printed: &str) -> Result<ProbedNode, ProviderError> {
    let mut answers = serde_json::Deserializer::from_str(printed);
    let mut read = || -> serde_json::Result<ProbedNode> {
        let CheckRecord { mut checks, .. } = CheckRecord::deserialize(&mut answers)?;
        let host = detached::Host::deserialize(&mut answers)?;
        let has_engine = bool::deserialize(&mut answers)?;
        let clock = host.platform.clock.is_some_and(|clock| clock.synchronised);
        checks.push(worth_knowing(
            "clock",
            clock,
            "nothing keeps the node's clock synchronised",
            "ask for `chronyd` or `systemd-timesyncd` on the nodes",
        ));
        checks.push(worth_knowing(
            ENGINE,
            has_engine,
            "there is no Docker Engine that this user may use",
            "ask whether one can be had, or choose nodes that have one by their feature (`constraint`)",
        ));
        Ok(ProbedNode { checks, host })
    };
    read().map_err(|error| ProviderError::Data {
        what: format!("the answer of the job, `{}`,", first_line(printed)),
        reason: error.to_string(),
    })
}

fn worth_knowing(name: &str, available: bool, reason: &str, fix: &str) -> Check {
    let missing = |text: &str| (!available).then(|| text.to_owned());
    Check {
        name: name.to_owned(),
        required: false,
        available,
        reason: missing(reason),
        fix: missing(fix),
    }
}

fn first_line(printed: &str) -> String {
    let line = printed.lines().next().unwrap_or_default();
    line.chars().take(100).collect()
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn printed(synchronised: bool) -> String {
        let check = json!({"format": 1, "workload_version": "0.1.0", "can_run": true, "checks": []});
        let mut host = serde_json::to_value(detached::Host {
            platform: record::platform::PlatformRecord::default(),
            free_bytes: 1,
            uid: 1000,
            now_ns: 2,
        })
        .unwrap();
        host["clock"] = json!({"synchronised": synchronised, "status": 0, "offset_ns": 0, "frequency_ppm": 0.0, "max_error_us": 9});
        format!("{check}\n{host}\nfalse\n")
    }

    #[test]
    fn a_node_is_told_with_its_clock_and_its_engine() {
        let node = answer(&printed(true)).unwrap();
        assert_eq!(node.host.uid, 1000);
        let told: Vec<_> = node
            .checks
            .iter()
            .map(|it| (it.name.as_str(), it.available, it.required))
            .collect();
        assert_eq!(told, [("clock", true, false), ("engine", false, false)]);
        assert!(!answer(&printed(false)).unwrap().checks[0].available);
    }

    #[test]
    fn words_that_are_no_answer_are_quoted() {
        let error = answer("slurmstepd: error: no\n").unwrap_err().to_string();
        assert!(error.contains("slurmstepd: error: no"), "{error}");
        let cut = printed(true).replace("false\n", "");
        assert!(answer(&cut).is_err());
    }
}
