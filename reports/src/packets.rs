//! Packets as a capture has them, read as a stream: a file of any length needs the memory of one buffer, and nothing is
//! allocated for a packet.
//!
//! ```text
//! h1.pcap, h1.pcap.zst -> CaptureFile -> Packet -> Segment
//! ```
//!
//! The main types are [`CaptureFile`] and [`Segment`].

mod capture_file;
mod segment;

pub use capture_file::{CaptureFault, CaptureFile, CaptureReadError, Packet};
pub use segment::Segment;
