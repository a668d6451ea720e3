//! What a report leaves in the run directory.

use std::{collections::BTreeMap, fs, path::Path};

use polars::prelude::{ParquetReader, SerReader};
use reports::{analyse, settings::ReportSettings, traffic::Traffic};

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
    reports::write(&run, &analyse(&run, Traffic::default(), settings)).unwrap();
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
            "report/figures/cdf-a-b.svg",
            "report/figures/trajectory-a.svg",
            "report/figures/trajectory-b.svg",
            "report/packets.csv",
            "report/packets.parquet",
            "report/report.html",
            "report/report.json",
            "report/samples.csv",
            "report/samples.parquet",
            "report/tables.md",
            "report/tables.tex",
        ]
    );
    after.retain(|name, _| before.contains_key(name));
    assert_eq!(before, after);
}

#[test]
fn the_same_run_gives_the_same_report_byte_for_byte() {
    let synthetic = two_scenarios();
    write(&synthetic, &ReportSettings::default());
    let first = tree(&synthetic.directory.report());
    write(&synthetic, &ReportSettings::default());
    assert_eq!(first, tree(&synthetic.directory.report()));
}

#[test]
fn figures_of_an_earlier_report_are_removed_and_other_files_are_not() {
    let synthetic = two_scenarios();
    write(&synthetic, &ReportSettings::default());
    let figures = synthetic.directory.report().join("figures");
    fs::write(figures.join("mine.svg"), "mine").unwrap();
    let pair = |a: &str, b: &str| (a.to_owned(), b.to_owned());
    let settings = ReportSettings {
        figures: vec![pair("b", "x86-debian-docker"), pair("a", "nowhere")],
        ..ReportSettings::default()
    };
    write(&synthetic, &settings);
    let names: Vec<String> = tree(&figures).into_keys().collect();
    assert_eq!(
        names,
        ["cdf-b-b.svg", "mine.svg", "trajectory-a.svg", "trajectory-b.svg"]
    );
    let run = reports::load(synthetic.directory.path()).unwrap();
    assert_eq!(
        analyse(&run, Traffic::default(), &settings).remarks,
        ["`report.figures` names `nowhere`, which is no scenario's letter or slug."]
    );
}

#[test]
fn the_csv_has_a_line_for_each_comparison_and_for_each_period() {
    let synthetic = two_scenarios();
    write(&synthetic, &ReportSettings::default());
    let read = |name| fs::read_to_string(synthetic.directory.report().join(name)).unwrap();
    let comparisons = read("comparisons.csv");
    assert_eq!(
        comparisons.lines().count(),
        1 + 28,
        "8 windows, every two of them"
    );
    let mut lines = comparisons.lines();
    assert_eq!(
        lines.next().unwrap(),
        "a,a_slug,a_window,b,b_slug,b_window,n,m,d,h,lcm,p,log10_p,signed_d,at_m,method,alpha,rejected,unlike"
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
    let file = fs::File::open(synthetic.directory.report().join("comparisons.parquet")).unwrap();
    let frame = ParquetReader::new(file).finish().unwrap();
    assert_eq!(frame.shape(), (28, 19));
    let rejected = frame.column("rejected").unwrap().bool().unwrap().sum();
    let csv = fs::read_to_string(synthetic.directory.report().join("comparisons.csv")).unwrap();
    assert_eq!(
        rejected,
        Some(csv.lines().filter(|line| line.ends_with(",true,")).count() as u32)
    );
}

#[test]
fn figures_are_well_labelled() {
    let synthetic = two_scenarios();
    write(&synthetic, &ReportSettings::default());
    let read = |name| fs::read_to_string(synthetic.directory.report().join("figures").join(name)).unwrap();
    let distributions = read("cdf-a-b.svg");
    for words in [
        "a x86-debian-native, window",
        "error of a period, mean |e_x| + mean |e_y| (m)",
        "D = ",
        "of 16 window pairs",
    ] {
        assert!(distributions.contains(words), "{words}");
    }
    for words in ["x (m)", "y (m)", "time within the period (s)", "target", "actual"] {
        assert!(read("trajectory-a.svg").contains(words), "{words}");
    }
}

#[test]
fn a_report_that_cannot_be_written_says_where() {
    let synthetic = two_scenarios();
    fs::write(synthetic.directory.report(), "a file where the folder belongs").unwrap();
    let run = reports::load(synthetic.directory.path()).unwrap();
    let error = reports::write(&run, &analyse(&run, Traffic::default(), &run.manifest.report)).unwrap_err();
    assert!(
        error.to_string().ends_with("report/figures cannot be written"),
        "{error}"
    );
}

#[test]
fn a_run_without_any_window_still_has_a_report() {
    let synthetic = Synthetic::new(&[Scenario::infeasible("x86-debian-virtualbox", "no VBoxManage")]);
    write(&synthetic, &ReportSettings::default());
    let csv = fs::read_to_string(synthetic.directory.report().join("comparisons.csv")).unwrap();
    assert_eq!(csv.lines().count(), 1);
}
