//! A report on one screen: what is found is said first, in plain words, and what disturbs it is said with it.

use captures::traffic::Traffic;
use record::{quantity::Length, report_settings::ReportSettings, run_directory::Outcome, window::Verdict};
use reports::{Report, analyse};

use crate::{
    synthetic::{Scenario, Synthetic},
    tables::nine,
};

const NATIVE: &str = "x86-debian-native";
const DOCKER: &str = "x86-debian-docker";

/// Eight windows of each: the fewest that can reach α in a pair are seven.
fn pair(native_m: [f64; 8], docker_m: [f64; 8]) -> Synthetic {
    Synthetic::new(&[
        Scenario::measured(NATIVE, &native_m),
        Scenario::measured(DOCKER, &docker_m).by("docker"),
    ])
}

const ALIKE: [f64; 8] = [0.100, 0.102, 0.101, 0.099, 0.098, 0.100, 0.101, 0.100];
const OTHERS: [f64; 8] = [0.101, 0.099, 0.100, 0.102, 0.100, 0.099, 0.101, 0.098];
const FAR: [f64; 8] = [0.120, 0.121, 0.122, 0.123, 0.119, 0.120, 0.121, 0.122];

fn report_by(synthetic: &Synthetic, settings: impl FnOnce(&mut ReportSettings)) -> Report {
    let run = reports::load(synthetic.directory.path()).unwrap();
    let mut of_run = run.manifest.report.clone();
    settings(&mut of_run);
    analyse(&run, Traffic::default(), &of_run)
}

fn report(synthetic: &Synthetic) -> Report {
    report_by(synthetic, |_| {})
}

/// The whole of it, and that no line is too long for a terminal.
fn screen(report: &Report) -> String {
    let text = report.present().summary();
    for line in text.lines() {
        assert!(
            line.chars().count() <= 80,
            "{} columns: {line}",
            line.chars().count()
        );
    }
    assert!(text.lines().count() <= 50, "{text}");
    text
}

#[test]
fn a_true_difference_is_the_first_sentence_with_its_size() {
    let report = report(&pair(ALIKE, FAR));
    insta::assert_snapshot!(screen(&report));
    let first = &report.findings()[0];
    assert!(
        first.starts_with("a and b differ: the error of b (docker) is ")
            && first.contains("larger than that of a (native)"),
        "{first}"
    );
}

#[test]
fn no_difference_is_not_told_as_proof_that_there_is_none() {
    let report = report(&pair(ALIKE, OTHERS));
    insta::assert_snapshot!(screen(&report));
    assert!(report.findings()[0].contains("not told apart, which is not the same as no difference"));
    let within = report_by(&pair(ALIKE, OTHERS), |settings| {
        settings.equivalence_margin = Some(Length::from_millimetres(20.0));
    });
    assert!(
        within.findings()[0].starts_with("a and b differ by no more than 20 mm, which does not matter"),
        "{:?}",
        within.findings()
    );
}

#[test]
fn a_disturbed_run_says_so_beside_what_it_found() {
    let synthetic = pair(ALIKE, FAR);
    for window in 1..=6 {
        synthetic.edit_window(DOCKER, window, |record| {
            record.verdict = Verdict::Suspect;
            record.reasons =
                vec!["Others used 97 % of the processors' time (suspect above 10 %).".to_owned()];
        });
    }
    let report = report(&synthetic);
    insta::assert_snapshot!(screen(&report));
    assert!(
        report
            .findings()
            .iter()
            .any(|sentence| sentence.contains("6 of 8 of b")),
        "{:?}",
        report.findings()
    );
    let page = report.present().html(&[]);
    assert!(
        page.contains("6 of them suspect") && page.contains("class=\"suspect\""),
        "{page}"
    );
}

#[test]
fn what_so_few_windows_cannot_show_is_said_with_the_number_that_can() {
    let few = |level: f64| [level, level + 0.001, level - 0.001];
    let synthetic = Synthetic::new(&[
        Scenario::measured(NATIVE, &few(0.1)),
        Scenario::measured(DOCKER, &few(0.2)).by("docker"),
    ]);
    let findings = report(&synthetic).findings();
    assert!(
        findings[0].contains("cannot be told apart by so few windows"),
        "{findings:?}"
    );
    assert!(
        findings[1].starts_with("It takes 7 windows of each scenario or more (`windows: 7`"),
        "{findings:?}"
    );
}

#[test]
fn the_papers_nine_fit_on_a_screen_with_reasons_that_are_alike_told_once() {
    let mut scenarios = nine();
    scenarios.push(Scenario::infeasible("arm64-osx-docker", "there is no `/dev/kvm`"));
    scenarios.push(Scenario::infeasible("arm64-osx-native", "there is no `/dev/kvm`"));
    let text = screen(&report(&Synthetic::new(&scenarios)));
    assert_eq!(text.matches("there is no `/dev/kvm`").count(), 1, "{text}");
    insta::assert_snapshot!(text);
}

#[test]
fn scenarios_of_a_sweep_are_no_pairs_and_it_is_said_what_to_do_about_it() {
    let mut run = reports::load(pair(ALIKE, FAR).directory.path()).unwrap();
    for (delay, scenario) in ["10ms", "12ms"].iter().zip(&mut run.scenarios) {
        scenario.planned.settings.network.delay = delay.parse().unwrap();
    }
    let report = analyse(&run, Traffic::default(), &run.manifest.report);
    let findings = report.findings();
    assert!(
        findings[0].starts_with("No two scenarios ran the same experiment")
            && findings[0].contains("network.delay"),
        "{findings:?}"
    );
}

#[test]
fn a_sweep_by_itself_says_from_where_to_where_the_metric_goes() {
    let higher = ALIKE.map(|mean_m| mean_m + 0.05);
    let synthetic = Synthetic::new(&[
        Scenario::measured("x86-debian-native", &ALIKE),
        Scenario::measured("x86-debian-docker", &higher),
        Scenario::measured("x86-debian-libvirt", &FAR),
    ]);
    let mut run = reports::load(synthetic.directory.path()).unwrap();
    for (delay, scenario) in ["10ms", "12ms", "15ms"].iter().zip(&mut run.scenarios) {
        let planned = &mut scenario.planned;
        planned.settings.network.delay = delay.parse().unwrap();
        planned.axes.insert("virtualization".to_owned(), "native".into());
        planned.axes.insert("network.delay".to_owned(), (*delay).into());
    }
    let report = analyse(&run, Traffic::default(), &run.manifest.report);
    insta::assert_snapshot!(screen(&report));
}

#[test]
fn without_a_scenario_that_was_measured_nothing_is_said_of_a_difference() {
    let synthetic = Synthetic::new(&[Scenario::ended("x86-debian-native", Outcome::Errored, "no box")]);
    insta::assert_snapshot!(screen(&report(&synthetic)));
}
