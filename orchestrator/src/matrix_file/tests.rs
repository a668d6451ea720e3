//! Every mistake, as a person sees it. The pictures are in `snapshots/`: read them as a user would.

use std::collections::BTreeMap;

use record::family::Family;
use rstest::rstest;

use super::*;
use crate::{
    plan::{HostFacts, ProviderFacts, Selection, order::Order, plan},
    provider::{Availability, Making, Provider, ProviderError, ProviderKind},
    workload_binary::start,
};

/// A provider from outside this crate whose settings have an even number of keys.
static OUTSIDE: [ProviderKind; 1] = [ProviderKind {
    check: |options| match options.as_object().map_or(1, serde_json::Map::len) % 2 {
        0 => Ok(()),
        _ => Err("the number of keys is odd".to_owned()),
    },
    ..ProviderKind::new("elsewhere", nowhere)
}];

fn nowhere(making: &Making<'_>) -> Result<Box<dyn Provider>, ProviderError> {
    Err(ProviderError::UnknownHost {
        name: making.host.name().to_owned(),
    })
}

fn works() -> ProviderFacts {
    ProviderFacts {
        availability: Availability::Available {
            detail: "works".to_owned(),
        },
        needs: BTreeMap::new(),
        time_limit: None,
    }
}

/// What is said of a text, be it when it is read or when it is planned.
pub(super) fn told(bytes: &[u8], profile: Option<&str>) -> Diagnostics {
    let facts = BTreeMap::from([(
        THIS_MACHINE.to_owned(),
        HostFacts {
            hardware: "x86_64".to_owned(),
            os: "debian-12".to_owned(),
            providers: ["native", "docker"].map(|name| (name.to_owned(), works())).into(),
            ..HostFacts::default()
        },
    )]);
    let planned = MatrixFile::parse("matrix.yaml", bytes, profile)
        .and_then(|file| plan(&file, &facts, &Selection::default(), Order::default(), 1));
    match planned {
        Ok(plan) => plan.warnings,
        Err(found) => found,
    }
}

/// What the case of the running test is: rstest names a test `case_07_tabs`, and the picture is named after that.
pub(super) fn case_name() -> String {
    let thread = std::thread::current();
    let case = thread
        .name()
        .and_then(|name| name.rsplit("::").next())
        .unwrap_or_default();
    case.splitn(3, '_').nth(2).unwrap_or_default().to_owned()
}

