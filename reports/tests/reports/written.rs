//! What a report leaves in the run directory.

use std::{collections::BTreeMap, fs, path::Path};

use captures::traffic::Traffic;
use polars::prelude::{ParquetReader, SerReader};
use record::{
    report_settings::{DrawnPair, ReportSettings},
    settings::NetworkBackend,
};
use reports::{
    analyse,
    present::figure::{self, Kind, Layout},
};

use crate::synthetic::{Scenario, Synthetic};

fn two_scenarios() -> Synthetic {
    Synthetic::new(&[
        Scenario::measured("x86-debian-native", &[0.1, 0.1, 0.1, 0.1]),
        Scenario::measured("x86-debian-docker", &[0.102, 0.103, 0.104, 0.11]).by("docker"),
        Scenario::infeasible("x86-debian-virtualbox", "no VBoxManage"),
    ])
}

fn write(synthetic: &Synthetic, settings: &ReportSettings) {
    let run = reports::load(synthetic.directory.path()).unwrap();
    reports::write(
        &run,
        &analyse(&run, Traffic::default(), settings),
        Layout::default(),
    )
    .unwrap();
}

/// Every file below a folder, with its content.
fn tree(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for entry in fs::read_dir(next).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(folder).unwrap().display().to_string();
                files.insert(name, fs::read(&path).unwrap());
            }
        }
    }
    files
}

#[test]
fn a_report_is_written_whole_and_nothing_else_is_touched() {
    let synthetic = two_scenarios();
    let before = tree(synthetic.directory.path());
    write(&synthetic, &ReportSettings::default());
    let mut after = tree(synthetic.directory.path());
    let written: Vec<String> = after
        .keys()
        .filter(|name| !before.contains_key(*name))
        .cloned()
        .collect();
    assert_eq!(
        written,
        [
            "report/comparisons.csv",
            "report/comparisons.parquet",
            "report/contrasts.csv",
            "report/contrasts.parquet",
            "report/figures.tex",
            "report/figures/cdf-a-b.pdf",
            "report/figures/cdf-a-b.svg",
            "report/figures/cdf-a-b.tex",
            "report/figures/control-loop-a.pdf",
            "report/figures/control-loop-a.svg",
            "report/figures/control-loop-a.tex",
            "report/figures/forest.pdf",
            "report/figures/forest.svg",
            "report/figures/forest.tex",
            "report/figures/histogram-a-b.pdf",
            "report/figures/histogram-a-b.svg",
            "report/figures/histogram-a-b.tex",
            "report/figures/ks-test.pdf",
            "report/figures/ks-test.svg",
            "report/figures/ks-test.tex",
            "report/figures/topology-a.pdf",
            "report/figures/topology-a.svg",
            "report/figures/topology-a.tex",
            "report/figures/trajectory-a.pdf",
            "report/figures/trajectory-a.svg",
            "report/figures/trajectory-a.tex",
            "report/figures/trajectory-b.pdf",
            "report/figures/trajectory-b.svg",
            "report/figures/trajectory-b.tex",
            "report/packets.csv",
            "report/packets.parquet",
            "report/report.html",
            "report/report.json",
            "report/samples.csv",
            "report/samples.parquet",
            "report/scenarios.csv",
            "report/scenarios.parquet",
            "report/tables.md",
            "report/tables.tex",
            "report/tables/conclusions.tex",
            "report/tables/controls-and-virtualizations.tex",
            "report/tables/counts-by-blocks.tex",
            "report/tables/effects.tex",
            "report/tables/environment-differences.tex",
            "report/tables/rejections-against-control-1-a.tex",
            "report/tables/rejections-within-each-scenario.tex",
            "report/tables/schedule.tex",
            "report/tables/shifts.tex",
            "report/tables/the-family-of-comparisons.tex",
            "report/tables/the-layers-of-a-robot-simulation.tex",
            "report/tables/the-scenarios.tex",
            "report/tables/the-window-as-the-unit.tex",
            "report/tables/within-the-windows.tex",
        ]
    );
    after.retain(|name, _| before.contains_key(name));
    assert_eq!(before, after);
}

#[test]
fn the_same_run_gives_the_same_report_byte_for_byte() {
    let synthetic = two_scenarios();
    write(&synthetic, &ReportSettings::default());
    let first = tree(&synthetic.directory.report().path());
    write(&synthetic, &ReportSettings::default());
    let second = tree(&synthetic.directory.report().path());
    // By name first: a difference in bytes is hard to read.
    for (name, bytes) in &first {
        assert!(second.get(name) == Some(bytes), "{name}");
    }
    assert_eq!(first.len(), second.len());
}

