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
