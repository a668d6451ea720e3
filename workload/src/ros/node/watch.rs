//! How a node notices that its master has ended, and registers with the next one: which nodes of ROS itself do not. The
//! main function is [`begin`].
//!
//! It keeps a connection to the master open on which nothing is said, since a question every second would be traffic on
//! the links that are measured. The connection breaks with the master; whoever answers there next is asked whether it
//! knows this node. Messages flow meanwhile: they need no master.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use super::{
    membership::{Membership, Role},
    registration::call_to_register,
};
use crate::ros::{
    Notice, RosError,
    stop::WaitError,
    xml_rpc::{CallError, Value},
};

/// For one call.
const CALL_TIMEOUT: Duration = Duration::from_secs(5);
/// Between two attempts, at first and at most.
const FIRST_PAUSE: Duration = Duration::from_millis(100);
const LONGEST_PAUSE: Duration = Duration::from_secs(1);

/// Watches from now on, on a thread of its own, until the node ends.
pub(super) fn begin(node: &Arc<Membership>) -> Result<(), RosError> {
    let member = Arc::clone(node);
    node.crew
        .spawn("ros-watch", move || watch(&member))
        .map_err(|error| RosError::system("start a thread to watch the master", error))
}

fn watch(node: &Membership) {
    let stop = node.crew.stop();
    let mut pause = FIRST_PAUSE;
    // The first time registrations are under way already, with a timeout and errors of their own.
    let mut is_first = true;
    loop {
        let outcome = node
            .master
            .open_line(Instant::now() + CALL_TIMEOUT)
            .and_then(|line| {
                if !is_first {
                    register_again(node)?;
                }
                is_first = false;
                pause = FIRST_PAUSE;
                // Nothing is ever answered, as nothing is asked.
                line.read(&mut [0], None).map_err(CallError::Exchange)
            });
        if matches!(outcome, Err(CallError::Refused(_) | CallError::Fault(_))) {
            // Its words are in a notice. Asked again at once it would say the same.
            pause = LONGEST_PAUSE;
        }
        if stop.is_raised() || matches!(outcome, Err(CallError::Exchange(WaitError::Stopped))) {
            return;
        }
        if stop.rest(pause).is_err() {
            return;
        }
        pause = LONGEST_PAUSE.min(pause * 2);
    }
}

/// Registers all that has been registered before, unless the master knows this node.
fn register_again(node: &Membership) -> Result<(), CallError> {
    let registrations = node.registered();
    if registrations.is_empty() || is_known(node, registrations.len())? {
        return Ok(());
    }
    for registration in registrations {
        let answer = call_to_register(node, &registration, Instant::now() + CALL_TIMEOUT);
        let answer = answer.inspect_err(|error| {
            node.notices.send(Notice::MasterCallFailed {
                call: registration.role.register(),
                topic: registration.topic.clone(),
                reason: error.to_string(),
            });
        })?;
        if let (Role::Subscriber, Some(intake)) = (registration.role, node.intake(&registration.topic)) {
            intake.add(&answer.as_texts().unwrap_or_default());
        }
    }
    node.notices.send(Notice::RegisteredAgain {
        node: node.name.clone(),
    });
    Ok(())
}

/// Whether the master has all of this node's registrations: one that was lost half way is not known.
fn is_known(node: &Membership, registrations: usize) -> Result<bool, CallError> {
    let deadline = Instant::now() + CALL_TIMEOUT;
    let state = node
        .master
        .call_ros("getSystemState", &[node.name.as_str().into()], deadline)?;
    let lists = state.as_array().unwrap_or_default();
    // Publishers and subscribers; the third list is of services.
    let rows = lists.iter().take(2).filter_map(Value::as_array).flatten();
    let nodes = rows.filter_map(|row| row.as_array()?.get(1)?.as_texts());
    let known = nodes.filter(|nodes| nodes.contains(&node.name)).count();
    Ok(known >= registrations)
}
