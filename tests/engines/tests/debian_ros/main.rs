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

/// Settings with short links and that master; messages are arrays of numbers.
fn settings(master: &str) -> String {
    of_dynamics("robust", master)
}

/// The same, and messages are the author's texts.
fn authors(master: &str) -> String {
    of_dynamics("author", master)
}

fn of_dynamics(dynamics: &str, master: &str) -> String {
    let links = stage::SHORT_LINKS;
    format!(r#"{{"dynamics":"{dynamics}",{links},"ros":{{"master":"{master}"}}}}"#)
}
