//! Names of people and machines out of runs, for a review in which nobody is to know who measured. The main type is
//! [`Redaction`]; [`copy`] makes a run directory that can be handed on.
//!
//! What is a name is known from where it stands: a host of the matrix file, the host and user of an SSH address, a hostname,
//! a user's folder. Each gets another name, the same wherever it stands as a word. Command lines, paths of keys and the matrix
//! file's text are left out. What was measured stays as it is, byte for byte, and so do axes and settings.

mod names;

use std::{
    collections::{BTreeMap, BTreeSet},
    io,
    net::IpAddr,
    path::{Path, PathBuf},
};

use record::{
    field, layout,
    platform::{PlatformRecord, RealtimeGrant},
    run_directory::{
        Chain, EnvironmentRecord, Event, FORMAT, HostRecord, Journal, JournalEntry, Kind as Entry,
        LONGEST_RECORD, Manifest, Place, PlannedScenario, ReadError, RunDirectory, RunRecords, ScenarioState,
        fact, read_environment, read_file, read_record, read_window,
    },
    virtual_host::VirtualHost,
    window::{NoticesRecord, WindowRecord},
};
use serde::{Serialize, de::DeserializeOwned};
use serde_json::{Map, Value};

use self::names::Names;
use crate::input::run::{Ending, Run, ScenarioRun, WindowState};

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
    field!(PlannedScenario, axes),
    "control",
    "event",
    field!(WindowRecord, files),
    field!(Manifest, matrix_sha256),
    "method",
    "outcome",
    field!(EnvironmentRecord, provider),
    field!(Manifest, report),
    field!(PlannedScenario, settings),
    "sha256",
    field!(PlannedScenario, slug),
    field!(WindowRecord, verdict),
    field!(Manifest, workload_sha256),
];
/// Fields that are left out.
const LEFT_OUT: [&str; 4] = [
    field!(HostRecord, connect),
    field!(PlatformRecord, kernel_command_line),
    "machine_id",
    field!(Manifest, state_directory),
];
/// Fields with sentences, in which addresses may stand.
const PROSE: [&str; 6] = [
    field!(NoticesRecord, first),
    field!(PlannedScenario, fix),
    "hint",
    field!(PlannedScenario, reason),
    field!(WindowRecord, reasons),
    field!(RealtimeGrant, priority_refusal),
];
/// Where the folders of users are.
const HOMES: [&str; 3] = ["/home/", "/Users/", "\\Users\\"];

/// Why a redacted copy cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum CopyError {
    /// The run cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// A name that was replaced is a word of the format.
    #[error("the copy of the journal cannot be understood")]
    Word(#[from] serde_json::Error),
    /// The operating system refused.
    #[error("{} cannot be written", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
}

impl CopyError {
    /// What to do about it.
    #[must_use]
    pub fn hint(&self) -> String {
        match self {
            Self::Read(error) => error.hint(),
            Self::Word(_) => {
                "a name that was replaced is a word of the run directory's own: leave it in, or rename the host".to_owned()
            }
            Self::Io { source, .. } if source.kind() == io::ErrorKind::AlreadyExists => {
                "give another folder with `--output`, or remove this one".to_owned()
            }
            Self::Io { .. } => "see that the disk has room and that you may write there".to_owned(),
        }
    }
}

