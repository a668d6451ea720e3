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
            "report/figures/cdf-a-b.pdf",
            "report/figures/cdf-a-b.svg",
            "report/figures/trajectory-a.pdf",
            "report/figures/trajectory-a.svg",
            "report/figures/trajectory-b.pdf",
            "report/figures/trajectory-b.svg",
            "report/packets.csv",
            "report/packets.parquet",
            "report/report.html",
            "report/report.json",
            "report/samples.csv",
            "report/samples.parquet",
            "report/tables.md",
            "report/tables.tex",
            "report/tables/controls-against-each-other-and-virtualizations-on-each-platform.tex",
            "report/tables/how-large-the-differences-are.tex",
            "report/tables/how-well-each-platform-held-the-schedule.tex",
            "report/tables/rejections-of-each-virtualized-scenario-against-each-control.tex",
            "report/tables/rejections-within-each-scenario.tex",
            "report/tables/the-counts-with-blocks-in-place-of-values.tex",
            "report/tables/the-family-of-comparisons.tex",
            "report/tables/the-window-as-the-unit.tex",
            "report/tables/what-was-different.tex",
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
    let first = tree(&synthetic.directory.report());
    write(&synthetic, &ReportSettings::default());
    let second = tree(&synthetic.directory.report());
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
    let figures = synthetic.directory.report().join("figures");
    fs::write(figures.join("mine.svg"), "mine").unwrap();
    let tables = synthetic.directory.report().join("tables");
    fs::write(tables.join("mine.tex"), "\\section{Mine}").unwrap();
    fs::rename(
        tables.join("within-the-windows.tex"),
        tables.join("rejections-continued.tex"),
    )
    .unwrap();
    let pair = |a: &str, b: &str| (a.to_owned(), b.to_owned());
    let settings = ReportSettings {
        figures: vec![pair("b", "x86-debian-docker"), pair("a", "nowhere")],
        ..ReportSettings::default()
    };
    write(&synthetic, &settings);
    let names: Vec<String> = tree(&figures).into_keys().collect();
    assert_eq!(
        names,
        [
            "cdf-b-b.pdf",
            "cdf-b-b.svg",
            "mine.svg",
            "trajectory-a.pdf",
            "trajectory-a.svg",
            "trajectory-b.pdf",
            "trajectory-b.svg"
        ]
    );
    let names = tree(&tables);
    assert!(names.contains_key("mine.tex") && names.contains_key("within-the-windows.tex"));
    assert!(!names.contains_key("rejections-continued.tex"));
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
    let folder = synthetic.directory.report();
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
    assert_eq!(files, 4);

    let mut found = std::collections::BTreeSet::new();
    for run in [
        synthetic.directory.path().to_owned(),
        concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/fixtures/recorded").into(),
    ] {
        let run = reports::load(&run).unwrap();
        let traffic = reports::traffic::read(&run);
        let report = analyse(&run, traffic, &run.manifest.report);
        fields(&serde_json::to_value(report.json()).unwrap(), &mut found);
    }
    assert!(found.len() > 80, "{found:?}");
    let mut documented = documented("report.json");
    documented.extend(self::documented("contrasts"));
    documented.extend(self::documented("comparisons"));
    for field in found {
        assert!(documented.contains(&field), "report.json has {field}");
    }
}
