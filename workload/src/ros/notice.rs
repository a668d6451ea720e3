//! What happens on connections, for whoever wants to log it: nothing in this module prints. The main types are
//! [`Notice`] and [`Notices`].

use std::{
    net::SocketAddr,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
        mpsc::{Receiver, SyncSender, TrySendError, sync_channel},
    },
};

/// Something that happened between this side and a peer.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Notice {
    /// Something that a node in another process has to say, in its words.
    #[error("{text}")]
    Relayed {
        /// The words.
        text: String,
    },
    /// A TCPROS connection was refused: wrong type, malformed header, silence.
    #[error("refused a subscriber from {peer}: {reason}")]
    SubscriberRefused {
        /// Who connected.
        peer: SocketAddr,
        /// What was wrong.
        reason: String,
    },
    /// A subscriber of a topic of ours is connected.
    #[error("{subscriber} at {peer} subscribed to {topic}")]
    SubscriberConnected {
        /// The topic.
        topic: String,
        /// The subscriber's node.
        subscriber: String,
        /// Its address.
        peer: SocketAddr,
    },
    /// A subscriber of a topic of ours has gone.
    #[error("{subscriber} at {peer} left {topic}: {reason}")]
    SubscriberLost {
        /// The topic.
        topic: String,
        /// The subscriber's node.
        subscriber: String,
        /// Its address.
        peer: SocketAddr,
        /// How it went.
        reason: String,
    },
    /// A publisher of a topic that we subscribe to is connected.
    #[error("connected to the publisher of {topic} at {publisher}")]
    PublisherConnected {
        /// The topic.
        topic: String,
        /// The publisher's slave API.
        publisher: String,
    },
    /// A publisher could not be reached, or its connection broke. It is tried again while it is registered.
    #[error("no connection to the publisher of {topic} at {publisher}: {reason}")]
    PublisherLost {
        /// The topic.
        topic: String,
        /// The publisher's slave API.
        publisher: String,
        /// What the other side did or answered.
        reason: String,
    },
    /// A call to the master failed, and is tried again if there is time.
    #[error("{call} of {topic} failed: {reason}")]
    MasterCallFailed {
        /// The call.
        call: &'static str,
        /// The topic.
        topic: String,
        /// What the other side did or answered.
        reason: String,
    },
    /// The master had ended, and another one did not know this node.
    #[error("{node} has registered with the master that came after")]
    RegisteredAgain {
        /// The node.
        node: String,
    },
    /// An XML-RPC connection was refused or closed: malformed, too large, too slow, too many.
    #[error("closed an XML-RPC connection from {peer}: {reason}")]
    CallerRefused {
        /// Who connected.
        peer: SocketAddr,
        /// What was wrong.
        reason: String,
    },
    /// The master could not tell a node about a change.
    #[error("could not call {call} of the node at {node}: {reason}")]
    CallbackFailed {
        /// The call.
        call: &'static str,
        /// The node's slave API.
        node: String,
        /// What the other side did or answered.
        reason: String,
    },
    /// The master or a tool wants a node to end, most often since another node has taken its name. It goes on.
    #[error("{node} was asked to shut down: {reason}")]
    ShutdownAsked {
        /// The node.
        node: String,
        /// The reason that came with the call.
        reason: String,
    },
    /// The rosmaster that was started ended by itself. It is started again, and the nodes register again.
    #[error("rosmaster ended and is started again: {words}")]
    MasterEnded {
        /// How it ended and what it said.
        words: String,
    },
    /// The operating system refused a thread or a socket for a connection.
    #[error("cannot {what}: {reason}")]
    System {
        /// What was wanted.
        what: String,
        /// What the system said.
        reason: String,
    },
}

/// Where notices go. A queue of bounded length: when nobody reads it, notices are counted and forgotten.
#[derive(Debug, Clone, Default)]
pub struct Notices {
    queue: Option<SyncSender<Notice>>,
    forgotten: Arc<AtomicU64>,
}

impl Notices {
    /// For who does not want any.
    #[must_use]
    pub fn ignored() -> Self {
        Self::default()
    }

    /// A queue for at most `capacity` notices that have not been read.
    #[must_use]
    pub fn queue(capacity: usize) -> (Self, Receiver<Notice>) {
        let (sender, receiver) = sync_channel(capacity);
        (
            Self {
                queue: Some(sender),
                forgotten: Arc::default(),
            },
            receiver,
        )
    }

    /// How many found the queue full.
    #[must_use]
    pub fn forgotten(&self) -> u64 {
        self.forgotten.load(Ordering::Relaxed)
    }

    /// Never blocks.
    pub(crate) fn send(&self, notice: Notice) {
        if let Some(queue) = &self.queue {
            if let Err(TrySendError::Full(_)) = queue.try_send(notice) {
                self.forgotten.fetch_add(1, Ordering::Relaxed);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_queue_forgets_and_counts() {
        let (notices, received) = Notices::queue(1);
        let notice = Notice::System {
            what: "spawn a thread".into(),
            reason: "too many".into(),
        };
        notices.send(notice.clone());
        notices.send(notice.clone());
        assert_eq!(notices.forgotten(), 1);
        assert_eq!(received.try_iter().collect::<Vec<_>>(), [notice]);
    }
}
