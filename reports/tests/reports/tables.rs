//! What a report says.

use std::collections::BTreeSet;

use captures::traffic::Traffic;
use record::{
    report_settings::{Metric, ReportSettings, WarmUp},
    run_directory::{EnvironmentRecord, Event, Outcome},
    window::{ReleaseRecord, Verdict},
};
use reports::{Report, analyse, analysis::within::Look, present::figure};
use serde_json::{Value, json};
use statistics::{dependence::Dependence, serial::SerialDependence, stationarity::Unseen};

use crate::synthetic::{Scenario, Synthetic, journal, log};

/// The paper's nine scenarios with made-up numbers: docker on b's platform far off, all else alike.
pub fn nine() -> Vec<Scenario> {
    let alike = [0.1000, 0.1001, 0.0999, 0.1000];
    vec![
        Scenario::infeasible("i686-ubuntu-docker", "excluded: Docker does not run on i686"),
        Scenario::measured("i686-ubuntu-native", &alike),
        Scenario::measured("i686-ubuntu-virtualbox", &[0.1002, 0.1000, 0.1000, 0.13]),
        Scenario::measured("i7-osx-docker", &[0.120, 0.121, 0.122, 0.123]).by("docker"),
        Scenario::infeasible("i7-osx-native", "excluded: mininet does not run on OSX"),
        Scenario::ended(
            "i7-osx-virtualbox",
            Outcome::Errored,
            "vagrant up: exit code 1\nE: no such box",
        ),
        Scenario::measured("arm64-ubuntu-docker", &[0.120, 0.121]).by("docker"),
        Scenario::measured("arm64-ubuntu-native", &[0.1001, 0.1000, 0.1001, 0.0999]),
        Scenario {
            outcome: None,
            ..Scenario::measured("arm64-ubuntu-virtualbox", &[])
        },
    ]
}

fn report_of(synthetic: &Synthetic) -> Report {
    let run = reports::load(synthetic.directory.path()).unwrap();
    analyse(&run, Traffic::default(), &run.manifest.report)
}

fn json_of(report: &Report) -> Value {
    serde_json::to_value(report.present().json()).unwrap()
}

#[test]
fn the_papers_tables_in_markdown() {
    let synthetic = Synthetic::new(&nine());
    let markdown = report_of(&synthetic).present().markdown();
    for line in markdown.lines() {
        assert!(
            line.chars().count() <= 80,
            "{} columns: {line}",
            line.chars().count()
        );
    }
    insta::assert_snapshot!(markdown);
}

