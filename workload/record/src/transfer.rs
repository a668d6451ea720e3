//! The data folder of an environment as a stream: `workload detached collect` sends it, and `matrix` receives it. Each file is
//! sent from where an earlier stream broke off. The functions are [`send()`] and [`receive()`].
//!
//! Here and not where they are called, since this crate is optimised in every profile: gigabytes go through.

pub mod files;
mod receive;
mod send;

pub use self::{
    receive::{Receiver, receive},
    send::{SendError, send},
};
