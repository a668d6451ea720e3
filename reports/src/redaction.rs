//! Names of people and machines out of runs, for a review in which nobody is to know who measured. The main type is
//! [`Redaction`]; [`copy`] makes a run directory that can be handed on.
//!
//! What is a name is known from where it stands: a host of the matrix file, the host and user of an SSH address, a hostname,
//! a user's folder. Each gets another name, the same wherever it stands as a word. Command lines, paths of keys and the matrix
//! file's text are left out. What was measured stays as it is, byte for byte, and so do axes and settings.

mod copy;
mod files;
mod names;
mod search;

use std::collections::{BTreeMap, BTreeSet};

use record::{
    field,
    platform::PlatformRecord,
    run_directory::{EnvironmentRecord, HostRecord, Manifest, PlannedScenario, ReadError, RunDirectory},
    window::WindowRecord,
};
use serde::{Serialize, de::DeserializeOwned};
use serde_json::{Map, Value};

pub use self::copy::{CopyError, copy};
use self::{names::Names, search::Found};
use crate::input::run::{Ending, Run, ScenarioRun, WindowState};

/// What a reader of a report must know.
pub(crate) const REMARK: &str =
    "Redacted: names of hosts and users, addresses and command lines are not those of the run.";

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
        Ok(found.into())
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

impl From<Found> for Redaction {
    fn from(found: Found) -> Self {
        let all = found.names.values().flatten();
        let all: Names<()> = all.map(|name| (name.clone(), ())).collect();
        let kept: BTreeSet<&str> = found.axes.iter().flat_map(|axis| all.within(axis)).collect();
        let replaced = found.names.iter().flat_map(|(kind, names)| {
            let replaced = names.iter().filter(|name| !kept.contains(name.as_str()));
            (1..)
                .zip(replaced)
                .map(move |(number, name)| (name.clone(), format!("{kind}-{number}")))
        });
        Self {
            names: replaced.collect(),
            kept: kept.into_iter().map(str::to_owned).collect(),
        }
    }
}

/// `platform.changes` has entries of a field's name and what it was and is.
fn is_change_of_what_is_left_out(fields: &Map<String, Value>) -> bool {
    let what = fields.get("what").and_then(Value::as_str);
    what.is_some_and(|what| LEFT_OUT.contains(&what))
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
