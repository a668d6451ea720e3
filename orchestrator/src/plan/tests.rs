//! The plan as a whole: the examples, GitHub's own examples, and what no input may do.

use std::collections::{BTreeMap, BTreeSet};

use proptest::prelude::*;
use rstest::rstest;

use super::*;
use crate::provider::{Availability, Catalogue};

/// A machine on which everything works.
fn willing(hardware: &str, os: &str) -> HostFacts {
    let available = || ProviderFacts {
        availability: Availability::Available {
            detail: "works".to_owned(),
        },
        needs: BTreeMap::new(),
        time_limit: None,
    };
    HostFacts {
        hardware: hardware.to_owned(),
        os: os.to_owned(),
        providers: Catalogue::default()
            .names()
            .map(|name| (name.to_owned(), available()))
            .collect(),
        ..HostFacts::default()
    }
}

fn this_machine() -> BTreeMap<String, HostFacts> {
    BTreeMap::from([("local".to_owned(), willing("x86_64", "debian-12"))])
}

fn planned(text: &str) -> Result<Plan, Diagnostics> {
    let file = MatrixFile::parse("matrix.yaml", text.as_bytes(), None)?;
    plan(
        &file,
        &this_machine(),
        &Selection::default(),
        Order::Randomised,
        1,
    )
}

/// Letter and slug of each scenario, excluded ones in parentheses.
fn table(plan: &Plan) -> String {
    let line = |scenario: &PlannedScenario| {
        let name = format!("{} {}", scenario.id, scenario.slug);
        if scenario.feasible {
            name
        } else {
            format!("({name}) {}", scenario.reason.clone().unwrap_or_default())
        }
    };
    plan.record
        .scenarios
        .iter()
        .map(line)
        .collect::<Vec<_>>()
        .join("\n")
}

fn example(name: &str) -> String {
    std::fs::read_to_string(format!("{}/../{name}", env!("CARGO_MANIFEST_DIR"))).unwrap()
}

#[test]
fn the_papers_nine_scenarios_are_a_to_i_and_a_and_e_are_excluded_for_its_reasons() {
    let plan = planned(&example("examples/paper.yaml")).unwrap();
    insta::assert_snapshot!(table(&plan));
    let excluded = plan
        .record
        .scenarios
        .iter()
        .filter(|s| s.reason.as_deref().is_some_and(|r| !r.contains("was not asked")));
    assert_eq!(excluded.map(|s| s.id.as_str()).collect::<Vec<_>>(), ["a", "e"]);
    assert_eq!(plan.record.order, Vec::<String>::new());
    assert!(plan.warnings.is_empty(), "{}", plan.warnings);
}

#[test]
fn the_matrix_for_newcomers_runs_on_this_machine() {
    let plan = planned(&example("matrix.yaml")).unwrap();
    insta::assert_snapshot!(table(&plan));
    assert!(plan.warnings.is_empty(), "{}", plan.warnings);
    assert_eq!(plan.record.measuring_s, 3.0 * 24_000.0);
    assert_eq!(plan.record.scenarios[0].settings, Settings::default());
}

#[test]
fn the_quick_profile_takes_at_most_five_minutes_for_two_scenarios_and_can_still_reject() {
    let file = MatrixFile::parse("matrix.yaml", example("matrix.yaml").as_bytes(), Some("quick")).unwrap();
    let selection = Selection {
        skip: vec!["virtualization=virtualbox".to_owned()],
        ..Selection::default()
    };
    let plan = plan(&file, &this_machine(), &selection, Order::Randomised, 1).unwrap();
    assert!(plan.record.measuring_s <= 300.0, "{}", plan.record.measuring_s);
    let attainable = plan.attainable.unwrap();
    assert!(attainable.worst.p < attainable.alpha, "{attainable:?}");
    let windows = plan.windows.unwrap();
    assert!(windows.can_reject(), "{windows:?}");
    assert!(plan.warnings.is_empty(), "{}", plan.warnings);
    assert_eq!(
        plan.record.scenarios[2].not_selected.as_deref(),
        Some("left out by `--skip virtualization=virtualbox`")
    );
}

#[test]
fn the_sweep_example_sweeps() {
    let plan = planned(&example("examples/sweep.yaml")).unwrap();
    insta::assert_snapshot!(table(&plan));
    let network = |index: usize| &plan.record.scenarios[index].settings.network;
    assert_eq!(network(0).loss.to_string(), "0%");
    assert_eq!(network(0).jitter.to_string(), "5ms");
    assert_eq!(network(5).loss.to_string(), "5%");
    assert_eq!(network(5).jitter.to_string(), "1ms");
    assert!(plan.warnings.is_empty(), "{}", plan.warnings);
}

