//! The recorded run with other files in the place of some of its own: it is read, reported and taken for a night, or refused with
//! an error. The main type is [`Recorded`].

use std::{
    cell::RefCell,
    fs,
    path::{Path, PathBuf},
};

use reports::{analyse, drift::Night, input::traffic};
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

/// Those of them that are JSON, or lines of it.
pub const RECORDS: [&str; 5] = [FILES[0], FILES[1], FILES[2], FILES[3], FILES[4]];

thread_local! {
    /// Copied once: each input changes a file or two and puts them back.
    static COPY: RefCell<Option<Recorded>> = const { RefCell::new(None) };
}

fn recorded() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures/run-format-1")
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

fn read_and_report(directory: &Path) {
    let Ok(run) = reports::load(directory) else {
        return;
    };
    let traffic = traffic::read(&run);
    let _ = Night::of(&run, &traffic);
    let report = analyse(&run, traffic, &run.manifest.report);
    let _ = (report.present().markdown(), report.present().latex());
    serde_json::to_writer(std::io::sink(), &report.present().json()).expect("a report has its JSON");
}

/// A copy of the recorded run, in memory.
pub struct Recorded {
    folder: TempDir,
    changed: Vec<&'static str>,
}

impl Recorded {
    /// As it was recorded.
    pub fn copy() -> Self {
        let folder = TempDir::new_in("/dev/shm").expect("a folder in memory");
        copy_tree(&recorded(), folder.path());
        Self {
            folder,
            changed: Vec::new(),
        }
    }

    /// Puts other bytes in the place of a file. A window's files are sealed again, so that what is damaged is read and not only its
    /// checksum.
    fn replace(&mut self, name: &'static str, content: &[u8]) {
        fs::write(self.folder.path().join(name), content).expect("a file in memory");
        self.changed.push(name);
        if let Some(of_window) = name.strip_prefix(WINDOW).map(|rest| rest.trim_start_matches('/'))
            && of_window != "window.json"
        {
            seal(&self.folder.path().join(WINDOW), of_window, content);
            self.changed.push(FILES[4]);
        }
    }

    /// Changes one of [`RECORDS`], counted round and round; the journal is an array of its lines.
    pub fn change(&mut self, number: usize, change: impl FnOnce(&mut Value)) {
        let name = RECORDS[number % RECORDS.len()];
        let text = fs::read_to_string(self.folder.path().join(name)).expect("it is there");
        let is_journal = name.ends_with(".jsonl");
        let mut document: Value = match is_journal {
            true => text
                .lines()
                .filter_map(|line| serde_json::from_str::<Value>(line).ok())
                .collect(),
            false => serde_json::from_str(&text).expect("it was written as JSON"),
        };
        change(&mut document);
        let text = match &document {
            Value::Array(lines) if is_journal => lines.iter().map(|line| format!("{line}\n")).collect(),
            other => other.to_string(),
        };
        fs::write(self.folder.path().join(name), text).expect("a file in memory");
        self.changed.push(name);
    }

    /// Reads and reports it.
    pub fn use_it(&self) {
        read_and_report(self.folder.path());
    }

    /// As it was recorded, again.
    pub fn put_back(&mut self) {
        for name in self.changed.drain(..) {
            fs::copy(recorded().join(name), self.folder.path().join(name)).expect("a file in memory");
        }
    }
}

/// Reads and reports the run with the file that the first byte names as the rest has it.
pub fn report(bytes: &[u8]) {
    let chosen = bytes.split_first();
    let Some((name, content)) =
        chosen.and_then(|(choice, rest)| Some((FILES.get(usize::from(*choice))?, rest)))
    else {
        return;
    };
    COPY.with_borrow_mut(|run| {
        let run = run.get_or_insert_with(Recorded::copy);
        run.replace(name, content);
        run.use_it();
        run.put_back();
    });
}

fn original(name: &str) -> Vec<u8> {
    fs::read(recorded().join(name)).expect("the recorded run")
}

/// Its control log.
pub fn control_logs() -> Vec<Vec<u8>> {
    vec![original(FILES[5])]
}

/// Its captures.
pub fn captures() -> Vec<Vec<u8>> {
    [FILES[6], FILES[7]].map(original).into()
}

/// Its records.
pub fn records() -> Vec<Vec<u8>> {
    RECORDS.map(original).into()
}

/// All of these, each behind the byte that names it.
pub fn files_by_number() -> Vec<Vec<u8>> {
    (0_u8..)
        .zip(FILES)
        .map(|(number, name)| [vec![number], original(name)].concat())
        .collect()
}
