//! The `hosts:` section: which machines there are, what they offer, how they are reached. The main type is [`Host`].

use std::sync::Arc;

use record::{connection::Connection, name::name_if_any, run_directory::Manifest};
use schemars::JsonSchema;
use serde::Deserialize;

use super::{
    diagnostic::{Code, Diagnostic, Diagnostics},
    source::{Source, Span, Spanned},
    tree::{Content, Node},
    typing,
};

/// The name of the host that is meant when the file names none.
pub const THIS_MACHINE: &str = "local";

/// A machine.
#[derive(Debug, Clone, PartialEq)]
pub struct Host {
    /// Its name in the file.
    pub name: Spanned<String>,
    /// The hardware it offers; read from the machine when it is left out.
    pub hardware: Option<String>,
    /// The operating system it offers; read from the machine when it is left out.
    pub os: Option<String>,
    /// The hosts of one pool share the rounds of the scenarios that all of them can run.
    pub pool: Option<String>,
    /// How it is reached.
    pub connection: Connection,
}

/// One entry of the section, as it is written.
#[derive(Debug, Default, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
#[schemars(rename = "Host")]
pub(super) struct HostEntry {
    /// The hardware it offers, such as `i686`; read from this machine when left out.
    hardware: Option<String>,
    /// The operating system it offers, such as `ubuntu`; read from this machine when left out.
    os: Option<String>,
    /// The name of a pool. Hosts of one pool that have the same hardware and OS share the rounds of each scenario
    /// (`workload.environments`), side by side: round N is measured on number N of them.
    #[serde(deserialize_with = "name_if_any")]
    pool: Option<String>,
    /// How it is reached.
    connect: Connection,
}

/// The hosts when the file has no such section: this machine.
#[must_use]
pub fn this_machine() -> Vec<Host> {
    vec![Host {
        name: Spanned::new(THIS_MACHINE.to_owned(), Span::default()),
        hardware: None,
        os: None,
        pool: None,
        connection: Connection::Local,
    }]
}

/// Reads the section. What is wrong goes to `found`.
pub fn read(source: &Arc<Source>, node: &Node, found: &mut Diagnostics) -> Vec<Host> {
    if !matches!(node.content, Content::Mapping(_)) || node.entries().is_empty() {
        let message = format!("names of hosts belong here, not {}", node.describe());
        found.push(
            Diagnostic::error(source, Code::WrongType, node.span, message).help(
                "write `lab1: {hardware: …, os: …, connect: local}`, or leave `hosts:` out for this machine",
            ),
        );
        return Vec::new();
    }
    if node.entries().len() > Manifest::MOST_HOSTS {
        let message = format!(
            "{} hosts are more than {}",
            node.entries().len(),
            Manifest::MOST_HOSTS
        );
        found.push(
            Diagnostic::error(source, Code::TooLarge, node.span, message)
                .help("leave out hosts that measure no scenario"),
        );
        return Vec::new();
    }
    let mut hosts = Vec::new();
    for entry in node.entries() {
        check_name(source, &entry.key, found);
        match typing::read::<HostEntry>(source, &entry.value) {
            Ok(host) => hosts.push(Host {
                name: entry.key.clone(),
                hardware: host.hardware,
                os: host.os,
                pool: host.pool,
                connection: host.connect,
            }),
            Err(wrong) => found.extend(wrong),
        }
    }
    for host in &hosts {
        check_offer(source, host, found);
    }
    hosts
}

/// Names become names of locks and of files.
fn check_name(source: &Arc<Source>, name: &Spanned<String>, found: &mut Diagnostics) {
    let text = &name.value;
    let safe = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-');
    if text.is_empty() || text.len() > 63 || text.starts_with(['.', '-']) || !text.chars().all(safe) {
        found.push(
            Diagnostic::error(
                source,
                Code::InvalidValue,
                name.span,
                format!("`{text}` is no name for a host"),
            )
            .help("use letters, digits, `-`, `_` and `.`, at most 63, a letter or digit first"),
        );
    }
}

/// What cannot be read from the machine must be said.
fn check_offer(source: &Arc<Source>, host: &Host, found: &mut Diagnostics) {
    if host.connection == Connection::Local {
        return;
    }
    for (key, value, example) in [("hardware", &host.hardware, "i686"), ("os", &host.os, "ubuntu")] {
        if value.is_none() {
            let message = format!("the host `{}` does not say its `{key}`", host.name.value);
            found.push(
                Diagnostic::error(source, Code::MissingKey, host.name.span, message).help(format!(
                    "add `{key}: {example}` or whatever it is: only of this machine it is read from the machine"
                )),
            );
        }
    }
}