/// What GitHub's documentation says its own examples expand to, `key: value` pairs sorted, without what every scenario of
/// ours has besides.
fn as_github_lists(text: &str) -> Vec<String> {
    let plan = planned(text).unwrap();
    let own =
        |axis: &str| matches!(axis, "hardware" | "virtualization") || (axis == "os" && !text.contains("os:"));
    let line = |scenario: &PlannedScenario| {
        let pairs = scenario.axes.iter().filter(|(axis, _)| !own(axis));
        let pairs: BTreeSet<_> = pairs
            .map(|(axis, value)| format!("{axis}:{}", value.as_str().unwrap()))
            .collect();
        let line = pairs.into_iter().collect::<Vec<_>>().join(" ");
        if scenario
            .reason
            .as_deref()
            .is_some_and(|reason| reason.contains("exclude"))
        {
            format!("-{line}")
        } else {
            line
        }
    };
    plan.record.scenarios.iter().map(line).collect()
}

#[rstest]
#[case::include_expands_and_adds(
    "matrix:\n  labels:\n    fruit: [apple, pear]\n    animal: [cat, dog]\n  include:\n    - labels: {color: green}\n    - labels: \
     {color: pink}\n      animal: cat\n    - fruit: apple\n      labels: {shape: circle}\n    - fruit: banana\n    - fruit: \
     banana\n      animal: cat\n",
    &[
        "animal:cat color:pink fruit:apple shape:circle",
        "animal:dog color:green fruit:apple shape:circle",
        "animal:cat color:pink fruit:pear",
        "animal:dog color:green fruit:pear",
        "fruit:banana",
        "animal:cat fruit:banana",
    ]
)]
#[case::expanding_configurations(
    "matrix:\n  os: [windows-latest, ubuntu-latest]\n  labels: {node: [14, 16]}\n  include:\n    - os: windows-latest\n      \
     node: 16\n      labels: {npm: 6}\n",
    &[
        "node:14 os:windows-latest",
        "node:16 npm:6 os:windows-latest",
        "node:14 os:ubuntu-latest",
        "node:16 os:ubuntu-latest",
    ]
)]
#[case::adding_configurations(
    "matrix:\n  os: [macos-latest, windows-latest, ubuntu-latest]\n  labels: {version: [12, 14, 16]}\n  include:\n    - os: \
     windows-latest\n      version: 17\n",
    &[
        "os:macos-latest version:12", "os:macos-latest version:14", "os:macos-latest version:16",
        "os:windows-latest version:12", "os:windows-latest version:14", "os:windows-latest version:16",
        "os:ubuntu-latest version:12", "os:ubuntu-latest version:14", "os:ubuntu-latest version:16",
        "os:windows-latest version:17",
    ]
)]
#[case::includes_alone(
    "matrix:\n  include:\n    - labels: {site: production, datacenter: site-a}\n    - labels: {site: staging, datacenter: site-b}\n",
    &["datacenter:site-a site:production", "datacenter:site-b site:staging"]
)]
#[case::excluding(
    "matrix:\n  os: [macos-latest, windows-latest]\n  labels: {version: [12, 14, 16], environment: [staging, production]}\n  \
     exclude:\n    - os: macos-latest\n      version: 12\n      environment: production\n    - os: windows-latest\n      \
     version: 16\n",
    &[
        "environment:staging os:macos-latest version:12", "-environment:production os:macos-latest version:12",
        "environment:staging os:macos-latest version:14", "environment:production os:macos-latest version:14",
        "environment:staging os:macos-latest version:16", "environment:production os:macos-latest version:16",
        "environment:staging os:windows-latest version:12", "environment:production os:windows-latest version:12",
        "environment:staging os:windows-latest version:14", "environment:production os:windows-latest version:14",
        "-environment:staging os:windows-latest version:16", "-environment:production os:windows-latest version:16",
    ]
)]
#[case::an_include_brings_back_what_was_excluded(
    "matrix:\n  labels: {fruit: [apple, pear]}\n  virtualization: [native, docker]\n  exclude:\n    - fruit: apple\n  include:\n    \
     - fruit: apple\n      virtualization: docker\n      labels: {color: red}\n",
    &["-fruit:apple", "color:red fruit:apple", "fruit:pear", "fruit:pear"]
)]
fn expansion_is_githubs(#[case] text: &str, #[case] expected: &[&str]) {
    assert_eq!(as_github_lists(text), expected);
}

#[rstest]
#[case::a_list("{os: osx, version: [12, 16]}", &[true, false, true])]
#[case::any_characters("{os: osx, version: \"1*\"}", &[true, true, true])]
#[case::one_character("{os: \"?sx\", version: [\"?4\", 9]}", &[false, true, false])]
#[case::a_pattern_of_a_setting("{network.delay: \"*\", version: 12}", &[true, false, false])]
fn an_exclude_takes_lists_and_patterns(#[case] exclude: &str, #[case] excluded: &[bool]) {
    let plan = planned(&format!(
        "matrix:\n  os: [osx]\n  labels: {{version: [12, 14, 16]}}\n  network.delay: [10ms]\n  exclude:\n    - {exclude}\n"
    ))
    .unwrap();
    let is_excluded = |scenario: &PlannedScenario| {
        let reason = scenario.reason.as_deref().unwrap_or_default();
        reason.contains("exclude")
    };
    let found: Vec<_> = plan.record.scenarios.iter().map(is_excluded).collect();
    assert_eq!(found, excluded);
}

