//! What Slurm's tools print, as types. Pure.

use std::collections::BTreeSet;

use record::run_directory::Standing;

use crate::batch::{Forecast, Job, JobOwner};

/// What `squeue` is asked for of each job. The comment comes last: it alone may have the separator in it.
pub const JOBS: &str = "%i|%T|%r|%N|%n|%S|%j|%k";
/// What `sinfo` is asked for of each partition.
pub const LIMITS: &str = "%P|%l";
/// What `sinfo` is asked for of each node.
pub const NODES: &str = "%N|%P|%T";
/// What is quoted of an answer.
const MOST_QUOTED: usize = 300;

/// A job of ours, out of a line of `squeue`; none of one that is not ours.
pub fn job(line: &str) -> Option<Job> {
    let mut fields = line.splitn(8, '|');
    let mut next = || fields.next().map(str::trim);
    let (id, state, reason) = (next()?, next()?, next()?);
    let (node, wanted_node, start) = (next()?, next()?, next()?);
    let (name, comment) = (next()?, next()?);
    let said = |text: &str| {
        let nothing = ["", "None", "N/A", "(null)"].contains(&text);
        (!nothing).then(|| first_words(text))
    };
    let is_number = !id.is_empty() && id.chars().all(|c| c.is_ascii_digit());
    // Another program's jobs may have any name; an array's are not ours.
    if !is_number || !name.starts_with("matrix-") {
        return None;
    }
    Some(Job {
        id: id.to_owned(),
        name: name.to_owned(),
        owner: JobOwner::of_comment(comment),
        standing: standing(state, reason),
        state: first_words(state),
        reason: said(reason),
        node: said(node),
        wanted_node: said(wanted_node),
        start: said(start),
    })
}

/// Reasons for which a job waits until somebody changes it or the cluster. Slurm has others, which pass.
const FOR_EVER: [&str; 12] = [
    "BadConstraints",
    "PartitionTimeLimit",
    "PartitionNodeLimit",
    "PartitionConfig",
    "InvalidAccount",
    "InvalidQOS",
    "QOSTimeLimit",
    "AssocMaxWallDurationPerJobLimit",
    "AccountNotAllowed",
    "QOSNotAllowed",
    "DependencyNeverSatisfied",
    "JobHeldUser",
];

/// What a state of Slurm's means (squeue(1), JOB STATE CODES). One that is not known is one of a job that is not over.
fn standing(state: &str, reason: &str) -> Standing {
    match state {
        "PENDING" | "REQUEUED" | "REQUEUE_FED" | "REQUEUE_HOLD" | "RESV_DEL_HOLD" | "SPECIAL_EXIT" => {
            match FOR_EVER.contains(&reason) {
                true => Standing::WaitsForEver,
                false => Standing::Waits,
            }
        }
        "NODE_FAIL" | "PREEMPTED" | "BOOT_FAIL" | "REVOKED" => Standing::LostItsNode,
        "COMPLETED" | "FAILED" | "TIMEOUT" | "OUT_OF_MEMORY" | "DEADLINE" | "CANCELLED" => Standing::Ended,
        _ => Standing::Runs,
    }
}

/// Out of what `sbatch --test-only` says: `sbatch: Job 5 to start at 2026-01-31T00:00:00 using 2 processors on nodes n3 in
/// partition lab`.
pub fn forecast(words: &str) -> Forecast {
    let after = |before: &str| {
        let (_, after) = words.split_once(before)?;
        let word = after.split_whitespace().next()?;
        Some(first_words(word))
    };
    Forecast {
        start: after(" to start at "),
        // A single node has no list's brackets.
        node: after(" on nodes ").filter(|node| !node.contains(['[', ','])),
    }
}

/// The nodes in service, and those that are not with their state, out of `sinfo`'s lines: of the partition that was named, or else of
/// the default one, which has a star. `sbatch --test-only` says of a node out of service what it says of one that does not fit.
pub fn nodes(said: &str, is_named: bool) -> (Vec<String>, Vec<(String, String)>) {
    let mut in_service = Vec::new();
    let mut out_of_service = Vec::new();
    // A node of several partitions that were named has a line for each.
    let mut seen = BTreeSet::new();
    for line in said.lines() {
        let [node, partition, state] = line.splitn(3, '|').collect::<Vec<_>>()[..] else {
            continue;
        };
        if (!is_named && !partition.trim().ends_with('*')) || !seen.insert(node) {
            continue;
        }
        // A star or another sign behind it says that the node does not answer, sleeps or is to be started anew.
        let state = state.trim().trim_end_matches(|c: char| !c.is_ascii_alphabetic());
        match OUT_OF_SERVICE.contains(&state) {
            true => out_of_service.push((first_words(node), state.to_owned())),
            false => in_service.push(first_words(node)),
        }
    }
    (in_service, out_of_service)
}

/// The states of nodes that get no job before somebody has seen to them (sinfo(1), NODE STATE CODES).
const OUT_OF_SERVICE: [&str; 7] = [
    "down", "drained", "draining", "fail", "failing", "error", "unknown",
];