/// The names that are replaced.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Redaction {
    /// With what stands for them.
    names: Names<String>,
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
            .map(|(name, other)| (name, other.as_str()))
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
        // From the last to the first.
        let mut found: Vec<_> = self.names.beginnings(&lower).collect();
        let mut redacted = String::with_capacity(text.len());
        let mut at = 0;
        while let Some((begins, name, other)) = found.pop() {
            // One within another that was replaced.
            if begins < at {
                continue;
            }
            redacted.push_str(text.get(at..begins).unwrap_or_default());
            redacted.push_str(other);
            at = begins + name.len();
        }
        redacted.push_str(text.get(at..).unwrap_or_default());
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
            ("invocation", Value::Array(_)) => Value::Array(Vec::new()),
            // A process, its machine and the folder of its run, which is somebody else's.
            ("holder", Value::String(_)) => "another run".into(),
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
        let RunRecords {
            manifest,
            plan,
            journal,
            ..
        } = RunRecords::read_unpruned(run)?;
        for host in &manifest.hosts {
            self.add_host(&host.name);
        }
        for document in [run.manifest(), run.plan()] {
            self.look_at("", &read_record(&document, FORMAT)?);
        }
        for entry in journal.entries {
            self.look_at("", &serde_json::to_value(entry).unwrap_or_default());
        }
        for scenario in &plan.scenarios {
            let folder = run.scenario(&scenario.slug);
            let unreadable = |source| ReadError::Io {
                path: folder.path(),
                source,
            };
            for file in files(&folder).map_err(unreadable)? {
                match Kind::of(&file) {
                    Some(Kind::Document) => self.look_at("", &read_record(&file, FORMAT)?),
                    Some(Kind::LeftOut) => {}
                    Some(Kind::Text) => {
                        self.look_at_text(&String::from_utf8_lossy(&read_file(&file, LONGEST_RECORD)?));
                    }
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
                        .map(|value| record::axis::axis_text(value).to_ascii_lowercase()),
                );
            }
            ("slug", Value::String(slug)) => drop(self.axes.insert(slug.to_ascii_lowercase())),
            ("host" | "hostname", Value::String(host)) => self.add_host(host),
            ("ssh" | "jump", Value::String(address)) => self.add_address(address),
            ("identity" | "known_hosts" | "matrix_file" | "state_directory", Value::String(path)) => {
                self.add("path", path);
                self.look_at_text(path);
            }
            (fact::JOB_WISHES, Value::Array(options)) => {
                let values = options.iter().filter_map(|it| it.as_str()?.split_once('='));
                values.for_each(|(_, value)| self.add("option", value));
            }
            (name, Value::String(text)) => {
                self.look_at_text(text);
                if PROSE.contains(&name) {
                    self.look_for_addresses(text);
                }
            }
            (name, Value::Array(values)) => values.iter().for_each(|value| self.look_at(name, value)),
            (_, Value::Object(fields)) => {
                // Not every node is a cluster's: a job's is.
                if let (Some(_), Some(node)) = (fields.get(fact::JOB), fields.get(fact::NODE)) {
                    self.add_host(node.as_str().unwrap_or_default());
                }
                fields.iter().for_each(|(name, value)| self.look_at(name, value));
            }
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
        let is_virtual = VirtualHost::OF_THE_BALL.iter().any(|host| host.name() == name);
        let says_something = !name.is_empty() && !is_virtual && !ANYBODYS.contains(&name.as_str());
        let is_new = self.names.values().all(|names| !names.contains(&name));
        if says_something && is_new {
            self.names.entry(kind).or_default().insert(name);
        }
    }

    fn redaction(self) -> Redaction {
        let all = self.names.values().flatten();
        let all: Names<()> = all.map(|name| (name.clone(), ())).collect();
        let kept: BTreeSet<&str> = self.axes.iter().flat_map(|axis| all.within(axis)).collect();
        let replaced = self.names.iter().flat_map(|(kind, names)| {
            let replaced = names.iter().filter(|name| !kept.contains(name.as_str()));
            (1..)
                .zip(replaced)
                .map(move |(number, name)| (name.clone(), format!("{kind}-{number}")))
        });
        Redaction {
            names: replaced.collect(),
            kept: kept.into_iter().map(str::to_owned).collect(),
        }
    }
}

/// What is not measured in a scenario's folder.
enum Kind {
    /// JSON.
    Document,
    /// Text.
    Text,
    /// What a command printed, which may be anything.
    LeftOut,
}

impl Kind {
    fn of(file: &Place) -> Option<Self> {
        match file.name() {
            layout::WINDOW => Some(Self::Document),
            name if layout::is_printed(name) => Some(Self::LeftOut),
            name if name.starts_with("environment") && name.ends_with(".json") => Some(Self::Document),
            name if name.starts_with("network") && name.ends_with(".txt") => Some(Self::Text),
            _ => None,
        }
    }
}