/// Excludes below the size limit that would take minutes, if each value were compared with each.
#[rstest]
#[case::patterns((0..40_000).map(|number| format!("w{number}*, ")).collect())]
#[case::patterns_that_go_back(format!("{}, ", "*a".repeat(490)).repeat(500))]
#[case::misspellings((0..40_000).map(|number| format!("w{number}, ")).collect())]
fn excludes_made_to_be_slow_are_an_error(#[case] values: String) {
    let labels: String = (0..1000)
        .map(|number| format!("{}{number}, ", "a".repeat(200)))
        .collect();
    let values = values.trim_end_matches(", ").replace(", ", "\", \"");
    let text = format!("matrix:\n  labels: {{x: [{labels}]}}\n  exclude:\n    - x: [\"{values}\"]\n");
    let started = std::time::Instant::now();
    let told = planned(&text).unwrap_err().to_string();
    assert!(
        told.contains("more values and patterns than can be compared"),
        "{told}"
    );
    // Generous, for a busy machine: what is wrong here takes minutes.
    let took = started.elapsed();
    assert!(took < std::time::Duration::from_secs(20), "{took:?}");
}

#[test]
fn a_thousand_scenarios_may_have_hundreds_of_patterns() {
    let labels: String = (0..1000).map(|number| format!("debian-12.{number}, ")).collect();
    let patterns: String = (0..500)
        .map(|number| format!("\"debian-*.{number}\", "))
        .collect();
    let text = format!(
        "matrix:\n  labels: {{release: [{labels}]}}\n  exclude:\n    - {{release: [{patterns}], reason: old}}\n"
    );
    let plan = planned(&text).unwrap();
    let excluded = plan.record.scenarios.iter().filter(|it| !it.feasible);
    assert_eq!(excluded.count(), 500);
}

#[test]
fn an_include_may_leave_to_the_hosts_what_it_brings_back() {
    let paper = example("examples/paper.yaml");
    let text = paper.replace(
        "workload:",
        "  include:\n    - {hardware: i686, virtualization: docker}\nworkload:",
    );
    let plan = planned(&text).unwrap();
    assert_eq!(plan.record.scenarios.len(), 9);
    assert!(
        plan.record.scenarios[0]
            .reason
            .as_deref()
            .unwrap()
            .contains("was not asked")
    );
}

const TWO_HOSTS: &str = "hosts:\n  one: {hardware: i686, os: ubuntu}\n  two: {hardware: arm64, os: osx}\n";

#[rstest]
#[case::neither_listed("matrix: {}", &["i686-ubuntu-native", "arm64-osx-native"])]
#[case::one_listed_gives_the_other("matrix: {os: [osx, ubuntu]}", &["arm64-osx-native", "i686-ubuntu-native"])]
#[case::both_listed_are_axes_like_any_other(
    "matrix: {hardware: [i686, arm64], os: [ubuntu, osx]}",
    &["i686-ubuntu-native", "(i686-osx-native)", "(arm64-ubuntu-native)", "arm64-osx-native"]
)]
#[case::one_that_nobody_offers("matrix: {os: [beos]}", &["(beos-native)"])]
fn hosts_give_what_no_axis_does(#[case] matrix: &str, #[case] expected: &[&str]) {
    let text = format!("{TWO_HOSTS}{matrix}\n");
    let file = MatrixFile::parse("matrix.yaml", text.as_bytes(), None).unwrap();
    let facts = BTreeMap::from([
        ("one".to_owned(), willing("i686", "ubuntu-24.04")),
        ("two".to_owned(), willing("aarch64", "osx")),
    ]);
    let plan = plan(&file, &facts, &Selection::default(), Order::Randomised, 1).unwrap();
    let line = |s: &PlannedScenario| {
        if s.feasible {
            s.slug.clone()
        } else {
            format!("({})", s.slug)
        }
    };
    assert_eq!(
        plan.record.scenarios.iter().map(line).collect::<Vec<_>>(),
        expected
    );
}

#[test]
fn a_combination_that_no_host_offers_says_so_and_what_was_meant() {
    let plan = planned("matrix: {hardware: [x86_46], os: [debian-12]}").unwrap();
    let scenario = &plan.record.scenarios[0];
    assert_eq!(
        scenario.reason.as_deref(),
        Some("no host offers hardware `x86_46` with os `debian-12`; did you mean `x86_64`?")
    );
    assert!(
        scenario
            .fix
            .as_deref()
            .unwrap()
            .contains("`x86_64 debian-12 (local)`"),
        "{:?}",
        scenario.fix
    );
}

#[test]
fn what_a_provider_lacks_is_the_reason_and_its_fix_the_fix() {
    let file = MatrixFile::parse("m", b"matrix: {virtualization: [native, docker]}", None).unwrap();
    let mut facts = this_machine();
    let here = facts.get_mut("local").unwrap();
    here.providers.get_mut("docker").unwrap().availability = Availability::Unavailable {
        reason: "no engine answers".to_owned(),
        fix: Some("apt-get install docker.io".to_owned()),
    };
    let plan = plan(&file, &facts, &Selection::default(), Order::Randomised, 1).unwrap();
    assert_eq!(
        plan.record.scenarios[1].reason.as_deref(),
        Some("no engine answers")
    );
    assert_eq!(
        plan.record.scenarios[1].fix.as_deref(),
        Some("apt-get install docker.io")
    );
    assert_eq!(plan.record.order, ["a"]);
}

