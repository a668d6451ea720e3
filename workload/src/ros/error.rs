//! What can keep a master or a node from working. The main type is [`RosError`].

use std::{io, net::SocketAddr, time::Duration};

/// Why a call to this module failed. What goes wrong later, on connections that others make, is a
/// [`Notice`](super::Notice) instead.
#[derive(Debug, Clone, thiserror::Error)]
pub enum RosError {
    /// The operating system refused a socket or a thread.
    #[error("cannot {what}")]
    System {
        /// What was wanted, such as `listen on 10.0.0.2`.
        what: String,
        /// What the system said.
        #[source]
        source: std::sync::Arc<io::Error>,
    },
    /// A name that ROS does not allow.
    #[error("`{name}` is not a global ROS name")]
    BadName {
        /// The name that breaks ROS's rules.
        name: String,
    },
    /// An address of the form `http://10.0.0.1:11311/` was wanted.
    #[error("`{uri}` is not an HTTP address with a numeric host and a port")]
    BadUri {
        /// What was given.
        uri: String,
    },
    /// This node has already advertised or subscribed to this topic.
    #[error("{node} already has a {role} of {topic}")]
    Taken {
        /// The node.
        node: String,
        /// `publisher` or `subscription`.
        role: &'static str,
        /// The topic.
        topic: String,
    },
    /// The master could not be reached within the time it was given.
    #[error("the ROS master at {master} did not answer within {waited:?}: {reason}")]
    MasterUnreachable {
        /// Its address.
        master: SocketAddr,
        /// How long it was tried.
        waited: Duration,
        /// How the last attempt failed.
        reason: String,
    },
    /// Debian's rosmaster was asked for and is not there, or cannot run.
    #[error("there is no usable rosmaster: {reason}")]
    NoRosmaster {
        /// What was tried.
        reason: String,
    },
    /// Debian's rosmaster ended at once.
    #[error("rosmaster ended: {words}")]
    RosmasterEnded {
        /// How, and what it said.
        words: String,
    },
    /// The master answered, and refused.
    #[error("the ROS master refused {call} of {topic}: {reason}")]
    Refused {
        /// The call.
        call: &'static str,
        /// The topic.
        topic: String,
        /// The master's words.
        reason: String,
    },
    /// The other ends of a topic did not connect in time.
    #[error("{topic} has {found} of {wanted} {what} after {waited:?}")]
    NotConnected {
        /// The topic.
        topic: String,
        /// `subscribers` or `publishers`.
        what: &'static str,
        /// How many there are.
        found: usize,
        /// How many were waited for.
        wanted: usize,
        /// For how long.
        waited: Duration,
    },
}

impl RosError {
    pub(super) fn system(what: impl Into<String>, source: io::Error) -> Self {
        Self::System {
            what: what.into(),
            source: std::sync::Arc::new(source),
        }
    }

    /// What to do about it, where that is known.
    #[must_use]
    pub fn hint(&self) -> Option<&'static str> {
        match self {
            Self::System { source, .. } if source.kind() == io::ErrorKind::AddrNotAvailable => {
                Some("the calling thread must be in the network namespace that has this address")
            }
            Self::System { source, .. } if source.kind() == io::ErrorKind::AddrInUse => {
                Some("another ROS master or node listens there: stop it, or choose another port")
            }
            Self::System { .. } => None,
            Self::BadName { .. } => {
                Some("write a slash, then letters, digits, `_` and `/`, as in `/plant/state`")
            }
            Self::BadUri { .. } => Some("write it as `http://10.0.0.1:11311/`"),
            Self::Taken { .. } => Some("drop the first one before making another"),
            Self::MasterUnreachable { .. } => Some("start the master first, and check the links to its host"),
            Self::NoRosmaster { .. } => Some(super::rosmaster::INSTALL),
            Self::RosmasterEnded { .. } => {
                Some("run `rosmaster --core` by hand to see what it lacks, or use `ros.master: embedded`")
            }
            Self::Refused { .. } => Some("see the master's own log"),
            Self::NotConnected { .. } => {
                Some("the notices of the node say which connections were tried and how they failed")
            }
        }
    }
}
