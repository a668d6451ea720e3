//! A question to a ROS master from somebody who is no node. The function is [`has_publisher`].

use std::time::Instant;

use super::{
    error::RosError,
    stop::Stop,
    xml_rpc::{Client, Value},
};

/// A caller's name, which ROS asks for.
const CALLER: &str = "/matrix";

/// Whether the master knows a publisher of that topic; not if it does not answer before the deadline.
///
/// # Errors
/// If its URI is none, or this process can have no sockets.
pub fn has_publisher(master_uri: &str, topic: &str, deadline: Instant) -> Result<bool, RosError> {
    let stop = Stop::new().map_err(|error| RosError::system("make a pair of sockets", error))?;
    let master = Client::new(master_uri, stop)?;
    let answer = master.call_ros("getSystemState", &[CALLER.into()], deadline);
    Ok(answer.is_ok_and(|state| is_published(&state, topic)))
}

/// Whether the topic is in the first of the three lists, which is that of the publishers.
fn is_published(state: &Value, topic: &str) -> bool {
    let publishers = state
        .as_array()
        .and_then(|lists| lists.first())
        .and_then(Value::as_array);
    publishers
        .into_iter()
        .flatten()
        .any(|row| row.as_array().and_then(|row| row.first()) == Some(&Value::from(topic)))
}
