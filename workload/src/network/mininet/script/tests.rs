use std::time::Instant;

use record::settings::NetworkSettings;

use super::*;

const SHORT: Duration = Duration::from_millis(200);
const LONG: Duration = Duration::from_secs(60);

/// A shell that reads a request before each answer.
fn answering(script: &str) -> Script {
    Script::of(Command::new("sh").args(["-c", script])).unwrap()
}

fn error(outcome: Result<Done, NetworkError>) -> MininetError {
    match outcome.unwrap_err() {
        NetworkError::Mininet(error) => error,
        other => panic!("{other:?}"),
    }
}

#[test]
fn requests_are_lines_of_json_with_what_mininet_is_told() {
    let settings = NetworkSettings::default();
    let line = serde_json::to_string(&Request::up(
        "mx00002a",
        Datapath::Kernel,
        &settings.topology(),
        settings.offloads,
    ))
    .unwrap();
    assert_eq!(
        line,
        r#"{"do":"up","name":"mx00002a","hosts":["#.to_owned()
            + r#"{"name":"h1","ip":"10.0.0.1/8","mac":"00:00:00:00:00:01","switch":0},"#
            + r#"{"name":"sta1","ip":"10.0.0.2/8","mac":"00:00:00:00:00:02","switch":0},"#
            + r#"{"name":"sta2","ip":"10.0.0.3/8","mac":"00:00:00:00:00:03","switch":0}],"#
            + r#""switches":[{"name":"mx00002a0","uplink":null}],"#
            + r#""datapath":"kernel","offloads":"mininet"}"#
    );
    let line = serde_json::to_string(&Request::impair(&settings.topology())).unwrap();
    let link =
        r#"{"bandwidth_mbit":10.0,"delay":"10ms","jitter":"1ms","loss_percent":1.0,"limit_packets":1000}"#;
    assert_eq!(
        line,
        format!(r#"{{"do":"impair","links":[{link},{link},{link}]}}"#)
    );
    assert_eq!(
        serde_json::to_string(&Request::Survey).unwrap(),
        r#"{"do":"survey"}"#
    );
    assert_eq!(
        serde_json::to_string(&Request::Inspect).unwrap(),
        r#"{"do":"inspect"}"#
    );
}

#[test]
fn the_answer_is_what_the_program_made() {
    let mut script = answering(
        r#"read request; echo '{"pids": [11, 12, 13], "links": [["h1-eth0", "mx-eth1"]]}'; read end"#,
    );
    let up: Up = script
        .ask(
            &Request::up(
                "mx",
                Datapath::User,
                &NetworkSettings::default().topology(),
                Offloads::None,
            ),
            LONG,
        )
        .unwrap();
    assert_eq!(up.pids, [11, 12, 13]);
    assert_eq!(up.links, [["h1-eth0", "mx-eth1"]]);
    assert!(!script.has_ended());
}

#[rstest::rstest]
#[case(r#"{"missing": "mnexec"}"#, MininetError::Missing { what: "mnexec".into() })]
#[case(r#"{"refused": "mount: Permission denied"}"#, MininetError::Refused { said: "mount: Permission denied".into() })]
#[case(r#"{"error": "no such bridge"}"#, MininetError::Failed { said: "no such bridge".into() })]
#[case("*** Creating network", MininetError::Puzzling { answer: "*** Creating network".into() })]
fn an_answer_that_is_not_the_wanted_one_is_an_error(#[case] answer: &str, #[case] expected: MininetError) {
    let mut script = answering(&format!("read request; echo '{answer}'; read end"));
    assert_eq!(error(script.ask(&Request::Survey, LONG)), expected);
}

#[test]
fn a_program_that_ends_is_not_waited_for() {
    let mut script = answering("read request");
    assert_eq!(error(script.ask(&Request::Survey, LONG)), MininetError::Ended);
    assert!(script.has_ended());
}

#[test]
fn a_program_that_says_nothing_is_given_up() {
    let mut script = answering("read request; read end");
    assert_eq!(
        error(script.ask(&Request::Survey, SHORT)),
        MininetError::Silent { after: SHORT }
    );
}

#[test]
fn the_end_of_its_input_is_the_end_of_the_program_and_is_waited_for() {
    let folder = tempfile::tempdir().unwrap();
    let trace = folder.path().join("down");
    let mut script = answering(&format!("read end; echo late; : > {}", trace.display()));
    let before = Instant::now();
    script.end();
    assert!(trace.exists(), "the program had not ended");
    assert!(before.elapsed() < END_TIMEOUT);
}

#[test]
fn a_program_that_is_not_installed_is_named() {
    let error = Script::of(&mut Command::new("no-such-python")).unwrap_err();
    let expected = MininetError::Missing {
        what: "no-such-python".into(),
    };
    assert_eq!(error, expected.into());
}
