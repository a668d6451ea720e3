//! One of our two nodes with its ends of both topics, in the process that calls: opened, connected, and taken apart for
//! its loop. The main type is [`Side`].

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use record::{
    settings::{PlantSends, Settings},
    topology::address_in_the_ball,
    virtual_host::VirtualHost,
};
use simulation::message::{StateEncoder, Topic};

use super::{
    latest_value::{self, CommandReader, StateReader},
    loops::{PlantOutput, answer},
};
use crate::{
    realtime::priority::request_fifo,
    ros::{Node, NodeConfig, Notices, Publisher, RosError, Subscribers, Subscription},
};

/// How long the nodes have to find each other: several lost packets in a row, each retried after a second or more.
pub const TIMEOUT: Duration = Duration::from_secs(60);

/// How often a wait looks up whether it is still wanted.
const LOOK_UP: Duration = Duration::from_millis(250);

/// A node with its ends of both topics.
pub struct Side<E> {
    node: Node,
    subscribers: Subscribers,
    subscription: Subscription,
    ends: E,
}

/// What the plant's loop needs.
pub struct PlantEnds {
    /// Where its state goes.
    pub output: PlantOutput,
    /// Where commands come from.
    pub commands: CommandReader,
}

/// What the controller's loop needs.
pub struct ControllerEnds {
    /// Where its commands go.
    pub publisher: Publisher,
    /// Where states come from.
    pub states: StateReader,
}

/// What is left of a node when its loop has its ends.
pub struct Tenancy {
    node: Node,
    _subscription: Subscription,
}

impl Tenancy {
    /// Unregisters the node and ends its threads, within a few seconds.
    pub fn end(self) {
        self.node.shutdown();
    }
}

impl Side<PlantEnds> {
    /// Starts the plant's node. Called from a thread inside its host.
    ///
    /// # Errors
    /// If something cannot be started.
    pub fn open_plant(settings: &Settings, master_uri: &str, notices: Notices) -> Result<Self, RosError> {
        let messages = settings.ros.messages;
        let (states, commands) = (Topic::of_states(messages), Topic::of_commands(messages));
        let node = Node::start(config("/plant", VirtualHost::STA2, settings, master_uri, notices))?;
        let publisher = node.advertise(states.name, states.message_type)?;
        let subscribers = publisher.subscribers();
        let (writer, reader) = latest_value::commands();
        let (output, subscription) = match settings.plant.sends {
            PlantSends::OnTick => {
                let receive = writer.receive(messages);
                let encoder = StateEncoder::new(messages);
                (
                    PlantOutput::Topic { publisher, encoder },
                    node.subscribe(commands.name, commands.message_type, receive)?,
                )
            }
            PlantSends::OnCommand => {
                let (newest_in, newest) = latest_value::states();
                let receive = answer(messages, writer, newest, publisher);
                (
                    PlantOutput::Answers(newest_in),
                    node.subscribe(commands.name, commands.message_type, receive)?,
                )
            }
        };
        let ends = PlantEnds {
            output,
            commands: reader,
        };
        Ok(Self {
            node,
            subscribers,
            subscription,
            ends,
        })
    }
}

impl Side<ControllerEnds> {
    /// Starts the controller's node. Called from a thread inside its host.
    ///
    /// # Errors
    /// If something cannot be started.
    pub fn open_controller(
        settings: &Settings,
        master_uri: &str,
        notices: Notices,
    ) -> Result<Self, RosError> {
        let messages = settings.ros.messages;
        let (states, commands) = (Topic::of_states(messages), Topic::of_commands(messages));
        let node = Node::start(config(
            "/controller",
            VirtualHost::STA1,
            settings,
            master_uri,
            notices,
        ))?;
        let publisher = node.advertise(commands.name, commands.message_type)?;
        let subscribers = publisher.subscribers();
        let (writer, reader) = latest_value::states();
        let subscription = node.subscribe(states.name, states.message_type, writer.receive(messages))?;
        let ends = ControllerEnds {
            publisher,
            states: reader,
        };
        Ok(Self {
            node,
            subscribers,
            subscription,
            ends,
        })
    }
}

fn config(
    name: &str,
    host: VirtualHost,
    settings: &Settings,
    master_uri: &str,
    notices: Notices,
) -> NodeConfig {
    let priority = settings.realtime.priority;
    NodeConfig {
        tcp_nodelay: settings.ros.tcp_nodelay,
        master_patience: TIMEOUT,
        notices,
        // As urgent as the loop that waits for the message. Refused here, it is refused to the loop too, which records
        // it.
        receiver_setup: Some(Arc::new(move || {
            let _ = request_fifo(priority);
        })),
        ..NodeConfig::new(name, address_in_the_ball(host), master_uri)
    }
}

impl<E> Side<E> {
    /// Hands out what the loop needs.
    #[must_use]
    pub fn into_parts(self) -> (Tenancy, E) {
        let tenancy = Tenancy {
            node: self.node,
            _subscription: self.subscription,
        };
        (tenancy, self.ends)
    }

    /// Waits for the other ends of both topics. False if it was told to stop.
    ///
    /// # Errors
    /// If a topic could not be registered, or nobody is there by the deadline.
    pub fn wait(&self, deadline: Instant, stop: &AtomicBool) -> Result<bool, RosError> {
        Ok(
            wait_in_parts(deadline, stop, |timeout| self.subscribers.wait_for(1, timeout))?
                && wait_in_parts(deadline, stop, |timeout| {
                    self.subscription.wait_for_publishers(1, timeout)
                })?,
        )
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