#[rstest]
#[case::empty("")]
#[case::only_comments("# nothing\n")]
#[case::not_yaml("matrix: {os: [ubuntu\nhosts: x]]\n")]
#[case::tabs("matrix:\n\tos: [ubuntu]\n")]
#[case::a_list("- matrix\n- hosts\n")]
#[case::two_documents("matrix: {}\n---\nmatrix: {}\n")]
#[case::a_tag("matrix: !env {}\n")]
#[case::unknown_section("matirx:\n  os: [ubuntu]\n")]
#[case::no_matrix("workload: {}\n")]
#[case::unknown_setting("matrix: {}\nworkload:\n  network:\n    dealy: 10ms\n")]
#[case::duplicate_key("matrix: {}\nworkload:\n  rate: 50Hz\n  window: 6000s\n  rate: 60Hz\n")]
#[case::host_named_twice("hosts:\n  lab1: {connect: local}\n  lab1: {connect: local}\nmatrix: {}\n")]
#[case::wrong_unit("matrix: {}\nworkload:\n  network: {delay: 10Mbit}\n")]
#[case::missing_unit("matrix: {}\nworkload:\n  period: 100\n")]
#[case::missing_unit_in_a_sweep("matrix:\n  network.loss: [0%, 1]\n")]
#[case::unknown_setting_as_an_axis("matrix:\n  network.los: [0%, 1%]\n")]
#[case::a_section_as_an_axis("matrix:\n  network: [a, b]\n")]
#[case::an_axis_that_is_no_setting(
    "matrix:\n  virtualisation: [native, docker]\n  rack: [1, 2, 3, 4, 5, 6, 7, 8, 9]\n"
)]
#[case::a_rule_on_no_axis("matrix:\n  include:\n  - {virtualization: docker, image: slim}\n")]
#[case::labels_that_are_none(
    "matrix:\n  labels:\n    network.loss: [0%]\n    network.lost: [x]\n    reason: [a]\n  exclude:\n  - {labels: rack, reason: x}\n"
)]
#[case::labels_without_names("matrix:\n  labels: [rack]\n")]
#[case::an_exclude_of_nothing(
    "matrix:\n  virtualization: [native]\n  exclude:\n  - {virtualization: [], reason: x}\n"
)]
#[case::an_exclude_that_fits_nothing(
    "matrix:\n  os: [osx]\n  exclude:\n  - {os: [debian, \"ubuntu*\"], reason: x}\n  - {os: \"d*\", reason: x}\n"
)]
#[case::misspelt_virtualization("matrix:\n  virtualization: [native, dokcer]\n")]
#[case::empty_axis("matrix:\n  virtualization: []\n")]
#[case::axis_without_a_value("matrix:\n  virtualization:\n")]
#[case::axis_that_is_no_list("matrix:\n  virtualization: docker\n")]
#[case::value_twice("matrix:\n  virtualization: [native, docker, native]\n")]
#[case::value_that_is_no_word("matrix:\n  virtualization: [native, {docker: yes}]\n")]
#[case::exclude_that_matches_nothing(
    "matrix:\n  virtualization: [native]\n  exclude:\n    - {virtualization: docker, reason: no engine}\n"
)]
#[case::exclude_with_a_misspelt_value(
    "matrix:\n  hardware: [i686, arm64]\n  exclude:\n    - {hardware: amr64, reason: too old}\n"
)]
#[case::exclude_with_a_misspelt_axis(
    "matrix:\n  hardware: [i686]\n  exclude:\n    - {hardwear: i686, reason: too old}\n"
)]
#[case::exclude_without_a_reason(
    "matrix:\n  virtualization: [native, docker]\n  exclude:\n    - virtualization: docker\n"
)]
#[case::include_that_repeats(
    "matrix:\n  virtualization: [native, docker]\n  include:\n    - virtualization: docker\n"
)]
#[case::include_twice(
    "matrix:\n  virtualization: [native]\n  include:\n    - {virtualization: docker}\n    - {virtualization: docker}\n"
)]
#[case::include_that_changes_nothing(
    "matrix:\n  virtualization: [native, docker]\n  period: [100s, 50s]\n  include:\n    - virtualization: docker\n"
)]
#[case::too_many_scenarios(
    "matrix:\n  network.seed: &n [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11]\n  control.angle.kp: *n\n  control.angle.kd: *n\n"
)]
#[case::settings_that_do_not_fit("matrix: {}\nworkload:\n  window: 250s\n  period: 100s\n")]
#[case::settings_that_do_not_fit_in_a_sweep("matrix:\n  window: [6000s, 250s]\n")]
#[case::everything_discarded("matrix: {}\nworkload: {window: 200s}\nreport:\n  discard_periods: 2\n")]
#[case::alpha_out_of_range("matrix: {}\nreport: {alpha: 5}\n")]
#[case::figure_of_no_scenario("matrix: {}\nreport:\n  figures: [[a, b]]\n")]
#[case::family_of_no_scenario("matrix: {}\nreport:\n  family: [[a, b]]\n")]
#[case::family_misspelt("matrix: {}\nreport:\n  family: against-baselin\n")]
#[case::equivalence_margin_without_a_unit("matrix: {}\nreport: {equivalence_margin: 2}\n")]
#[case::baseline_on_no_axis("matrix: {}\nreport:\n  baseline: {virtualisation: native}\n")]
#[case::baseline_that_no_scenario_is(
    "matrix: {virtualization: [docker]}\nreport:\n  baseline: {virtualization: native}\n"
)]
#[case::mistakes_under_former_names("matrix: {}\nreport:\n  control: native\n  matters: 2\n")]
#[case::a_setting_under_both_its_names(
    "matrix: {}\nreport:\n  baseline: {}\n  control: {}\nprofiles:\n  quick:\n    report: {matters: 1mm, equivalence_margin: 2mm}\n"
)]
#[case::never_rejects("matrix: {}\nworkload:\n  window: 300s\n")]
#[case::sometimes_rejects("matrix: {}\nworkload:\n  window: 700s\nreport:\n  discard_periods: 3\n")]
#[case::address_without_ssh("hosts:\n  lab1: {hardware: i686, os: ubuntu, connect: me@lab1}\nmatrix: {}\n")]
#[case::bad_address(
    "hosts:\n  lab1: {hardware: i686, os: ubuntu, connect: {ssh: 'me@lab1:port'}}\nmatrix: {}\n"
)]
#[case::ssh_without_an_offer("hosts:\n  lab1: {connect: {ssh: me@lab1}}\nmatrix: {}\n")]
#[case::no_hosts("hosts: {}\nmatrix: {}\n")]
#[case::bad_host_name("hosts:\n  ../lab: {connect: local}\nmatrix: {}\n")]
#[case::unknown_provider_setting("matrix: {}\nproviders:\n  docker: {imgae: debian}\n")]
#[case::vagrant_options_that_reach_beyond_the_guest(
    "matrix: {}\nproviders:\n  libvirt:\n    options: {driver: qemu, uri: 'qemu+ext:///x?command=y', emulator_path: /tmp/x}\n  virtualbox: {options: {customize: [[sharedfolder, add, ':id', --hostpath, /]]}}\n"
)]
#[case::mistakes_everywhere(
    "matrix:\n  virtualization: [natvie]\nhosts:\n  lab1: {os: ubuntu, conect: local}\nworkload:\n  rate: 50\n  network: {loss: 1, jitter: soon}\nreport: {metrics: x}\n"
)]
#[case::mistake_in_a_profile(
    "matrix: {}\nworkload: {window: 6000s}\nprofiles:\n  quick:\n    workload: {window: 32}\n"
)]
#[case::unknown_section_in_a_profile("matrix: {}\nprofiles:\n  quick:\n    worklaod: {window: 32s}\n")]
#[case::merge_key("a: &a {b: 1}\nmatrix: {}\nworkload:\n  <<: *a\n")]
#[case::a_problem_with_a_setting_that_is_left_out("matrix: {}\nworkload:\n  period: 70s\n")]
#[case::axis_twice("matrix:\n  virtualization: [native]\n  virtualization: [docker]\n")]
#[case::control_characters("matrix:\n  \"\\e[31mred\": [1, 2]\n")]
#[case::letters_that_are_not_seen("matrix:\n  virtuali\u{200b}zation: [native]\n")]
fn every_mistake_is_shown_at_its_place(#[case] text: &str) {
    let told = told(text.as_bytes(), None);
    assert!(!told.is_empty());
    insta::with_settings!({ description => text, omit_expression => true }, {
        insta::assert_snapshot!(case_name(), told);
    });
}