/// Whether a tool says that a job asks for something else than the node that it names.
pub fn does_not_fit(words: &str) -> bool {
    [
        "Requested node configuration is not available",
        // It is excluded.
        "Invalid node name specified",
    ]
    .iter()
    .any(|other| words.contains(other))
}

/// The longest time that a job may ask for in minutes, out of `sinfo`'s partitions: in the one that was named, or else in the default
/// one, which has a star.
pub fn longest_minutes(said: &str, is_named: bool) -> Option<u32> {
    let lines = said.lines().filter_map(|line| line.split_once('|'));
    let mut meant = lines.filter(|(partition, _)| is_named || partition.ends_with('*'));
    meant.find_map(|(_, limit)| minutes(limit.trim()))
}

/// `2-12:00:00`, `30:00`, `infinite`: whole minutes, of which a job gets no more.
fn minutes(limit: &str) -> Option<u32> {
    let (days, rest) = match limit.split_once('-') {
        Some((days, rest)) => (days.parse::<u32>().ok()?, rest),
        None => (0, limit),
    };
    let parts: Vec<u32> = rest
        .split(':')
        .map(|part| part.parse().ok())
        .collect::<Option<_>>()?;
    let (hours, minutes) = match parts.as_slice() {
        [hours, minutes, _] => (*hours, *minutes),
        [minutes, _] => (0, *minutes),
        _ => return None,
    };
    days.checked_mul(24)?
        .checked_add(hours)?
        .checked_mul(60)?
        .checked_add(minutes)
}

/// The number of a job, out of `sbatch --parsable`: `17`, or `17;cluster`.
pub fn job_number(said: &str) -> Option<String> {
    let number = said.trim().split(';').next()?;
    let is_number = !number.is_empty() && number.chars().all(|c| c.is_ascii_digit());
    is_number.then(|| number.to_owned())
}

/// Whether a tool says that the controller could not be asked now: it is busy, being restarted, or out of reach.
pub fn is_passing(words: &str) -> bool {
    [
        "Socket timed out",
        "Unable to contact slurm controller",
        "Connection refused",
        "Transport endpoint",
        "Zero Bytes were transmitted",
        "Slurm backup controller in standby mode",
        "Job/step already completing",
        "Slurm temporarily unable to accept job",
        "Resource temporarily unavailable",
    ]
    .iter()
    .any(|passing| words.contains(passing))
}

/// Whether a tool says that there is no such job any more.
pub fn is_gone(words: &str) -> bool {
    ["Invalid job id", "already completing or completed"]
        .iter()
        .any(|gone| words.contains(gone))
}

/// What a refusal means to whoever wrote the matrix file.
pub fn hint(words: &str) -> Option<&'static str> {
    [
        (
            "Invalid feature specification",
            "no node has the features of `constraint`: `sinfo -o '%N %f'` prints which there are",
        ),
        (
            "nvalid partition",
            "there is no such `partition`: `sinfo -s` prints which there are",
        ),
        (
            "Requested node configuration is not available",
            "no node is all that is asked for: compare `constraint`, `partition`, `nodelist` and `exclude` with `sinfo -N -o '%N %P %f'`",
        ),
        (
            "Invalid account",
            "write an `account` that may use this partition: `sacctmgr show associations user=$USER` prints yours",
        ),
        ("Invalid qos", "write a `qos` that you may use, or leave it out"),
        (
            "eservation is invalid",
            "there is no such `reservation`, or it is not yours: `scontrol show reservation` prints which there are",
        ),
        (
            "time limit",
            "write shorter or fewer windows, or a `partition` that allows more time: `sinfo -o '%P %l'`",
        ),
        ("nvalid node name", "write nodes that `sinfo -N` prints"),
        (
            "unrecognized option",
            "leave out of `options` what this version of Slurm does not know",
        ),
        (
            "no default partition",
            "write a `partition`: this cluster has no default",
        ),
        (
            "Unable to open file",
            "write a `root` that the submit host's user can write to",
        ),
    ]
    .into_iter()
    .find_map(|(said, hint)| words.contains(said).then_some(hint))
}

/// The beginning of what somebody said, in one line.
pub fn first_words(text: &str) -> String {
    let line = text.trim().chars().map(|c| if c.is_control() { ' ' } else { c });
    line.take(MOST_QUOTED).collect()
}

