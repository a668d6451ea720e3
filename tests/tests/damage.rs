//! A digit of a run directory that is another than was written either changes nothing that is reported, or matrix says which file is
//! damaged.

use std::{
    fs,
    path::{Path, PathBuf},
};

use record::run_directory::RunDirectory;
use reports::{
    analyse,
    input::{traffic, verification::verify},
};
use serde_json::Value;
use tests::{Workplace, without_checksums};

/// Two fake scenarios of two windows with captures.
const FAKE: &str = "\
matrix:
  virtualization: [fake]
  labels: {place: [here, there]}
workload:
  windows: 2
  window: 8s
  period: 1s
";

/// A run that has ended, and its directory.
fn recorded() -> (Workplace, PathBuf) {
    let workplace = Workplace::new();
    workplace.write("m.yaml", FAKE);
    let ran = workplace.run(&["run", "m.yaml"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let directory = workplace.run_directory();
    (workplace, directory)
}

/// The folder of one of its scenarios, relative to the run directory.
fn scenario(directory: &Path) -> PathBuf {
    let mut found: Vec<PathBuf> = fs::read_dir(directory.join("scenarios"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    found.sort();
    found[0].strip_prefix(directory).unwrap().to_owned()
}

/// The report as JSON, or why there is none.
fn report(directory: &Path) -> Result<String, String> {
    let run = reports::load(directory).map_err(|error| error.to_string())?;
    let report = analyse(&run, traffic::read(&run), &run.manifest.report);
    serde_json::to_string(&report.present().json()).map_err(|error| error.to_string())
}

/// Changes a digit of a file to the next one at each of at most so many places, spread over all that it has, and gives them to
/// `look`. The file is as it was in the end.
fn with_another_digit(file: &Path, most: usize, mut look: impl FnMut(&str)) -> usize {
    let whole = fs::read(file).unwrap();
    let digits: Vec<usize> = (0..whole.len())
        .filter(|at| whole[*at].is_ascii_digit())
        .collect();
    let every = digits.len().div_ceil(most).max(1);
    let places = digits.iter().step_by(every);
    let count = places.len();
    for &at in places {
        let mut changed = whole.clone();
        changed[at] = b'0' + (changed[at] - b'0' + 1) % 10;
        fs::write(file, &changed).unwrap();
        let from = at.saturating_sub(30);
        let around = String::from_utf8_lossy(&changed[from..(at + 30).min(changed.len())]).into_owned();
        look(&format!("byte {at} of {}: …{around}…", file.display()));
    }
    fs::write(file, whole).unwrap();
    count
}

/// Files of a run that a report is made of, and at how many digits of each it is looked.
fn files(directory: &Path) -> Vec<(PathBuf, usize)> {
    let scenario = scenario(directory);
    let window = scenario.join("window-1");
    vec![
        ("manifest.json".into(), usize::MAX),
        ("plan.json".into(), 1000),
        ("events.jsonl".into(), 1000),
        (scenario.join("environment.json"), 40),
        (window.join("window.json"), 100),
        (window.join("control.csv"), 40),
    ]
}

/// Whether a report names the file as damaged.
fn says_so(report: &str, file: &Path) -> bool {
    let name = file.file_name().unwrap().to_str().unwrap();
    report.contains(name)
        && ["damaged", "cannot be used", "not an event"]
            .iter()
            .any(|words| report.contains(words))
}

#[test]
fn a_digit_that_is_another_changes_no_report_in_silence() {
    let (_workplace, directory) = recorded();
    let before = report(&directory).unwrap();
    let run = RunDirectory::new(&directory);
    assert_eq!(verify(&run).unwrap().damaged, []);
    assert!(verify(&run).unwrap().is_checked && !before.contains("earlier version"));
    for (name, most) in files(&directory) {
        let file = directory.join(&name);
        let looked_at = with_another_digit(&file, most, |place| {
            match report(&directory) {
                Ok(after) => assert!(after == before || says_so(&after, &file), "in silence: {place}"),
                Err(error) => assert!(says_so(&error, &file), "{error}: {place}"),
            }
            match verify(&run) {
                Ok(found) => assert_eq!(found.damaged.len(), 1, "{place}: {found:?}"),
                Err(error) => assert!(says_so(&error.to_string(), &file), "{error}: {place}"),
            }
        });
        assert!(looked_at >= 30, "{looked_at} digits of {}", name.display());
    }
    assert_eq!(report(&directory).unwrap(), before);
}

#[test]
fn a_file_that_is_gone_is_found() {
    let (_workplace, directory) = recorded();
    let run = RunDirectory::new(&directory);
    let aside = directory.with_extension("aside");
    for (name, _) in files(&directory) {
        let file = directory.join(&name);
        fs::rename(&file, &aside).unwrap();
        match verify(&run) {
            Ok(found) => assert!(!found.damaged.is_empty(), "{}", name.display()),
            Err(error) => assert!(error.to_string().contains("is missing"), "{error}"),
        }
        fs::rename(&aside, &file).unwrap();
    }
    assert_eq!(verify(&run).unwrap().damaged, []);
}

#[test]
fn of_a_journal_that_was_cut_at_a_line_no_window_counts_that_it_does_not_have() {
    let (workplace, directory) = recorded();
    let journal = directory.join("events.jsonl");
    let lines = fs::read_to_string(&journal).unwrap();
    let first = lines.find("window-collected").unwrap();
    let end = lines[..first].rfind('\n').unwrap() + 1;
    fs::write(&journal, &lines[..end]).unwrap();

    let counted = || {
        let report: Value = serde_json::from_str(&report(&directory).unwrap()).unwrap();
        let windows = report["scenarios"][0]["windows"].as_array().unwrap().clone();
        windows.iter().filter(|window| window["counted"] == true).count()
    };
    assert_eq!(counted(), 0);
    let run = RunDirectory::new(&directory);
    assert!(!verify(&run).unwrap().damaged.is_empty());
    // One that goes on with the run looks whether they are whole.
    let resumed = workplace.run(&["resume", directory.to_str().unwrap()]);
    assert_eq!(resumed.code, Some(0), "{resumed:?}");
    assert!(counted() > 0);
    assert_eq!(verify(&run).unwrap().damaged, []);
}

#[test]
fn a_run_of_an_earlier_version_is_reported_and_said_not_to_be_checked() {
    let (workplace, directory) = recorded();
    let before: Value = serde_json::from_str(&report(&directory).unwrap()).unwrap();
    without_checksums(&directory);
    let after: Value = serde_json::from_str(&report(&directory).unwrap()).unwrap();
    assert_eq!(after["comparisons"], before["comparisons"]);
    let remarks = after["remarks"].to_string();
    assert_eq!(remarks.matches("earlier version").count(), 1, "{remarks}");
    // What those of today find would not be found: the test above can fail.
    let unchanged = report(&directory).unwrap();
    let mut in_silence = 0;
    with_another_digit(&directory.join("plan.json"), 100, |_| {
        let found = report(&directory);
        in_silence += usize::from(found.is_ok_and(|found| found != unchanged));
    });
    assert!(in_silence > 0);
    let path = directory.to_str().unwrap();
    let verified = workplace.run(&["status", path, "--verify"]);
    assert_eq!(verified.code, Some(0), "{verified:?}");
    assert!(verified.out.contains("earlier version"), "{verified:?}");
    // Whoever goes on with it has checksums from then on.
    let scenario = directory.join(scenario(&directory));
    fs::remove_dir_all(scenario.join("window-2")).unwrap();
    assert_eq!(workplace.run(&["resume", path]).code, Some(0));
    assert!(verify(&RunDirectory::new(&directory)).unwrap().is_checked);
}

#[test]
fn status_verifies_a_whole_run_and_resume_measures_damaged_windows_again() {
    let (workplace, directory) = recorded();
    let path = directory.to_str().unwrap();
    let verified = workplace.run(&["status", path, "--verify"]);
    assert_eq!(verified.code, Some(0), "{verified:?}");
    assert!(verified.out.contains("all as they were written"), "{verified:?}");
    let scenario = scenario(&directory);
    let capture = scenario.join("window-1/h1.pcap.zst");
    let record = scenario.join("window-2/window.json");
    for file in [&capture, &record] {
        let file = directory.join(file);
        let mut bytes = fs::read(&file).unwrap();
        let at = bytes.len() / 2;
        bytes[at] ^= 1;
        fs::write(file, bytes).unwrap();
    }
    let verified = workplace.run(&["status", path, "--verify"]);
    assert_eq!(verified.code, Some(2), "{verified:?}");
    for file in [&capture, &record] {
        assert!(verified.out.contains(file.to_str().unwrap()), "{verified:?}");
    }
    let json = workplace.json(&["status", path, "--verify"]);
    assert_eq!(
        json["verified"]["damaged"].as_array().unwrap().len(),
        2,
        "{json:#}"
    );
    assert_eq!(workplace.json(&["status", path])["verified"], Value::Null);
    let resumed = workplace.run(&["resume", path]);
    assert_eq!(resumed.code, Some(0), "{resumed:?}");
    let verified = workplace.run(&["status", path, "--verify"]);
    assert_eq!(verified.code, Some(0), "{verified:?}");
}

#[test]
fn a_redacted_copy_has_checksums_of_its_own_and_none_is_made_of_what_is_damaged() {
    let (workplace, directory) = recorded();
    let path = directory.to_str().unwrap();
    let ran = workplace.run(&["redact", path, "--output", "copies"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let copy = fs::read_dir(workplace.path().join("copies"))
        .unwrap()
        .next()
        .unwrap();
    let copy = copy.unwrap().path();
    let found = verify(&RunDirectory::new(&copy)).unwrap();
    assert!(found.is_checked && found.damaged.is_empty(), "{found:?}");
    with_another_digit(&copy.join("plan.json"), 20, |place| {
        assert!(report(&copy).is_err(), "{place}");
    });
    for name in ["environment.json", "window-1/window.json"] {
        let file = directory.join(scenario(&directory)).join(name);
        with_another_digit(&file, 1, |place| {
            let ran = workplace.run(&["redact", path, "--output", "others"]);
            assert_eq!(ran.code, Some(2), "{place}: {ran:?}");
            assert!(ran.err.contains(name), "{place}: {ran:?}");
            let _ = fs::remove_dir_all(workplace.path().join("others"));
        });
    }
}
