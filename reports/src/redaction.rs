//! Names of people and machines out of runs, for a review in which nobody is to know who measured. The main type is
//! [`Redaction`]; [`copy`] makes a run directory that can be handed on.
//!
//! What is a name is known from where it stands: a host of the matrix file, the host and user of an SSH address, a hostname,
//! a user's folder. Each gets another name, the same wherever it stands as a word. Command lines, paths of keys and the matrix
//! file's text are left out. What was measured stays as it is, byte for byte, and so do axes and settings.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs, io,
    net::IpAddr,
    path::{Path, PathBuf},
};

use serde::{Serialize, de::DeserializeOwned};
use serde_json::{Map, Value};
use workload::{record::window::WindowRecord, virtual_host::VirtualHost};

use crate::{
    run::{Ending, Run, ScenarioRun, WindowState},
    run_directory::{FORMAT, Journal, PlanRecord, ReadError, RunDirectory, read_file, read_record},
};

/// What a reader of a report must know.
pub(crate) const REMARK: &str =
    "Redacted: names of hosts and users, addresses and command lines are not those of the run.";

/// Names that everybody has, and that say nothing of anybody.
const ANYBODYS: [&str; 11] = [
    "admin",
    "debian",
    "here",
    "host",
    "local",
    "localhost",
    "root",
    "ubuntu",
    "user",
    "vagrant",
    "workload",
];
/// Fields that have words of the format, hashes, or what the report is about.
const KEPT: [&str; 14] = [
    "axes",
    "control",
    "event",
    "files",
    "matrix_sha256",
    "method",
    "outcome",
    "provider",
    "report",
    "settings",
    "sha256",
    "slug",
    "verdict",
    "workload_sha256",
];
/// Fields that are left out.
const LEFT_OUT: [&str; 3] = ["connect", "kernel_command_line", "machine_id"];
/// Fields with sentences, in which addresses may stand.
const PROSE: [&str; 7] = [
    "first",
    "fix",
    "hint",
    "holder",
    "reason",
    "reasons",
    "priority_refusal",
];
/// Where the folders of users are.
const HOMES: [&str; 3] = ["/home/", "/Users/", "\\Users\\"];

/// Why a redacted copy cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum CopyError {
    /// The run cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The operating system refused.
    #[error("{} cannot be written", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A name with which a file would leave its folder.
    #[error("`{name}` is not the name of a file")]
    Name {
        /// The name.
        name: String,
    },
}

impl CopyError {
    /// What to do about it.
    #[must_use]
    pub fn hint(&self) -> String {
        match self {
            Self::Read(error) => error.hint(),
            Self::Io { source, .. } if source.kind() == io::ErrorKind::AlreadyExists => {
                "give another folder with `--output`, or remove this one".to_owned()
            }
            Self::Io { .. } => "see that the disk has room and that you may write there".to_owned(),
            Self::Name { .. } => {
                "matrix writes no such names: somebody else changed plan.json or manifest.json".to_owned()
            }
        }
    }
}

/// The names that are replaced.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Redaction {
    /// In lower case, with what stands for them; the longest first.
    names: Vec<(String, String)>,
    /// Names that stay, since axes have them.
    kept: BTreeSet<String>,
}

impl Redaction {
    /// Of these runs, which then have the same names for the same, and of other words that are to go.
    ///
    /// # Errors
    /// When a run cannot be read.
    pub fn of(runs: &[RunDirectory], words: &[String]) -> Result<Self, ReadError> {
        let mut found = Found::default();
        for run in runs {
            found.look_at_run(run)?;
        }
        for word in words {
            found.add("name", word);
        }
        Ok(found.redaction())
    }

    /// Each name with what stands for it, in alphabetical order.
    #[must_use]
    pub fn names(&self) -> BTreeMap<&str, &str> {
        self.names
            .iter()
            .map(|(name, other)| (name.as_str(), other.as_str()))
            .collect()
    }