#[test]
fn of_two_hosts_with_the_same_offer_the_one_that_can_is_taken() {
    let text = "hosts:\n  one: {hardware: x, os: y}\n  two: {hardware: x, os: y}\nmatrix: {}\n";
    let file = MatrixFile::parse("m", text.as_bytes(), None).unwrap();
    let plan = plan(
        &file,
        &BTreeMap::from([("two".to_owned(), willing("x", "y"))]),
        &Selection::default(),
        Order::Randomised,
        1,
    )
    .unwrap();
    assert_eq!(plan.record.scenarios.len(), 1);
    assert_eq!(plan.record.scenarios[0].host.as_deref(), Some("two"));
    assert!(plan.record.scenarios[0].feasible);
}

#[rstest]
#[case::hardware("hardware: i686, os: debian-12", "x86_64", "debian-12", Some("hardware"))]
#[case::another_name_of_it("hardware: amd64, os: debian-12", "x86_64", "debian-12", None)]
#[case::a_name_of_the_users("hardware: intel-i7, os: lab", "x86_64", "debian-12", None)]
#[case::system("hardware: x86_64, os: ubuntu-24.04", "x86_64", "debian-12", Some("os"))]
#[case::version("hardware: x86_64, os: debian-13", "x86_64", "debian-12", Some("os"))]
#[case::no_version("hardware: x86_64, os: debian", "x86_64", "debian-12", None)]
#[case::the_older_name_of_macos("hardware: aarch64, os: osx", "arm64", "macos-15.1", None)]
#[case::not_macos("hardware: aarch64, os: ubuntu", "arm64", "macos-15.1", Some("os"))]
fn what_a_host_certainly_is_not_is_an_error_at_its_place(
    #[case] said: &str,
    #[case] hardware: &str,
    #[case] os: &str,
    #[case] wrong: Option<&str>,
) {
    let text = format!("hosts:\n  lab: {{{said}}}\nmatrix: {{}}\n");
    let facts = BTreeMap::from([("lab".to_owned(), willing(hardware, os))]);
    let planned = |text: &str| {
        let file = MatrixFile::parse("m", text.as_bytes(), None).unwrap();
        plan(&file, &facts, &Selection::default(), Order::Randomised, 1)
    };
    match (planned(&text), wrong) {
        (Ok(plan), None) => assert_eq!(plan.record.order, ["a"]),
        (Err(found), Some(axis)) => {
            let found: Vec<_> = found.iter().collect();
            assert_eq!(found.len(), 1, "{found:?}");
            assert_eq!(found[0].code, Code::FalseClaim);
            assert!(
                found[0].message.contains(&format!("`{axis}: ")),
                "{}",
                found[0].message
            );
            // Its place is the value's.
            assert_eq!(found[0].to_json().line, 2);
        }
        (other, wrong) => panic!("{wrong:?}: {other:?}"),
    }
    // Numbers that are made up may be called as one likes.
    assert!(planned(&text.replace("matrix: {}", "matrix: {virtualization: [fake]}")).is_ok());
}

#[test]
fn a_host_that_is_out_of_reach_is_tried_when_its_turn_comes_and_after_those_that_answer() {
    let silent = HostFacts {
        obstacle: Some(Obstacle {
            reason: "connection refused".to_owned(),
            fix: Some("start it".to_owned()),
        }),
        ..HostFacts::default()
    };
    let planned = |text: &str| {
        let file = MatrixFile::parse("m", text.as_bytes(), None).unwrap();
        let facts = BTreeMap::from([
            ("one".to_owned(), silent.clone()),
            ("two".to_owned(), willing("x", "y")),
        ]);
        plan(&file, &facts, &Selection::default(), Order::Randomised, 1).unwrap()
    };
    let alone = planned("hosts:\n  one: {hardware: x, os: y}\n  two: {hardware: z, os: y}\nmatrix: {}\n");
    assert_eq!(alone.record.order.len(), 2);
    assert_eq!(alone.record.scenarios[0].host.as_deref(), Some("one"));
    assert!(alone.record.scenarios[0].feasible);
    let warning = alone.warnings.iter().next().unwrap();
    assert_eq!(warning.code, Code::SilentHost);
    assert_eq!(
        alone.silent,
        BTreeMap::from([("one".to_owned(), "connection refused".to_owned())])
    );
    assert!(
        warning.message.contains("connection refused"),
        "{}",
        warning.message
    );

    let with_another =
        planned("hosts:\n  one: {hardware: x, os: y}\n  two: {hardware: x, os: y}\nmatrix: {}\n");
    assert_eq!(with_another.record.order.len(), 1);
    assert_eq!(with_another.record.scenarios[0].host.as_deref(), Some("two"));
}