#[test]
fn figures_and_tables_of_an_earlier_report_are_removed_and_other_files_are_not() {
    let synthetic = two_scenarios();
    write(&synthetic, &ReportSettings::default());
    let figures = synthetic.directory.report().path().join("figures");
    fs::write(figures.join("mine.svg"), "mine").unwrap();
    let tables = synthetic.directory.report().path().join("tables");
    fs::write(tables.join("mine.tex"), "\\section{Mine}").unwrap();
    fs::rename(
        tables.join("within-the-windows.tex"),
        tables.join("rejections-continued.tex"),
    )
    .unwrap();
    let pair = |a: &str, b: &str| DrawnPair(a.parse().unwrap(), b.parse().unwrap());
    let settings = ReportSettings {
        figures: vec![
            pair("b", "x86-debian-docker"),
            pair("b/2", "a/1"),
            pair("a/1", "b/2"),
            pair("a", "nowhere"),
            pair("a/5", "b"),
        ],
        ..ReportSettings::default()
    };
    write(&synthetic, &settings);
    let names: Vec<String> = tree(&figures)
        .into_keys()
        .filter(|name| !name.ends_with(".pdf"))
        .collect();
    let expected = [
        "cdf-a1-b2.svg",
        "cdf-a1-b2.tex",
        "cdf-b-b.svg",
        "cdf-b-b.tex",
        "control-loop-a.svg",
        "control-loop-a.tex",
        "forest.svg",
        "forest.tex",
        "histogram-a1-b2.svg",
        "histogram-a1-b2.tex",
        "histogram-b-b.svg",
        "histogram-b-b.tex",
        "ks-test.svg",
        "ks-test.tex",
        "mine.svg",
        "topology-a.svg",
        "topology-a.tex",
        "trajectory-a.svg",
        "trajectory-a.tex",
        "trajectory-b.svg",
        "trajectory-b.tex",
    ];
    assert_eq!(names, expected);
    let names = tree(&tables);
    assert!(names.contains_key("mine.tex") && names.contains_key("within-the-windows.tex"));
    assert!(!names.contains_key("rejections-continued.tex"));
    let run = reports::load(synthetic.directory.path()).unwrap();
    let remarks = analyse(&run, Traffic::default(), &settings).present().remarks;
    assert!(
        remarks[0].starts_with("DIFFERS FROM WHAT WAS DECLARED: figures"),
        "{remarks:?}"
    );
    assert_eq!(
        remarks[1..3],
        [
            "`report.figures` names `nowhere`, which is no scenario's letter or slug.",
            "`report.figures` names `a/5`, and there is no window 5 of it that counts: the pair is not drawn.",
        ]
    );
}

#[test]
fn the_csv_has_a_line_for_each_comparison_and_for_each_period() {
    let synthetic = two_scenarios();
    write(&synthetic, &ReportSettings::default());
    let read = |name| fs::read_to_string(synthetic.directory.report().path().join(name)).unwrap();
    let comparisons = read("comparisons.csv");
    assert_eq!(
        comparisons.lines().count(),
        1 + 28,
        "8 windows, every two of them"
    );
    let mut lines = comparisons.lines();
    assert_eq!(
        lines.next().unwrap(),
        "a,a_slug,a_window,b,b_slug,b_window,n,m,d,h,lcm,p,log10_p,signed_d,at,method,alpha,rejected,unlike,\
         same_scenario,a_hardware,b_hardware,a_os,b_os,a_virtualization,b_virtualization,a_platform,b_platform,a_is_control,\
         b_is_control,a_paper,b_paper"
    );
    assert!(
        lines
            .next()
            .unwrap()
            .starts_with("a,x86-debian-native,1,a,x86-debian-native,2,29,30,")
    );
    let samples = read("samples.csv");
    assert_eq!(samples.lines().count(), 1 + 2 * (29 + 3 * 30));
    assert!(
        samples.lines().nth(1).unwrap().starts_with("a,1,2,"),
        "the first period is left out"
    );
}

#[test]
fn the_parquet_reads_back_as_it_was_written() {
    let synthetic = two_scenarios();
    write(&synthetic, &ReportSettings::default());
    let file = fs::File::open(synthetic.directory.report().path().join("comparisons.parquet")).unwrap();
    let frame = ParquetReader::new(file).finish().unwrap();
    assert_eq!(frame.shape(), (28, 32));
    let rejected = frame.column("rejected").unwrap().bool().unwrap().sum();
    let csv = fs::read_to_string(synthetic.directory.report().path().join("comparisons.csv")).unwrap();
    assert_eq!(
        rejected,
        Some(
            csv.lines()
                .filter(|line| line.contains("exact,0.001,true,"))
                .count() as u32
        )
    );
}