/// The paper's nine scenarios, those that can run measured, with one level of error in each window.
fn measured(levels: [(&'static str, [f64; 4]); 7]) -> Synthetic {
    let mut levels = levels.into_iter();
    let scenarios: Vec<Scenario> = nine()
        .iter()
        .map(|scenario| match scenario.infeasible {
            Some(reason) => Scenario::infeasible(scenario.slug, reason),
            None => {
                let (slug, levels) = levels.next().unwrap();
                assert_eq!(slug, scenario.slug);
                Scenario::measured(slug, &levels)
            }
        })
        .collect();
    Synthetic::new(&scenarios)
}

fn all_measured() -> Synthetic {
    measured([
        ("i686-ubuntu-native", [0.100, 0.1001, 0.0999, 0.100]),
        ("i686-ubuntu-virtualbox", [0.1002, 0.100, 0.100, 0.13]),
        ("i7-osx-docker", [0.120, 0.121, 0.122, 0.123]),
        ("i7-osx-virtualbox", [0.101, 0.1, 0.1, 0.12]),
        ("arm64-ubuntu-docker", [0.1, 0.115, 0.1, 0.1]),
        ("arm64-ubuntu-native", [0.1001, 0.100, 0.1001, 0.0999]),
        ("arm64-ubuntu-virtualbox", [0.1, 0.1001, 0.1, 0.1]),
    ])
}

#[test]
fn a_run_of_the_papers_scenarios_has_its_tables_in_its_layout_beside_its_counts() {
    let report = report_of(&all_measured());
    let tables = report.present().tables;
    let table = |title: &str| {
        let found = tables.iter().find(|table| table.title.starts_with(title));
        found.unwrap_or_else(|| panic!("{title}"))
    };
    let columns = |title: &str| {
        let columns = table(title).columns.iter();
        columns.map(|column| column.heading.clone()).collect::<Vec<_>>()
    };
    let last = |title: &str, cells: usize| {
        let rows = table(title).rows.iter();
        rows.map(|row| row[row.len() - cells..].join(" "))
            .collect::<Vec<_>>()
    };
    assert_eq!(
        table("Table II.").rows,
        [
            ["i686", "ubuntu", "(a)", "b", "c"],
            ["i7", "osx", "d", "(e)", "f"],
            ["arm64", "ubuntu", "g", "h", "i"]
        ]
    );
    // b c d f g h i, as printed.
    assert_eq!(last("Table III.", 1), ["0", "3", "3", "3", "1", "0", "0"]);
    assert_eq!(last("Table IV.", 1), ["0", "9", "1"]);
    assert_eq!(
        columns("Table V (a)"),
        ["", "osx", "ubuntu", "paper: osx", "paper: ubuntu"]
    );
    let rows = |title: &str| {
        table(title)
            .rows
            .iter()
            .map(|row| row[0].clone())
            .collect::<Vec<_>>()
    };
    assert_eq!(rows("Table V (a)"), ["virtualbox", "docker"]);
    assert_eq!(last("Table V (a)", 2), ["0 0", "10 2"]);
    assert_eq!(last("Table V (b)", 2), ["1 0", "7 0"]);
    // What was measured is what was counted: of d against b, and of i against h.
    let rejected = |a: &str, b: &str| report.tally(a, b).unwrap().rejected;
    assert_eq!(
        table("Table V (a)").rows[1][1],
        format!("{} of 16", rejected("b", "d"))
    );
    assert_eq!(
        table("Table V (b)").rows[0][2],
        format!("{} of 16", rejected("h", "i"))
    );
    let notes = table("Table V (b)").notes.join(" ");
    let of_c = format!(
        "c (virtualbox on i686 ubuntu) against b: {} of 16",
        rejected("b", "c")
    );
    for said in [of_c.as_str(), "It is taken for i"] {
        assert!(notes.contains(said), "{said}: {notes}");
    }
}

#[test]
fn each_control_and_each_part_of_its_table_has_an_id_of_its_own() {
    let natives = ["a", "b"].map(|os| format!("x86-{os}-native"));
    let dockers = ["a", "b", "c", "d", "e", "f", "g", "h", "i"].map(|os| format!("x86-{os}-docker"));
    let slugs = natives.into_iter().chain(dockers);
    let scenarios: Vec<Scenario> = slugs
        .map(|slug| Scenario::measured(Box::leak(slug.into_boxed_str()), &[0.1]))
        .collect();
    let report = report_of(&Synthetic::new(&scenarios));
    let tables = report.present().tables;
    let ids: Vec<&str> = tables.iter().map(|table| table.id.as_str()).collect();
    let of_table_v: Vec<&str> = ids
        .iter()
        .copied()
        .filter(|id| id.starts_with("rejections-against-"))
        .collect();
    assert_eq!(
        of_table_v,
        [
            "rejections-against-control-1-a",
            "rejections-against-control-1-a-continued",
            "rejections-against-control-1-a-continued-2",
            "rejections-against-control-2-b",
            "rejections-against-control-2-b-continued",
            "rejections-against-control-2-b-continued-2",
        ]
    );
    assert_eq!(BTreeSet::from_iter(&ids).len(), ids.len(), "{ids:?}");
    let kebab = |it: char| it.is_ascii_lowercase() || it.is_ascii_digit() || it == '-';
    assert!(ids.iter().all(|id| id.chars().all(kebab)), "{ids:?}");
}

#[test]
fn what_is_no_scenario_of_the_paper_has_no_count_of_it_beside() {
    let scenarios = [
        Scenario::measured("x86-debian-native", &[0.1, 0.1]),
        Scenario::measured("x86-debian-docker", &[0.2, 0.1]).by("docker"),
    ];
    let report = report_of(&Synthetic::new(&scenarios));
    let tables = report.present().tables;
    let headings = tables.iter().flat_map(|table| &table.columns);
    assert!(headings.clone().count() > 20);
    for column in headings {
        assert!(!column.heading.contains("paper"), "{}", column.heading);
    }
    let text = report.present().markdown().replace('\n', " ");
    assert!(
        text.contains("None of the paper's scenarios is in this run"),
        "{text}"
    );

    let some = [
        Scenario::measured("arm64-ubuntu-native", &[0.1, 0.1]),
        Scenario::measured("arm64-ubuntu-docker", &[0.2, 0.1]).by("docker"),
    ];
    let report = report_of(&Synthetic::new(&some));
    let text = report.present().markdown().replace('\n', " ");
    assert!(
        text.contains("Its scenarios a, b, c, d, e, f, i are not in this run"),
        "{text}"
    );
}

#[test]
fn a_node_that_is_odd_is_the_first_of_its_table_and_tested_against_all_others() {
    let levels = [
        ("i686-ubuntu-n1-native", [0.1, 0.1001, 0.0999, 0.1002]),
        ("i686-ubuntu-n2-native", [0.1001, 0.1, 0.1002, 0.0999]),
        ("i686-ubuntu-n3-native", [0.112, 0.1121, 0.1119, 0.112]),
        ("i686-ubuntu-n4-native", [0.0998, 0.1001, 0.1, 0.1]),
    ];
    let scenarios = levels.map(|(slug, levels)| Scenario::measured(slug, &levels));
    let report = report_of(&Synthetic::new(&scenarios));
    let nodes: Vec<_> = report.conclusions.iter().filter(|it| it.axis == "node").collect();
    assert!(nodes.iter().all(|it| it.first == "the other nodes"), "{nodes:?}");
    let odd = nodes.iter().find(|it| it.second == "n3").unwrap();
    // Twelve windows of the others and four of its own: C(16, 4) labellings, and one of them is as extreme.
    assert_eq!((odd.test.labellings, odd.smallest_p), (1820, 1.0 / 1820.0));
    assert!((odd.shift.value - 0.024).abs() < 0.001, "{odd:?}");
    assert_eq!((odd.test.p, odd.p_holm), (1.0 / 1820.0, 4.0 / 1820.0));
    let presented = report.present();
    let table = presented.tables.iter().find(|it| it.id == "nodes").unwrap();
    assert_eq!(table.rows[0][1], "n3");
    assert_eq!(table.rows.len(), 4);
    assert!(presented.tables.iter().all(|it| it.id != "conclusions"));
}

#[test]
fn the_papers_two_conclusions_are_tests_of_their_own() {
    let report = report_of(&all_measured());
    let find = |first: &str, second: &str| {
        let found = report
            .conclusions
            .iter()
            .find(|one| one.first == first && one.second == second);
        found.unwrap_or_else(|| panic!("{first} {second}"))
    };
    let docker = find("virtualbox", "docker");
    assert_eq!((docker.axis, docker.hardware_differs), ("virtualization", false));
    let strata: Vec<_> = docker
        .strata
        .iter()
        .map(|it| (it.name.as_str(), it.n, it.m))
        .collect();
    assert_eq!(strata, [("i7 osx", 4, 4), ("arm64 ubuntu", 4, 4)]);
    assert_eq!((docker.test.labellings, docker.smallest_p), (4900, 2.0 / 4900.0));
    // Half of what the levels of d and f and of g and i differ by, on two axes.
    assert!(docker.shift.value > 0.01 && docker.test.p < 0.05, "{docker:?}");

    let osx = find("ubuntu", "osx");
    assert_eq!((osx.axis, osx.hardware_differs), ("os", true));
    let strata: Vec<_> = osx
        .strata
        .iter()
        .map(|it| (it.name.as_str(), it.a.concat(), it.b.concat()))
        .collect();
    assert_eq!(
        strata,
        [
            ("virtualbox", "ci".to_owned(), "f".to_owned()),
            ("docker", "g".to_owned(), "d".to_owned())
        ]
    );
    let text = report.present().markdown().replace('\n', " ");
    for said in ["it may be the hardware that differs", "on one machine"] {
        assert!(
            text.split_whitespace()
                .collect::<Vec<_>>()
                .join(" ")
                .contains(said),
            "{text}"
        );
    }
    let json = json_of(&report);
    assert_eq!(
        json["conclusions"].as_array().unwrap().len(),
        report.conclusions.len()
    );
}

#[test]
fn the_papers_tables_in_latex() {
    insta::assert_snapshot!(report_of(&Synthetic::new(&nine())).present().latex());
}

#[test]
fn the_report_as_json() {
    let scenarios = [
        Scenario::measured("x86-debian-native", &[0.1, 0.1]),
        Scenario::measured("x86-debian-docker", &[0.2]).by("docker"),
        Scenario::infeasible("x86-debian-virtualbox", "no VBoxManage"),
        Scenario::ended("arm-debian-native", Outcome::Errored, "host unreachable"),
        Scenario {
            outcome: None,
            not_selected: Some("not selected by `--only a`"),
            ..Scenario::measured("arm-debian-docker", &[])
        },
    ];
    let json = json_of(&report_of(&Synthetic::new(&scenarios)));
    insta::assert_snapshot!(serde_json::to_string_pretty(&json).unwrap());
}

#[test]
fn four_windows_give_six_pairs_and_two_scenarios_sixteen() {
    let report = report_of(&Synthetic::new(&nine()));
    let count = |a, b| report.tally(a, b).map(|tally| (tally.pairs, tally.rejected));
    assert_eq!(count("b", "b"), Some((6, 0)));
    assert_eq!(count("c", "c"), Some((6, 3)), "one window of c is apart");
    assert_eq!(count("b", "h"), Some((16, 0)));
    assert_eq!(count("b", "d"), Some((16, 16)));
    assert_eq!(count("d", "b"), Some((16, 16)), "in either order");
    assert_eq!(count("b", "g"), Some((8, 8)), "g has two windows");
    assert_eq!(count("b", "f"), None, "no data is not no change");
}

#[test]
fn the_first_period_of_a_run_is_left_out_and_of_its_other_windows_not() {
    let synthetic = Synthetic::new(&nine());
    let sizes = |report: &Report| {
        report
            .samples
            .iter()
            .take(4)
            .map(|s| s.values.len())
            .collect::<Vec<_>>()
    };
    let run = reports::load(synthetic.directory.path()).unwrap();
    assert_eq!(
        sizes(&analyse(&run, Traffic::default(), &ReportSettings::default())),
        [29, 30, 30, 30]
    );
    let settings = ReportSettings {
        discard_periods: 3,
        ..ReportSettings::default()
    };
    assert_eq!(
        sizes(&analyse(&run, Traffic::default(), &settings)),
        [27, 30, 30, 30]
    );
}

/// A log that is as the first for so many periods, of ten steps each, and then as the second.
fn turning(first: &str, periods: usize, second: &str) -> String {
    // The header is a line too.
    let lines = 1 + 10 * periods;
    let begins = first.split_inclusive('\n').take(lines);
    begins.chain(second.split_inclusive('\n').skip(lines)).collect()
}

#[test]
fn what_a_window_warms_up_is_flagged_and_cut_only_if_asked() {
    let synthetic = Synthetic::new(&[Scenario::measured("x86-debian-native", &[0.1, 0.1, 0.1])]);
    let log = turning(&log(1, 0.3, 8), 5, &log(1, 0.1, 7));
    synthetic.write_window("x86-debian-native", 2, &log);
    let run = reports::load(synthetic.directory.path()).unwrap();
    let report_with = |warm_up| {
        let settings = ReportSettings {
            warm_up,
            ..ReportSettings::default()
        };
        analyse(&run, Traffic::default(), &settings)
    };

    let flagged = report_with(WarmUp::Flag);
    let sizes = |report: &Report| report.samples.iter().map(|s| s.values.len()).collect::<Vec<_>>();
    assert_eq!(sizes(&flagged), [29, 30, 30]);
    let within = flagged.scenarios[0].within.clone().unwrap();
    assert_eq!(within.cut, []);
    assert_eq!(within.unsteady[0].1.warm_up, Some(5.0));

    let cut = report_with(WarmUp::Cut);
    assert_eq!(sizes(&cut), [29, 25, 30]);
    assert_eq!(
        (&cut.samples[0], &cut.samples[2]),
        (&flagged.samples[0], &flagged.samples[2])
    );
    assert_eq!(cut.samples[1].first_value, 6);
    let within = cut.scenarios[0].within.clone().unwrap();
    assert_eq!((within.cut, within.unsteady), (vec![(2, 5)], vec![]));
    let markdown = cut.present().markdown();
    for said in [
        "a window 2: warmed up, 5 periods more were cut",
        "in which a window warms up (MSER)",
    ] {
        let words = markdown.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(words.contains(said), "{markdown}");
    }
}

#[test]
fn a_step_in_the_middle_is_no_warm_up_and_nothing_is_cut_for_it() {
    let synthetic = Synthetic::new(&[Scenario::measured("x86-debian-native", &[0.1, 0.1, 0.1])]);
    let log = turning(&log(1, 0.1, 7), 15, &log(1, 0.3, 8));
    synthetic.write_window("x86-debian-native", 2, &log);
    let run = reports::load(synthetic.directory.path()).unwrap();
    let settings = ReportSettings {
        warm_up: WarmUp::Cut,
        ..ReportSettings::default()
    };
    let report = analyse(&run, Traffic::default(), &settings);
    let within = report.scenarios[0].within.clone().unwrap();
    assert_eq!(within.cut, []);
    assert!(within.unsteady.iter().all(|(_, found)| found.warm_up.is_none()));
    assert_eq!(within.unseen, []);
}

#[test]
fn what_could_not_be_looked_at_is_not_called_steady() {
    let synthetic = Synthetic::new(&[Scenario::measured("x86-debian-native", &[0.1, 0.1])]);
    let run = reports::load(synthetic.directory.path()).unwrap();
    let settings = ReportSettings {
        discard_periods: 27,
        ..ReportSettings::default()
    };
    let mut report = analyse(&run, Traffic::default(), &settings);
    let words = |report: &Report| {
        let markdown = report.present().markdown();
        markdown.split_whitespace().collect::<Vec<_>>().join(" ")
    };
    let said = words(&report);
    assert!(
        said.contains("a: no warm-up could be looked for in window 1 (fewer than 4 periods)."),
        "{said}"
    );
    let within = report.scenarios[0].within.as_ref().unwrap();
    assert!(within.is_looked_at(), "the second window was");

    let within = report.scenarios[0].within.as_mut().unwrap();
    within.unseen = (1..=2)
        .flat_map(|window| Look::ALL.map(|look| (window, look, Unseen::FewBlocks(12))))
        .collect();
    assert!(!within.is_looked_at());
}

#[test]
fn each_metric_is_what_its_name_says() {
    // e_x = 0.1 and e_y = −0.1 at each step, up to the noise that all metrics share.
    let run = reports::load(Synthetic::new(&nine()).directory.path()).unwrap();
    let first = |metric| {
        let settings = ReportSettings {
            metric,
            ..ReportSettings::default()
        };
        analyse(&run, Traffic::default(), &settings).samples[0].values[0]
    };
    let x = first(Metric::MeanAbsX);
    assert!((0.09..0.11).contains(&x), "{x}");
    for (metric, factor) in [
        (Metric::MeanAbsY, 1.0),
        (Metric::MeanAbsSum, 2.0),
        (Metric::MeanDistance, 2_f64.sqrt()),
        (Metric::RootMeanSquare, 2_f64.sqrt()),
    ] {
        assert!((first(metric) - factor * x).abs() < 1e-12, "{metric:?}");
    }
}

#[test]
fn invalid_and_broken_windows_are_listed_and_never_counted() {
    let synthetic = Synthetic::new(&nine());
    let b = "i686-ubuntu-native";
    synthetic.edit_window(b, 1, |record| {
        record.verdict = Verdict::Invalid;
        record.reasons = vec!["21 % of the steps were late".to_owned()];
    });
    synthetic.edit_window(b, 2, |record| {
        record.verdict = Verdict::Suspect;
        record.reasons = vec!["the wall clock jumped by 2 s".to_owned()];
    });
    std::fs::remove_file(synthetic.directory.window(b, 3).path().join("window.json")).unwrap();
    let report = report_of(&synthetic);
    assert_eq!(
        report.tally("b", "b").map(|tally| tally.pairs),
        Some(1),
        "windows 2 and 4"
    );
    let windows: Vec<_> = report.scenarios[1]
        .windows
        .iter()
        .map(|w| (w.verdict, w.n))
        .collect();
    assert_eq!(
        windows,
        [("invalid", 0), ("suspect", 30), ("broken", 0), ("valid", 30)]
    );
    let markdown = report.present().markdown();
    for line in [
        "  - window 1 invalid, not counted: 21 % of the steps were late",
        "  - window 2 suspect, counted: the wall clock jumped by 2 s",
        "  - window 3 broken, not counted: window.json is missing, so it was never",
    ] {
        assert!(markdown.contains(line), "{line}\n{markdown}");
    }
    let latex = report.present().latex();
    let note = "Not valid: b window 1 invalid, not counted; b window 2 suspect, counted.";
    for text in [&markdown, &latex] {
        let spaced = text.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(spaced.contains(note), "{text}");
    }
    for words in [
        "window 1 invalid, not counted: 21 \\% of the steps were late",
        "window 2 suspect, counted: the wall clock jumped by 2 s",
    ] {
        assert!(latex.contains(words), "{words}\n{latex}");
    }
}

#[test]
fn an_incomplete_window_is_broken() {
    let synthetic = Synthetic::new(&nine());
    synthetic.edit_window("i686-ubuntu-native", 4, |record| {
        record.complete = false;
        record.loops_mut().unwrap().steps_done = 120;
    });
    let window = &report_of(&synthetic).scenarios[1].windows[3];
    assert_eq!(
        (window.verdict, window.reasons.join("")),
        ("broken", "120 of 300 steps were done".to_owned())
    );
}

#[test]
fn what_was_computed_is_said_first() {
    let scenarios = [Scenario::measured("x86-debian-native", &[0.1, 0.1]).by("fake")];
    let report = report_of(&Synthetic::new(&scenarios));
    assert_eq!(json_of(&report)["simulated"], json!(true));
    assert_eq!(json_of(&report)["scenarios"][0]["simulated"], json!(true));
    let markdown = report.present().markdown();
    let first = markdown.lines().nth(2).unwrap();
    assert!(first.starts_with("Simulated, not measured: "), "{first}");
    assert!(
        markdown.contains("\n> **SIMULATED, NOT MEASURED: scenario a was computed"),
        "{markdown}"
    );
    assert!(
        report
            .present()
            .latex()
            .contains("\\textbf{SIMULATED, NOT MEASURED")
    );
}

#[test]
fn what_another_provider_made_up_is_simulated_if_the_plan_says_so_and_it_was_begun() {
    let not_begun = Scenario {
        not_selected: Some("left out by `--skip b`"),
        ..Scenario::measured("x86-debian-played", &[])
    };
    let scenarios = [Scenario::measured("x86-debian-native", &[0.1, 0.1]), not_begun];
    let synthetic = Synthetic::new(&scenarios);
    assert_eq!(json_of(&report_of(&synthetic))["simulated"], json!(false));
    let simulated = |scenario: usize| {
        let path = synthetic.directory.plan().path();
        let mut plan: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
        plan["scenarios"][scenario]["simulated"] = json!(true);
        synthetic.write_json(path, &plan);
        json_of(&report_of(&synthetic))["simulated"].clone()
    };
    assert_eq!(simulated(1), json!(false));
    assert_eq!(simulated(0), json!(true));
}

#[test]
fn what_the_operating_system_refused_the_loops_is_said() {
    let synthetic = Synthetic::new(&[Scenario::measured("x86-debian-native", &[0.1, 0.1])]);
    let path = synthetic.directory.environment("x86-debian-native").path();
    let mut record: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    record["platform"] = json!({"of a": "later version", "realtime": {
        "priority_asked": 80, "priority_granted": 0, "priority_refusal": "EPERM: Operation not permitted",
        "lock_asked": true, "locked": true, "lock_refusal": null
    }});
    synthetic.write_json(path, &record);
    let report = report_of(&synthetic);
    assert_eq!(
        report.scenarios[0].environment.as_ref().unwrap().remarks(),
        ["real-time priority 80 was asked for and 0 granted: EPERM: Operation not permitted"]
    );
    assert!(
        report
            .present()
            .markdown()
            .contains("  - real-time priority 80 was asked for and 0 granted: EPERM")
    );
}

#[test]
fn windows_too_short_to_be_told_apart_are_said_to_be() {
    let synthetic = Synthetic::new(&nine());
    let run = reports::load(synthetic.directory.path()).unwrap();
    let settings = ReportSettings {
        alpha: 1e-30,
        ..ReportSettings::default()
    };
    let report = analyse(&run, Traffic::default(), &settings);
    assert!(
        report.present().remarks[1].contains("such windows are never told apart"),
        "{:?}",
        report.present().remarks
    );
}

#[test]
fn without_a_baseline_the_tables_say_what_is_missing() {
    let scenarios = [Scenario::measured("x86-debian-docker", &[0.1, 0.1])];
    let markdown = report_of(&Synthetic::new(&scenarios)).present().markdown();
    let unwrapped = markdown.replace('\n', " ");
    assert!(unwrapped.contains(
        "Nothing to compare with: no scenario is what `report.baseline` asks for (virtualization: native)"
    ));
    assert!(unwrapped.contains("No two virtualizations on one platform besides the baseline"));
}

#[test]
fn a_journal_that_a_crash_cut_still_gives_a_report_with_a_remark() {
    let scenarios = nine();
    let synthetic = Synthetic::new(&scenarios);
    let path = synthetic.directory.journal().path();
    let journal = std::fs::read_to_string(&path).unwrap();
    std::fs::write(&path, &journal[..journal.len() - 10]).unwrap();
    let report = report_of(&synthetic);
    assert!(
        report.present().remarks[0].contains("events.jsonl is cut"),
        "{:?}",
        report.present().remarks
    );
}

#[test]
fn the_last_word_of_the_journal_on_a_scenario_counts() {
    let scenarios = [Scenario::ended(
        "x86-debian-native",
        Outcome::Errored,
        "no space left",
    )];
    let synthetic = Synthetic::new(&scenarios);
    let mut events = journal(&scenarios);
    let scenario = "x86-debian-native".to_owned();
    events.push(Event::RunStarted {
        pid: 2,
        resumed: true,
        manifest_sha256: None,
        plan_sha256: None,
    });
    events.push(Event::ScenarioStarted {
        scenario: scenario.clone(),
        windows: vec![1],
        round: None,
    });
    synthetic.write_journal(&events);
    assert_eq!(report_of(&synthetic).scenarios[0].standing.name(), "unfinished");
    events.push(Event::ScenarioFinished {
        scenario,
        outcome: Outcome::Completed,
        reason: None,
        hint: None,
        round: None,
    });
    synthetic.write_journal(&events);
    assert_eq!(report_of(&synthetic).scenarios[0].standing.name(), "completed");
}

#[test]
fn how_late_the_emulator_let_packets_go_is_a_table_of_the_worst_window_that_counts() {
    let synthetic = Synthetic::new(&nine());
    let b = "i686-ubuntu-native";
    assert!(
        !report_of(&synthetic)
            .present()
            .markdown()
            .contains("network emulator")
    );
    for (window, mean_ns, max_ns) in [(1, 40_000.0, 2_000_000), (2, 60_000.0, 5_000_000)] {
        synthetic.edit_window(b, window, |record| {
            record.releases = Some(ReleaseRecord {
                released: 1000,
                lateness_mean_ns: mean_ns,
                lateness_p99_ns: 100_000,
                lateness_p999_ns: 300_000,
                lateness_max_ns: max_ns,
            });
        });
    }
    let report = report_of(&synthetic);
    let markdown = report.present().markdown();
    let row = markdown
        .lines()
        .find(|line| line.contains("| b |") && line.contains("5.000"))
        .unwrap_or_else(|| panic!("{markdown}"));
    let cells: Vec<&str> = row.split('|').map(str::trim).collect();
    assert_eq!(cells[3..7], ["0.050", "0.100", "0.300", "5.000"], "{row}");
    assert_eq!(
        json_of(&report)["scenarios"][1]["health"]["releases"]["released"],
        json!(2000)
    );
}

/// The report, on one line, of a run where the workload saw that of one platform.
fn told_of(platform: Value) -> String {
    let synthetic = Synthetic::new(&nine());
    let path = synthetic.directory.environment("i686-ubuntu-native").path();
    let mut record: EnvironmentRecord = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    record.platform = serde_json::from_value(platform).unwrap();
    std::fs::write(&path, serde_json::to_vec(&record).unwrap()).unwrap();
    let markdown = report_of(&synthetic).present().markdown();
    markdown.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[test]
fn a_platform_that_changed_while_it_was_measured_is_told() {
    let told = told_of(json!({
        "changes": [{"what": "cpu_governor", "before": "performance", "after": "powersave"}],
    }));
    assert!(
        told.contains(
            "the platform changed while it was measured: cpu_governor was `performance` and is `powersave`"
        ),
        "{told}"
    );
}

#[test]
fn scenarios_of_a_host_that_ended_on_different_nodes_are_told() {
    let synthetic = Synthetic::new(&nine());
    for (slug, node) in [
        ("i686-ubuntu-native", "n1"),
        ("i686-ubuntu-virtualbox", "n2"),
        ("i7-osx-docker", "n1"),
    ] {
        let path = synthetic.directory.environment(slug).path();
        let mut record: EnvironmentRecord = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
        record.host = "cluster".to_owned();
        record.facts.insert("node".to_owned(), json!(node));
        std::fs::write(&path, serde_json::to_vec(&record).unwrap()).unwrap();
    }
    let markdown = report_of(&synthetic).present().markdown();
    let told = markdown
        .split_whitespace()
        .filter(|word| *word != ">")
        .collect::<Vec<_>>()
        .join(" ");
    assert!(
        told.contains("DIFFERENT NODES: the scenarios of host cluster ended on n1 (b, d) and n2 (c)"),
        "{told}"
    );
}

#[test]
fn a_workload_for_another_machine_than_the_kernels_is_told() {
    let said = "the workload is a program for i686, on a kernel for x86_64";
    let told = told_of(json!({"machine": "x86_64", "workload_machine": "i686"}));
    assert!(told.contains(said), "{told}");
    for alike in [
        json!({"machine": "i686", "workload_machine": "i686"}),
        json!({"machine": "x86_64", "workload_machine": null}),
        json!({"machine": "x86_64"}),
    ] {
        assert!(!told_of(alike).contains("is a program for"));
    }
}

/// Three scenarios, the links of the last of which are slower.
fn with_another_network(family: Value) -> Report {
    let synthetic = Synthetic::new(&[
        Scenario::measured("x86-debian-native", &[0.1, 0.1001, 0.0999, 0.1]),
        Scenario::measured("x86-debian-docker", &[0.1, 0.1002, 0.0999, 0.1001]),
        Scenario::measured("x86-ubuntu-docker", &[0.2, 0.2001, 0.1999, 0.2]),
    ]);
    let edit = |path: std::path::PathBuf, edit: &dyn Fn(&mut Value)| {
        let mut value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
        edit(&mut value);
        synthetic.write_json(path, &value);
    };
    edit(synthetic.directory.plan().path(), &|plan| {
        plan["scenarios"][2]["settings"]["network"]["delay"] = json!("20ms");
    });
    edit(synthetic.directory.manifest().path(), &|manifest| {
        manifest["report"]["family"] = family.clone();
    });
    report_of(&synthetic)
}

#[test]
fn scenarios_over_other_networks_are_marked_wherever_they_are_compared_and_left_out_of_the_family() {
    let report = with_another_network(json!("all"));
    let json = json_of(&report);
    let fields = json!(["network.delay"]);
    assert_eq!(
        json["unlike"],
        json!([{"a": "a", "b": "c", "fields": fields}, {"a": "b", "b": "c", "fields": fields}])
    );
    for kind in ["between", "comparisons"] {
        for one in json[kind].as_array().unwrap() {
            let marked = one["b"] == "c" && one["a"] != "c";
            assert_eq!(
                one["unlike"],
                if marked { fields.clone() } else { json!([]) },
                "{one}"
            );
        }
    }
    let family: Vec<_> = report
        .contrasts
        .pairs
        .iter()
        .map(|pair| (&*pair.a, &*pair.b))
        .collect();
    assert_eq!(family, [("a", "b")]);

    let markdown = report.present().markdown();
    assert!(
        markdown.contains("NOT THE SAME EXPERIMENT: a / c, b / c differ in network.delay"),
        "{markdown}"
    );
    assert!(markdown.contains("16 of 16 *"), "{markdown}");
    assert!(markdown.contains("0 of 16 |"), "{markdown}");
    assert!(markdown.contains("* Not the same experiment"), "{markdown}");
}

#[test]
fn a_pair_that_is_named_is_in_the_family_whatever_it_ran() {
    let report = with_another_network(json!([["a", "c"]]));
    let [pair] = &report.contrasts.pairs[..] else {
        panic!("{:?}", report.contrasts.pairs)
    };
    assert_eq!((&*pair.a, &*pair.b), ("a", "c"));
    assert_eq!(
        json_of(&report)["contrasts"][0]["unlike"],
        json!(["network.delay"])
    );
}

#[test]
fn what_ran_the_same_experiment_has_no_mark() {
    let report = report_of(&Synthetic::new(&nine()));
    assert!(
        report.setup_differences.is_empty(),
        "{:?}",
        report.setup_differences
    );
    let markdown = report.present().markdown();
    assert!(
        !markdown.contains(" * |") && !markdown.contains("NOT THE SAME"),
        "{markdown}"
    );
}

#[test]
fn how_large_the_differences_are_comes_before_any_count() {
    let synthetic = Synthetic::new(&nine());
    let run = reports::load(synthetic.directory.path()).unwrap();
    let report = analyse(&run, Traffic::default(), &run.manifest.report);
    let page = report.present();
    assert_eq!(page.tables[0].id, "shifts");
    let markdown = page.markdown();
    assert!(markdown.find("b–d  +43.091").unwrap() < markdown.find("Table III").unwrap());
    let figures = figure::draw(&run, &report, figure::Layout::default()).unwrap();
    assert_eq!(figures[0].kind, figure::Kind::Forest);
    let html = page.html(&figures);
    assert!(html.find("id=\"shifts\"").unwrap() < html.find("id=\"heatmap\"").unwrap());
}

#[test]
fn what_depends_on_its_neighbours_is_remarked_on() {
    let mut report = report_of(&all_measured());
    let remarks = |report: &Report| report.present().remarks.join("\n");
    assert!(!remarks(&report).contains("DEPEND"), "{}", remarks(&report));
    let within = report.scenarios[1].within.as_mut().unwrap();
    within.dependence = Some(Dependence {
        autocorrelation: vec![0.82],
        time: 18.0,
        n: 240,
        effective: 240.0 / 18.0,
    });
    report.contrasts.serial = Some(SerialDependence {
        lag_one: 0.6,
        p: 0.0004,
        windows: 28,
    });
    let remarks = remarks(&report);
    for said in [
        "VALUES WITHIN WINDOWS DEPEND ON EACH OTHER in b: of b the 240 values are worth 13 (lag 1 +0.82).",
        "SUCCESSIVE WINDOWS RESEMBLE EACH OTHER: over all scenarios, 28 windows correlate with the next one by +0.60 (p = 0.0004)",
    ] {
        assert!(remarks.contains(said), "{remarks}");
    }
}

#[test]
fn what_was_chosen_when_the_data_was_known_is_said_first() {
    let synthetic = Synthetic::new(&nine());
    let run = reports::load(synthetic.directory.path()).unwrap();
    let settings = ReportSettings {
        alpha: 0.2,
        metric: Metric::MeanAbsX,
        warm_up: WarmUp::Cut,
        ..run.manifest.report.clone()
    };
    let report = analyse(&run, Traffic::default(), &settings);
    let first = report.present().remarks[0].clone();
    for said in [
        "DIFFERS FROM WHAT WAS DECLARED",
        "alpha (`0.2`",
        "metric (`mean-abs-x`",
        "warm_up (`cut`",
    ] {
        assert!(first.contains(said), "{first}");
    }
}