    /// Names that are not replaced, since an axis has them.
    #[must_use]
    pub const fn kept(&self) -> &BTreeSet<String> {
        &self.kept
    }

    /// A text without the names, wherever one stands as a word, in capitals or not.
    #[must_use]
    pub fn text(&self, text: &str) -> String {
        let lower = text.to_ascii_lowercase();
        let mut redacted = String::with_capacity(text.len());
        let (mut at, mut before) = (0, None);
        while let (Some(rest), Some(original)) = (lower.get(at..), text.get(at..)) {
            let name = self.names.iter().find(|(name, _)| is_word_at(name, before, rest));
            let (length, piece) = match (name, original.chars().next()) {
                (Some((name, other)), _) => (name.len(), other.as_str()),
                (None, Some(next)) => (
                    next.len_utf8(),
                    original.get(..next.len_utf8()).unwrap_or_default(),
                ),
                (None, None) => break,
            };
            redacted.push_str(piece);
            before = original
                .get(..length)
                .and_then(|passed| passed.chars().next_back());
            at += length;
        }
        redacted
    }

    /// A JSON document without them.
    #[must_use]
    pub fn document(&self, document: Value) -> Value {
        self.field("", document)
    }

    fn field(&self, name: &str, value: Value) -> Value {
        match (name, value) {
            (name, value) if KEPT.contains(&name) => value,
            (name, _) if LEFT_OUT.contains(&name) => Value::Null,
            ("matrix_file", Value::String(_)) => "matrix.yaml".into(),
            ("matrix_text", Value::String(_)) => "".into(),
            (_, Value::String(text)) => self.text(&text).into(),
            (name, Value::Array(values)) => values.into_iter().map(|value| self.field(name, value)).collect(),
            (_, Value::Object(fields)) => {
                let is_left_out = is_change_of_what_is_left_out(&fields);
                let field = |(name, value): (String, Value)| {
                    let value = match (is_left_out, name.as_str()) {
                        (true, "before" | "after") => Value::Null,
                        _ => self.field(&name, value),
                    };
                    (name, value)
                };
                Value::Object(fields.into_iter().map(field).collect())
            }
            (_, plain) => plain,
        }
    }

    /// A record that keeps its shape.
    fn record<T: Serialize + DeserializeOwned>(&self, record: &T) -> Result<T, serde_json::Error> {
        serde_json::from_value(self.document(serde_json::to_value(record)?))
    }
}

/// `platform.changes` has entries of a field's name and what it was and is.
fn is_change_of_what_is_left_out(fields: &Map<String, Value>) -> bool {
    let what = fields.get("what").and_then(Value::as_str);
    what.is_some_and(|what| LEFT_OUT.contains(&what))
}

/// Whether a text goes on with this name, and the name is not a part of a longer word.
fn is_word_at(name: &str, before: Option<char>, rest: &str) -> bool {
    let joins = |edge: Option<char>, beside: Option<char>| {
        edge.is_some_and(char::is_alphanumeric) && beside.is_some_and(char::is_alphanumeric)
    };
    rest.strip_prefix(name).is_some_and(|after| {
        !joins(name.chars().next(), before) && !joins(name.chars().next_back(), after.chars().next())
    })
}

fn has_word(text: &str, name: &str) -> bool {
    text.match_indices(name).any(|(at, _)| {
        is_word_at(
            name,
            text.get(..at).and_then(|it| it.chars().next_back()),
            text.get(at..).unwrap_or_default(),
        )
    })
}

/// What was found in documents, before it has other names.
#[derive(Default)]
struct Found {
    /// By kind, in lower case.
    names: BTreeMap<&'static str, BTreeSet<String>>,
    /// Axis values and slugs, in lower case.
    axes: BTreeSet<String>,
}