#[test]
fn figures_and_their_captions_say_what_is_to_be_seen() {
    let synthetic = two_scenarios();
    write(&synthetic, &ReportSettings::default());
    let folder = synthetic.directory.report().path().join("figures");
    for (name, expected) in [
        (
            "cdf-a-b.svg",
            [
                "a x86-debian-native, window",
                "error of a period, mean |e_x| + mean |e_y| (m)",
                "D = ",
            ],
        ),
        (
            "cdf-a-b.tex",
            [
                "\\label{fig:cdf-a-b}",
                "of 16 window pairs are rejected",
                "the one of the median D",
            ],
        ),
        (
            "histogram-a-b.svg",
            ["b x86-debian-docker, window", "share of periods", "(m)"],
        ),
        (
            "histogram-a-b.tex",
            ["width=\\columnwidth", "mean 200 mm", "with the same bars"],
        ),
        ("trajectory-a.svg", ["x (m)", "target", "time (s)"]),
        ("control-loop-a.svg", ["10ms ± 1ms each", "controller", "U(s)"]),
        (
            "control-loop-a.tex",
            ["Scenarios a, b", "kp = $-1.312$", "at 10Hz"],
        ),
        (
            "topology-a.svg",
            ["10ms ± 1ms, 1% loss, 10Mbit/s", "1000 packets", "(emulated)"],
        ),
        ("ks-test.svg", ["F(x) of a", "G(x) of b", ">\nD\n<"]),
    ] {
        let text = fs::read_to_string(folder.join(name)).unwrap();
        for words in expected {
            assert!(text.contains(words), "{name}, {words}: {text}");
        }
    }
}

#[test]
fn the_network_is_drawn_from_the_settings_of_the_run_once_for_each_that_there_is() {
    let synthetic = two_scenarios();
    let mut run = reports::load(synthetic.directory.path()).unwrap();
    let network = &mut run.scenarios[1].planned.settings.network;
    network.backend = NetworkBackend::Mininet;
    network.loss = "2%".parse().unwrap();
    let report = analyse(&run, Traffic::default(), &run.manifest.report);
    let figures = figure::draw(&run, &report, Layout::default()).unwrap();
    let drawn = |name: &str| figures.iter().find(|figure| figure.name == name).unwrap();
    let of_mininet = &drawn("topology-b.svg").svg;
    for words in ["OpenFlow controller", "Open vSwitch", "2% loss"] {
        assert!(of_mininet.contains(words), "{words}");
        assert!(!drawn("topology-a.svg").svg.contains(words), "{words}");
    }
    let loops = figures.iter().filter(|figure| figure.kind == Kind::ControlLoop);
    assert_eq!(loops.count(), 1, "the loops are alike");
}

#[test]
fn figures_are_as_wide_as_the_place_that_they_are_drawn_for() {
    let synthetic = two_scenarios();
    let run = reports::load(synthetic.directory.path()).unwrap();
    let report = analyse(&run, Traffic::default(), &run.manifest.report);
    for (layout, width, float) in [
        (Layout::IeeeColumn, "252pt", "{figure}[tbp]"),
        (Layout::IeeePage, "516pt", "{figure*}[tbp]"),
        (Layout::LncsPage, "347pt", "{figure}[tbp]"),
        (Layout::Slide, "640pt", "{figure}[tbp]"),
    ] {
        for figure in figure::draw(&run, &report, layout).unwrap() {
            let size = format!("<svg width=\"{width}\" height=\"");
            assert!(figure.svg.starts_with(&size), "{layout:?}: {}", figure.name);
            assert!(
                figure::latex_float(&figure).contains(float),
                "{layout:?}: {}",
                figure.name
            );
        }
    }
    // The letters of a slide are twice as large as its drawing, which is in the units of a column.
    let slide = figure::draw(&run, &report, Layout::Slide).unwrap();
    assert!(
        slide[0].svg.contains("viewBox=\"0 0 3200 "),
        "{}",
        &slide[0].svg[..200]
    );
}

