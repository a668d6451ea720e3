//! Several run directories as one matrix.

use std::{fs, path::Path};

use captures::traffic::Traffic;
use record::run_directory::Place;
use reports::{
    Run, analyse,
    analysis::combination::{Misfit, Misfits, Repeated, combine},
    load,
};
use serde_json::{Value, json};

use crate::synthetic::{Scenario, Synthetic};

const LEVELS_M: [f64; 4] = [0.010, 0.011, 0.010, 0.011];

/// Changes a JSON file.
fn edit(path: &Path, edit: impl FnOnce(&mut Value)) {
    let mut value = serde_json::from_slice(&fs::read(path).unwrap()).unwrap();
    edit(&mut value);
    fs::write(path, serde_json::to_vec(&value).unwrap()).unwrap();
}

fn named(run: &str, scenarios: &[Scenario]) -> Synthetic {
    let synthetic = Synthetic::new(scenarios);
    edit(&synthetic.directory.manifest().path(), |manifest| {
        manifest["run"] = json!(run)
    });
    synthetic
}

fn one(run: &str, slug: &'static str) -> Synthetic {
    named(run, &[Scenario::measured(slug, &LEVELS_M)])
}

fn together(runs: &[&Synthetic], repeated: Repeated) -> Result<Run, Misfits> {
    combine(
        runs.iter()
            .map(|run| load(run.directory.path()).unwrap())
            .collect(),
        repeated,
    )
}

/// What keeps two runs of one scenario each from being one.
fn misfits(change: impl FnOnce(&Synthetic)) -> (Vec<Misfit>, String) {
    let (first, second) = (
        one("first", "arm-ubuntu-native"),
        one("second", "i7-ubuntu-native"),
    );
    change(&second);
    let misfits = together(&[&first, &second], Repeated::Refused).unwrap_err();
    let hint = misfits.hint().unwrap();
    (misfits.0, hint)
}

/// The paper's nine scenarios; those of one machine are measured.
fn on_machine(hardware: &str) -> Vec<Scenario> {
    let slugs = [
        "i686-ubuntu-docker",
        "i686-ubuntu-native",
        "i686-ubuntu-virtualbox",
        "i7-osx-docker",
        "i7-osx-native",
        "i7-osx-virtualbox",
        "arm64-ubuntu-docker",
        "arm64-ubuntu-native",
        "arm64-ubuntu-virtualbox",
    ];
    let scenario = |slug: &'static str| match slug {
        "i686-ubuntu-docker" => Scenario::infeasible(slug, "Docker does not run on i686"),
        "i7-osx-native" => Scenario::infeasible(slug, "mininet does not run on OSX"),
        _ if slug.starts_with(hardware) => Scenario::measured(slug, &LEVELS_M),
        _ => Scenario {
            not_selected: Some("not selected by `--only`"),
            outcome: None,
            ..Scenario::measured(slug, &[])
        },
    };
    slugs.map(scenario).into()
}

#[test]
fn the_papers_three_machines_measured_apart_are_its_nine_scenarios() {
    let runs = ["arm64", "i686", "i7"].map(|machine| named(machine, &on_machine(machine)));
    let runs: Vec<&Synthetic> = runs.iter().collect();
    let run = together(&runs, Repeated::Refused).unwrap();
    let report = analyse(&run, Traffic::default(), &run.manifest.report);
    let letters: String = report
        .scenarios
        .iter()
        .map(|scenario| scenario.id.as_str())
        .collect();
    assert_eq!(letters, "abcdefghi");
    let standings: Vec<_> = report
        .scenarios
        .iter()
        .map(|scenario| (scenario.standing.name(), scenario.windows_counted()))
        .collect();
    let (measured, cannot) = (("completed", 4), ("infeasible", 0));
    assert_eq!(
        standings,
        [
            cannot, measured, measured, measured, cannot, measured, measured, measured, measured
        ]
    );
    let measured: Vec<String> = report.parts.iter().map(|part| part.scenarios.concat()).collect();
    assert_eq!(measured, ["ghi", "bc", "df"]);
    assert_eq!(report.run, "arm64 + i686 + i7");
    assert_eq!(report.tally("b", "h").unwrap().pairs, 16);
    let remarks = report.present().remarks;
    assert!(
        matches!(remarks.as_slice(), [one] if one.starts_with("ONE ENVIRONMENT EACH")),
        "{remarks:?}"
    );
    let text = report.present().markdown();
    assert!(
        text.contains("- Run i686 of 2026-11-21T04:00:00.000Z by matrix 0.1.0, revision unknown: b, c."),
        "{text}"
    );
}