impl Found {
    fn look_at_run(&mut self, run: &RunDirectory) -> Result<(), ReadError> {
        self.look_at_text(&run.path().display().to_string());
        let plan: PlanRecord = read_record(&run.plan(), FORMAT)?;
        for document in [run.manifest(), run.plan()] {
            self.look_at("", &read_record(&document, FORMAT)?);
        }
        for entry in Journal::read(&run.journal())?.entries {
            self.look_at("", &serde_json::to_value(entry).unwrap_or_default());
        }
        for scenario in &plan.scenarios {
            for file in files(&run.scenario(&scenario.slug)) {
                match Kind::of(&file) {
                    Some(Kind::Document) => self.look_at("", &read_record(&file, FORMAT)?),
                    Some(Kind::Text) => self.look_at_text(&String::from_utf8_lossy(&read_file(&file)?)),
                    None => {}
                }
            }
        }
        Ok(())
    }

    fn look_at(&mut self, name: &str, value: &Value) {
        match (name, value) {
            ("axes", Value::Object(axes)) => {
                self.axes.extend(
                    axes.values()
                        .map(|value| crate::report::text_of(value).to_ascii_lowercase()),
                );
            }
            ("slug", Value::String(slug)) => drop(self.axes.insert(slug.to_ascii_lowercase())),
            ("hosts", Value::Array(hosts)) => {
                for host in hosts {
                    self.add_host(host.get("name").and_then(Value::as_str).unwrap_or_default());
                    self.look_at("", host);
                }
            }
            ("host" | "hostname", Value::String(host)) => self.add_host(host),
            ("ssh" | "jump", Value::String(address)) => self.add_address(address),
            ("identity" | "known_hosts" | "matrix_file", Value::String(path)) => {
                self.add("path", path);
                self.look_at_text(path);
            }
            (name, Value::String(text)) => {
                self.look_at_text(text);
                if PROSE.contains(&name) {
                    self.look_for_addresses(text);
                }
            }
            (name, Value::Array(values)) => values.iter().for_each(|value| self.look_at(name, value)),
            (_, Value::Object(fields)) => fields.iter().for_each(|(name, value)| self.look_at(name, value)),
            _ => {}
        }
    }

    /// A host's name, the first part of it, by which it is called at home, and its domain.
    fn add_host(&mut self, host: &str) {
        if host.parse::<IpAddr>().is_ok() {
            return self.add("address", host);
        }
        self.add("host", host);
        if let Some((first, domain)) = host.split_once('.') {
            self.add("host", first);
            if domain.contains('.') {
                self.add("domain", domain);
            }
        }
    }

    /// `user@host:port`, a user's `[address]:port`, or less of it.
    fn add_address(&mut self, address: &str) {
        let (user, host) = address.rsplit_once('@').unwrap_or(("", address));
        self.add("user", user.trim_start_matches("ssh://"));
        let host = match host.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
            Some((bracketed, _)) => bracketed,
            None => host.split_once(':').map_or(host, |(host, _)| host),
        };
        self.add_host(host);
    }

    /// Users, by their folders.
    fn look_at_text(&mut self, text: &str) {
        for home in HOMES {
            for (at, _) in text.match_indices(home) {
                let after = text.get(at + home.len()..).unwrap_or_default();
                let end = after.find(|c: char| !(c.is_alphanumeric() || "._-".contains(c)));
                self.add(
                    "user",
                    after.get(..end.unwrap_or(after.len())).unwrap_or_default(),
                );
            }
        }
    }

    /// Addresses that are neither this machine's to itself nor of the emulated network.
    fn look_for_addresses(&mut self, text: &str) {
        for word in text.split(|c: char| !(c.is_ascii_hexdigit() || ".:".contains(c))) {
            let word = word.trim_matches([':', '.']);
            let word = match word.split_once(':') {
                Some((address, _)) if address.contains('.') => address,
                _ => word,
            };
            if let Ok(address) = word.parse::<IpAddr>()
                && !address.is_loopback()
                && !address.is_unspecified()
                && !word.starts_with("10.0.0.")
            {
                self.add("address", word);
            }
        }
    }

    fn add(&mut self, kind: &'static str, name: &str) {
        let name = name.trim().to_ascii_lowercase();
        let is_virtual = VirtualHost::ALL.iter().any(|host| host.name() == name);
        let says_something = !name.is_empty() && !is_virtual && !ANYBODYS.contains(&name.as_str());
        let is_new = self.names.values().all(|names| !names.contains(&name));
        if says_something && is_new {
            self.names.entry(kind).or_default().insert(name);
        }
    }

    fn redaction(self) -> Redaction {
        let mut redaction = Redaction::default();
        for (kind, names) in self.names {
            let (kept, replaced): (BTreeSet<String>, BTreeSet<String>) = names
                .into_iter()
                .partition(|name| self.axes.iter().any(|axis| has_word(axis, name)));
            redaction.kept.extend(kept);
            let numbered = (1..).zip(replaced);
            redaction
                .names
                .extend(numbered.map(|(number, name)| (name, format!("{kind}-{number}"))));
        }
        redaction
            .names
            .sort_by_key(|(name, _)| std::cmp::Reverse(name.len()));
        redaction
    }
}