#[rstest]
#[case::value("matrix: {virtualization: [\"\\n::error file=x::evil\"]}\n")]
#[case::key("matrix: {}\n\"\\n::stop-commands::x\": 1\n")]
#[case::host("matrix: {}\nhosts: {\"\\n::add-path::/x\": {connect: local}}\n")]
fn no_line_of_a_message_is_a_command_for_a_ci_systems_runner(#[case] text: &str) {
    let told = told(text.as_bytes(), None).to_string();
    let obeyed = told.lines().find(|line| line.trim_start().starts_with("::"));
    assert_eq!(obeyed, None, "{told}");
    assert!(told.contains("::"), "{told}");
}

#[test]
fn what_is_not_utf8_is_shown_at_its_place() {
    insta::assert_snapshot!(told(b"matrix:\n  os: [\"m\xe4c\"]\n", None));
}

#[test]
fn an_unknown_profile_is_asked_about() {
    insta::assert_snapshot!(told(b"matrix: {}\nprofiles: {quick: {}}\n", Some("quik")));
}

#[test]
fn a_file_that_is_not_there_is_named() {
    let found = MatrixFile::read(Path::new("/nowhere/matrix.yaml"), None, Catalogue::default()).unwrap_err();
    insta::assert_snapshot!(found);
}

