//! Every mistake in an `experiment:` section, as a person sees it. The pictures are in `snapshots/`: read them as a user would.

use rstest::rstest;

use crate::matrix_file::tests::{case_name, told};

/// An experiment without mistakes, with a field in place of its own.
fn with(field: &str) -> String {
    let key = field.split_once(':').map_or(field, |(key, _)| key);
    let fields = [
        "name: reach",
        "run: [\"true\"]",
        "metrics:\n  - {name: error, from: errors.csv}",
    ];
    let others = fields
        .into_iter()
        .filter(|it| !it.starts_with(&format!("{key}:")));
    let lines: Vec<String> = others.chain([field]).map(|it| format!("  {it}\n")).collect();
    format!("matrix: {{}}\nexperiment:\n{}", lines.concat())
}

#[rstest]
#[case::a_command_as_text(&with("run: \"python3 reach.py\""))]
#[case::no_command(&with("run: []"))]
#[case::a_number_as_a_command(&with("run: 5"))]
#[case::an_argument_that_is_a_list(&with("run: [python3, [a, b]]"))]
#[case::an_argument_that_is_nothing(&with("run: [python3, ~]"))]
#[case::an_argument_with_a_nul(&with("run: [python3, \"a\\0b\"]"))]
#[case::an_unknown_placeholder(&with("run: [python3, \"{window.sead}\"]"))]
#[case::a_placeholder_of_nothing(&with("run: [python3, \"{}\"]"))]
#[case::a_placeholder_that_does_not_end(&with("run: [python3, \"{window.seed\"]"))]
#[case::a_brace_that_was_not_opened(&with("run: [python3, \"seed}\"]"))]
#[case::an_unknown_parameter(&with("run: [python3, \"{parameters.solvr}\"]\n  parameters: {solver: newton}"))]
#[case::a_parameter_of_none(&with("run: [python3, \"{parameters.steps}\"]"))]
#[case::a_windows_seed_before_the_windows(&with("prepare: [make, \"{window.seed}\"]"))]
#[case::a_misspelt_key(&with("runs: [true]"))]
#[case::a_name_that_is_a_path(&with("name: ../reach"))]
#[case::a_name_with_a_space(&with("name: arm reach"))]
#[case::a_parameter_that_is_a_list(&with("parameters: {steps: [1, 2]}"))]
#[case::a_parameter_that_is_a_mapping(&with("parameters: {steps: {a: 1}}"))]
#[case::a_parameter_that_is_nothing(&with("parameters: {steps: }"))]
#[case::a_parameter_with_a_bad_name(&with("parameters: {\"a b\": 1}"))]
#[case::files_outside(&with("files: [../secret]"))]
#[case::files_from_the_root(&with("files: [/etc/passwd]"))]
#[case::files_as_text(&with("files: sim/"))]
#[case::a_timeout_without_a_unit(&with("window: {timeout: 10}"))]
#[case::a_timeout_of_nothing(&with("window: {timeout: 0s}"))]
#[case::a_misspelt_timeout(&with("window: {timeuot: 10min}"))]
#[case::a_window_that_is_a_time(&with("window: 10min"))]
#[case::no_metric(&with("metrics: []"))]
#[case::a_metric_without_a_file(&with("metrics:\n  - {name: error, unit: mm}"))]
#[case::a_metric_without_a_name(&with("metrics:\n  - {from: errors.csv}"))]
#[case::two_metrics_of_one_name(&with("metrics:\n  - {name: error, from: errors.csv}\n  - {name: error, from: others.csv}"))]
#[case::a_metric_from_elsewhere(&with("metrics:\n  - {name: error, from: ../errors.csv}"))]
#[case::a_metric_from_a_folder(&with("metrics:\n  - {name: error, from: out/errors.csv}"))]
#[case::a_metric_from_a_file_of_ours(&with("metrics:\n  - {name: error, from: window.json}"))]
#[case::a_metric_with_an_unknown_comparison(&with("metrics:\n  - {name: error, from: errors.csv, compare: same}"))]
#[case::a_column_of_bytes(&with("metrics:\n  - {name: state, from: state.txt, compare: identical, column: x}"))]
#[case::a_unit_of_bytes(&with("metrics:\n  - {name: state, from: state.txt, compare: identical, unit: mm}"))]
#[case::a_unit_that_is_a_sentence(&with("metrics:\n  - {name: error, from: errors.csv, unit: \"millimetres from the target\"}"))]
#[case::a_column_without_a_name(&with("metrics:\n  - {name: error, from: errors.csv, column: \"\"}"))]
#[case::a_margin_below_nothing(&with("metrics:\n  - {name: error, from: errors.csv, equivalence_margin: -1}"))]
#[case::a_margin_with_a_unit(&with("metrics:\n  - {name: error, from: errors.csv, equivalence_margin: 1mm}"))]
#[case::a_metric_that_is_a_name(&with("metrics: [error]"))]
#[case::too_many_retries(&with("retries: 11"))]
#[case::retries_that_are_a_word(&with("retries: once"))]
#[case::a_windows_folder_after_the_windows(&with("restore: [rm, \"{window.folder}\"]"))]
#[case::fail_fast_that_is_a_number(&with("fail_fast: 1"))]
#[case::no_metrics_at_all("matrix: {}\nexperiment:\n  name: reach\n  run: [\"true\"]\n")]
#[case::no_name_at_all(
    "matrix: {}\nexperiment:\n  run: [\"true\"]\n  metrics:\n  - {name: error, from: errors.csv}\n"
)]
#[case::a_section_that_is_a_word("matrix: {}\nexperiment: reach\n")]
#[case::an_empty_section_with_an_axis("matrix:\n  parameters.steps: [1, 2]\nexperiment:\n")]
#[case::below_the_workload("matrix: {}\nworkload:\n  experiment: {name: reach}\n")]
#[case::an_axis_of_no_parameter(
    "matrix:\n  parameters.stps: [1, 2]\nexperiment:\n  name: reach\n  run: [\"true\"]\n  metrics:\n  - {name: error, from: errors.csv}\n  parameters: {steps: 1}\n"
)]
#[case::an_axis_of_the_ball(
    "matrix:\n  network.loss: [0%, 1%]\nexperiment:\n  name: reach\n  run: [\"true\"]\n  metrics:\n  - {name: error, from: errors.csv}\n"
)]
#[case::an_include_of_the_ball(
    "matrix:\n  virtualization: [native]\n  include:\n  - {virtualization: docker, network.loss: 0%}\nexperiment:\n  name: reach\n  run: [\"true\"]\n  metrics:\n  - {name: error, from: errors.csv}\n"
)]
#[case::a_setting_of_the_ball(
    "matrix: {}\nexperiment:\n  name: reach\n  run: [\"true\"]\n  metrics:\n  - {name: error, from: errors.csv}\nworkload: {windows: 4, period: 10s}\n"
)]
#[case::a_report_of_the_ball(
    "matrix: {}\nexperiment:\n  name: reach\n  run: [\"true\"]\n  metrics:\n  - {name: error, from: errors.csv}\nreport: {discard_periods: 0, equivalence_margin: 1mm}\n"
)]
#[case::a_parameter_as_an_axis_that_is_not_used(
    "matrix:\n  parameters: [1, 2]\nexperiment:\n  name: reach\n  run: [\"true\"]\n  metrics:\n  - {name: error, from: errors.csv}\n"
)]
#[case::in_a_profile(
    "matrix: {}\nexperiment:\n  name: reach\n  run: [\"true\"]\n  metrics:\n  - {name: error, from: errors.csv}\nprofiles:\n  quick:\n    experiment: {window: {timeout: 5}}\n"
)]
fn every_mistake_of_an_experiment_is_shown_at_its_place(#[case] text: &str) {
    let told = told(text.as_bytes(), None);
    assert!(!told.is_empty());
    insta::with_settings!({ description => text, omit_expression => true }, {
        insta::assert_snapshot!(case_name(), told);
    });
}

