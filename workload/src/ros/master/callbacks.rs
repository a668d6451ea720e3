//! How the master tells nodes of changes, without making whoever caused them wait. The main type is [`Callbacks`].
//!
//! A worker for each node that is told something, so that one that hangs holds up none but itself. What is told is
//! always the present state, so of several updates that wait only the last is sent.

use std::{
    collections::{BTreeMap, VecDeque},
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use crate::ros::{
    Notice, Notices,
    thread_group::ThreadGroup,
    xml_rpc::{CallError, Client, Value},
};

/// For one call.
const CALL_TIMEOUT: Duration = Duration::from_secs(5);
/// How long a worker keeps its connection with nothing to tell.
const IDLE_TIMEOUT: Duration = Duration::from_secs(30);
/// What may wait for one node that hangs.
const MOST_WAITING: usize = 256;
/// As whom the master calls.
const CALLER: &str = "/master";

/// Something to tell a node at its slave API.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Callback {
    PublisherUpdate {
        api: String,
        topic: String,
        publishers: Vec<String>,
    },
    ParamUpdate {
        api: String,
        key: String,
        value: Value,
    },
    Shutdown {
        api: String,
    },
}

impl Callback {
    fn api(&self) -> &str {
        match self {
            Self::PublisherUpdate { api, .. } | Self::ParamUpdate { api, .. } | Self::Shutdown { api } => api,
        }
    }

    /// Whether a later one makes this one needless.
    fn is_outdated_by(&self, later: &Self) -> bool {
        match (self, later) {
            (Self::PublisherUpdate { topic: old, .. }, Self::PublisherUpdate { topic: new, .. }) => {
                old == new
            }
            (Self::ParamUpdate { key: old, .. }, Self::ParamUpdate { key: new, .. }) => old == new,
            _ => false,
        }
    }

    fn call(self) -> (&'static str, Vec<Value>) {
        match self {
            Self::PublisherUpdate {
                topic, publishers, ..
            } => (
                "publisherUpdate",
                vec![CALLER.into(), topic.into(), publishers.into()],
            ),
            Self::ParamUpdate { key, value, .. } => ("paramUpdate", vec![CALLER.into(), key.into(), value]),
            Self::Shutdown { .. } => (
                "shutdown",
                vec![CALLER.into(), "new node registered with same name".into()],
            ),
        }
    }
}

/// The workers, and what waits for them.
#[derive(Debug, Clone)]
pub(super) struct Callbacks {
    shared: Arc<Shared>,
    crew: ThreadGroup,
    notices: Notices,
}

#[derive(Debug, Default)]
struct Shared {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct State {
    /// By slave API; there is a worker for each.
    waiting: BTreeMap<String, VecDeque<Callback>>,
    closed: bool,
}

impl Callbacks {
    pub fn new(crew: ThreadGroup, notices: Notices) -> Self {
        Self {
            shared: Arc::default(),
            crew,
            notices,
        }
    }

    /// Has each told soon, and returns at once.
    pub fn tell(&self, callbacks: Vec<Callback>) {
        for callback in callbacks {
            let api = callback.api().to_owned();
            self.with_worker(&api, |waiting| {
                waiting.retain(|earlier| !earlier.is_outdated_by(&callback));
                if waiting.len() >= MOST_WAITING {
                    waiting.pop_front();
                }
                waiting.push_back(callback);
            });
        }
    }

    /// Connects to a node that is going to be told something, so that telling it takes one trip and not two round
    /// trips: a publisher often registers right after its subscriber.
    pub fn prepare(&self, api: &str) {
        self.with_worker(api, |_| ());
    }

    /// Ends the workers.
    pub fn close(&self) {
        self.lock().closed = true;
        self.shared.changed.notify_all();
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.shared.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn with_worker(&self, api: &str, change: impl FnOnce(&mut VecDeque<Callback>)) {
        let mut state = self.lock();
        if state.closed {
            return;
        }
        if let Some(waiting) = state.waiting.get_mut(api) {
            change(waiting);
        } else {
            let (worker, node) = (self.clone(), api.to_owned());
            if let Err(error) = self.crew.spawn("ros-callbacks", move || worker.work(&node)) {
                let reason = error.to_string();
                self.notices.send(Notice::System {
                    what: format!("spawn a thread to call {api}"),
                    reason,
                });
                return;
            }
            change(state.waiting.entry(api.to_owned()).or_default());
        }
        self.shared.changed.notify_all();
    }

    /// Tells one node what waits for it, until nothing has for a while.
    fn work(&self, api: &str) {
        let failed = |call, error: &dyn ToString| {
            let (node, reason) = (api.to_owned(), error.to_string());
            self.notices.send(Notice::CallbackFailed { call, node, reason });
        };
        let client = Client::new(api, self.crew.stop().clone())
            .inspect_err(|error| failed("publisherUpdate", error))
            .ok();
        if let Some(client) = &client {
            // If it fails, the call itself will say so.
            let _ = client.connect_ahead(Instant::now() + CALL_TIMEOUT);
        }
        while let Some(callback) = self.next(api) {
            let Some(client) = &client else { continue };
            let (call, params) = callback.call();
            match client.call_ros(call, &params, Instant::now() + CALL_TIMEOUT) {
                // A node may refuse to end, and rospy answers updates of parameters it does not know with an error.
                Ok(_) | Err(CallError::Refused(_)) => {}
                Err(error) => failed(call, &error),
            }
        }
    }

    /// Waits for the next callback; `None` when the worker is to end, which it has then already in the books.
    fn next(&self, api: &str) -> Option<Callback> {
        let mut state = self.lock();
        let deadline = Instant::now() + IDLE_TIMEOUT;
        loop {
            let next = state.waiting.get_mut(api).and_then(VecDeque::pop_front);
            if next.is_some() && !state.closed {
                return next;
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if state.closed || left.is_zero() {
                state.waiting.remove(api);
                return None;
            }
            let waited = self.shared.changed.wait_timeout(state, left);
            state = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}