#[test]
fn in_blocks_the_scenarios_of_one_virtualization_run_next_to_each_other() {
    let text = "matrix: {virtualization: [native, docker], network.seed: [1, 2, 3, 4]}";
    let file = MatrixFile::parse("m", text.as_bytes(), None).unwrap();
    let blocks = |order, seed| {
        let plan = plan(&file, &this_machine(), &Selection::default(), order, seed).unwrap();
        let virtualization = |id: &String| {
            let mut scenarios = plan.record.scenarios.iter();
            scenarios
                .find(|it| it.id == *id)
                .and_then(|it| it.axis("virtualization"))
        };
        let mut ordered: Vec<_> = plan.record.order.iter().map(virtualization).collect();
        assert_eq!(ordered.len(), 8);
        ordered.dedup();
        ordered.len()
    };
    for seed in 0..20 {
        assert_eq!(blocks(Order::Blocked, seed), 2);
    }
    assert!((0..20).any(|seed| blocks(Order::Randomised, seed) > 2));
}

#[test]
fn hosts_that_are_at_work_side_by_side_take_as_long_as_the_slowest() {
    let text = format!(
        "{TWO_HOSTS}matrix: {{network.seed: [1, 2]}}\nworkload: {{windows: 1, window: 60s, period: 10s}}\n"
    );
    let file = MatrixFile::parse("m", text.as_bytes(), None).unwrap();
    let facts = BTreeMap::from([
        ("one".to_owned(), willing("i686", "ubuntu-24.04")),
        ("two".to_owned(), willing("aarch64", "osx")),
    ]);
    let plan = plan(&file, &facts, &Selection::default(), Order::Randomised, 1).unwrap();
    assert_eq!(plan.record.order.len(), 4);
    assert_eq!(plan.record.measuring_s, 2.0 * 60.0);
}

#[test]
fn the_same_seed_gives_the_same_plan_and_another_another_order() {
    let text = "matrix: {network.seed: [1, 2, 3, 4, 5, 6, 7, 8]}";
    let file = MatrixFile::parse("m", text.as_bytes(), None).unwrap();
    let with = |seed| {
        plan(
            &file,
            &this_machine(),
            &Selection::default(),
            Order::Randomised,
            seed,
        )
        .unwrap()
    };
    assert_eq!(with(7), with(7));
    assert_ne!(with(7).record.order, with(8).record.order);
    assert_eq!(with(7).record.scenarios, with(8).record.scenarios);
}

#[test]
fn values_keep_their_spelling() {
    let plan = planned("matrix: {labels: {release: [22.10, 1e3, true, 0x10, '01']}}").unwrap();
    let values: Vec<_> = plan
        .record
        .scenarios
        .iter()
        .map(|s| s.axis("release").unwrap())
        .collect();
    assert_eq!(values, ["22.10", "1e3", "true", "0x10", "01"]);
}

#[test]
fn a_design_that_cannot_reach_alpha_is_told_what_would() {
    let plan = planned("matrix: {}\nworkload: {window: 200s}\n").unwrap();
    let warning = plan.warnings.iter().next().unwrap();
    assert_eq!(warning.code, Code::NeverRejects);
    assert!(
        warning.help.as_deref().unwrap().contains("`window: 800s`"),
        "{:?}",
        warning.help
    );
    // What it proposes does.
    let plan = planned("matrix: {}\nworkload: {window: 800s}\n").unwrap();
    assert!(plan.warnings.is_empty(), "{}", plan.warnings);
}

#[test]
fn a_design_whose_windows_cannot_reach_alpha_is_told_how_many_would() {
    let warning = |text: &str| {
        let file = MatrixFile::parse("m", text.as_bytes(), None).unwrap();
        let plan = planned(text).unwrap();
        plan.windows.unwrap().warning(&file)
    };
    let matrix = "matrix: {virtualization: [native, docker]}";
    let told = warning(&format!("{matrix}\nworkload: {{windows: 4}}\n")).unwrap();
    assert_eq!(told.code, Code::NeverRejects);
    assert!(
        told.help.as_deref().unwrap().contains("`windows: 7`"),
        "{:?}",
        told.help
    );
    // What it proposes does.
    assert_eq!(warning(&format!("{matrix}\nworkload: {{windows: 7}}\n")), None);
}

