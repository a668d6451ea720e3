//! What settings need is asked for before a run, and what a host has not got makes the scenarios infeasible, whichever
//! command asks.

use std::collections::BTreeSet;

use record::settings::Need;
use rstest::rstest;
use serde_json::Value;
use tests::Workplace;

fn infeasible(told: &Value) -> Vec<(Value, Value, Value)> {
    let scenarios = told["scenarios"].as_array().unwrap().iter();
    scenarios
        .filter(|scenario| scenario["feasible"] == false)
        .map(|scenario| {
            (
                scenario["slug"].clone(),
                scenario["reason"].clone(),
                scenario["fix"].clone(),
            )
        })
        .collect()
}

#[rstest]
#[case::a_filter_that_tcpdump_refuses(
    "{virtualization: [native], capture.filter: [udp, udp prt 1]}",
    "syntax error",
    "pcap-filter(7)"
)]
#[case::a_program_that_the_built_in_image_has_not_got(
    "{virtualization: [docker], ros.master: [embedded, rosmaster]}",
    "`ros.master: rosmaster` needs rosmaster, which the built-in image has not got",
    "name an image"
)]
fn a_scenario_whose_need_is_not_met_is_infeasible_with_the_reason_and_the_fix(
    #[case] axes: &str,
    #[case] reason: &str,
    #[case] fix: &str,
) {
    let workplace = Workplace::new();
    workplace.write("m.yaml", format!("matrix: {axes}\n"));
    let planned = infeasible(&workplace.json(&["plan", "m.yaml"]));
    let [(slug, why, how)] = planned.as_slice() else {
        panic!("one of the two is infeasible: {planned:?}");
    };
    assert!(why.as_str().unwrap().contains(reason), "{why}");
    assert!(how.as_str().unwrap().contains(fix), "{how}");

    assert_eq!(
        infeasible(&workplace.json(&["run", "m.yaml", "--dry-run"])),
        planned
    );
    let checked = workplace.json(&["check", "m.yaml", "--hosts"]);
    assert_eq!(checked["infeasible"].as_array().unwrap().len(), 1, "{checked:#}");
    assert_eq!(&checked["infeasible"][0]["slug"], slug);
    assert_eq!(&checked["infeasible"][0]["reason"], why);
    let text = workplace.run(&["check", "m.yaml", "--hosts"]).out;
    assert!(
        text.contains("right, 2 scenarios") && text.contains(reason),
        "{text}"
    );
}

#[test]
fn doctor_says_of_each_setting_that_needs_something_whether_it_can_be_had() {
    let told = Workplace::new().json(&["doctor"]);
    let providers = told["providers"].as_array().unwrap();
    let native = providers
        .iter()
        .find(|provider| provider["name"] == "native")
        .unwrap();
    let settings: Vec<_> = native["settings"].as_array().unwrap().iter().collect();
    let names: Vec<_> = settings.iter().map(|one| one["name"].as_str().unwrap()).collect();
    let asked: BTreeSet<_> = Need::each().into_iter().collect();
    assert_eq!(names, asked.iter().map(Need::to_string).collect::<Vec<_>>());
    for setting in settings {
        assert_eq!(
            setting["available"] == false,
            setting["reason"].is_string(),
            "{setting}"
        );
    }
}

#[test]
fn the_plan_of_the_papers_example_says_of_each_of_the_nine_what_is_missing() {
    let workplace = Workplace::new();
    let paper = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/paper.yaml");
    let ran = workplace.run(&["plan", paper.to_str().unwrap()]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let line = |id: &str| {
        let mut lines = ran.out.lines();
        lines
            .find(|line| line.trim_start().starts_with(&format!("{id}  ")))
            .unwrap()
    };
    assert!(
        line("a").ends_with("infeasible: Docker does not run on i686"),
        "{}",
        ran.out
    );
    assert!(
        line("e").ends_with("infeasible: mininet does not run on OSX"),
        "{}",
        ran.out
    );
    for (ids, host) in [("bc", "lab-i686"), ("df", "lab-mac"), ("ghi", "lab-arm")] {
        for id in ids.chars() {
            let missing = format!("on {host}, once it answers: cannot reach host `{host}`");
            assert!(line(&id.to_string()).contains(&missing), "{}", ran.out);
        }
    }
}
