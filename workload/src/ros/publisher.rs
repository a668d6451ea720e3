//! The publishing end of a topic (being written).
use super::RosError;
use std::time::Duration;

/// What became of one message.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct PublishOutcome {
    /// Subscribers whose socket took the whole message.
    pub sent: u32,
    /// Subscribers whose socket took a part; the rest is sent with the next call.
    pub partial: u32,
    /// Subscribers who did not get it, since their socket was full.
    pub dropped: u32,
}

/// The publishing end of a topic.
pub struct Publisher;

impl Publisher {
    /// Writes to each subscriber. Never blocks, never allocates.
    pub fn publish(&mut self, _message: &[u8]) -> PublishOutcome {
        PublishOutcome::default()
    }

    /// How many are connected.
    #[must_use]
    pub fn subscribers(&self) -> usize {
        0
    }

    /// Waits until `count` subscribers are connected.
    ///
    /// # Errors
    /// [`RosError`] if registration fails or the time is over.
    pub fn wait_for_subscribers(&self, _count: usize, _timeout: Duration) -> Result<(), RosError> {
        Ok(())
    }
}
