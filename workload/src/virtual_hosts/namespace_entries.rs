//! The ways into the virtual hosts from other processes: an idle thread in each, by whose entry in /proc the host's
//! network namespace can be had, whichever backend made it. [`crate::enter`] goes through them. The main type is
//! [`NamespaceEntries`].

use std::{
    sync::mpsc::{Sender, channel},
    thread,
};

use super::namespace_thread::on_host;
use crate::experiment::ExperimentError;
use crate::{enter::entry_name, network::Network};

/// It does nothing but wait.
const STACK_BYTES: usize = 64 * 1024;

/// Open until dropped.
#[derive(Debug)]
pub struct NamespaceEntries {
    /// Nothing is ever sent: the threads end when these are dropped.
    _held: Vec<Sender<()>>,
}

impl NamespaceEntries {
    /// Opens one into each host.
    ///
    /// # Errors
    /// If a host cannot be entered or a thread not be had.
    pub fn open(network: &dyn Network) -> Result<Self, ExperimentError> {
        let held = network.topology().names().map(|host| {
            on_host(network, host, move || {
                let (held, waits) = channel::<()>();
                let entry = thread::Builder::new()
                    .name(entry_name(host))
                    .stack_size(STACK_BYTES)
                    .spawn(move || {
                        // It ends with the sender.
                        let _ = waits.recv();
                    });
                entry.map_err(|source| ExperimentError::Thread {
                    name: host.to_string().into(),
                    source,
                })?;
                Ok(held)
            })
        });
        Ok(Self {
            _held: held.collect::<Result<_, _>>()?,
        })
    }
}