proptest! {
    #[test]
    fn no_text_makes_it_panic(text in "(matrix|hosts|workload|report|profiles|[a-z.]{1,8}|[0-9]{1,3}(ms|%|Hz)?|\
        [-:,?&*!|>%@`#'\"{}\\[\\]\n\t ]|: |\n  |\n- |\\PC){0,80}") {
        if let Err(found) = planned(&text) {
            prop_assert!(!found.to_string().is_empty());
            prop_assert!(found.has_errors());
        }
    }

    #[test]
    fn no_mutilated_file_makes_it_panic(at in 0_usize..1800, length in 0_usize..40, with in "\\PC{0,6}|\n|\t|\\{|- ") {
        let text: Vec<char> = example("examples/paper.yaml").chars().collect();
        let (start, end) = (at.min(text.len()), (at + length).min(text.len()));
        let mutilated: String = text[..start].iter().copied().chain(with.chars()).chain(text[end..].iter().copied()).collect();
        if let Err(found) = planned(&mutilated) {
            prop_assert!(!found.to_string().is_empty());
        }
    }

    #[test]
    fn every_plan_has_unique_names_and_an_order_of_the_feasible(values in prop::collection::hash_set("[a-zA-Z0-9 ./-]{1,70}", 1..20), seed: u64) {
        let list: Vec<_> = values.iter().map(|value| format!("'{value}'")).collect();
        let text = format!("matrix: {{labels: {{label: [{}]}}, virtualization: [fake, native]}}", list.join(", "));
        let file = MatrixFile::parse("m", text.as_bytes(), None);
        prop_assume!(file.is_ok());
        let plan = plan(&file.unwrap(), &this_machine(), &Selection::default(), Order::Randomised, seed).unwrap();
        let slugs: BTreeSet<_> = plan.record.scenarios.iter().map(|s| &s.slug).collect();
        prop_assert_eq!(slugs.len(), values.len() * 2);
        let order: BTreeSet<_> = plan.record.order.iter().collect();
        prop_assert_eq!(order.len(), values.len() * 2);
        prop_assert_eq!(plan.record.order.len(), values.len() * 2);
    }
}

/// What is asked of this machine, a line for each provider and need; and nothing is of another.
fn asked(text: &str) -> Vec<String> {
    let file = MatrixFile::parse("matrix.yaml", text.as_bytes(), None).unwrap();
    let mut facts = this_machine();
    facts.values_mut().for_each(|host| host.providers.clear());
    let mut questions = ExpandedMatrix::of(&file, &facts).unwrap().questions();
    let here = questions.remove("local").unwrap_or_default();
    assert!(questions.is_empty(), "{questions:?}");
    let lines = |(name, needs): (String, BTreeSet<Need>)| {
        let line = |need| format!("{name}: {need}");
        needs.into_iter().map(line).collect::<Vec<_>>()
    };
    here.into_iter().flat_map(lines).collect()
}

#[rstest]
#[case::native_where_none_is_listed("matrix: {os: [debian-12]}\n", &["native: network.backend: userspace"])]
#[case::one_need_of_many_scenarios(
    "matrix:\n  virtualization: [docker]\n  network.loss: [0%, 1%, 5%]\n",
    &["docker: network.backend: userspace"]
)]
#[case::an_axis_of_needs_and_a_need_of_all(
    "matrix:\n  network.backend: [userspace, kernel]\nworkload: {ros: {master: rosmaster}}\n",
    &["native: ros.master: rosmaster", "native: network.backend: kernel, ros.master: rosmaster"]
)]
#[case::what_an_include_adds_is_asked_of_those_it_is_added_to(
    "matrix:\n  virtualization: [docker, native]\n  include:\n    - {virtualization: native, capture.tool: tcpdump}\n",
    &["docker: network.backend: userspace", "native: capture.tool: tcpdump"]
)]
#[case::an_include_of_its_own(
    "matrix:\n  virtualization: [docker]\n  include:\n    - {virtualization: fake, network.backend: mininet}\n",
    &["docker: network.backend: userspace", "fake: network.backend: mininet"]
)]
#[case::nothing_for_what_is_excluded(
    "matrix:\n  virtualization: [native, docker]\n  exclude:\n    - {virtualization: docker, reason: no}\n",
    &["native: network.backend: userspace"]
)]
#[case::nothing_for_a_machine_that_is_not_here("matrix: {hardware: [i686]}\n", &[])]
#[case::nothing_where_the_matrix_is_wrong("matrix: {network.backend: [kernel]}\nworkload: {window: 70s}\n", &[])]
fn each_need_is_asked_once_of_the_providers_that_are_to_meet_it(#[case] text: &str, #[case] wanted: &[&str]) {
    assert_eq!(asked(text), wanted);
}

#[test]
fn a_matrix_that_was_expanded_before_the_providers_were_asked_has_the_same_plan() {
    let text = "matrix: {virtualization: [native, docker], network.seed: [1, 2]}\nworkload: {window: 200s}\n";
    let file = MatrixFile::parse("matrix.yaml", text.as_bytes(), None).unwrap();
    let mut identities = this_machine();
    identities.values_mut().for_each(|host| host.providers.clear());
    let expanded = ExpandedMatrix::of(&file, &identities).unwrap();
    let placed = expanded.plan(&this_machine(), &Selection::default(), Order::Randomised, 1);
    assert_eq!(placed, planned(text));
}

