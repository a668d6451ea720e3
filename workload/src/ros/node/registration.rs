//! How a node tells the master of its topics, and takes that back at its end.
//!
//! Each registration has a thread and a connection of its own, since what is measured next waits for all of them and
//! each takes two round trips.

use std::{
    sync::Arc,
    thread,
    time::{Duration, Instant},
};

use super::membership::{Membership, Registered, Role};
use crate::ros::{
    Notice, RosError,
    connections::Connections,
    publisher::Publication,
    subscription::Intake,
    xml_rpc::{CallError, Value},
};

/// For one attempt at the master.
const CALL_TIMEOUT: Duration = Duration::from_secs(5);
/// For all that is taken back at the end, together.
const END_TIMEOUT: Duration = Duration::from_millis(1500);
/// Between two attempts, at first and at most.
const FIRST_PAUSE: Duration = Duration::from_millis(50);
const LONGEST_PAUSE: Duration = Duration::from_secs(1);

/// Starts to register a publisher.
pub(super) fn begin_publisher(node: &Arc<Membership>, publication: Arc<Publication>) -> Result<(), RosError> {
    let member = Arc::clone(node);
    spawn(node, move || {
        let registration = Registered {
            role: Role::Publisher,
            topic: publication.topic.clone(),
            topic_type: publication.message_type.name,
        };
        register(&member, &registration, &publication.connections);
    })
}

/// Starts to register a subscription, which connects to the publishers that there are as soon as the master answers.
pub(super) fn begin_subscriber(node: &Arc<Membership>, intake: Arc<Intake>) -> Result<(), RosError> {
    let member = Arc::clone(node);
    spawn(node, move || {
        let registration = Registered {
            role: Role::Subscriber,
            topic: intake.topic.clone(),
            topic_type: intake.message_type.name,
        };
        let answer = register(&member, &registration, &intake.connections);
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

/// One call that registers a topic.
pub(super) fn call_to_register(
    node: &Membership,
    registration: &Registered,
    deadline: Instant,
) -> Result<Value, CallError> {
    let Registered {
        role,
        topic,
        topic_type,
    } = registration;
    let params = [node.name.as_str(), topic, topic_type, &node.slave_uri].map(Value::from);
    node.master.call_ros(role.register(), &params, deadline)
}

/// Calls the master until it answers, refuses, or the timeout ends.
fn register(node: &Membership, registration: &Registered, connections: &Connections) -> Option<Value> {
    let (call, topic) = (registration.role.register(), &registration.topic);
    let deadline = Instant::now() + node.master_patience;
    let mut pause = FIRST_PAUSE;
    loop {
        let attempt_ends = deadline.min(Instant::now() + CALL_TIMEOUT);
        let error = match call_to_register(node, registration, attempt_ends) {
            Ok(value) => {
                note(node, registration);
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
            topic: topic.clone(),
            reason: reason.clone(),
        });
        if !matches!(error, CallError::Connect(_) | CallError::Exchange(_)) {
            connections.fail(RosError::Refused {
                call,
                topic: topic.clone(),
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
fn note(node: &Membership, registration: &Registered) {
    if !node.note_registered(registration.clone()) {
        take_back(node, registration, Instant::now() + END_TIMEOUT);
    }
}

/// Unregisters all topics, at the same time, in bounded time.
pub(super) fn end(node: &Membership) {
    let deadline = Instant::now() + END_TIMEOUT;
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

fn take_back(node: &Membership, registration: &Registered, deadline: Instant) {
    let (call, topic) = (registration.role.unregister(), &registration.topic);
    let params = [node.name.as_str(), topic, &node.slave_uri].map(Value::from);
    if let Err(error) = node.master.call_ros(call, &params, deadline) {
        node.notices.send(Notice::MasterCallFailed {
            call,
            topic: topic.clone(),
            reason: error.to_string(),
        });
    }
}