#[test]
fn a_combined_report_is_as_one_of_a_single_run() {
    let all = Synthetic::new(&[
        Scenario::measured("arm-ubuntu-native", &LEVELS_M),
        Scenario::measured("i7-ubuntu-native", &[0.010, 0.030, 0.030, 0.011]),
    ]);
    let whole = load(all.directory.path()).unwrap();
    let apart = [
        one("first", "arm-ubuntu-native"),
        named(
            "second",
            &[Scenario::measured(
                "i7-ubuntu-native",
                &[0.010, 0.030, 0.030, 0.011],
            )],
        ),
    ];
    let combined = together(&[&apart[0], &apart[1]], Repeated::Refused).unwrap();
    let tables = |run: &Run| {
        analyse(run, Traffic::default(), &run.manifest.report)
            .present()
            .tables
    };
    assert_eq!(tables(&combined), tables(&whole));
    assert_eq!(
        combined.remarks.len(),
        1,
        "that the letters are its own: {:?}",
        combined.remarks
    );
}

#[test]
fn settings_that_differ_are_refused_with_the_runs_and_the_fields() {
    let (found, hint) = misfits(|second| {
        edit(&second.directory.plan().path(), |plan| {
            plan["scenarios"][0]["settings"]["network"]["delay"] = json!("20ms");
            plan["scenarios"][0]["settings"]["control"]["phase"] = json!("1ms");
        });
    });
    let differ = Misfit::Experiment {
        first: "first".to_owned(),
        second: "second".to_owned(),
        fields: vec!["control.phase".to_owned(), "network.delay".to_owned()],
    };
    assert_eq!(found, [differ]);
    assert!(hint.contains("same experiment"), "{hint}");
}

#[test]
fn what_an_axis_sweeps_is_no_other_experiment() {
    let sweeps = [
        ("first", "arm-ubuntu-native", "10ms"),
        ("second", "i7-ubuntu-native", "20ms"),
    ];
    let runs = sweeps.map(|(run, slug, delay)| {
        let synthetic = one(run, slug);
        edit(&synthetic.directory.plan().path(), |plan| {
            plan["scenarios"][0]["settings"]["network"]["delay"] = json!(delay);
            plan["scenarios"][0]["axes"]["network.delay"] = json!(delay);
        });
        synthetic
    });
    let run = together(&[&runs[0], &runs[1]], Repeated::Refused).unwrap();
    let report = analyse(&run, Traffic::default(), &run.manifest.report);
    assert_eq!(
        report.setup_differences("a", "b"),
        ["network.delay"],
        "said, as within one run"
    );
}

#[test]
fn what_follows_from_swept_dynamics_is_no_other_experiment() {
    let sweeps = [
        ("first", "arm-ubuntu-native", "author"),
        ("second", "i7-ubuntu-native", "robust"),
    ];
    let runs = sweeps.map(|(run, slug, dynamics)| {
        let synthetic = one(run, slug);
        edit(&synthetic.directory.plan().path(), |plan| {
            plan["scenarios"][0]["settings"]["ros"]["tcp_nodelay"] = json!(dynamics == "robust");
            plan["scenarios"][0]["axes"]["dynamics"] = json!(dynamics);
        });
        synthetic
    });
    assert!(together(&[&runs[0], &runs[1]], Repeated::Refused).is_ok());
}

#[test]
fn other_declarations_are_refused_until_the_call_says_which_is_meant() {
    let (found, hint) = misfits(|second| {
        edit(&second.directory.manifest().path(), |manifest| {
            manifest["report"]["alpha"] = json!(0.01)
        });
    });
    let [
        Misfit::Declaration {
            field, value, other, ..
        },
    ] = found.as_slice()
    else {
        panic!("{found:?}")
    };
    assert_eq!([field.as_str(), value, other], ["alpha", "0.001", "0.01"]);
    assert!(hint.contains("--alpha"), "{hint}");
}