#[test]
fn without_names_the_papers_kinds_of_pairs_are_drawn_and_no_more_than_twelve() {
    let cdfs = |scenarios: &[Scenario]| -> (Vec<String>, Vec<String>) {
        let synthetic = Synthetic::new(scenarios);
        let run = reports::load(synthetic.directory.path()).unwrap();
        let report = analyse(&run, Traffic::default(), &run.manifest.report);
        let figures = figure::draw(&run, &report, Layout::default()).unwrap();
        let drawn = figures.iter().filter(|figure| figure.kind == Kind::Distributions);
        (
            drawn.map(|figure| figure.stem().to_owned()).collect(),
            report.present().remarks,
        )
    };
    let measured = |slug| Scenario::measured(slug, &[0.1, 0.11]);
    let (drawn, remarks) = cdfs(&[
        measured("x86-debian-docker"),
        measured("x86-debian-native"),
        measured("x86-osx-native"),
        measured("x86-osx-virtualbox"),
        measured("x86-osx-docker"),
    ]);
    assert_eq!(drawn, ["cdf-b-c", "cdf-a-b", "cdf-c-d", "cdf-c-e", "cdf-d-e"]);
    assert!(
        remarks.iter().all(|remark| !remark.contains("could be drawn")),
        "{remarks:?}"
    );

    let systems = ["a", "b", "c", "d", "e", "f"].map(|os| format!("x86-{os}-native"));
    let natives = systems.map(|slug| measured(Box::leak(slug.into_boxed_str())));
    let (drawn, remarks) = cdfs(&natives);
    assert_eq!(drawn.len(), 12);
    assert!(
        remarks[0].starts_with("15 pairs of scenarios could be drawn, and the first 12 are."),
        "{remarks:?}"
    );
}

#[test]
fn a_report_that_cannot_be_written_says_where() {
    let synthetic = two_scenarios();
    fs::write(
        synthetic.directory.report().path(),
        "a file where the folder belongs",
    )
    .unwrap();
    let run = reports::load(synthetic.directory.path()).unwrap();
    let error = reports::write(
        &run,
        &analyse(&run, Traffic::default(), &run.manifest.report),
        Layout::default(),
    )
    .unwrap_err();
    assert!(
        error.to_string().ends_with("report/figures cannot be written"),
        "{error}"
    );
}

#[test]
fn a_run_without_any_window_still_has_a_report() {
    let synthetic = Synthetic::new(&[Scenario::infeasible("x86-debian-virtualbox", "no VBoxManage")]);
    write(&synthetic, &ReportSettings::default());
    let csv = fs::read_to_string(synthetic.directory.report().path().join("comparisons.csv")).unwrap();
    assert_eq!(csv.lines().count(), 1);
}

/// The names between backticks in a section of docs/report-columns.md.
fn documented(section: &str) -> Vec<String> {
    let docs = include_str!("../../../docs/report-columns.md");
    let (_, rest) = docs.split_once(&format!("\n## {section}\n")).unwrap();
    let own = rest.split("\n## ").next().unwrap();
    own.split('`').skip(1).step_by(2).map(str::to_owned).collect()
}

fn fields(value: &serde_json::Value, found: &mut std::collections::BTreeSet<String>) {
    match value {
        serde_json::Value::Array(all) => all.iter().for_each(|one| fields(one, found)),
        serde_json::Value::Object(all) => {
            for (name, inner) in all {
                found.insert(name.clone());
                // What these hold is a user's, or of another file.
                if !["axes", "control", "facts", "platform", "declared"].contains(&name.as_str()) {
                    fields(inner, found);
                }
            }
        }
        _ => {}
    }
}

#[test]
fn the_docs_name_each_column_and_field_that_is_written_and_no_other_column() {
    let synthetic = two_scenarios();
    write(&synthetic, &ReportSettings::default());
    let folder = synthetic.directory.report().path();
    let mut files = 0;
    for name in tree(&folder).into_keys() {
        let Some(section) = name.strip_suffix(".csv") else {
            continue;
        };
        files += 1;
        let csv = fs::read_to_string(folder.join(&name)).unwrap();
        let columns: Vec<&str> = csv.lines().next().unwrap().split(',').collect();
        let documented = documented(section);
        for column in &columns {
            assert!(documented.iter().any(|it| it == column), "{name} has {column}");
        }
        let first_cells = include_str!("../../../docs/report-columns.md")
            .split_once(&format!("\n## {section}\n"))
            .and_then(|(_, rest)| rest.split("\n## ").next())
            .unwrap()
            .lines()
            .filter_map(|line| line.strip_prefix("| `"))
            .filter_map(|line| line.split(" |").next());
        for name in first_cells.flat_map(|cell| cell.split(", ")) {
            let name = name.trim_matches('`');
            assert!(columns.contains(&name), "{section} has no {name}");
        }
    }
    assert_eq!(files, 5);

    let mut found = std::collections::BTreeSet::new();
    for run in [
        synthetic.directory.path().to_owned(),
        concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/fixtures/recorded").into(),
    ] {
        let run = reports::load(&run).unwrap();
        let traffic = reports::input::traffic::read(&run);
        let report = analyse(&run, traffic, &run.manifest.report);
        fields(
            &serde_json::to_value(report.present().json()).unwrap(),
            &mut found,
        );
    }
    assert!(found.len() > 80, "{found:?}");
    let mut documented = documented("report.json");
    documented.extend(self::documented("contrasts"));
    documented.extend(self::documented("comparisons"));
    for field in found {
        assert!(documented.contains(&field), "report.json has {field}");
    }
}
