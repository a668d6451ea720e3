//! Our master and nodes together with Debian's ROS 1: rosmaster, rospy and rostopic, inside the virtual hosts. As root or
//! as an ordinary user where user namespaces are allowed; where Debian's ROS is missing, they fail.

#![allow(clippy::unwrap_used, clippy::panic)]

mod abuse;
mod listeners;
mod master;
mod nodelay;
mod nodes;
mod rostopic;
mod stage;

/// Settings with short links and that master.
fn settings(master: &str) -> String {
    format!(r#"{{{},"ros":{{"master":"{master}"}}}}"#, stage::SHORT_LINKS)
}