#[test]
fn other_axes_are_refused() {
    let (found, _) = misfits(|second| {
        edit(&second.directory.plan().path(), |plan| {
            plan["scenarios"][0]["axes"]["room"] = json!("cold")
        });
    });
    assert!(matches!(found.as_slice(), [Misfit::Axes { .. }]), "{found:?}");
}

#[test]
fn the_same_run_twice_is_refused() {
    let run = one("first", "arm-ubuntu-native");
    let misfits = together(&[&run, &run], Repeated::Refused).unwrap_err();
    assert_eq!(
        misfits.to_string(),
        "the runs are not of one matrix: run first is there twice"
    );
}

#[test]
fn a_scenario_that_two_runs_measured_is_refused_or_told_apart_by_its_run() {
    let runs = [
        one("first", "arm-ubuntu-native"),
        one("second", "arm-ubuntu-native"),
    ];
    let misfits = together(&[&runs[0], &runs[1]], Repeated::Refused).unwrap_err();
    assert!(misfits.hint().unwrap().contains("--by-run"));
    assert!(
        misfits
            .to_string()
            .contains("first and second both measured arm-ubuntu-native"),
        "{misfits}"
    );

    let run = together(&[&runs[0], &runs[1]], Repeated::Distinguished).unwrap();
    let slugs: Vec<&str> = run
        .scenarios
        .iter()
        .map(|scenario| scenario.planned.slug.as_str())
        .collect();
    assert_eq!(slugs, ["arm-ubuntu-native-first", "arm-ubuntu-native-second"]);
    let report = analyse(&run, Traffic::default(), &run.manifest.report);
    assert_eq!(report.tally("a", "b").unwrap().pairs, 16);
}

#[test]
fn what_a_run_began_and_another_measured_is_the_others_with_a_remark() {
    let failed = named(
        "first",
        &[Scenario::ended(
            "arm-ubuntu-native",
            record::run_directory::Outcome::Errored,
            "the disk is full",
        )],
    );
    let run = together(&[&failed, &one("second", "arm-ubuntu-native")], Repeated::Refused).unwrap();
    assert_eq!(run.scenarios[0].counted().count(), 4);
    assert_eq!(
        run.remarks,
        ["arm-ubuntu-native was begun in run first too, and is taken from run second."]
    );
}

#[test]
fn a_letter_that_means_another_scenario_elsewhere_cannot_be_declared() {
    let runs = [
        one("first", "arm-ubuntu-native"),
        one("second", "i7-ubuntu-native"),
    ];
    for run in &runs {
        edit(&run.directory.manifest().path(), |manifest| {
            manifest["report"]["family"] = json!([["a", "i7-ubuntu-native"]]);
        });
    }
    let misfits = together(&[&runs[0], &runs[1]], Repeated::Refused).unwrap_err();
    assert!(
        matches!(misfits.0.as_slice(), [Misfit::Letter { field: "family", .. }]),
        "{misfits}"
    );
    assert!(misfits.hint().unwrap().contains("slugs"));
}

#[test]
fn a_combined_report_goes_where_it_is_told_and_leaves_the_runs_alone() {
    let runs = [
        one("first", "arm-ubuntu-native"),
        one("second", "i7-ubuntu-native"),
    ];
    let folder = tempfile::tempdir().unwrap();
    let run = Run {
        report_folder: Place::root(folder.path().join("both")),
        ..together(&[&runs[0], &runs[1]], Repeated::Refused).unwrap()
    };
    let report = analyse(&run, Traffic::default(), &run.manifest.report);
    reports::write(&run, &report, reports::Layout::default()).unwrap();
    let written: Value =
        serde_json::from_slice(&fs::read(folder.path().join("both/report.json")).unwrap()).unwrap();
    assert_eq!(written["run"], "first + second");
    assert_eq!(written["runs"][1]["scenarios"], json!(["b"]));
    for run in &runs {
        assert!(!run.directory.report().path().exists());
    }
}
