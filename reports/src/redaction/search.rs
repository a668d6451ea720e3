//! Names in a run, known from where they stand.

use std::{
    collections::{BTreeMap, BTreeSet},
    net::IpAddr,
};

use record::{
    field,
    platform::RealtimeGrant,
    run_directory::{
        FORMAT, LONGEST_RECORD, PlannedScenario, ReadError, RunDirectory, RunRecords, fact, read_file,
        read_record,
    },
    virtual_host::VirtualHost,
    window::{NoticesRecord, WindowRecord},
};
use serde_json::Value;

use super::files::{Kind, files};

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

/// What was found in documents, before it has other names.
#[derive(Default)]
pub(super) struct Found {
    /// By kind, in lower case.
    pub(super) names: BTreeMap<&'static str, BTreeSet<String>>,
    /// Axis values and slugs, in lower case.
    pub(super) axes: BTreeSet<String>,
}

impl Found {
    pub(super) fn look_at_run(&mut self, run: &RunDirectory) -> Result<(), ReadError> {
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

    pub(super) fn add(&mut self, kind: &'static str, name: &str) {
        let name = name.trim().to_ascii_lowercase();
        let is_virtual = VirtualHost::OF_THE_BALL.iter().any(|host| host.name() == name);
        let says_something = !name.is_empty() && !is_virtual && !ANYBODYS.contains(&name.as_str());
        let is_new = self.names.values().all(|names| !names.contains(&name));
        if says_something && is_new {
            self.names.entry(kind).or_default().insert(name);
        }
    }
}
