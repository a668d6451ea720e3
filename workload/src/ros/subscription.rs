//! The subscribing end of a topic. The main types are [`Subscription`] and [`Intake`], the part of it that the node's
//! threads hold.

mod inlet;
mod registration;

use std::{
    collections::BTreeMap,
    fmt,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use simulation::ros::message_type::MessageType;

use self::{inlet::Inlet, registration::Registration};
use super::{
    Notice, Notices, RosError,
    connections::Connections,
    thread_group::{ThreadGroup, ThreadSetup},
};

/// Publishers of one topic that are connected to; the experiment has one.
const MOST_PUBLISHERS: usize = 32;

/// The subscribing end of a topic. Dropping it closes its connections.
#[derive(Debug)]
pub struct Subscription {
    intake: Arc<Intake>,
}

impl Subscription {
    pub(super) fn new(intake: Arc<Intake>) -> Self {
        Self { intake }
    }

    /// How many publishers are connected.
    #[must_use]
    pub fn publishers(&self) -> usize {
        self.intake.connections.count()
    }

    /// Waits until `count` publishers are connected.
    ///
    /// # Errors
    /// [`RosError`] if the topic could not be registered or the time is over.
    pub fn wait_for_publishers(&self, count: usize, timeout: Duration) -> Result<(), RosError> {
        self.intake
            .connections
            .wait_for(count, timeout, &self.intake.topic, "publishers")
    }
}

impl Drop for Subscription {
    fn drop(&mut self) {
        self.intake.close();
    }
}

/// Called with each message, from whichever thread received it.
pub(super) type OnMessage = Box<dyn FnMut(&[u8]) + Send>;

/// What the node's threads know of a subscription.
pub(super) struct Intake {
    pub topic: String,
    pub message_type: MessageType,
    /// The node that subscribes.
    pub node: String,
    pub tcp_nodelay: bool,
    pub connections: Arc<Connections>,
    pub crew: ThreadGroup,
    pub notices: Notices,
    pub receiver_setup: Option<ThreadSetup>,
    /// Behind a lock for the case of several publishers.
    pub on_message: Mutex<OnMessage>,
    pub publishers: Mutex<Publishers>,
}

/// The publishers that are connected to, or will be.
#[derive(Debug, Default)]
pub(super) struct Publishers {
    /// By slave API; what the thread for it is told by.
    inlets: BTreeMap<String, Arc<Registration>>,
    /// Whether the master has called with an update.
    updated: bool,
    closed: bool,
}

impl fmt::Debug for Intake {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Intake")
            .field("topic", &self.topic)
            .finish_non_exhaustive()
    }
}

impl Intake {
    /// The publishers as the master has them now.
    ///
    /// A connection that works is not ended by it, as its publisher ends it when it unregisters: after a restart a
    /// master knows only those publishers that have registered again so far.
    pub fn update(self: &Arc<Self>, publishers: &[String]) {
        let mut current = self.lock();
        current.updated = true;
        current
            .inlets
            .retain(|publisher, registration| publishers.contains(publisher) || !registration.withdraw());
        self.connect_to(&mut current, publishers);
    }

    /// The publishers as the master had them at registration. An update that was faster than this answer is newer.
    pub fn begin(self: &Arc<Self>, publishers: &[String]) {
        let mut current = self.lock();
        if !current.updated {
            self.connect_to(&mut current, publishers);
        }
    }

    /// Publishers that a master knows which may not know all of them yet.
    pub fn add(self: &Arc<Self>, publishers: &[String]) {
        self.connect_to(&mut self.lock(), publishers);
    }

    /// Ends all connections for good.
    pub fn close(&self) {
        let mut current = self.lock();
        current.closed = true;
        for registration in std::mem::take(&mut current.inlets).into_values() {
            registration.stop.raise();
        }
    }

    /// Whether the [`Subscription`] has been dropped.
    pub fn is_closed(&self) -> bool {
        self.lock().closed
    }

    fn lock(&self) -> MutexGuard<'_, Publishers> {
        self.publishers.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn connect_to(self: &Arc<Self>, current: &mut Publishers, publishers: &[String]) {
        if current.closed {
            return;
        }
        for publisher in publishers.iter().take(MOST_PUBLISHERS) {
            let taken = current.inlets.get(publisher);
            if taken.is_some_and(|registration| registration.renew())
                || current.inlets.len() >= MOST_PUBLISHERS && taken.is_none()
            {
                continue;
            }
            match self.open(publisher) {
                Ok(registration) => drop(current.inlets.insert(publisher.clone(), registration)),
                Err(error) => self.notices.send(Notice::System {
                    what: format!("receive {} from {publisher}", self.topic),
                    reason: error.to_string(),
                }),
            }
        }
    }

    /// Starts the thread that keeps a connection to this publisher.
    fn open(self: &Arc<Self>, publisher: &str) -> std::io::Result<Arc<Registration>> {
        let registration = Arc::new(Registration::new()?);
        let inlet = Inlet::new(Arc::clone(self), publisher, Arc::clone(&registration));
        self.crew.spawn("ros-receive", move || inlet.run())?;
        Ok(registration)
    }

    /// The thread for that publisher has ended, and its place is free.
    fn forget(&self, publisher: &str, ended: &Arc<Registration>) {
        let mut current = self.lock();
        if current
            .inlets
            .get(publisher)
            .is_some_and(|registration| Arc::ptr_eq(registration, ended))
        {
            current.inlets.remove(publisher);
        }
    }
}