#[rstest]
#[case::network("network.backend: [userspace, kernel]", serde_json::json!({"network": {"backend": "kernel"}}), "backend-kernel")]
#[case::master("ros.master: [embedded, rosmaster]", serde_json::json!({"ros": {"master": "rosmaster"}}), "master-rosmaster")]
#[case::capture("capture.tool: [builtin, tcpdump]", serde_json::json!({"capture": {"tool": "tcpdump"}}), "tool-tcpdump")]
fn a_need_that_a_provider_cannot_meet_makes_the_scenarios_with_it_infeasible(
    #[case] axis: &str,
    #[case] settings: Value,
    #[case] name: &str,
) {
    let text = format!("matrix:\n  virtualization: [native, docker]\n  {axis}\n");
    let file = MatrixFile::parse("matrix.yaml", text.as_bytes(), None).unwrap();
    let mut facts = this_machine();
    let lacks_it = Availability::Unavailable {
        reason: "it is not there".to_owned(),
        fix: Some("install it".to_owned()),
    };
    let need = Need::of_the_network(&serde_json::from_value(settings).unwrap());
    let here = facts.get_mut("local").unwrap();
    here.providers
        .get_mut("native")
        .unwrap()
        .needs
        .insert(need, lacks_it);
    let plan = plan(&file, &facts, &Selection::default(), Order::Randomised, 1).unwrap();
    let infeasible: Vec<_> = plan
        .record
        .scenarios
        .iter()
        .filter(|scenario| !scenario.feasible)
        .map(|scenario| {
            (
                scenario.slug.as_str(),
                scenario.reason.as_deref(),
                scenario.fix.as_deref(),
            )
        })
        .collect();
    let slug = format!("x86-64-debian-12-native-{name}");
    assert_eq!(
        infeasible,
        [(slug.as_str(), Some("it is not there"), Some("install it"))]
    );
}

/// Two hosts of the pool `lab`, both willing, and one that is in none.
const LAB: &str = "hosts:\n  one: {hardware: x86_64, os: debian-12, pool: lab}\n  two: {hardware: x86_64, os: debian-12, pool: lab}\n  \
                   three: {hardware: x86_64, os: debian-12}\nmatrix: {virtualization: [native, docker]}\n\
                   workload: {environments: 3, window: 200s}\n";

fn lab(change: impl FnOnce(&mut BTreeMap<String, HostFacts>)) -> PlanRecord {
    let file = MatrixFile::parse("matrix.yaml", LAB.as_bytes(), None).unwrap();
    let hosts = ["one", "two", "three"].map(|name| (name.to_owned(), willing("x86_64", "debian-12")));
    let mut facts = BTreeMap::from(hosts);
    change(&mut facts);
    plan(&file, &facts, &Selection::default(), Order::Randomised, 1)
        .unwrap()
        .record
}

fn hosts_of(record: &PlanRecord) -> Vec<Vec<&str>> {
    let of = |scenario| {
        (1..=3)
            .map(|round| PlannedScenario::host_in(scenario, round))
            .collect()
    };
    record.scenarios.iter().map(of).collect()
}

#[test]
fn hosts_of_one_pool_take_turns_with_the_rounds_and_measure_side_by_side() {
    let record = lab(|_| ());
    assert_eq!(hosts_of(&record), [["one", "two", "one"], ["one", "two", "one"]]);
    let in_an_environment = f64::from(record.scenarios[0].settings.windows) * 200.0;
    assert_eq!(
        record.measuring_s,
        2.0 * 2.0 * in_an_environment,
        "two rounds of two scenarios, of three"
    );
    let read: PlanRecord = serde_json::from_str(&serde_json::to_string(&record).unwrap()).unwrap();
    assert_eq!(hosts_of(&read), hosts_of(&record));
}

#[test]
fn a_host_of_a_pool_that_cannot_run_one_of_the_scenarios_has_no_round_of_the_others_either() {
    let record = lab(|facts| {
        let cannot = Availability::Unavailable {
            reason: "no engine".to_owned(),
            fix: None,
        };
        facts
            .get_mut("one")
            .unwrap()
            .providers
            .get_mut("docker")
            .unwrap()
            .availability = cannot;
    });
    assert_eq!(hosts_of(&record), [["two"; 3]; 2]);
    assert!(record.scenarios.iter().all(|scenario| scenario.feasible));
}

/// Two nodes of a cluster and this machine, with these lines below `matrix:`.
fn on_each_node(matrix: &str) -> Result<Plan, Diagnostics> {
    let text = format!(
        "hosts:\n  lab: {{hardware: i686, os: alpine, connect: {{slurm: {{nodes: each}}}}}}\n  here: {{hardware: x86_64, os: \
         debian-12, connect: local}}\nmatrix:\n{matrix}"
    );
    let mut file = MatrixFile::parse("matrix.yaml", text.as_bytes(), None)?;
    let nodes = ["n1", "n2"].map(str::to_owned).to_vec();
    file.split_hosts(&BTreeMap::from([("lab".to_owned(), nodes)]))?;
    let facts = BTreeMap::from([
        ("lab-n1".to_owned(), willing("i686", "alpine")),
        ("lab-n2".to_owned(), willing("i686", "alpine")),
        ("here".to_owned(), willing("x86_64", "debian-12")),
    ]);
    plan(&file, &facts, &Selection::default(), Order::default(), 1)
}

