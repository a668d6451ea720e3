//! The clusters of one call of `matrix`. The main types are [`Cluster`] and [`Clusters`].

use std::sync::{Arc, Mutex, PoisonError};

use record::connection::Slurm;

use super::{BatchSystem, queue::Queue, slurm::SlurmCommands};
use crate::host::Host;

/// A cluster: its batch system, and what was last seen of its queue.
pub struct Cluster {
    /// The system.
    pub system: Arc<dyn BatchSystem>,
    /// All jobs of this user.
    pub queue: Queue,
}

impl Cluster {
    /// With a system of its own.
    #[must_use]
    pub fn new(system: Arc<dyn BatchSystem>) -> Self {
        Self {
            queue: Queue::new(Arc::clone(&system)),
            system,
        }
    }
}

/// The clusters that one call of `matrix` works with, each once, so that one question is for all hosts of it.
#[derive(Clone, Default)]
pub struct Clusters(Arc<Mutex<Vec<Known>>>);

/// How a cluster is reached, and itself.
type Known = (Slurm, Arc<Cluster>);

impl Clusters {
    /// That of a host, whose programs are started on the submit host.
    #[must_use]
    pub fn of(&self, slurm: &Slurm, host: &Arc<dyn Host>) -> Arc<Cluster> {
        // The list is whole whenever the lock is free, also after a panic.
        let mut known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let is_it = |other: &Slurm| (&other.submit, &other.bin) == (&slurm.submit, &slurm.bin);
        if let Some((_, cluster)) = known.iter().find(|(other, _)| is_it(other)) {
            return Arc::clone(cluster);
        }
        let commands = SlurmCommands::new(Arc::clone(host), slurm.bin.clone());
        let cluster = Arc::new(Cluster::new(Arc::new(commands)));
        known.push((slurm.clone(), Arc::clone(&cluster)));
        cluster
    }
}
