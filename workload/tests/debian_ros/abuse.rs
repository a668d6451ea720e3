//! What strangers do to the master and the nodes, and that the loops do not feel it.

use std::fs;

use rstest::rstest;
use tempfile::TempDir;
use workload::record::{progress::Progress, window::WindowRecord};

use crate::{
    settings,
    stage::{PYTHON, SHORT_LINKS, Stage, machine, script},
};

fn abuse(stage: &Stage) -> crate::stage::Tool {
    stage.tool("h1", PYTHON, &[script("abuse.py")])
}

#[test]
fn the_loops_hold_their_schedule_and_their_connections_while_strangers_do_their_worst() {
    let _machine = machine();
    let data = TempDir::new().unwrap();
    let settings = format!(r#"{{"windows":4,"window":"3s","period":"1s",{SHORT_LINKS}}}"#);
    let mut stage = Stage::run(&settings, "1,2,3,4", data.path());
    let stranger = abuse(&stage);
    stage.wait_for(|progress| matches!(progress, Progress::Finished));
    let rounds = stranger.said();
    assert!(rounds.len() >= 3, "{rounds:?}");

    let mut texts = Vec::new();
    let mut p99_ns = Vec::new();
    for window in 1..=4 {
        let path = data.path().join(format!("window-{window}/window.json"));
        let record: WindowRecord = serde_json::from_slice(&fs::read(path).unwrap()).unwrap();
        assert_eq!(record.steps_done, record.steps_expected);
        assert_eq!(record.log_dropped, 0);
        for held in [record.controller, record.plant] {
            assert_eq!(held.missed_deadlines, 0, "{held:?}");
            if window > 1 {
                p99_ns.push(held.lateness_p99_ns);
            }
        }
        assert!(record.notices.first.len() <= 20);
        assert!(record.notices.count >= record.notices.first.len() as u64);
        if window > 1 {
            assert!(record.notices.count > 20, "{:?}", record.notices);
        }
        texts.extend(record.notices.first);
    }
    // A hiccup of the machine is in one window; the strangers are in all of these. A twentieth of a step.
    p99_ns.sort_unstable();
    assert!(p99_ns[p99_ns.len() / 2] < 1_000_000, "{p99_ns:?}");
    let said = stage.said.iter().filter_map(|progress| match progress {
        Progress::Notice { text, .. } => Some(text.clone()),
        _ => None,
    });
    texts.extend(said);
    for reason in [
        "is above the limit of 65536",
        "its header ends within a field",
        "with sum 00000000000000000000000000000000",
        "[/nothing] is not published here",
        "has no `topic`",
        "it is not HTTP",
        "only POST is served",
        "was asked to shut down: so there",
    ] {
        assert!(
            texts.iter().any(|text| text.contains(reason)),
            "no {reason:?} in {texts:#?}"
        );
    }
    for ours in ["/controller at 10.0.0.2", "/plant at 10.0.0.3"] {
        assert!(
            !texts
                .iter()
                .any(|text| text.contains(ours) && text.contains(" left ")),
            "{texts:#?}"
        );
    }
}

#[rstest]
fn who_comes_after_strangers_is_served(#[values("embedded", "rosmaster")] master: &str) {
    let _machine = machine();
    let stage = Stage::rehearse(&settings(master), &[]);
    let stranger = abuse(&stage);
    stranger.wait_for("round 3");
    let listener = stage.node("sta1", "listener.py", &["listener"]);
    listener.wait_for("received 50");
    drop(stranger);
    assert_eq!(
        stage.output("h1", "/usr/bin/rostopic", &["list"]),
        "/command\n/state\n"
    );
    listener.wait_for("received 100");
    stage.end();
}