#[test]
fn each_node_of_a_cluster_measures_every_scenario_that_the_cluster_offers() {
    let plan = on_each_node("  virtualization: [native, simulated]\n  exclude: [{node: n2, virtualization: simulated, reason: one is enough}]\n")
        .unwrap();
    let placed: Vec<_> = plan
        .record
        .scenarios
        .iter()
        .map(|it| format!("{} {} {}", it.slug, it.host.as_deref().unwrap_or("-"), it.runs()))
        .collect();
    assert_eq!(
        placed,
        [
            "i686-alpine-native-node-n1 lab-n1 true",
            "i686-alpine-native-node-n2 lab-n2 true",
            "i686-alpine-simulated-node-n1 lab-n1 true",
            "i686-alpine-simulated-node-n2 lab-n2 false",
            "x86-64-debian-12-native here true",
            "x86-64-debian-12-simulated here true",
        ]
    );
    assert!(plan.warnings.is_empty(), "{}", plan.warnings);
}

#[test]
fn what_an_include_adds_on_a_cluster_is_measured_on_each_of_its_nodes() {
    let plan = on_each_node("  include: [{os: alpine}, {node: n2, os: alpine, virtualization: simulated}]\n")
        .unwrap();
    assert_eq!(
        table(&plan),
        "a i686-alpine-native-node-n1\nb i686-alpine-native-node-n2\nc i686-alpine-simulated-node-n2"
    );
}

#[test]
fn a_node_that_is_not_there_is_told_and_no_axis_or_label_takes_the_place_of_the_clusters_nodes() {
    let exclude = "  virtualization: [native]\n  exclude: [{node: n3, reason: broken}]\n";
    let told = on_each_node(exclude).unwrap().warnings.to_string();
    assert!(told.contains("no scenario has `node: n3`"), "{told}");
    let wrong = on_each_node("  node: [n1]\n").unwrap_err().to_string();
    assert!(wrong.contains("there is no setting `node`"), "{wrong}");
    let wrong = on_each_node("  labels: {node: [n1]}\n").unwrap_err().to_string();
    assert!(wrong.contains("give this label another name"), "{wrong}");
}

#[test]
fn without_asking_a_cluster_its_nodes_are_one_host_and_names_of_nodes_are_left_open() {
    let text = "hosts: {lab: {hardware: i686, os: alpine, connect: {slurm: {nodes: each}}}}\n\
                matrix: {virtualization: [native], exclude: [{node: n9, reason: broken}]}\n";
    let file = MatrixFile::parse("matrix.yaml", text.as_bytes(), None).unwrap();
    let facts = BTreeMap::from([("lab".to_owned(), willing("i686", "alpine"))]);
    let plan = plan(&file, &facts, &Selection::default(), Order::default(), 1).unwrap();
    assert_eq!(table(&plan), "a i686-alpine-native");
    let told = plan.warnings.to_string();
    assert!(
        told.contains("planned as one host") && !told.contains("n9"),
        "{told}"
    );
}

#[rstest]
#[case("latency: {value: 1, above: 5%}", "there is no metric `latency`", "`error`")]
#[case("error: {value: 120, above: 5%}", "`120` has no unit", "`120mm`")]
#[case("error: {value: 120mm, above: 3}", "`3` has no unit", "`3mm`")]
#[case("error: {value: 120mm}", "bounds nothing", "add `above: 5%`")]
#[case(
    "error: [{for: {os: debian}, value: 120mm, above: 5%}]",
    "no scenario has `os: debian`",
    "host"
)]
#[case(
    "error: [{for: {host: lab}, value: 120mm, above: 5%}]",
    "no scenario has `host: lab`",
    "host"
)]
fn what_cannot_be_expected_of_a_scenario_is_an_error_with_what_to_write(
    #[case] expected: &str,
    #[case] says: &str,
    #[case] help: &str,
) {
    let text = format!("matrix: {{virtualization: [native]}}\nreport:\n  expect:\n    {expected}\n");
    let told = planned(&text).unwrap_err().to_string();
    assert!(told.contains(says) && told.contains(help), "{told}");
    assert!(told.contains("matrix.yaml:4:"), "{told}");
}

#[test]
fn a_metric_of_a_command_is_expected_in_its_own_unit() {
    let with = |expected: &str| {
        planned(&format!(
            "matrix: {{virtualization: [native]}}\nexperiment:\n  name: reach\n  run: [\"true\"]\n  metrics:\n  - {{name: reach, unit: s, \
             from: reach.csv}}\n  - {{name: state, from: state.txt, compare: identical}}\nreport: {{expect: {{{expected}}}}}\n"
        ))
    };
    assert!(with("reach: {value: 3, below: 10%, above: 0.5}").is_ok());
    let told = with("reach: {value: 3mm, above: 5%}").unwrap_err().to_string();
    assert!(told.contains("a unit of its own"), "{told}");
    let told = with("state: {value: 3, above: 5%}").unwrap_err().to_string();
    assert!(told.contains("byte for byte"), "{told}");
    let told = with("error: {value: 3mm, above: 5%}").unwrap_err().to_string();
    assert!(told.contains("there is no metric `error`"), "{told}");
}