#[test]
fn ten_megabytes_of_nesting_are_one_clear_error() {
    let text = "[".repeat(10_000_000);
    insta::assert_snapshot!(told(text.as_bytes(), None));
}

/// Texts just below the size limit that would take minutes, or the stack, if anything went with the square of the text.
#[rstest]
#[case::flow("[".repeat(1_000_000))]
#[case::one_word("a".repeat(1_000_000))]
#[case::quotes("'".repeat(1_000_000))]
#[case::keys((0..40_000).map(|key| format!("k{key}: 1\n")).collect())]
#[case::unknown_axes(format!("matrix:\n{}", (0..20_000).map(|key| format!("  k{key}: [1]\n")).collect::<String>()))]
#[case::labels(format!("matrix:\n  labels:\n{}", (0..20_000).map(|key| format!("    k{key}: [1]\n")).collect::<String>()))]
#[case::values(format!("matrix:\n  labels:\n    a: [{}]\n", (0..40_000).map(|value| format!("{value}, ")).collect::<String>()))]
#[case::includes(format!("matrix:\n  labels: {{a: [x]}}\n  include:\n{}", (0..15_000).map(|value| format!("  - {{a: {value}}}\n")).collect::<String>()))]
#[case::excludes(format!("matrix:\n  labels: {{a: [1]}}\n  exclude:\n{}", (0..10_000).map(|value| format!("  - {{a: {value}}}\n")).collect::<String>()))]
#[case::profiles(format!("matrix: {{}}\nprofiles:\n{}", (0..20_000).map(|key| format!("  k{key}: {{}}\n")).collect::<String>()))]
#[case::comments("#\n".repeat(500_000))]
#[case::anchors("- &a x\n".repeat(140_000))]
#[case::long_values(format!("matrix:\n  labels: {{x: [{}, b]}}\n  exclude:\n    - x: \"*{}b\"\n", "a".repeat(300_000), "a".repeat(150_000)))]
#[case::wrong_settings(format!("matrix: {{}}\nworkload:\n{}", (0..20_000).map(|key| format!("  k{key}: 1\n")).collect::<String>()))]
fn a_file_made_to_be_slow_is_not(#[case] text: String) {
    let started = std::time::Instant::now();
    let told = told(text.as_bytes(), None);
    let rendered = told.to_string();
    assert!(
        !rendered.is_empty() && rendered.len() < 100_000,
        "{} bytes",
        rendered.len()
    );
    // Generous, for a busy machine: what is wrong here takes minutes.
    assert!(
        started.elapsed() < std::time::Duration::from_secs(20),
        "{:?}",
        started.elapsed()
    );
}

#[test]
fn a_value_or_a_pattern_that_nobody_writes_is_refused_at_its_place() {
    let found = told(
        format!(
            "matrix:\n  labels: {{x: [b, {}]}}\n  exclude:\n    - x: \"*{}\"\n      reason: r\n",
            "a".repeat(1001),
            "a".repeat(1000)
        )
        .as_bytes(),
        None,
    );
    let found: Vec<_> = found
        .to_json()
        .iter()
        .map(|it| (it.line, it.message.to_owned()))
        .collect();
    let message = "a value of 1001 bytes is longer than 1000".to_owned();
    assert_eq!(found, [(2, message.clone()), (4, message)]);
}

