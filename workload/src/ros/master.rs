//! The embedded ROS master (being written).
use super::{Notices, RosError};
use std::net::TcpListener;

/// A running master.
pub struct Master;

impl Master {
    /// Starts serving on this listener, from threads of the calling thread's network namespace.
    ///
    /// # Errors
    /// [`RosError::System`] if a thread or the listener's address cannot be had.
    pub fn start(_listener: TcpListener, _notices: Notices) -> Result<Self, RosError> {
        Ok(Self)
    }

    /// Its address, such as `http://10.0.0.1:11311/`.
    #[must_use]
    pub fn uri(&self) -> String {
        String::new()
    }

    /// Stops serving, within a second.
    pub fn stop(self) {}
}
