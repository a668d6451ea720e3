//! What a node's threads share: who it is, and which topics it has. The main type is [`Membership`].

use std::{
    collections::BTreeMap,
    net::Ipv4Addr,
    sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use crate::ros::{
    Notices, RosError, name, publisher::Publication, subscription::Intake, thread_group::ThreadGroup,
    xml_rpc::Client,
};

/// A node's place in the graph.
#[derive(Debug)]
pub(super) struct Membership {
    pub name: String,
    pub address: Ipv4Addr,
    pub slave_uri: String,
    /// Where subscribers connect.
    pub topic_port: u16,
    pub tcp_nodelay: bool,
    pub master_uri: String,
    pub master_patience: Duration,
    pub master: Client,
    pub crew: ThreadGroup,
    pub notices: Notices,
    /// For a subscriber to send its header.
    pub header_patience: Duration,
    pub topics: Mutex<Topics>,
    /// When a registration has come to an end.
    pub settled: Condvar,
}

/// The topics, and which of them the master knows.
#[derive(Debug, Default)]
pub(super) struct Topics {
    publications: BTreeMap<String, Arc<Publication>>,
    intakes: BTreeMap<String, Arc<Intake>>,
    registered: Vec<Registered>,
    /// Registrations that are under way.
    registering: usize,
    closing: bool,
}

/// A registration that the master has confirmed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Registered {
    pub role: Role,
    pub topic: String,
    /// The topic's type.
    pub topic_type: &'static str,
}

/// What a node is to a topic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Role {
    Publisher,
    Subscriber,
}

impl Role {
    /// The master's call to register it.
    pub const fn register(self) -> &'static str {
        match self {
            Self::Publisher => "registerPublisher",
            Self::Subscriber => "registerSubscriber",
        }
    }

    /// The master's call to take that back.
    pub const fn unregister(self) -> &'static str {
        match self {
            Self::Publisher => "unregisterPublisher",
            Self::Subscriber => "unregisterSubscriber",
        }
    }
}

impl Membership {
    /// The full name of a topic.
    pub fn resolve(&self, topic: &str) -> Result<String, RosError> {
        let full = name::resolve(topic, &self.name);
        if topic.is_empty() || !name::is_global(&full) {
            return Err(RosError::BadName {
                name: topic.to_owned(),
            });
        }
        Ok(full)
    }

    pub fn add_publication(&self, publication: &Arc<Publication>) -> Result<(), RosError> {
        let mut topics = self.lock();
        let topic = &publication.topic;
        if topics
            .publications
            .get(topic)
            .is_some_and(|former| !former.is_over())
        {
            return Err(self.taken("publisher", topic));
        }
        topics.publications.insert(topic.clone(), Arc::clone(publication));
        Ok(())
    }

    pub fn add_intake(&self, intake: &Arc<Intake>) -> Result<(), RosError> {
        let mut topics = self.lock();
        if topics
            .intakes
            .get(&intake.topic)
            .is_some_and(|former| !former.is_closed())
        {
            return Err(self.taken("subscription", &intake.topic));
        }
        topics.intakes.insert(intake.topic.clone(), Arc::clone(intake));
        Ok(())
    }

    pub fn publication(&self, topic: &str) -> Option<Arc<Publication>> {
        self.lock()
            .publications
            .get(topic)
            .filter(|publication| !publication.is_over())
            .cloned()
    }

    pub fn intake(&self, topic: &str) -> Option<Arc<Intake>> {
        self.lock().intakes.get(topic).cloned()
    }

    pub fn publications(&self) -> Vec<Arc<Publication>> {
        self.lock().publications.values().cloned().collect()
    }

    pub fn intakes(&self) -> Vec<Arc<Intake>> {
        self.lock().intakes.values().cloned().collect()
    }

    /// Notes a registration; false if the node is ending, and it should be taken back at once.
    pub fn note_registered(&self, registered: Registered) -> bool {
        let mut topics = self.lock();
        if !topics.closing {
            topics.registered.push(registered);
        }
        !topics.closing
    }

    /// A registration is under way for as long as the answer lives.
    pub fn begin_to_register(self: &Arc<Self>) -> Registering {
        self.lock().registering += 1;
        Registering(Arc::clone(self))
    }

    pub fn is_closing(&self) -> bool {
        self.lock().closing
    }

    /// Waits until no registration is under way, or the time is over.
    pub fn wait_until_settled(&self, deadline: Instant) {
        let left = deadline.saturating_duration_since(Instant::now());
        // Either way the node goes on to end.
        drop(
            self.settled
                .wait_timeout_while(self.lock(), left, |topics| topics.registering > 0),
        );
    }

    /// The topics whose registration the master has confirmed, once.
    pub fn registered(&self) -> Vec<Registered> {
        self.lock().registered.clone()
    }

    /// From now on nothing is registered. What has been is for the caller to take back.
    pub fn begin_to_close(&self) -> Vec<Registered> {
        let mut topics = self.lock();
        topics.closing = true;
        std::mem::take(&mut topics.registered)
    }

    pub fn close_intakes(&self) {
        for intake in self.intakes() {
            intake.close();
        }
    }

    fn taken(&self, role: &'static str, topic: &str) -> RosError {
        RosError::Taken {
            node: self.name.clone(),
            role,
            topic: topic.to_owned(),
        }
    }

    fn lock(&self) -> MutexGuard<'_, Topics> {
        self.topics.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Counted while it lives.
#[derive(Debug)]
pub(super) struct Registering(Arc<Membership>);

impl Drop for Registering {
    fn drop(&mut self) {
        self.0.lock().registering -= 1;
        self.0.settled.notify_all();
    }
}
