//! The network of the experiment in virtual time: what a message sent now does on links that delay, lose and limit, and
//! on a TCP connection as Linux has it. Pure: no clock, no thread, no file; the same seed gives the same times.
//!
//! ```text
//! send -> tcp (one stream each way) -> path (two link ends each way) -> tcp -> delivery
//!         \__________ timers in jiffies __________/
//! ```
//!
//! The main type is [`exchange::Exchange`]: two hosts, with a topic each way as ROS has it, a connection of its own for
//! each topic. Who drives it asks when something happens next and lets it happen, as with the workload's own
//! network (`workload/src/network/star.rs`):
//!
//! ```
//! use record::settings::NetworkSettings;
//! use simulation::virtual_time::exchange::{Conditions, Exchange, Peer};
//!
//! let mut exchange = Exchange::new(&Conditions::of(&NetworkSettings::default()), 1);
//! exchange.send(0, Peer::Plant, "a state", 58);
//! let delivery = exchange.advance(1_000_000_000).unwrap();
//! assert_eq!((delivery.to, delivery.message), (Peer::Controller, "a state"));
//! ```
//!
//! [`programs`] lets two programs talk over it, each with its ticks and with what it does when a message comes.
//!
//! What it leaves out: the handshake (a connection is established, with one measured round trip), the master's
//! connections, ARP, captures, and what a process does between a packet's arrival and its reading.

pub mod exchange;
pub mod jiffies;
pub mod path;
pub mod programs;
pub mod tcp;
