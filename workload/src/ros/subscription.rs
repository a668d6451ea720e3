//! The subscribing end of a topic (being written).
use super::RosError;
use std::time::Duration;

/// The subscribing end of a topic.
pub struct Subscription;

impl Subscription {
    /// How many are connected.
    #[must_use]
    pub fn publishers(&self) -> usize {
        0
    }

    /// Waits until `count` publishers are connected.
    ///
    /// # Errors
    /// [`RosError`] if registration fails or the time is over.
    pub fn wait_for_publishers(&self, _count: usize, _timeout: Duration) -> Result<(), RosError> {
        Ok(())
    }
}
