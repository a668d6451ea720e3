//! ROS 1's wire protocol between the virtual hosts: the XML-RPC master, nodes with their slave API, and TCPROS topics.
//!
//! ```text
//! Master      <- registerPublisher, registerSubscriber -   Node
//!             - publisherUpdate ->                         Subscription   (XML-RPC, over HTTP)
//! Publisher   <- requestTopic -                            Subscription   (XML-RPC, to the publisher's Node)
//! Publisher   - header, then messages ->                   Subscription   (TCPROS)
//! ```
//!
//! It is our own because the sockets and threads are part of the experiment: every listener is bound to one virtual
//! host's address, every thread is spawned from the thread that called (so that it stays in that thread's network
//! namespace), a message is written by the control loop itself with one system call, and TCP_NODELAY is as the
//! subscriber asked. Debian's rosmaster, rospy and rostopic are the other side that it is held against.
//!
//! Sources: <http://wiki.ros.org/ROS/Master_API>, <http://wiki.ros.org/ROS/Slave_API>,
//! <http://wiki.ros.org/ROS/TCPROS>, <http://wiki.ros.org/ROS/Parameter%20Server%20API>, and Debian's rosmaster 1.15.15
//! where they are silent. The main types are [`Master`], [`Node`], [`Publisher`] and [`Subscription`].

mod address;
mod connection_header;
mod connections;
mod error;
mod frames;
#[doc(hidden)]
pub mod fuzzing;
mod inquiry;
mod master;
mod name;
mod node;
mod notice;
mod publisher;
pub mod rosmaster;
mod socket;
mod stop;
mod subscription;
#[cfg(test)]
mod tests;
mod thread_group;
mod xml_rpc;

pub use error::RosError;
pub use inquiry::has_publisher;
pub use master::Master;
pub use node::{Node, NodeConfig};
pub use notice::{Notice, Notices};
pub use publisher::{PublishOutcome, Publisher, Subscribers};
pub use rosmaster::Rosmaster;
pub use subscription::Subscription;
pub use thread_group::ThreadSetup;
