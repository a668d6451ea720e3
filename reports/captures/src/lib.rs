//! What the captures of two virtual hosts contain: packets as a stream, and what became of them.
//!
//! They are a crate of their own since they are read for long: every profile optimises this crate.

pub mod packets;
pub mod traffic;
