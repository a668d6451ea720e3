//! What the workload leaves behind, as types: one module for each file or stream, with its format and units.
//!
//! `reports` reads these, the workload and the `fake` provider write them. A change of meaning needs a new
//! [`FORMAT`].

pub mod check;
pub mod control_log;
pub mod detached;
pub mod exit;
pub mod name;
pub mod plant_log;
pub mod platform;
pub mod progress;
pub mod window;

/// Version of the files that the workload writes.
pub const FORMAT: u32 = 1;
