//! Where things are in a container.

/// Where the volume is in the container.
pub const DATA: &str = "/data";

/// Where a command has its files, and writes.
pub const WORK: &str = "/work";
