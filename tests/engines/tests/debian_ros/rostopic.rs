//! What `rostopic` shows of our topics.

use rstest::rstest;

use crate::{
    authors, settings,
    stage::{Stage, machine},
};

const ROSTOPIC: &str = "/usr/bin/rostopic";

#[rstest]
fn rostopic_lists_describes_prints_and_times_our_topics(#[values("embedded", "rosmaster")] master: &str) {
    let _machine = machine();
    let stage = Stage::rehearse(&settings(master), &[]);

    let list = stage.output("h1", ROSTOPIC, &["list"]);
    assert_eq!(list, "/command\n/state\n");

    let info = stage.output("sta1", ROSTOPIC, &["info", "/state"]);
    assert!(info.contains("Type: std_msgs/Float64MultiArray"), "{info}");
    assert!(
        info.contains("Publishers: \n * /plant (http://10.0.0.3:"),
        "{info}"
    );
    assert!(
        info.contains("Subscribers: \n * /controller (http://10.0.0.2:"),
        "{info}"
    );

    let echo = stage.output("sta2", ROSTOPIC, &["echo", "-n", "3", "/command"]);
    assert_eq!(
        echo.matches("label: \"seq stamp_s x_v y_v\"").count(),
        3,
        "{echo}"
    );
    assert_eq!(echo.matches("data: [").count(), 3, "{echo}");

    // Its window goes from its first message on; what came before it was ready arrives at once.
    let hz = stage.tool("h1", ROSTOPIC, &["hz", "--window", "100", "/state"]);
    let is_ours = |line: &String| {
        let rate: f64 = line.trim_start_matches("average rate: ").parse().unwrap();
        (49.0..51.0).contains(&rate)
    };
    let mut rates = std::iter::repeat_with(|| hz.wait_for("average rate: ")).take(20);
    assert!(rates.any(|line| is_ours(&line)));
    drop(hz);
    stage.end();
}

#[rstest]
fn rostopic_prints_the_authors_texts(#[values("embedded", "rosmaster")] master: &str) {
    let _machine = machine();
    let stage = Stage::rehearse(&authors(master), &[]);
    let list = stage.output("h1", ROSTOPIC, &["list"]);
    assert_eq!(list, "/control_action\n/plant_state\n");
    let info = stage.output("sta1", ROSTOPIC, &["info", "/plant_state"]);
    assert!(info.contains("Type: std_msgs/String"), "{info}");
    let states = stage.output("h1", ROSTOPIC, &["echo", "-n", "3", "/plant_state"]);
    let is_state = |line: &&str| {
        let fields = line
            .strip_prefix("data: \"[")
            .and_then(|line| line.strip_suffix("]\""));
        fields.is_some_and(|fields| {
            fields
                .split(' ')
                .filter(|field| field.parse::<f64>().is_ok())
                .count()
                == 5
        })
    };
    assert_eq!(states.lines().filter(is_state).count(), 3, "{states}");
    let commands = stage.output("h1", ROSTOPIC, &["echo", "-n", "3", "/control_action"]);
    assert_eq!(commands.matches("&value0=").count(), 3, "{commands}");
    stage.end();
}
