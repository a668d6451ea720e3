//! Brings up master and nodes on their virtual hosts and waits until both topics are connected. The main type is
//! [`Connection`].

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, Scope, ScopedJoinHandle},
    time::{Duration, Instant},
};

use super::{
    error::ExperimentError,
    master::{self, RunningMaster},
    message::{COMMAND_TOPIC, STATE_TOPIC},
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
struct Side<R> {
    node: Node,
    publisher: Publisher,
    subscription: Subscription,
    reader: R,
}

/// What the plant's loop needs.
pub type PlantEnds = (Publisher, CommandReader);
/// What the controller's loop needs.
pub type ControllerEnds = (Publisher, StateReader);

/// What is left of a connection when the loops have their ends; dropped or shut down when they are done.
pub struct Nodes {
    master: Box<dyn RunningMaster>,
    nodes: [Node; 2],
    _subscriptions: [Subscription; 2],
}

impl Connection {
    /// Starts everything, the two nodes at the same time, and waits for the topics. `None` if it was told to stop.
    ///
    /// # Errors
    /// If something cannot be started or the nodes do not find each other.
    pub fn open(
        network: &dyn Network,
        settings: &Settings,
        stop: &AtomicBool,
    ) -> Result<Option<Self>, ExperimentError> {
        let master = on_host(network, VirtualHost::H1, || {
            master::start(settings.ros.master, Notices::ignored())
        })?;
        let uri = master.uri();
        let (plant, controller) = thread::scope(|scope| {
            let plant = begin_on_host(scope, network, VirtualHost::Sta2, || {
                let (receive, reader) = slot::commands();
                let names = ("/plant", STATE_TOPIC, COMMAND_TOPIC);
                Side::open(names, VirtualHost::Sta2, &uri, settings, receive, reader)
            })?;
            let controller = on_host(network, VirtualHost::Sta1, || {
                let (receive, reader) = slot::states();
                let names = ("/controller", COMMAND_TOPIC, STATE_TOPIC);
                Side::open(names, VirtualHost::Sta1, &uri, settings, receive, reader)
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
        let nodes = Nodes {
            master: self.master,
            nodes: [self.controller.node, self.plant.node],
            _subscriptions: [self.controller.subscription, self.plant.subscription],
        };
        (
            nodes,
            (self.plant.publisher, self.plant.reader),
            (self.controller.publisher, self.controller.reader),
        )
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
        let [controller, plant] = self.nodes;
        thread::scope(|scope| {
            scope.spawn(|| controller.shutdown());
            plant.shutdown();
        });
        self.master.stop();
    }
}

impl<R> Side<R> {
    fn open(
        (name, publishes, subscribes): (&str, &str, &str),
        host: VirtualHost,
        master_uri: &str,
        settings: &Settings,
        receive: impl FnMut(&[u8]) + Send + 'static,
        reader: R,
    ) -> Result<Self, ExperimentError> {
        let priority = settings.realtime.priority;
        let node = Node::start(NodeConfig {
            tcp_nodelay: settings.ros.tcp_nodelay,
            master_patience: PATIENCE,
            // As urgent as the loop that waits for the message. Refused here, it is refused to the loop too, which
            // records it.
            receiver_setup: Some(Arc::new(move || {
                let _ = request_fifo(priority);
            })),
            ..NodeConfig::new(name, host.address(), master_uri)
        })?;
        Ok(Self {
            publisher: node.advertise(publishes, MESSAGE_TYPE)?,
            subscription: node.subscribe(subscribes, MESSAGE_TYPE, receive)?,
            node,
            reader,
        })
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

/// Runs `make` on a thread inside the host, so that whatever threads and sockets it makes stay there.
fn on_host<T: Send>(
    network: &dyn Network,
    host: VirtualHost,
    make: impl FnOnce() -> Result<T, ExperimentError> + Send,
) -> Result<T, ExperimentError> {
    thread::scope(|scope| outcome_of(begin_on_host(scope, network, host, make)?, host))
}

type Making<'scope, T> = ScopedJoinHandle<'scope, Result<T, ExperimentError>>;

fn begin_on_host<'scope, 'env, T: Send + 'scope>(
    scope: &'scope Scope<'scope, 'env>,
    network: &'scope dyn Network,
    host: VirtualHost,
    make: impl FnOnce() -> Result<T, ExperimentError> + Send + 'scope,
) -> Result<Making<'scope, T>, ExperimentError> {
    let name = host.name();
    let inside = thread::Builder::new()
        .name(name.to_owned())
        .spawn_scoped(scope, move || {
            network.enter(host)?;
            make()
        });
    inside.map_err(|source| ExperimentError::Thread { name, source })
}

fn outcome_of<T>(making: Making<'_, T>, host: VirtualHost) -> Result<T, ExperimentError> {
    making
        .join()
        .unwrap_or(Err(ExperimentError::ThreadEnded { name: host.name() }))
}
