//! The peers that a topic is connected to at the moment, for whoever waits for them. The main type is [`Connections`].

use std::{
    collections::BTreeMap,
    sync::{
        Arc, Condvar, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicUsize, Ordering},
    },
    time::Duration,
};

use super::RosError;

/// One topic's connections at one node.
#[derive(Debug, Default)]
pub(super) struct Connections {
    state: Mutex<State>,
    changed: Condvar,
    /// Beside the lock, since control loops ask for it.
    count: AtomicUsize,
}

#[derive(Debug, Default)]
struct State {
    peers: BTreeMap<u64, String>,
    next_id: u64,
    failure: Option<RosError>,
}

/// Counted while it lives.
#[derive(Debug)]
pub(super) struct Connection {
    connections: Arc<Connections>,
    id: u64,
}

impl Connections {
    pub fn count(&self) -> usize {
        self.count.load(Ordering::Acquire)
    }

    /// The peers' names, or slave APIs.
    pub fn peers(&self) -> Vec<String> {
        self.lock().peers.values().cloned().collect()
    }

    pub fn add(self: &Arc<Self>, peer: String) -> Connection {
        let mut state = self.lock();
        let id = state.next_id;
        state.next_id += 1;
        state.peers.insert(id, peer);
        self.count.store(state.peers.len(), Ordering::Release);
        self.changed.notify_all();
        Connection {
            connections: Arc::clone(self),
            id,
        }
    }

    /// The topic could not be registered: nobody is going to connect.
    pub fn fail(&self, error: RosError) {
        self.lock().failure = Some(error);
        self.changed.notify_all();
    }

    /// Waits for a number of peers; `what` they are and of which topic is for the error.
    pub fn wait_for(
        &self,
        count: usize,
        timeout: Duration,
        topic: &str,
        what: &'static str,
    ) -> Result<(), RosError> {
        let missing = |state: &mut State| state.peers.len() < count && state.failure.is_none();
        let waited = self.changed.wait_timeout_while(self.lock(), timeout, missing);
        let (state, _) = waited.unwrap_or_else(PoisonError::into_inner);
        let found = state.peers.len();
        if found >= count {
            return Ok(());
        }
        Err(state.failure.clone().unwrap_or_else(|| RosError::NotConnected {
            topic: topic.to_owned(),
            what,
            found,
            wanted: count,
            waited: timeout,
        }))
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Connection {
    fn drop(&mut self) {
        let mut state = self.connections.lock();
        state.peers.remove(&self.id);
        self.connections.count.store(state.peers.len(), Ordering::Release);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_connection_counts_while_it_lives() {
        let connections = Arc::new(Connections::default());
        let connection = connections.add("/plant".into());
        assert_eq!(
            (connections.count(), connections.peers()),
            (1, vec!["/plant".to_owned()])
        );
        connections
            .wait_for(1, Duration::ZERO, "/state", "publishers")
            .unwrap();
        drop(connection);
        assert_eq!(connections.count(), 0);
    }

    #[test]
    fn who_waits_in_vain_learns_how_many_there_are_or_why_there_are_none() {
        let connections = Connections::default();
        let wait = || {
            connections
                .wait_for(2, Duration::from_millis(1), "/state", "publishers")
                .unwrap_err()
        };
        assert_eq!(wait().to_string(), "/state has 0 of 2 publishers after 1ms");
        connections.fail(RosError::BadName { name: "state".into() });
        assert_eq!(wait().to_string(), "`state` is not a global ROS name");
    }
}