#[test]
fn of_very_many_mistakes_the_first_are_told_and_that_there_are_more() {
    let text = "matrix: {}\nworkload:\n".to_owned()
        + &(0..24_000)
            .map(|key| format!("  k{key}: 1\n"))
            .collect::<String>();
    let started = std::time::Instant::now();
    let rendered = told(text.as_bytes(), None).to_string();
    assert!(
        rendered.contains("more than 40 mistakes are in one section, and the rest of it was not looked at"),
        "{rendered}"
    );
    let took = started.elapsed();
    // With the square of the keys it takes a minute.
    assert!(took < std::time::Duration::from_secs(10), "{took:?}");
    let text = "matrix: {}\n".to_owned() + &(0..24_000).map(|key| format!("k{key}: 1\n")).collect::<String>();
    let rendered = told(text.as_bytes(), None).to_string();
    assert!(rendered.ends_with("and 23950 more"), "{rendered}");
}

#[test]
fn programs_read_the_same() {
    insta::assert_snapshot!(
        serde_json::to_string_pretty(&told(b"matrix:\n  os: [x]\n  os: [y]\n", None).to_json()).unwrap()
    );
}

#[test]
fn platforms_outside_of_the_folder_of_the_file_are_refused_in_every_profile() {
    let text = "matrix: {}\nproviders: {simulated: {platforms: ../../etc}}\n\
                profiles: {other: {providers: {simulated: {platforms: /etc}}}}\n";
    let found = told(text.as_bytes(), None);
    let found: Vec<_> = found
        .to_json()
        .iter()
        .map(|it| (it.line, it.message.to_owned()))
        .collect();
    let expected = [(2, "../../etc"), (3, "/etc")].map(|(line, path)| {
        (
            line,
            format!("`{path}` is not below the folder of the matrix file"),
        )
    });
    assert_eq!(found, expected);
}

#[test]
fn a_byte_order_mark_shifts_nothing() {
    let found = told("\u{feff}matirx: {}\n".as_bytes(), None);
    assert_eq!(found.to_json()[0].column, 1);
}

#[test]
fn a_profile_overrides_and_keeps_the_rest() {
    let text = "matrix: {virtualization: [native, docker]}\nworkload: {window: 6000s, rate: 100Hz}\nreport: {alpha: 0.01}\n\
        profiles:\n  quick:\n    matrix: {virtualization: [fake]}\n    workload: {window: 400s}\n  other:\n";
    let file = MatrixFile::parse("m", text.as_bytes(), Some("quick")).unwrap();
    assert_eq!(file.profile.as_deref(), Some("quick"));
    assert_eq!(file.profiles, ["quick", "other"]);
    assert_eq!(file.workload.window.to_string(), "400s");
    assert_eq!(file.workload.rate.to_string(), "100Hz");
    assert_eq!(file.report.alpha, 0.01);
    assert_eq!(file.matrix.axes[0].values[0].text, "fake");
}

#[test]
fn a_setting_is_read_under_its_former_name_and_proposed_under_its_own() {
    let text = "matrix: {}\nreport: {control: {os: a}, matters: 1mm, family: against-controls}\n\
        profiles: {quick: {report: {baseline: {os: b}, equivalence_margin: 2mm}}}\n";
    for (profile, os, margin) in [(None, "a", "1mm"), (Some("quick"), "b", "2mm")] {
        let report = MatrixFile::parse("m", text.as_bytes(), profile).unwrap().report;
        assert_eq!(report.baseline["os"], os);
        assert_eq!(report.equivalence_margin.unwrap().to_string(), margin);
        assert_eq!(report.family, Family::AgainstBaseline);
    }
    let found = told(b"matrix: {}\nreport: {xyz: 1}\n", None).to_string();
    let schema = schema(Catalogue::default());
    let settings = &schema["$defs"]["ReportSettings"]["properties"];
    for (former, own) in ReportSettings::RENAMED {
        assert!(
            found.contains(&format!("`{own}`")) && !found.contains(&format!("`{former}`")),
            "{found}"
        );
        assert!(
            settings[own].is_object() && settings[former].is_null(),
            "{settings:#}"
        );
    }
}

