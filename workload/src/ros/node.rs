//! A ROS node: its slave API, its publishers and its subscriptions. The main type is [`Node`].

mod handshake;
mod membership;
mod registration;
mod slave;
mod watch;

use std::{
    fmt,
    net::{Ipv4Addr, TcpListener},
    sync::{Arc, Condvar, Mutex},
    time::Duration,
};

use simulation::ros::message_type::MessageType;

use self::{membership::Membership, slave::Slave};
use super::{
    Notices, Publisher, RosError, Subscription,
    connections::Connections,
    name,
    publisher::Publication,
    subscription::Intake,
    thread_group::{ThreadGroup, ThreadSetup},
    xml_rpc::{Client, serve},
};

/// For a node's threads to end, beside what unregistering takes.
const END_TIMEOUT: Duration = Duration::from_secs(2);

/// What a node is to be.
#[derive(Clone)]
pub struct NodeConfig {
    /// Global name, such as `/controller`.
    pub name: String,
    /// The address that it listens on and names itself by.
    pub address: Ipv4Addr,
    /// Such as `http://10.0.0.1:11311/`.
    pub master_uri: String,
    /// Whether its subscriptions ask for TCP_NODELAY.
    pub tcp_nodelay: bool,
    /// For how long a registration is tried, if the master does not answer.
    pub master_patience: Duration,
    /// For a subscriber to send its header, from when it connects.
    pub header_patience: Duration,
    /// Where its notices go.
    pub notices: Notices,
    /// For threads that receive messages.
    pub receiver_setup: Option<ThreadSetup>,
}

impl NodeConfig {
    /// With a timeout of 30 s for the master and 10 s for subscribers; without TCP_NODELAY (as ROS), notices, or a setup for threads.
    #[must_use]
    pub fn new(name: &str, address: Ipv4Addr, master_uri: &str) -> Self {
        Self {
            name: name.to_owned(),
            address,
            master_uri: master_uri.to_owned(),
            tcp_nodelay: false,
            master_patience: Duration::from_secs(30),
            header_patience: Duration::from_secs(10),
            notices: Notices::ignored(),
            receiver_setup: None,
        }
    }
}

impl fmt::Debug for NodeConfig {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("NodeConfig")
            .field("name", &self.name)
            .field("address", &self.address)
            .field("master_uri", &self.master_uri)
            .field("tcp_nodelay", &self.tcp_nodelay)
            .field("master_patience", &self.master_patience)
            .finish_non_exhaustive()
    }
}

/// A running node.
///
/// All its threads are made from the thread that starts it, and inherit that thread's network namespace and scheduling:
/// start it before the thread becomes a real-time one.
#[derive(Debug)]
pub struct Node {
    membership: Arc<Membership>,
    receiver_setup: ReceiverSetup,
}

/// Only to be shown as nothing.
struct ReceiverSetup(Option<ThreadSetup>);

impl fmt::Debug for ReceiverSetup {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if self.0.is_some() { "set" } else { "none" })
    }
}

impl Node {
    /// Starts its servers. The master is not called before there is a topic.
    ///
    /// # Errors
    /// [`RosError`] for a name or address that is none, or a socket or thread that cannot be had.
    pub fn start(config: NodeConfig) -> Result<Self, RosError> {
        if !name::is_global(&config.name) {
            return Err(RosError::BadName { name: config.name });
        }
        let failed = |error| RosError::system(format!("start {} on {}", config.name, config.address), error);
        let crew = ThreadGroup::new().map_err(failed)?;
        let master = Client::new(&config.master_uri, crew.stop().clone())?;
        let slave_listener = TcpListener::bind((config.address, 0)).map_err(failed)?;
        let topic_listener = TcpListener::bind((config.address, 0)).map_err(failed)?;
        let slave_port = slave_listener.local_addr().map_err(failed)?.port();
        let membership = Arc::new(Membership {
            slave_uri: format!("http://{}:{slave_port}/", config.address),
            topic_port: topic_listener.local_addr().map_err(failed)?.port(),
            name: config.name.clone(),
            address: config.address,
            tcp_nodelay: config.tcp_nodelay,
            master_uri: config.master_uri.clone(),
            master_patience: config.master_patience,
            master,
            crew: crew.clone(),
            notices: config.notices.clone(),
            header_patience: config.header_patience,
            topics: Mutex::default(),
            settled: Condvar::new(),
        });
        let api = Arc::new(Slave(Arc::clone(&membership)));
        serve(slave_listener, &crew, &config.notices, api).map_err(failed)?;
        handshake::serve(topic_listener, &membership).map_err(failed)?;
        watch::begin(&membership)?;
        Ok(Self {
            membership,
            receiver_setup: ReceiverSetup(config.receiver_setup),
        })
    }

    /// A publisher of a topic. Returns at once; registration goes on on a thread of its own, and how it went is told by
    /// `wait_for` of [`Publisher::subscribers`].
    ///
    /// # Errors
    /// [`RosError`] for a name that is none, a topic that this node publishes already, or a thread that cannot be had.
    pub fn advertise(&self, topic: &str, message_type: MessageType) -> Result<Publisher, RosError> {
        let topic = self.membership.resolve(topic)?;
        let (publisher, publication) = Publication::new(&topic, message_type);
        self.membership.add_publication(&publication)?;
        registration::begin_publisher(&self.membership, publication)?;
        Ok(publisher)
    }

    /// A subscription of a topic. Returns at once; registration goes on on a thread of its own, and how it went is told
    /// by [`Subscription::wait_for_publishers`]. `on_message` is called with each message as it is received.
    ///
    /// # Errors
    /// [`RosError`] for a name that is none, a topic that this node subscribes to already, or a thread that cannot be
    /// had.
    pub fn subscribe(
        &self,
        topic: &str,
        message_type: MessageType,
        on_message: impl FnMut(&[u8]) + Send + 'static,
    ) -> Result<Subscription, RosError> {
        let topic = self.membership.resolve(topic)?;
        let intake = Arc::new(Intake {
            topic,
            message_type,
            node: self.membership.name.clone(),
            tcp_nodelay: self.membership.tcp_nodelay,
            connections: Arc::new(Connections::default()),
            crew: self.membership.crew.clone(),
            notices: self.membership.notices.clone(),
            receiver_setup: self.receiver_setup.0.clone(),
            on_message: Mutex::new(Box::new(on_message)),
            publishers: Mutex::default(),
        });
        self.membership.add_intake(&intake)?;
        registration::begin_subscriber(&self.membership, Arc::clone(&intake))?;
        Ok(Subscription::new(intake))
    }

    /// Where it answers other nodes and the master.
    #[must_use]
    pub fn slave_uri(&self) -> &str {
        &self.membership.slave_uri
    }

    /// Unregisters, closes all connections and ends all threads, within some four seconds.
    pub fn shutdown(self) {
        registration::end(&self.membership);
        self.membership.close_intakes();
        self.membership.crew.dismiss(END_TIMEOUT);
    }
}

impl Drop for Node {
    /// For whoever leaves by an error: tells the threads to end, without waiting, and without telling the master.
    fn drop(&mut self) {
        self.membership.close_intakes();
        self.membership.crew.stop().raise();
    }
}
