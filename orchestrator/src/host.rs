//! Hosts: the machines that environments are made on, this one and others over SSH. A [`Host`] starts programs and opens
//! sockets there; everything else (the workload's agent, a Docker Engine, Vagrant) is a program or a socket, and does
//! not know where it is.
//!
//! ```text
//! provider ── Program ──> Host ──> a process of this machine
//!          <── stream ───      └─> a process behind SSH
//! ```

mod choice;
mod error;
mod forward;
mod here;
pub mod lease;
mod nodes;
mod output;
mod program;
mod script;
pub mod slurm;
pub mod ssh;

use std::{path::PathBuf, process, sync::Arc};

use async_trait::async_trait;
use record::connection::SshAddress;
use tokio::net::UnixStream;

pub use self::{
    choice::{Said, all, of},
    error::HostError,
    forward::Forward,
    here::Here,
    nodes::SlurmNodes,
    output::output,
    program::{Exit, Program, ProgramEnd, RunningProgram},
};

/// A machine that programs are started on.
#[async_trait]
pub trait Host: Send + Sync {
    /// Its name in the matrix file.
    fn name(&self) -> &str;

    /// Whether it is where this process runs, so that what we see of our surroundings is the host's.
    fn is_this_machine(&self) -> bool {
        false
    }

    /// The nodes that it stands for, if it is none itself: programs are then started on the submit host, which is not what is
    /// measured.
    fn nodes(&self) -> Option<&SlurmNodes> {
        None
    }

    /// Starts a program, which lives at most as long as its stream and, over SSH, as the connection: what is to outlive
    /// us detaches itself.
    ///
    /// # Errors
    /// When the host cannot be reached or refuses. That there is no such program is its end, as a shell says it: 127.
    async fn start(&self, program: &Program) -> Result<RunningProgram, HostError>;

    /// Connects to a socket as it is named there.
    ///
    /// # Errors
    /// When the host cannot be reached, or nobody listens.
    async fn connect(&self, listener: &Listener) -> Result<UnixStream, HostError>;

    /// The workload for what the host is, put there if it is not there yet.
    ///
    /// # Errors
    /// When there is none for such a machine, or it cannot be put there.
    async fn deploy(&self) -> Result<Deployed, HostError>;

    /// A program there for a person, with our own standard input and output, a terminal if they are one. It has what a
    /// login there has.
    fn terminal(&self, program: &Program) -> process::Command;

    /// A machine that we have just made on it and that is reached from it, over SSH with the key in this file of ours.
    /// Nothing is connected before something is asked of it.
    fn machine_behind(&self, name: &str, address: SshAddress, identity: PathBuf) -> Arc<dyn Host>;
}

/// Something on a host that can be connected to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Listener {
    /// A socket in the file system.
    Unix(PathBuf),
    /// A TCP port, of a name or address as the host resolves it.
    Tcp {
        /// Name or address.
        host: String,
        /// Port.
        port: u16,
    },
}

/// The workload as it is on a host.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Deployed {
    /// Its file there.
    pub program: PathBuf,
    /// Its SHA-256, in hexadecimal.
    pub sha256: String,
    /// The folder there that has a folder for each detached environment: `--root` of `workload detached`.
    pub environments: PathBuf,
    /// The file there that leases of the host are on: one for all its users.
    pub lease: PathBuf,
}