/// A path as `--output` takes it: a per cent sign begins a replacement there, a backslash switches them all off.
pub fn file_name_pattern(path: &str) -> String {
    path.replace('%', "%%")
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rstest::rstest;

    use super::*;

    fn line(state: &str, reason: &str) -> String {
        format!(
            "17|{state}|{reason}|n1|n1|2026-11-27T14:00:00|matrix-r-native-1|matrix run=r host=h scenario=native"
        )
    }

    #[test]
    fn a_job_of_ours_is_read_with_its_owner() {
        let job = job(&line("RUNNING", "None")).unwrap();
        let owner = job.owner.unwrap();
        assert_eq!(
            (owner.run.as_str(), owner.host.as_str(), owner.scenario.as_str()),
            ("r", "h", "native")
        );
        assert_eq!(owner.comment(), "matrix run=r host=h scenario=native");
        assert_eq!(
            (job.id.as_str(), job.standing, job.reason, job.node.as_deref()),
            ("17", Standing::Runs, None, Some("n1"))
        );
    }

    #[test]
    fn nodes_are_those_of_the_partition_and_the_ones_out_of_service_are_told_apart() {
        let said = "n1|lab*|idle\nn1|brief|idle\nn2|lab*|down*\nn3|brief|idle\nn4|lab*|allocated$\nn5|lab*|drained\n\nodd";
        let (in_service, out) = nodes(said, false);
        assert_eq!(in_service, ["n1", "n4"]);
        let out: Vec<_> = out.iter().map(|(node, state)| (&node[..], &state[..])).collect();
        assert_eq!(out, [("n2", "down"), ("n5", "drained")]);
        assert_eq!(nodes("n3|brief|idle~", true).0, ["n3"]);
        assert_eq!(nodes("n3|brief|idle\nn3|lab|idle", true).0, ["n3"]);
    }

    /// The table of docs/clusters.md.
    #[rstest]
    #[case("PENDING", "Priority", Standing::Waits)]
    #[case("PENDING", "Dependency", Standing::Waits)]
    #[case("PENDING", "ReqNodeNotAvail, UnavailableNodes:n1", Standing::Waits)]
    #[case("PENDING", "BadConstraints", Standing::WaitsForEver)]
    #[case("PENDING", "PartitionTimeLimit", Standing::WaitsForEver)]
    #[case("CONFIGURING", "None", Standing::Runs)]
    #[case("RUNNING", "None", Standing::Runs)]
    #[case("COMPLETING", "None", Standing::Runs)]
    #[case("SUSPENDED", "None", Standing::Runs)]
    #[case("A_STATE_OF_A_LATER_VERSION", "None", Standing::Runs)]
    #[case("COMPLETED", "None", Standing::Ended)]
    #[case("FAILED", "NonZeroExitCode", Standing::Ended)]
    #[case("FAILED", "BadConstraints", Standing::Ended)]
    #[case("TIMEOUT", "TimeLimit", Standing::Ended)]
    #[case("CANCELLED", "None", Standing::Ended)]
    #[case("NODE_FAIL", "NodeDown", Standing::LostItsNode)]
    #[case("PREEMPTED", "None", Standing::LostItsNode)]
    fn a_state_has_its_meaning(#[case] state: &str, #[case] reason: &str, #[case] means: Standing) {
        assert_eq!(job(&line(state, reason)).unwrap().standing, means);
    }

    #[rstest]
    #[case::anothers("8|PENDING|None|||N/A|wrap|(null)")]
    #[case::of_an_array("8_[1-3]|PENDING|None|||N/A|matrix-r-a-1|matrix run=r host=h scenario=a")]
    #[case::cut("8|PENDING|None")]
    #[case::empty("")]
    fn what_is_no_job_of_ours_is_left_out(#[case] line: &str) {
        assert_eq!(job(line), None);
    }

    #[test]
    fn the_forecast_is_read_and_one_without_a_node_is_none() {
        let said =
            "sbatch: Job 5 to start at 2026-11-27T14:55:40 using 2 processors on nodes n3 in partition lab";
        assert_eq!(
            forecast(said),
            Forecast {
                start: Some("2026-11-27T14:55:40".to_owned()),
                node: Some("n3".to_owned()),
            }
        );
        assert_eq!(forecast(&said.replace("n3", "n[1-2]")).node, None);
        assert_eq!(forecast("sbatch: something else"), Forecast::default());
    }

    #[rstest]
    #[case("lab*|infinite\nshort|1:00\n", false, None)]
    #[case("lab|infinite\nshort*|1:00\n", false, Some(1))]
    #[case("short|30:00\n", true, Some(30))]
    #[case("long|2-12:00:00\n", true, Some(3600))]
    #[case("odd|n/a\n", true, None)]
    fn the_limit_is_that_of_the_partition_that_is_meant(
        #[case] said: &str,
        #[case] is_named: bool,
        #[case] limit: Option<u32>,
    ) {
        assert_eq!(longest_minutes(said, is_named), limit);
    }

    #[rstest]
    #[case("17\n", Some("17"))]
    #[case("17;here\n", Some("17"))]
    #[case("Submitted batch job 17\n", None)]
    #[case("", None)]
    fn the_number_of_a_submitted_job_is_read(#[case] said: &str, #[case] number: Option<&str>) {
        assert_eq!(job_number(said).as_deref(), number);
    }

    proptest! {
        #[test]
        fn no_answer_ends_the_program(said in ".{0,200}") {
            let _ = (job(&said), forecast(&said), longest_minutes(&said, true), job_number(&said));
        }
    }
}