#[test]
fn a_provider_from_outside_has_its_value_and_its_section_and_checks_it() {
    let catalogue = Catalogue::with(&OUTSIDE).unwrap();
    let parse = |section: &str| {
        let text = format!("matrix: {{virtualization: [elsewhere]}}\nproviders: {{{section}}}\n");
        MatrixFile::parse_for("m", text.as_bytes(), None, catalogue)
    };
    let file = parse("elsewhere: {a: 22.10, b: [x, 1]}, docker: {image: debian}").unwrap();
    assert_eq!(file.providers.docker.image.as_deref(), Some("debian"));
    let record = file.providers.to_record().unwrap();
    assert_eq!(record["elsewhere"], serde_json::json!({"a": 22.1, "b": ["x", 1]}));
    let read = catalogue.settings_of(record.clone()).unwrap();
    assert_eq!(read, file.providers);
    // Without the provider nobody can read its section.
    assert!(Catalogue::default().settings_of(record).is_err());
    assert!(parse("elsewhere: null").unwrap().providers.outside.is_empty());

    let found = parse("elsewhere: {a: 1}").unwrap_err();
    let [wrong] = found.iter().collect::<Vec<_>>()[..] else {
        panic!("{found}")
    };
    assert_eq!(
        wrong.message,
        "`elsewhere` does not take these settings: the number of keys is odd"
    );
    let unknown = MatrixFile::parse("m", b"matrix: {virtualization: [elsewhere]}", None).unwrap_err();
    assert!(
        unknown
            .to_string()
            .contains("there is no virtualization `elsewhere`")
    );
}

#[test]
fn the_schema_has_the_providers_from_outside() {
    let schema = schema(Catalogue::with(&OUTSIDE).unwrap());
    let sections = &schema["$defs"]["ProviderSettings"]["properties"];
    assert!(sections["elsewhere"].is_object() && sections["outside"].is_null());
    let values = &schema["properties"]["matrix"]["properties"]["virtualization"]["items"]["enum"];
    assert_eq!(values.as_array().unwrap().last().unwrap(), "elsewhere");
}

#[rstest]
#[case("matrix.schema.json", "matrix schema", &schema(Catalogue::default()))]
#[case("drift.schema.json", "matrix schema drift", &reports::drift::schema())]
fn the_schema_that_is_committed_is_current(
    #[case] name: &str,
    #[case] command: &str,
    #[case] schema: &serde_json::Value,
) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs").join(name);
    let current = serde_json::to_string_pretty(schema).unwrap() + "\n";
    let committed = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(committed == current, "run `{command} > docs/{name}`");
}

#[test]
fn a_fifo_is_refused_and_not_waited_for() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("m.yaml");
    let made = start(|| std::process::Command::new("mkfifo").arg(&path).status());
    assert!(made.unwrap().success());
    let found = MatrixFile::read(&path, None, Catalogue::default()).unwrap_err();
    assert!(
        found.to_string().contains("a FIFO, and not a regular file"),
        "{found}"
    );
}

#[test]
fn a_link_to_a_matrix_file_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("m.yaml");
    std::fs::write(folder.path().join("other.yaml"), "matrix: {}\n").unwrap();
    std::os::unix::fs::symlink("other.yaml", &path).unwrap();
    assert!(MatrixFile::read(&path, None, Catalogue::default()).is_ok());
}

#[test]
fn more_hosts_than_a_manifest_may_have_are_a_mistake() {
    let file = |hosts: usize| {
        let host = |number| format!("  h{number}: {{hardware: x86_64, os: debian-12, connect: local}}\n");
        let hosts: String = (0..hosts).map(host).collect();
        MatrixFile::parse(
            "m.yaml",
            format!("matrix: {{}}\nhosts:\n{hosts}").as_bytes(),
            None,
        )
    };
    assert_eq!(file(1000).unwrap().hosts.len(), 1000);
    let found = file(1001).unwrap_err();
    assert!(
        found.to_string().contains("1001 hosts are more than 1000"),
        "{found}"
    );
}