/// What is not measured in a scenario's folder.
enum Kind {
    /// JSON.
    Document,
    /// Text.
    Text,
}

impl Kind {
    fn of(file: &Path) -> Option<Self> {
        let name = file.file_name()?.to_str()?;
        match name {
            "window.json" => Some(Self::Document),
            _ if name.starts_with("environment") && name.ends_with(".json") => Some(Self::Document),
            _ if name.starts_with("network") && name.ends_with(".txt") => Some(Self::Text),
            _ => None,
        }
    }
}

/// The files of a scenario's folder and of its windows, in the order of their names; none of what broke.
fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = |folder: &Path| -> Vec<PathBuf> {
        let entries = fs::read_dir(folder).into_iter().flatten().flatten();
        let mut paths: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
        paths.sort();
        paths
    };
    let is_window = |path: &PathBuf| {
        let name = path.file_name().and_then(|name| name.to_str());
        name.is_some_and(|name| name.starts_with("window-"))
    };
    let (folders, mut files): (Vec<PathBuf>, Vec<PathBuf>) =
        entries(folder).into_iter().partition(|path| path.is_dir());
    files.extend(
        folders
            .iter()
            .filter(|path| is_window(path))
            .flat_map(|window| entries(window)),
    );
    files
}

impl Run {
    /// The run without names of hosts and users, addresses and command lines.
    ///
    /// # Errors
    /// When a name is a word of the format.
    pub fn redacted(mut self, redaction: &Redaction) -> Result<Self, serde_json::Error> {
        self.manifest = redaction.record(&self.manifest)?;
        self.manifest.redacted = true;
        for part in &mut self.parts {
            part.run = redaction.text(&part.run);
        }
        for scenario in &mut self.scenarios {
            scenario.redact(redaction)?;
        }
        let is_said = self.remarks.iter().any(|remark| remark == REMARK);
        self.remarks.extend((!is_said).then(|| REMARK.to_owned()));
        Ok(self)
    }
}

impl ScenarioRun {
    fn redact(&mut self, redaction: &Redaction) -> Result<(), serde_json::Error> {
        let text = |text: &mut String| *text = redaction.text(text);
        self.planned = redaction.record(&self.planned)?;
        if let Some(environment) = &mut self.environment {
            *environment = redaction.record(environment)?;
        }
        match &mut self.ending {
            Ending::Infeasible { reason, fix } => {
                text(reason);
                fix.iter_mut().for_each(text);
            }
            Ending::Ended { reason, hint, .. } => reason.iter_mut().chain(hint).for_each(text),
            Ending::NotSelected { reason } => text(reason),
            Ending::NotStarted | Ending::Unfinished => {}
        }
        for window in &mut self.windows {
            match &mut window.state {
                WindowState::Counted { record, .. } | WindowState::Invalid { record } => {
                    **record = redaction.record::<WindowRecord>(record)?;
                }
                WindowState::Broken { reason } => text(reason),
                WindowState::Missing => {}
            }
        }
        self.broken.iter_mut().for_each(|broken| text(&mut broken.reason));
        Ok(())
    }
}

