//! What went through a netem queue, out of `tc -s -j qdisc show`. The main function is [`of_netem`].

use record::window::PassRecord;
use serde::Deserialize;

/// One queueing discipline as `tc` prints it (iproute2, `tc/tc_qdisc.c` and `lib/gnet_stats` in `tc/tc_util.c`).
#[derive(Debug, Deserialize)]
struct Qdisc {
    /// Packets that left.
    packets: u64,
    /// Packets that were lost on purpose or found the queue full; netem has one counter for both.
    drops: u64,
    /// Packets that wait.
    qlen: u64,
}

/// The counts of the interface's netem queue; a queue that is not there yet has let nothing through. None if it is not
/// what `tc` prints.
pub fn of_netem(json: &str) -> Option<PassRecord> {
    let qdiscs: Vec<serde_json::Value> = serde_json::from_str(json).ok()?;
    let netem = qdiscs.into_iter().find(|qdisc| qdisc["kind"] == "netem");
    let Some(netem) = netem else {
        return Some(PassRecord::default());
    };
    let Qdisc { packets, drops, qlen } = serde_json::from_value(netem).ok()?;
    Some(PassRecord {
        offered: packets + drops + qlen,
        lost: drops,
        overflowed: None,
        delivered: packets,
        lateness_mean_ns: None,
        lateness_max_of_run_ns: None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As iproute2 6.1 printed it.
    const PRINTED: &str = r#"[{"kind":"htb","handle":"5:","root":true,"refcnt":3,"options":{"r2q":10,"default":"0x1","direct_packets_stat":0,"direct_qlen":1000},"bytes":294,"packets":3,"drops":0,"overlimits":0,"requeues":0,"backlog":0,"qlen":0},{"kind":"netem","handle":"10:","parent":"5:1","options":{"limit":1000,"delay":{"delay":0.01,"jitter":0.001,"correlation":0},"loss-random":{"loss":0.01,"correlation":0},"ecn":false,"gap":0},"bytes":294,"packets":3,"drops":2,"overlimits":0,"requeues":0,"backlog":98,"qlen":1}]"#;

    #[test]
    fn the_counts_of_a_pass_are_netems() {
        let counts = of_netem(PRINTED).unwrap();
        assert_eq!(
            (counts.offered, counts.lost, counts.delivered),
            (6, 2, 3),
            "{counts:?}"
        );
        assert_eq!(counts.overflowed, None, "netem does not tell it from a loss");
        assert_eq!(counts.lateness_max_of_run_ns, None, "the kernel does not say");
    }

    #[test]
    fn before_the_links_are_impaired_nothing_is_counted() {
        let counts = of_netem(r#"[{"kind":"noqueue","handle":"0:","root":true,"options":{}}]"#).unwrap();
        assert_eq!(counts.offered, 0);
    }

    #[test]
    fn what_is_not_from_tc_gives_no_counts() {
        assert_eq!(of_netem("Error"), None);
        assert_eq!(of_netem(r#"[{"kind":"netem"}]"#), None);
    }
}