/// The files of a scenario's folder and of its windows, in the order of their names; none of what broke.
fn files(scenario: &Place) -> io::Result<Vec<Place>> {
    let mut files = Vec::new();
    if !scenario.exists() {
        return Ok(files);
    }
    for (place, kind) in scenario.entries()? {
        match kind {
            Entry::Folder if layout::window_of(place.name()).is_some() => {
                let inner = place.entries()?;
                files.extend(inner.into_iter().filter(is_file).map(|(place, _)| place));
            }
            Entry::File => files.push(place),
            Entry::Folder | Entry::Other => {}
        }
    }
    Ok(files)
}

fn is_file((_, kind): &(Place, Entry)) -> bool {
    *kind == Entry::File
}

impl Run {
    /// The run without names of hosts and users, addresses and command lines.
    ///
    /// # Errors
    /// When a name is a word of the format.
    pub fn redacted(mut self, redaction: &Redaction) -> Result<Self, serde_json::Error> {
        // That of several runs is a list of names and no name.
        let run = std::mem::replace(&mut self.manifest.run, "run".to_owned());
        self.manifest = redaction.record(&self.manifest)?;
        self.manifest.run = redaction.text(&run);
        self.manifest.redacted = true;
        for part in &mut self.parts {
            part.run = redaction.text(&part.run);
            part.asked.invocation.clear();
            part.asked.matrix_text.clear();
            part.asked.profile = part
                .asked
                .profile
                .as_deref()
                .map(|profile| redaction.text(profile));
            "matrix.yaml".clone_into(&mut part.asked.matrix_file);
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
                WindowState::Missing { .. } => {}
            }
        }
        self.broken.iter_mut().for_each(|broken| text(&mut broken.reason));
        Ok(())
    }
}

/// Makes a copy of a run without the names, from which a report can be made. Left out are what broke, the report, the files
/// of a user's experiment and what its commands printed, and lines of the journal that a crash cut. It has checksums of its own where the run has them.
///
/// # Errors
/// When there is something at that place, and when something cannot be read or written, or is damaged.
pub fn copy(run: &RunDirectory, to: &Path, redaction: &Redaction) -> Result<(), CopyError> {
    let records = RunRecords::read_unpruned(run)?;
    std::fs::create_dir_all(to.parent().unwrap_or(to)).map_err(at(to))?;
    std::fs::create_dir(to).map_err(at(to))?;
    let copy = RunDirectory::new(to);
    let mut sums = NewSums::default();
    for scenario in &records.plan.scenarios {
        let (from, to) = (run.scenario(&scenario.slug), copy.scenario(&scenario.slug));
        let known = records.state.scenario(&scenario.slug);
        copy_scenario(&from, &to, &known, redaction, &mut sums)?;
    }
    copy_document(&run.plan(), &copy.plan(), redaction, &mut sums)?;
    let mut manifest: Map<String, Value> = read_record(&run.manifest(), FORMAT)?;
    manifest.insert(field!(Manifest, redacted).to_owned(), true.into());
    let manifest = redaction.document(manifest.into());
    sums.write_document(&run.manifest(), &copy.manifest(), &manifest)?;
    write(
        &copy.journal(),
        &copied_journal(records.journal, redaction, &sums)?,
    )
}

/// SHA-256 of files of a run, with those that stand for them in its copy.
#[derive(Default)]
struct NewSums(BTreeMap<String, String>);

impl NewSums {
    /// Writes what stands for a file.
    fn write_document(&mut self, from: &Place, to: &Place, document: &Value) -> Result<(), CopyError> {
        write(to, format!("{document:#}\n").as_bytes())?;
        let [from, to] = [from, to].map(|it| it.digest().map_err(at(&it.path())));
        self.0.insert(from?.sha256, to?.sha256);
        Ok(())
    }

    /// What stands for a file that was copied; none for others.
    fn renew(&self, sha256: &mut Option<String>) {
        *sha256 = sha256.take().and_then(|old| self.0.get(&old).cloned());
    }
}

