//! A run directory with one file in place of its own: it is read, reported and taken for a night, or refused with an error.
//!
//! The first byte chooses the file, the rest is what is in it. A window's files are sealed again, so that what is damaged is
//! read and not only its checksum.

use std::{
    cell::RefCell,
    fs,
    path::{Path, PathBuf},
};

use reports::{analyse, drift::Night, traffic};
use serde_json::Value;
use sha2::{Digest, Sha256};
use tempfile::TempDir;

const WINDOW: &str = "scenarios/x86-64-debian-12-native/window-1";
const FILES: [&str; 8] = [
    "manifest.json",
    "plan.json",
    "events.jsonl",
    "scenarios/x86-64-debian-12-native/environment.json",
    "scenarios/x86-64-debian-12-native/window-1/window.json",
    "scenarios/x86-64-debian-12-native/window-1/control.csv",
    "scenarios/x86-64-debian-12-native/window-1/sta1.pcap",
    "scenarios/x86-64-debian-12-native/window-1/sta2.pcap",
];

thread_local! {
    /// Copied once: each input changes a file or two and puts them back.
    static COPY: RefCell<Option<TempDir>> = const { RefCell::new(None) };
}

fn recorded() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/run-format-1")
}

fn copy_tree(from: &Path, to: &Path) {
    fs::create_dir_all(to).expect("a folder in memory");
    for entry in fs::read_dir(from).expect("the recorded run") {
        let entry = entry.expect("the recorded run");
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy_tree(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).expect("a file in memory");
        }
    }
}

fn seal(window: &Path, name: &str, bytes: &[u8]) {
    let path = window.join("window.json");
    let mut record: Value =
        serde_json::from_slice(&fs::read(&path).expect("it is there")).expect("it is JSON");
    let sha256: String = Sha256::digest(bytes)
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect();
    for file in record["files"].as_array_mut().into_iter().flatten() {
        if file["name"] == name {
            file["bytes"] = bytes.len().into();
            file["sha256"] = sha256.clone().into();
        }
    }
    fs::write(&path, record.to_string()).expect("a file in memory");
}

fn use_it(directory: &Path) {
    let Ok(run) = reports::load(directory) else {
        return;
    };
    let traffic = traffic::read(&run);
    let _ = Night::of(&run, &traffic);
    let report = analyse(&run, traffic, &run.manifest.report);
    let _ = (report.markdown(), report.latex());
    serde_json::to_writer(std::io::sink(), &report.json()).expect("a report has its JSON");
}

/// Reads and reports the run with the file that the first byte names as the rest has it.
pub fn report(bytes: &[u8]) {
    let chosen = bytes.split_first();
    let Some((name, content)) =
        chosen.and_then(|(choice, rest)| Some((FILES.get(usize::from(*choice))?, rest)))
    else {
        return;
    };
    COPY.with_borrow_mut(|copy| {
        let folder = copy.get_or_insert_with(|| {
            let folder = TempDir::new_in("/dev/shm").expect("a folder in memory");
            copy_tree(&recorded(), folder.path());
            folder
        });
        let file = folder.path().join(name);
        fs::write(&file, content).expect("a file in memory");
        if let Some(of_window) = name.strip_prefix(WINDOW).map(|rest| rest.trim_start_matches('/'))
            && of_window != "window.json"
        {
            seal(&folder.path().join(WINDOW), of_window, content);
        }
        use_it(folder.path());
        for changed in [name, "scenarios/x86-64-debian-12-native/window-1/window.json"] {
            fs::copy(recorded().join(changed), folder.path().join(changed)).expect("a file in memory");
        }
    });
}
