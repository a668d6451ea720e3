//! Packets as a capture has them, read as a stream: a file of any length needs the memory of one buffer, and nothing is
//! allocated for a packet.
//!
//! ```text
//! h1.pcap, h1.pcap.zst -> CaptureFile -> Packet -> Segment
//! ```
//!
//! Windows without a gap between them are one stream, a `Stretch`. The main types are [`CaptureFile`] and [`Segment`].

mod capture_file;
mod segment;
mod sequence;
mod stretch;
mod too_much;
mod topic;

pub use capture_file::{CaptureFault, CaptureFile, CaptureReadError, Packet};
pub use segment::Segment;
pub use sequence::{Coming, Departure, Furthest, Passage, count_on};
pub use stretch::{CapturedWindow, Stretch};
pub use too_much::{MOST_CONNECTIONS, SILENCE_NS, TooMuch};
pub use topic::Topic;
