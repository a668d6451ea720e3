//! Brings up master and nodes on their virtual hosts and waits until both topics are connected. The main type is
//! [`Connection`].

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use super::{
    error::ExperimentError,
    master::{self, RunningMaster},
    message::{COMMAND_TOPIC, STATE_TOPIC},
    notice_board::NoticeBoard,
    on_host::{begin_on_host, on_host, outcome_of},
    slot::{self, CommandReader, StateReader},
};
use crate::{
    network::Network,
    realtime::priority::request_fifo,
    ros::{Node, NodeConfig, Notices, Publisher, RosError, Subscription, float64_multi_array::MESSAGE_TYPE},
    settings::Settings,
    virtual_host::VirtualHost,
};

/// How long the nodes have to find each other: several lost packets in a row, each retried after a second or more.
const PATIENCE: Duration = Duration::from_secs(60);

/// How often a wait looks up whether it is still wanted.
const LOOK_UP: Duration = Duration::from_millis(250);

/// Master and nodes, connected. The loops take the ends of the topics.
pub struct Connection {
    master: Box<dyn RunningMaster>,
    plant: Side<CommandReader>,
    controller: Side<StateReader>,
}

/// One node with its end of both topics.
pub struct Side<R> {
    node: Node,
    publisher: Publisher,
    subscription: Subscription,
    reader: R,
}

/// What the plant's loop needs.
pub type PlantEnds = (Publisher, CommandReader);
/// What the controller's loop needs.
pub type ControllerEnds = (Publisher, StateReader);

/// What is left of a node when its loop has its ends.
pub struct Tenancy {
    node: Node,
    _subscription: Subscription,
}

/// What is left of a connection when the loops have their ends; dropped or shut down when they are done.
pub struct Nodes {
    master: Box<dyn RunningMaster>,
    tenancies: [Tenancy; 2],
}

impl Connection {
    /// Starts everything, the two nodes at the same time, and waits for the topics. `None` if it was told to stop.
    ///
    /// # Errors
    /// If something cannot be started or the nodes do not find each other.
    pub fn open(
        network: &dyn Network,
        settings: &Settings,
        board: &NoticeBoard,
        stop: &AtomicBool,
    ) -> Result<Option<Self>, ExperimentError> {
        let [h1, sta1, sta2] = VirtualHost::ALL.map(|host| board.of(host));
        let master = on_host(network, VirtualHost::H1, || {
            master::start(settings.ros.master, h1)
        })?;
        let uri = master::uri();
        let (plant, controller) = thread::scope(|scope| {
            let plant = begin_on_host(scope, network, VirtualHost::Sta2, || {
                open_plant(settings, &uri, sta2)
            })?;
            let controller = on_host(network, VirtualHost::Sta1, || {
                open_controller(settings, &uri, sta1)
            })?;
            Ok::<_, ExperimentError>((outcome_of(plant, VirtualHost::Sta2)?, controller))
        })?;
        let connection = Self {
            master,
            plant,
            controller,
        };
        let deadline = Instant::now() + PATIENCE;
        let connected =
            connection.plant.wait(deadline, stop)? && connection.controller.wait(deadline, stop)?;
        if connected {
            Ok(Some(connection))
        } else {
            connection.close();
            Ok(None)
        }
    }

    /// Hands out the ends of the topics.
    #[must_use]
    pub fn into_ends(self) -> (Nodes, PlantEnds, ControllerEnds) {
        let (plant, plant_ends) = self.plant.into_parts();
        let (controller, controller_ends) = self.controller.into_parts();
        let nodes = Nodes {
            master: self.master,
            tenancies: [controller, plant],
        };
        (nodes, plant_ends, controller_ends)
    }

    fn close(self) {
        let (nodes, plant, controller) = self.into_ends();
        drop((plant, controller));
        nodes.close();
    }
}

impl Nodes {
    /// Unregisters the nodes and ends all threads, within a few seconds.
    pub fn close(self) {
        let [controller, plant] = self.tenancies;
        thread::scope(|scope| {
            scope.spawn(|| controller.end());
            plant.end();
        });
        self.master.stop();
    }
}

impl Tenancy {
    /// Unregisters the node and ends its threads, within a few seconds.
    pub fn end(self) {
        self.node.shutdown();
    }
}

/// Starts the plant's node. Called from a thread inside its host.
///
/// # Errors
/// If something cannot be started.
pub fn open_plant(
    settings: &Settings,
    master_uri: &str,
    notices: Notices,
) -> Result<Side<CommandReader>, ExperimentError> {
    let (receive, reader) = slot::commands();
    let config = node_config("/plant", VirtualHost::Sta2, settings, master_uri, notices);
    Side::open(config, (STATE_TOPIC, COMMAND_TOPIC), receive, reader)
}

/// Starts the controller's node. Called from a thread inside its host.
///
/// # Errors
/// If something cannot be started.
pub fn open_controller(
    settings: &Settings,
    master_uri: &str,
    notices: Notices,
) -> Result<Side<StateReader>, ExperimentError> {
    let (receive, reader) = slot::states();
    let config = node_config("/controller", VirtualHost::Sta1, settings, master_uri, notices);
    Side::open(config, (COMMAND_TOPIC, STATE_TOPIC), receive, reader)
}

fn node_config(
    name: &str,
    host: VirtualHost,
    settings: &Settings,
    master_uri: &str,
    notices: Notices,
) -> NodeConfig {
    let priority = settings.realtime.priority;
    NodeConfig {
        tcp_nodelay: settings.ros.tcp_nodelay,
        master_patience: PATIENCE,
        notices,
        // As urgent as the loop that waits for the message. Refused here, it is refused to the loop too, which records
        // it.
        receiver_setup: Some(Arc::new(move || {
            let _ = request_fifo(priority);
        })),
        ..NodeConfig::new(name, host.address(), master_uri)
    }
}

impl<R> Side<R> {
    fn open(
        config: NodeConfig,
        (publishes, subscribes): (&str, &str),
        receive: impl FnMut(&[u8]) + Send + 'static,
        reader: R,
    ) -> Result<Self, ExperimentError> {
        let node = Node::start(config)?;
        Ok(Self {
            publisher: node.advertise(publishes, MESSAGE_TYPE)?,
            subscription: node.subscribe(subscribes, MESSAGE_TYPE, receive)?,
            node,
            reader,
        })
    }

    /// Hands out what the loop needs.
    #[must_use]
    pub fn into_parts(self) -> (Tenancy, (Publisher, R)) {
        let tenancy = Tenancy {
            node: self.node,
            _subscription: self.subscription,
        };
        (tenancy, (self.publisher, self.reader))
    }

    /// Waits for the other ends of both topics. False if it was told to stop.
    fn wait(&self, deadline: Instant, stop: &AtomicBool) -> Result<bool, RosError> {
        Ok(wait_in_parts(deadline, stop, |patience| {
            self.publisher.wait_for_subscribers(1, patience)
        })? && wait_in_parts(deadline, stop, |patience| {
            self.subscription.wait_for_publishers(1, patience)
        })?)
    }
}

/// Waits until connected or the deadline, looking up now and then whether it is still wanted.
fn wait_in_parts(
    deadline: Instant,
    stop: &AtomicBool,
    wait: impl Fn(Duration) -> Result<(), RosError>,
) -> Result<bool, RosError> {
    while !stop.load(Ordering::Relaxed) {
        match wait(LOOK_UP) {
            Ok(()) => return Ok(true),
            Err(RosError::NotConnected { .. }) if Instant::now() < deadline => {}
            Err(error) => return Err(error),
        }
    }
    Ok(false)
}
