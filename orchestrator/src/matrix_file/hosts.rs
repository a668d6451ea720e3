//! The `hosts:` section: which machines there are, what they offer, how they are reached. The main type is [`Host`].

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
};

use record::{
    connection::{Connection, Nodes},
    name::name_if_any,
    run_directory::Manifest,
};
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
    /// The node that it is, where a host of the file is each of a cluster's nodes.
    pub node: Option<OneNode>,
    /// How it is reached.
    pub connection: Connection,
}

/// A node of a cluster as a host of its own.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OneNode {
    /// Its name in the cluster.
    pub name: String,
    /// The host of the file that stands for all of them.
    pub of: String,
}

impl Host {
    /// Whether it stands for nodes that only their cluster knows (`nodes: each`).
    #[must_use]
    pub fn is_each_node(&self) -> bool {
        matches!(&self.connection, Connection::Slurm(slurm) if slurm.nodes == Nodes::Each)
    }

    /// The same host on one node of its cluster.
    #[must_use]
    pub fn on_node(&self, node: &str) -> Self {
        let mut host = self.clone();
        host.name.value = format!("{}-{node}", self.name.value);
        host.node = Some(OneNode {
            name: node.to_owned(),
            of: self.name.value.clone(),
        });
        if let Connection::Slurm(slurm) = &mut host.connection {
            slurm.nodes = Nodes::One;
            slurm.nodelist = Some(node.to_owned());
        }
        host
    }
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
        node: None,
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
                node: None,
                connection: host.connect,
            }),
            Err(wrong) => found.extend(wrong),
        }
    }
    for host in &hosts {
        check_offer(source, host, found);
        if let Some(pool) = host.pool.as_ref().filter(|_| host.is_each_node()) {
            let message = format!(
                "each node of `{}` measures every scenario, and those of the pool `{pool}` share them",
                host.name.value
            );
            let help = "leave out `pool`, or write `nodes: any`";
            found.push(Diagnostic::error(source, Code::InvalidValue, host.name.span, message).help(help));
        }
    }
    hosts
}

/// Makes each of these nodes a host in the place of the one that stands for them.
///
/// # Errors
/// When there is none, or a name of a host that cannot be one or that is there already.
pub fn split(
    source: &Arc<Source>,
    hosts: &mut Vec<Host>,
    nodes: &BTreeMap<String, Vec<String>>,
) -> Result<(), Diagnostics> {
    let mut found = Diagnostics::new();
    let mut all = Vec::new();
    for host in hosts.iter() {
        match nodes.get(&host.name.value) {
            Some(nodes) => {
                if nodes.is_empty() {
                    let message = format!("no node of the cluster fits the host `{}`", host.name.value);
                    let help = "compare `constraint`, `partition`, `nodelist` and `exclude` with `sinfo -N -o '%N %P %f'`";
                    found.push(
                        Diagnostic::error(source, Code::UnknownValue, host.name.span, message).help(help),
                    );
                }
                all.extend(nodes.iter().map(|node| host.on_node(node)));
            }
            None => all.push(host.clone()),
        }
    }
    let mut names = BTreeSet::new();
    for host in &all {
        if host.node.is_some() {
            check_name(source, &host.name, &mut found);
        }
        if !names.insert(&host.name.value) {
            let message = format!("the name `{}` is that of two hosts", host.name.value);
            let help = "give the host another name: those of its nodes follow it, behind a `-`";
            found.push(Diagnostic::error(source, Code::InvalidValue, host.name.span, message).help(help));
        }
    }
    if all.len() > Manifest::MOST_HOSTS {
        let message = format!(
            "{} hosts and nodes are more than {}",
            all.len(),
            Manifest::MOST_HOSTS
        );
        let span = hosts.first().map_or_else(Span::default, |host| host.name.span);
        found.push(
            Diagnostic::error(source, Code::TooLarge, span, message)
                .help("name fewer nodes as `nodelist`, or write `nodes: any`"),
        );
    }
    let (all, _) = found.unless_errors(all)?;
    *hosts = all;
    Ok(())
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

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use rstest::rstest;

    use crate::matrix_file::MatrixFile;

    #[rstest]
    #[case::none(&[], "no node of the cluster fits the host `lab`")]
    #[case::taken(&["a"], "the name `lab-a` is that of two hosts")]
    #[case::odd(&["a/b"], "`lab-a/b` is no name for a host")]
    fn nodes_that_cannot_be_hosts_are_errors_of_the_host_that_stands_for_them(
        #[case] nodes: &[&str],
        #[case] says: &str,
    ) {
        let text = "hosts:\n  lab: {hardware: x, os: y, connect: {slurm: {nodes: each}}}\n  lab-a: {hardware: x, os: y, connect: {ssh: \
                    me@there}}\nmatrix: {}\n";
        let mut file = MatrixFile::parse("matrix.yaml", text.as_bytes(), None).unwrap();
        let nodes = nodes.iter().map(|&it| it.to_owned()).collect();
        let wrong = file.split_hosts(&BTreeMap::from([("lab".to_owned(), nodes)]));
        let told = wrong.unwrap_err().to_string();
        assert!(told.contains(says) && told.contains("matrix.yaml:"), "{told}");
    }

    #[test]
    fn nodes_that_are_each_a_host_are_in_no_pool() {
        let text =
            "hosts: {lab: {hardware: x, os: y, pool: p, connect: {slurm: {nodes: each}}}}\nmatrix: {}\n";
        let wrong = MatrixFile::parse("matrix.yaml", text.as_bytes(), None).unwrap_err();
        assert!(wrong.to_string().contains("leave out `pool`"), "{wrong}");
    }
}
