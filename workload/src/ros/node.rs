//! A ROS node (being written).
use super::{MessageType, Notices, Publisher, RosError, Subscription};
use std::{net::Ipv4Addr, sync::Arc, time::Duration};

/// Called at the start of each thread that receives messages, in that thread: to raise its priority, say.
pub type ThreadSetup = Arc<dyn Fn() + Send + Sync>;

/// What a node is to be.
#[derive(Clone)]
pub struct NodeConfig {
    /// Global name, such as `/controller`.
    pub name: String,
    /// The address that it binds to and names itself by.
    pub address: Ipv4Addr,
    /// Such as `http://10.0.0.1:11311/`.
    pub master_uri: String,
    /// Whether its subscriptions ask for TCP_NODELAY.
    pub tcp_nodelay: bool,
    /// For how long a registration is tried.
    pub master_patience: Duration,
    /// Where its notices go.
    pub notices: Notices,
    /// For threads that receive messages.
    pub receiver_setup: Option<ThreadSetup>,
}

impl NodeConfig {
    /// With patience of 30 s, without TCP_NODELAY (as ROS), notices or setup.
    #[must_use]
    pub fn new(name: &str, address: Ipv4Addr, master_uri: &str) -> Self {
        Self {
            name: name.to_owned(),
            address,
            master_uri: master_uri.to_owned(),
            tcp_nodelay: false,
            master_patience: Duration::from_secs(30),
            notices: Notices::ignored(),
            receiver_setup: None,
        }
    }
}

/// A running node.
pub struct Node;

impl Node {
    /// Starts its servers.
    ///
    /// # Errors
    /// [`RosError`]
    pub fn start(_config: NodeConfig) -> Result<Self, RosError> {
        Ok(Self)
    }

    /// Returns at once; registration goes on on a thread.
    ///
    /// # Errors
    /// [`RosError`]
    pub fn advertise(&self, topic: &str, _message_type: MessageType) -> Result<Publisher, RosError> {
        Err(RosError::BadName {
            name: topic.to_owned(),
        })
    }

    /// Returns at once; registration goes on on a thread. `on_message` is called from the receiving thread.
    ///
    /// # Errors
    /// [`RosError`]
    pub fn subscribe(
        &self,
        topic: &str,
        _message_type: MessageType,
        _on_message: impl FnMut(&[u8]) + Send + 'static,
    ) -> Result<Subscription, RosError> {
        Err(RosError::BadName {
            name: topic.to_owned(),
        })
    }

    /// Unregisters and ends all threads and connections, in bounded time.
    pub fn shutdown(self) {}
}
