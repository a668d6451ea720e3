//! How a node tells the master of its topics, and takes that back at its end.
//!
//! Each registration has a thread and a connection of its own, since what is measured next waits for all of them and
//! each takes two round trips.

use std::{
    sync::Arc,
    thread,
    time::{Duration, Instant},
};

use super::membership::{Membership, Registered};
use crate::ros::{
    Notice, RosError,
    connections::Connections,
    publisher::Publication,
    subscription::Intake,
    xml_rpc::{CallError, Value},
};

/// For one attempt at the master.
const CALL_PATIENCE: Duration = Duration::from_secs(5);
/// For all that is taken back at the end, together.
const END_PATIENCE: Duration = Duration::from_millis(1500);
/// Between two attempts, at first and at most.
const FIRST_PAUSE: Duration = Duration::from_millis(50);
const LONGEST_PAUSE: Duration = Duration::from_secs(1);

/// Starts to register a publisher.
pub(super) fn begin_publisher(node: &Arc<Membership>, publication: Arc<Publication>) -> Result<(), RosError> {
    let member = Arc::clone(node);
    spawn(node, move || {
        let Publication {
            topic,
            message_type,
            connections,
            ..
        } = &*publication;
        register(
            &member,
            "registerPublisher",
            topic,
            message_type.name,
            connections,
        );
    })
}

/// Starts to register a subscription, which connects to the publishers that there are as soon as the master answers.
pub(super) fn begin_subscriber(node: &Arc<Membership>, intake: Arc<Intake>) -> Result<(), RosError> {
    let member = Arc::clone(node);
    spawn(node, move || {
        let Intake {
            topic,
            message_type,
            connections,
            ..
        } = &*intake;
        let answer = register(
            &member,
            "registerSubscriber",
            topic,
            message_type.name,
            connections,
        );
        if let Some(publishers) = answer.as_ref().and_then(Value::as_texts) {
            intake.begin(&publishers);
        }
    })
}

fn spawn(node: &Arc<Membership>, work: impl FnOnce() + Send + 'static) -> Result<(), RosError> {
    let failed = |error| RosError::system("start a thread to register a topic", error);
    let registering = node.begin_to_register();
    let work = move || {
        work();
        drop(registering);
    };
    node.crew.spawn("ros-register", work).map_err(failed)
}

/// Calls the master until it answers, refuses, or the patience ends.
fn register(
    node: &Membership,
    call: &'static str,
    topic: &str,
    topic_type: &str,
    connections: &Connections,
) -> Option<Value> {
    let params = [node.name.as_str(), topic, topic_type, &node.slave_uri].map(Value::from);
    let deadline = Instant::now() + node.master_patience;
    let mut pause = FIRST_PAUSE;
    loop {
        let attempt_ends = deadline.min(Instant::now() + CALL_PATIENCE);
        let error = match node.master.call_ros(call, &params, attempt_ends) {
            Ok(value) => {
                note(node, call, topic);
                return Some(value);
            }
            Err(error) => error,
        };
        if node.crew.stop().is_raised() || node.is_closing() {
            return None;
        }
        let reason = error.to_string();
        node.notices.send(Notice::MasterCallFailed {
            call,
            topic: topic.to_owned(),
            reason: reason.clone(),
        });
        if !matches!(error, CallError::Connect(_) | CallError::Exchange(_)) {
            connections.fail(RosError::Refused {
                call,
                topic: topic.to_owned(),
                reason,
            });
            return None;
        }
        if Instant::now() + pause >= deadline {
            let master = node.master.address().socket.into();
            connections.fail(RosError::MasterUnreachable {
                master,
                waited: node.master_patience,
                reason,
            });
            return None;
        }
        node.crew.stop().rest(pause).ok()?;
        pause = LONGEST_PAUSE.min(pause * 2);
    }
}

/// Notes a registration, or takes it back if the node has begun to end meanwhile.
fn note(node: &Membership, call: &str, topic: &str) {
    let unregister = if call == "registerPublisher" {
        "unregisterPublisher"
    } else {
        "unregisterSubscriber"
    };
    let registered = Registered {
        unregister,
        topic: topic.to_owned(),
    };
    if !node.note_registered(registered.clone()) {
        take_back(node, &registered, Instant::now() + END_PATIENCE);
    }
}

/// Unregisters all topics, at the same time, in bounded time.
pub(super) fn end(node: &Membership) {
    let deadline = Instant::now() + END_PATIENCE;
    thread::scope(|scope| {
        for registered in node.begin_to_close() {
            let unregister = move || take_back(node, &registered, deadline);
            if let Err(error) = thread::Builder::new().spawn_scoped(scope, unregister) {
                let what = "start a thread to unregister a topic".into();
                node.notices.send(Notice::System {
                    what,
                    reason: error.to_string(),
                });
            }
        }
    });
    // One whose answer is still on its way takes itself back.
    node.wait_until_settled(deadline);
}

fn take_back(node: &Membership, Registered { unregister, topic }: &Registered, deadline: Instant) {
    let params = [node.name.as_str(), topic, &node.slave_uri].map(Value::from);
    if let Err(error) = node.master.call_ros(unregister, &params, deadline) {
        let (topic, reason) = (topic.clone(), error.to_string());
        node.notices.send(Notice::MasterCallFailed {
            call: unregister,
            topic,
            reason,
        });
    }
}
