//! A program on a virtual host: `nodes:` in place of `run:`. The main type is [`NodeSettings`].

use serde::{Deserialize, Serialize};

use super::argument::Argument;
use crate::{settings::RosMaster, topology::Topology, virtual_host::VirtualHost};

/// A program that is started on a virtual host in each window.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct NodeSettings {
    /// Its name, in reports and in files.
    pub name: VirtualHost,
    /// The virtual host that it runs on.
    pub host: VirtualHost,
    /// The program and its arguments, without a shell.
    pub run: Vec<Argument>,
    /// What shows that it is ready. The nodes are started in the order of the file, each when the one before it is ready. Left out, it
    /// is ready once it is started.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ready: Option<Ready>,
    /// Whether the window ends without it: it is then asked to end (SIGTERM). One that ends before makes the window invalid.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub background: bool,
}

/// What shows that a node is ready.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum Ready {
    /// Something listens on this TCP port of its host.
    Port(u32),
    /// The ROS master knows a publisher of this topic.
    Topic(String),
    /// It has printed a line with this text, on standard output or standard error.
    Line(String),
}

/// A ROS master for the nodes, which find it by `ROS_MASTER_URI`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct RosMasterSettings {
    /// Which program it is.
    pub program: RosMaster,
    /// The virtual host that it runs on; the first one if it is left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub host: Option<VirtualHost>,
}

impl RosMasterSettings {
    /// Where it runs in that network; none if that has no such host.
    #[must_use]
    pub fn position(&self, topology: &Topology) -> Option<usize> {
        match self.host {
            Some(host) => topology.position(host),
            None => (!topology.hosts.is_empty()).then_some(0),
        }
    }
}

/// A path below the section, what is wrong, what to write.
type Problem = (String, String, String);

/// A line to look for, or a topic's name, is no longer.
const LONGEST: usize = 255;

/// What is wrong with nodes and their master.
pub(super) fn problems(
    nodes: &[NodeSettings],
    master: Option<&RosMasterSettings>,
    topology: &Topology,
) -> Vec<Problem> {
    let mut found = Vec::new();
    let hosts = || {
        topology
            .names()
            .map(|name| format!("`{name}`"))
            .collect::<Vec<_>>()
            .join(", ")
    };
    let no_host = |path: String, host: VirtualHost| {
        let hint = format!("write one of {}, or add it to `workload.network.hosts`", hosts());
        (path, format!("the network has no host `{host}`"), hint)
    };
    let lost = master.and_then(|master| master.host.filter(|_| master.position(topology).is_none()));
    if let Some(host) = lost {
        found.push(no_host("ros_master.host".to_owned(), host));
    }
    if !nodes.is_empty() && nodes.iter().all(|node| node.background) {
        let message = "all nodes are in the background, and nothing ends the window".to_owned();
        let hint = "take `background: true` from the node that measures".to_owned();
        found.push(("nodes".to_owned(), message, hint));
    }
    for (at, node) in nodes.iter().enumerate() {
        let path = |field: &str| format!("nodes.{at}.{field}");
        if nodes
            .get(..at)
            .unwrap_or_default()
            .iter()
            .any(|other| other.name == node.name)
        {
            let message = format!("two nodes are called `{}`", node.name);
            found.push((
                path("name"),
                message,
                "give each node a name of its own".to_owned(),
            ));
        }
        if topology.position(node.host).is_none() {
            found.push(no_host(path("host"), node.host));
        }
        if node.run.is_empty() {
            let hint = "write a program and its arguments as a list, such as `run: [python3, plant.py]`";
            found.push((
                path("run"),
                "there is no program to start".to_owned(),
                hint.to_owned(),
            ));
        }
        let wrong = match &node.ready {
            Some(Ready::Port(port)) if !(1..=u32::from(u16::MAX)).contains(port) => {
                Some(("that is no port", "write one from 1 to 65535"))
            }
            Some(Ready::Topic(_)) if master.is_none() => Some((
                "there is no ROS master that could know a topic",
                "write `ros_master: {}` beside `nodes:`, or another sign, such as `ready: {line: started}`",
            )),
            Some(Ready::Topic(topic)) if !is_topic(topic) => Some((
                "that is no topic of ROS",
                "write its whole name, such as `/plant/state`",
            )),
            Some(Ready::Line(line)) if line.trim().is_empty() || line.len() > LONGEST => Some((
                "no line is known by that text",
                "write a word that the program prints once it is ready",
            )),
            _ => None,
        };
        found.extend(wrong.map(|(message, hint)| (path("ready"), message.to_owned(), hint.to_owned())));
    }
    found
}

/// Whether it is a global name of ROS (wiki.ros.org/Names).
fn is_topic(text: &str) -> bool {
    let is_part = |part: &str| {
        part.bytes()
            .next()
            .is_some_and(|first| first.is_ascii_alphabetic())
            && part
                .bytes()
                .all(|byte| byte.is_ascii_alphanumeric() || byte == b'_')
    };
    text.len() <= LONGEST
        && text
            .strip_prefix('/')
            .is_some_and(|rest| rest.split('/').all(is_part))
}
