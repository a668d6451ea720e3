//! What the experiment requires of every backend. The trait is [`Network`].

use std::io;

use record::{topology::Topology, virtual_host::VirtualHost, window::LinkRecord};

use super::{
    error::NetworkError,
    namespace::{Namespaces, Work},
    release_lateness::ReleaseCounts,
};

/// Hosts and the links between them, up from [`super::open`] until it is dropped.
pub trait Network: Send + Sync {
    /// Its hosts, switches and links.
    fn topology(&self) -> &Topology;

    /// The network namespaces of its hosts.
    fn namespaces(&self) -> &Namespaces;

    /// Moves the calling thread into the host's network namespace: sockets it opens from now on are there, those
    /// opened before stay where they are. Threads that it starts later are there, too. The thread must have
    /// CAP_SYS_ADMIN; the experiment, which has not, uses [`super::spawn`].
    ///
    /// # Errors
    /// If the kernel refuses, or there is no such host.
    fn enter(&self, host: VirtualHost) -> Result<(), NetworkError> {
        self.namespaces().at(host)?.enter()
    }

    /// Has a thread that is in the host's namespace do something short, sometime. [`super::spawn`] is what it is for.
    ///
    /// # Errors
    /// If there is no such thread.
    fn give(&self, host: VirtualHost, work: Work) -> io::Result<()> {
        self.namespaces().at(host).map_err(io::Error::other)?.give(work)
    }

    /// From now on every link delays, loses and limits as the settings say. A network that was opened carries without
    /// delay or loss until then; [`ImpairedFrom`](record::settings::ImpairedFrom) says why. Once is enough.
    ///
    /// # Errors
    /// If the platform refuses.
    fn impair(&self) -> Result<(), NetworkError>;

    /// What went through the links since the network came up, in [`Topology::links`]' order.
    fn links(&self) -> Vec<LinkRecord>;

    /// What losses and delays are drawn from, given or drawn itself; none if they cannot be drawn again.
    fn seed(&self) -> Option<u64>;

    /// How late packets were let go since the network came up; nothing where that is the kernel's doing.
    fn release_lateness(&self) -> Option<ReleaseCounts> {
        None
    }

    /// What was done to the platform to have the network and what the platform says of it now, for a person to read:
    /// `network.txt`. None where nothing outside this process was asked for anything.
    fn transcript(&self) -> Option<String> {
        None
    }

    /// Why the network stopped carrying packets, if it did.
    fn failure(&self) -> Option<NetworkError>;
}