/// Nodes without mistakes but for the lines, which come before the nodes, and the workload's network.
fn nodes(lines: &str, node: &str, network: &str) -> String {
    format!(
        "matrix: {{}}\nexperiment:\n  name: loop\n{lines}  nodes:\n  - {{name: plant, host: sta2, run: [./plant]}}\n  - {node}\n  \
         metrics:\n  - {{name: error, from: errors.csv}}\n{network}"
    )
}

#[rstest]
#[case::a_command_and_nodes(&nodes("  run: [\"true\"]\n", "{name: a, host: h1, run: [a]}", ""))]
#[case::a_node_without_a_host(&nodes("", "{name: a, run: [a]}", ""))]
#[case::a_node_without_a_name(&nodes("", "{host: h1, run: [a]}", ""))]
#[case::a_node_with_a_bad_name(&nodes("", "{name: My Node, host: h1, run: [a]}", ""))]
#[case::a_node_without_a_program(&nodes("", "{name: a, host: h1}", ""))]
#[case::an_empty_program(&nodes("", "{name: a, host: h1, run: []}", ""))]
#[case::a_program_as_text(&nodes("", "{name: a, host: h1, run: ./a --fast}", ""))]
#[case::an_unknown_host(&nodes("", "{name: a, host: sta3, run: [a]}", ""))]
#[case::two_nodes_of_one_name(&nodes("", "{name: plant, host: h1, run: [a]}", ""))]
#[case::an_unknown_placeholder_of_a_host(&nodes("", "{name: a, host: h1, run: [a, \"{hosts.h1.ip}\"]}", ""))]
#[case::an_address_of_no_host(&nodes("", "{name: a, host: h1, run: [a, \"{hosts.h2.address}\"]}", ""))]
#[case::an_address_without_a_network(&with("run: [a, \"{hosts.h1.address}\"]"))]
#[case::an_unknown_sign(&nodes("", "{name: a, host: h1, run: [a], ready: {file: x}}", ""))]
#[case::two_signs(&nodes("", "{name: a, host: h1, run: [a], ready: {port: 80, line: x}}", ""))]
#[case::a_port_that_is_none(&nodes("", "{name: a, host: h1, run: [a], ready: {port: 70000}}", ""))]
#[case::a_topic_without_a_master(&nodes("", "{name: a, host: h1, run: [a], ready: {topic: /state}}", ""))]
#[case::a_topic_that_is_none(&nodes("  ros_master: {}\n", "{name: a, host: h1, run: [a], ready: {topic: state}}", ""))]
#[case::a_master_on_no_host(&nodes("  ros_master: {host: h9}\n", "{name: a, host: h1, run: [a]}", ""))]
#[case::a_master_of_another_kind(&nodes("  ros_master: {program: roscore}\n", "{name: a, host: h1, run: [a]}", ""))]
#[case::a_master_of_nobody(&with("ros_master: {}"))]
#[case::a_capture_as_a_metrics_file(
    &nodes("", "{name: a, host: h1, run: [a]}", "").replace("errors.csv", "h1.pcap")
)]
#[case::a_network_of_a_command(&format!("{}workload: {{network: {{delay: 1ms}}}}\n", with("retries: 1")))]
#[case::a_setting_of_the_ball_with_nodes(&nodes("", "{name: a, host: h1, run: [a]}", "workload: {period: 10s}\n"))]
#[case::a_host_with_a_bad_name(&nodes("", "{name: a, host: h1, run: [a]}", "workload: {network: {hosts: {Robot: {}}}}\n"))]
#[case::a_host_with_a_misspelt_link(
    &nodes("", "{name: a, host: h1, run: [a]}", "workload: {network: {hosts: {h1: {dealy: 1ms}, sta2: {}}}}\n")
)]
#[case::a_host_at_no_switch(
    &nodes("", "{name: a, host: h1, run: [a]}", "workload: {network: {hosts: {h1: {switch: s2}, sta2: {}}}}\n")
)]
#[case::a_switch_before_its_own(
    &nodes("", "{name: a, host: h1, run: [a]}", "workload: {network: {switches: {s1: {}, s2: {switch: s3}, s3: {}}}}\n")
)]
#[case::a_jitter_of_one_link(
    &nodes("", "{name: a, host: h1, run: [a]}", "workload: {network: {hosts: {h1: {jitter: 50ms}, sta2: {}}}}\n")
)]
#[case::other_hosts_for_the_ball("matrix: {}\nworkload: {network: {hosts: {robot: {}, base: {}}}}\n")]
#[case::an_axis_of_no_field("matrix: {network.hosts.sta1.dealy: [1ms]}\n")]
fn every_mistake_of_nodes_and_of_their_network_is_shown_at_its_place(#[case] text: &str) {
    let told = told(text.as_bytes(), None);
    assert!(!told.is_empty());
    insta::with_settings!({ description => text, omit_expression => true }, {
        insta::assert_snapshot!(case_name(), told);
    });
}
