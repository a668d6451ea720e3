//! A run that was recorded with captures: every file of its report against the stored one. `tests/engines/tests/tshark.rs` holds
//! its packets against those that tshark sees.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use captures::traffic::Traffic;
use record::run_directory::RunDirectory;
use reports::{
    analyse,
    drift::{Metric, Night, digest::night_of},
    input::traffic,
};
use serde_json::Value;
use sha2::{Digest, Sha256};
use tempfile::TempDir;

/// Its text files; Parquet has the numbers of the CSV files, and PDF the drawings of the SVG files.
const TEXTS: [&str; 6] = ["csv", "html", "json", "md", "svg", "tex"];

fn recorded() -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/fixtures/recorded"))
}

/// A copy that a test may write to.
fn copy() -> (TempDir, RunDirectory) {
    let folder = tempfile::tempdir().unwrap();
    let to = folder.path().join("recorded");
    copy_tree(&recorded(), &to);
    (folder, RunDirectory::new(to))
}

fn copy_tree(from: &Path, to: &Path) {
    fs::create_dir(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy_tree(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).unwrap();
        }
    }
}

fn traffic_of(directory: &RunDirectory) -> Traffic {
    traffic::read(&reports::load(directory.path()).unwrap())
}

/// Numbers with more than nine digits brought to nine: the last ones are those of a machine's library of mathematics.
fn to_nine_digits(text: &str) -> String {
    let mut rounded = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(begin) = rest.find(|it: char| it.is_ascii_digit()) {
        let (before, from) = rest.split_at(begin);
        let end = from
            .find(|it: char| !(it.is_ascii_digit() || it == '.'))
            .unwrap_or(from.len());
        let (number, after) = from.split_at(end);
        rounded.push_str(before);
        let digits = number.trim_start_matches(['0', '.']).len();
        match number.parse::<f64>() {
            Ok(value) if number.contains('.') && digits > 10 && value > 0.0 => {
                let places = (8 - value.log10().floor() as i32).max(0) as usize;
                rounded.push_str(&format!("{value:.places$}"));
            }
            _ => rounded.push_str(number),
        }
        rest = after;
    }
    rounded + rest
}

#[test]
fn every_table_and_figure_is_the_stored_one() {
    let (_folder, directory) = copy();
    let run = reports::load(directory.path()).unwrap();
    let report = analyse(&run, traffic::read(&run), &run.manifest.report);
    reports::write(&run, &report, reports::Layout::default()).unwrap();
    let mut names = Vec::new();
    for folder in [
        directory.report().path(),
        directory.report().path().join("figures"),
    ] {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path
                .strip_prefix(directory.report().path())
                .unwrap()
                .display()
                .to_string();
            if path
                .extension()
                .is_some_and(|it| TEXTS.iter().any(|text| it == *text))
            {
                let text = to_nine_digits(&fs::read_to_string(&path).unwrap());
                insta::with_settings!({omit_expression => true, prepend_module_to_snapshot => true}, {
                    insta::assert_snapshot!(name.replace('/', "-"), text);
                });
            }
            names.push(name);
        }
    }
    names.sort_unstable();
    insta::assert_snapshot!("files", names.join("\n"));
}

#[test]
fn a_tables_file_label_and_anchor_are_its_id_whatever_its_title_is() {
    let run = reports::load(recorded()).unwrap();
    let report = analyse(&run, traffic::read(&run), &run.manifest.report);
    let mut page = report.present();
    for table in &mut page.tables {
        table.title = "Other words".to_owned();
    }
    let tables = page.latex_tables();
    let names: Vec<&str> = tables.iter().map(|table| table.name.as_str()).collect();
    // Users' papers have these names.
    assert_eq!(
        names,
        [
            "shifts",
            "the-layers-of-a-robot-simulation",
            "the-scenarios",
            "rejections-within-each-scenario",
            "controls-and-virtualizations",
            "rejections-against-control-1-a",
            "conclusions",
            "the-window-as-the-unit",
            "the-family-of-comparisons",
            "effects",
            "counts-by-blocks",
            "within-the-windows",
            "packets-between-controller-and-plant",
            "packet-counts",
            "packet-explanations",
            "schedule",
            "release-lateness",
        ]
    );
    let html = page.html(&[]);
    let docs = include_str!("../../../docs/run-directory.md");
    for table in tables {
        let name = table.name;
        assert!(table.text.contains(&format!("\\label{{tab:{name}}}")), "{name}");
        assert_eq!(html.matches(&format!("id=\"table-{name}\"")).count(), 1, "{name}");
        assert!(docs.contains(&format!("| `{name}`")), "{name} in the docs");
    }
}

