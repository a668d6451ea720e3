//! The settings of the emulated network.

use indexmap::IndexMap;
use serde::{Deserialize, Serialize};

use super::NetworkBackend;
use crate::{
    quantity::{BitRate, Fraction, TimeSpan},
    topology::{Link, LinkSettings, Topology, Wanted},
    virtual_host::VirtualHost,
};

/// How the virtual hosts are connected. Delay, jitter, loss and rate are applied at both ends of each link.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct NetworkSettings {
    /// What carries the packets.
    pub backend: NetworkBackend,
    /// Mean delay of one pass through a link's end.
    pub delay: TimeSpan,
    /// Uniform on [delay − jitter, delay + jitter).
    pub jitter: TimeSpan,
    /// Share of packets lost at one pass through a link's end, each independently.
    pub loss: Fraction,
    /// Rate of one pass through a link's end.
    pub bandwidth: BitRate,
    /// How many packets a link's end holds before it drops (netem's `limit`).
    pub limit_packets: u32,
    /// From when on the links are impaired.
    pub impaired_from: ImpairedFrom,
    /// What the hosts' interfaces do for TCP, where they are the kernel's.
    pub offloads: Offloads,
    /// Seed of the losses and the jitter, of the `userspace` network only. When it is left out, each environment draws its own and `window.json` has it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// The virtual hosts, each with its link to a switch. Their addresses are 10.0.0.1, 10.0.0.2 and so on in this order. Left out,
    /// they are h1, sta1 and sta2.
    #[serde(skip_serializing_if = "IndexMap::is_empty")]
    #[cfg_attr(
        feature = "schema",
        schemars(with = "std::collections::BTreeMap<String, LinkSettings>")
    )]
    pub hosts: IndexMap<VirtualHost, LinkSettings>,
    /// The switches, each but the first with its link to one before it. Left out, there is one.
    #[serde(skip_serializing_if = "IndexMap::is_empty")]
    #[cfg_attr(
        feature = "schema",
        schemars(with = "std::collections::BTreeMap<String, LinkSettings>")
    )]
    pub switches: IndexMap<VirtualHost, LinkSettings>,
}

impl NetworkSettings {
    /// Who is connected to whom.
    #[must_use]
    pub fn topology(&self) -> Topology {
        Topology::of(&self.wanted(&self.link()))
    }

    pub(crate) const fn wanted<'a>(&'a self, link: &'a Link) -> Wanted<'a> {
        Wanted {
            hosts: &self.hosts,
            switches: &self.switches,
            link,
        }
    }

    /// What each link does that says nothing of its own.
    #[must_use]
    pub const fn link(&self) -> Link {
        Link {
            delay: self.delay,
            jitter: self.jitter,
            loss: self.loss,
            bandwidth: self.bandwidth,
            limit_packets: self.limit_packets,
        }
    }
}

impl Default for NetworkSettings {
    fn default() -> Self {
        Self {
            backend: NetworkBackend::Userspace,
            delay: TimeSpan::from_millis(10),
            jitter: TimeSpan::from_millis(1),
            loss: Fraction::from_percent(1.0),
            bandwidth: BitRate::from_mbit(10),
            limit_packets: 1000,
            impaired_from: ImpairedFrom::Connection,
            offloads: Offloads::Mininet,
            seed: None,
            hosts: IndexMap::new(),
            switches: IndexMap::new(),
        }
    }
}

/// From when on the links delay, lose and limit. All control steps are after it, either way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum ImpairedFrom {
    /// Once both topics are connected. Registering and connecting take some fifteen messages in a row, 0.3 s on the
    /// paper's links and minutes or for ever on worse ones, and nothing of it is measured. TCP, though, keeps the
    /// shortest round trip that it saw on a connection for 300 s (`tcp_min_rtt_wlen`) and judges reordering by a quarter
    /// of it: it matters where segments follow each other within 10 ms, so not at 50 Hz.
    Connection,
    /// From the beginning, as with Mininet's `TCLink`: registering and connecting meet delay and loss, too.
    Start,
}

/// What an interface of the kernel does for TCP. The TAP devices of `userspace` never do any of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum Offloads {
    /// As Mininet leaves veth: TCP hands over up to 64 KiB at once, which netem delays and loses as one packet, and
    /// leaves checksums out, which captures then show.
    Mininet,
    /// None (`ethtool -K … tso off gso off gro off tx off`): every packet on a link is one that Ethernet could carry.
    /// Needs `ethtool`.
    None,
}