fn copied_journal(journal: Journal, redaction: &Redaction, sums: &NewSums) -> Result<Vec<u8>, CopyError> {
    let is_checked = journal.is_checked();
    let (mut chain, mut text) = (Chain::default(), Vec::new());
    for entry in journal.entries {
        let mut entry: JournalEntry = redaction.record(&entry)?;
        match &mut entry.event {
            Event::RunStarted {
                manifest_sha256,
                plan_sha256,
                ..
            } => {
                sums.renew(manifest_sha256);
                sums.renew(plan_sha256);
            }
            Event::WindowCollected { sha256, .. } => sums.renew(sha256),
            Event::EnvironmentRecorded { sha256, .. } => {
                let mut renewed = Some(sha256.clone());
                sums.renew(&mut renewed);
                match renewed {
                    Some(renewed) => *sha256 = renewed,
                    // It was written over.
                    None => continue,
                }
            }
            _ => {}
        }
        match is_checked {
            true => text.extend(chain.line(&entry)?),
            false => {
                serde_json::to_writer(&mut text, &entry)?;
                text.push(b'\n');
            }
        }
    }
    Ok(text)
}

fn copy_scenario(
    from: &Place,
    to: &Place,
    known: &ScenarioState,
    redaction: &Redaction,
    sums: &mut NewSums,
) -> Result<(), CopyError> {
    for file in files(from).map_err(at(&from.path()))? {
        let (path, above) = (file.path(), from.path());
        let copy = to.join(path.strip_prefix(above).unwrap_or(&path));
        match Kind::of(&file) {
            Some(Kind::Document) => {
                ensure_as_written(&file, known)?;
                copy_document(&file, &copy, redaction, sums)?;
            }
            Some(Kind::LeftOut) => {}
            Some(Kind::Text) => {
                let text = redaction.text(&String::from_utf8_lossy(&read_file(&file, LONGEST_RECORD)?));
                write(&copy, text.as_bytes())?;
            }
            None => {
                let Some(bytes) = measured_bytes(&file) else {
                    continue;
                };
                make_folder_of(&copy)?;
                let mut from = file.open_within(bytes).map_err(|source| ReadError::Io {
                    path: file.path(),
                    source,
                })?;
                let copied = copy.create().and_then(|mut to| io::copy(&mut from, &mut to));
                copied.map(drop).map_err(at(&copy.path()))?;
            }
        }
    }
    Ok(())
}

/// A copy has checksums of its own: what is damaged would be whole in it.
fn ensure_as_written(document: &Place, known: &ScenarioState) -> Result<(), ReadError> {
    match layout::window_of(document.parent().name()) {
        Some(window) => read_window(&document.parent(), known.window_sha256(window)).map(drop),
        None => read_environment(document, known.environment_sha256s()).map(drop),
    }
}

/// How long it was when it was measured, if the record of the window beside it names it.
fn measured_bytes(file: &Place) -> Option<u64> {
    let record = read_window(&file.parent(), None).ok()?;
    let recorded = record.files.iter().find(|it| it.name == file.name())?;
    Some(recorded.bytes)
}

fn copy_document(
    from: &Place,
    to: &Place,
    redaction: &Redaction,
    sums: &mut NewSums,
) -> Result<(), CopyError> {
    let mut document = redaction.document(read_record(from, FORMAT)?);
    // A window's record names the files that the copy has.
    if let Some(Value::Array(files)) = document.get_mut("files") {
        files.retain(|file| {
            let name = file.get("name").and_then(Value::as_str).unwrap_or_default();
            !layout::is_printed(name)
        });
    }
    sums.write_document(from, to, &document)
}

fn write(to: &Place, text: &[u8]) -> Result<(), CopyError> {
    make_folder_of(to)?;
    to.write(text).map_err(at(&to.path()))
}

fn make_folder_of(file: &Place) -> Result<(), CopyError> {
    let folder = file.parent();
    folder.make_folder().map_err(at(&folder.path()))
}

fn at(path: &Path) -> impl FnOnce(io::Error) -> CopyError {
    let path = path.to_owned();
    |source| CopyError::Io { path, source }
}