#[test]
fn a_night_has_the_delays_of_its_packets() {
    let (_folder, directory) = copy();
    let run = reports::load(directory.path()).unwrap();
    let night = Night::of(&run, &traffic::read(&run));
    let measured = &night.scenarios["x86-64-debian-12-native"];
    let delay_s = measured.level(&Metric::PacketDelay).unwrap();
    // Two links of 10 ms, and the time that 300 bytes take on two of 10 Mbit/s.
    assert!((0.0200..0.0215).contains(&delay_s), "{delay_s}");
    let without = Night::of(&run, &Traffic::default());
    assert_eq!(
        without.scenarios["x86-64-debian-12-native"].level(&Metric::PacketDelay),
        None
    );
}

#[test]
fn a_run_is_read_once_and_again_when_a_file_of_it_is_another() {
    let (_folder, directory) = copy();
    let kept = directory.report().path().join("night.json");
    let run = reports::load(directory.path()).unwrap();
    let read = Night::of(&run, &traffic::read(&run));
    assert_eq!(night_of(directory.path()).unwrap(), read);
    assert!(kept.exists());

    // To tell the one that was kept from the one that was read: another name for the run.
    let whole = fs::read_to_string(&kept).unwrap();
    let mut renamed: Value = serde_json::from_str(&whole).unwrap();
    renamed["night"]["run"] = "kept".into();
    let night = serde_json::to_string(&renamed["night"]).unwrap();
    renamed["sha256"] = format!("{:x}", Sha256::digest(night)).into();
    let renamed = renamed.to_string();
    fs::write(&kept, &renamed).unwrap();
    assert_eq!(night_of(directory.path()).unwrap().run, "kept");
    for not_true in [
        "",
        "{}",
        &renamed.replacen("\"format\":4", "\"format\":3", 1),
        &whole.replace(&read.run, "changed"),
    ] {
        fs::write(&kept, not_true).unwrap();
        assert_eq!(night_of(directory.path()).unwrap(), read, "{not_true}");
    }

    fs::write(&kept, &renamed).unwrap();
    let capture = directory
        .window("x86-64-debian-12-native", 2)
        .join("sta1.pcap.zst")
        .path();
    let bytes = fs::read(&capture).unwrap();
    fs::write(&capture, &bytes[..bytes.len() / 2]).unwrap();
    let shorter = night_of(directory.path()).unwrap();
    let delays =
        |night: &Night| night.scenarios["x86-64-debian-12-native"].values[&Metric::PacketDelay].len();
    assert_eq!(shorter.run, read.run);
    assert_eq!((delays(&read), delays(&shorter)), (3, 2));
}

#[test]
fn a_night_that_cannot_be_kept_is_read_all_the_same() {
    let (_folder, directory) = copy();
    // A file where the folder would be.
    fs::write(directory.report().path(), "").unwrap();
    assert_eq!(
        night_of(directory.path()).unwrap().run,
        night_of(directory.path()).unwrap().run
    );
    assert!(night_of(&directory.path().join("nowhere")).is_err());
}

#[test]
fn a_truncated_capture_takes_its_window_out_and_no_other() {
    let (_folder, directory) = copy();
    let slug = "x86-64-debian-12-native";
    let capture = directory.window(slug, 2).path().join("sta1.pcap.zst");
    let bytes = fs::read(&capture).unwrap();
    fs::write(&capture, &bytes[..bytes.len() / 2]).unwrap();
    let run = reports::load(directory.path()).unwrap();
    let report = analyse(&run, traffic::read(&run), &run.manifest.report);
    let windows: BTreeMap<&str, Vec<u32>> = report
        .traffic
        .scenarios
        .iter()
        .map(|(id, found)| {
            (
                id.as_str(),
                found.windows.iter().map(|window| window.window).collect(),
            )
        })
        .collect();
    assert_eq!(windows, BTreeMap::from([("a", vec![1, 3]), ("b", vec![1, 2, 3])]));
    let remarks = report.present().remarks;
    let remark = remarks.iter().find(|remark| remark.contains("window 2")).unwrap();
    assert!(
        remark.contains("sta1.pcap.zst") && remark.contains("bytes"),
        "{remark}"
    );
}

#[test]
fn packets_are_the_same_whether_or_not_a_window_before_can_be_read() {
    let (_folder, directory) = copy();
    let whole = traffic_of(&directory);
    let capture = directory
        .window("x86-64-debian-12-native", 1)
        .join("sta2.pcap.zst")
        .path();
    fs::remove_file(&capture).unwrap();
    let without = traffic_of(&directory);
    assert_eq!(without.scenarios["b"], whole.scenarios["b"]);
    let [of_whole, of_without] =
        [&whole, &without].map(|traffic| traffic.scenarios["a"].windows.last().unwrap());
    assert_eq!(
        of_without, of_whole,
        "the third window is not the broken one's neighbour"
    );
    assert_eq!(without.scenarios["a"].unreadable[0].0, 1);
}