/// Makes a copy of a run without the names, from which a report can be made. Left out are what broke, the report, and lines
/// of the journal that a crash cut.
///
/// # Errors
/// When there is something at that place, and when something cannot be read or written.
pub fn copy(run: &RunDirectory, to: &Path, redaction: &Redaction) -> Result<(), CopyError> {
    fs::create_dir_all(to.parent().unwrap_or(to)).map_err(at(to))?;
    fs::create_dir(to).map_err(at(to))?;
    let copy = RunDirectory::new(to);
    let plan: PlanRecord = read_record(&run.plan(), FORMAT)?;
    for scenario in &plan.scenarios {
        see_that_it_stays(&scenario.slug)?;
        copy_scenario(
            &run.scenario(&scenario.slug),
            &copy.scenario(&scenario.slug),
            redaction,
        )?;
    }
    let entries = Journal::read(&run.journal())?.entries.into_iter();
    // Plain data can always be written as JSON.
    let documents = entries.map(|entry| redaction.document(serde_json::to_value(entry).unwrap_or_default()));
    let lines: String = documents.map(|document| format!("{document}\n")).collect();
    write(&copy.journal(), &lines)?;
    copy_document(&run.plan(), &copy.plan(), redaction)?;
    let mut manifest: Map<String, Value> = read_record(&run.manifest(), FORMAT)?;
    manifest.insert("redacted".to_owned(), true.into());
    write_document(&copy.manifest(), &redaction.document(manifest.into()))
}

/// That a name is one of a file, and no way out of its folder.
///
/// # Errors
/// When it is more than that, such as `../x`.
pub fn see_that_it_stays(name: &str) -> Result<(), CopyError> {
    match Path::new(name).file_name() == Some(name.as_ref()) {
        true => Ok(()),
        false => Err(CopyError::Name {
            name: name.to_owned(),
        }),
    }
}

fn copy_scenario(from: &Path, to: &Path, redaction: &Redaction) -> Result<(), CopyError> {
    for file in files(from) {
        let copy = to.join(file.strip_prefix(from).unwrap_or(&file));
        match Kind::of(&file) {
            Some(Kind::Document) => copy_document(&file, &copy, redaction)?,
            Some(Kind::Text) => {
                write(
                    &copy,
                    &redaction.text(&String::from_utf8_lossy(&read_file(&file)?)),
                )?;
            }
            None if was_measured(&file) => {
                make_folder_of(&copy)?;
                fs::copy(&file, &copy).map(drop).map_err(at(&copy))?;
            }
            None => {}
        }
    }
    Ok(())
}

/// Whether the record of the window beside it names it, with its checksum.
fn was_measured(file: &Path) -> bool {
    let record = read_record::<WindowRecord>(&file.with_file_name("window.json"), workload::record::FORMAT);
    let name = file.file_name().and_then(|name| name.to_str());
    record.is_ok_and(|record| record.files.iter().any(|file| Some(file.name.as_str()) == name))
}

fn copy_document(from: &Path, to: &Path, redaction: &Redaction) -> Result<(), CopyError> {
    write_document(to, &redaction.document(read_record(from, FORMAT)?))
}

fn write_document(to: &Path, document: &Value) -> Result<(), CopyError> {
    write(to, &format!("{document:#}\n"))
}

fn write(to: &Path, text: &str) -> Result<(), CopyError> {
    make_folder_of(to)?;
    fs::write(to, text).map_err(at(to))
}

fn make_folder_of(file: &Path) -> Result<(), CopyError> {
    let folder = file.parent().unwrap_or(file);
    fs::create_dir_all(folder).map_err(at(folder))
}

fn at(path: &Path) -> impl FnOnce(io::Error) -> CopyError {
    let path = path.to_owned();
    |source| CopyError::Io { path, source }
}
