//! Where things are in a container.

/// Where the volume is in the container.
pub const DATA: &str = "/data";
