//! Which kind of host a matrix file names. The function is [`of`].

use std::sync::Arc;

use record::connection::{Connection, Slurm};

use super::{
    Here, Host, SlurmNodes,
    slurm::SlurmHost,
    ssh::{SshClient, SshHost, Trust},
};
use crate::state_directory::StateDirectory;

/// What a matrix file says of a host.
#[derive(Debug, Clone, Copy)]
pub struct Said<'a> {
    /// Its name there.
    pub name: &'a str,
    /// How it is reached.
    pub connection: &'a Connection,
    /// Its hardware; empty where it is not said.
    pub hardware: &'a str,
    /// Its operating system; empty where it is not said.
    pub os: &'a str,
}

/// The host that a matrix file names, with what is put on this machine in this state directory.
#[must_use]
pub fn of(said: Said<'_>, state: &StateDirectory) -> Arc<dyn Host> {
    let name = said.name;
    match said.connection {
        Connection::Local => Arc::new(Here::new(name, state.clone())),
        Connection::Ssh(ssh) => Arc::new(SshHost::new(
            name,
            ssh.clone(),
            Trust::KnownHosts,
            SshClient::of_this_user(),
        )),
        Connection::Slurm(slurm) => {
            let submit = Said {
                connection: slurm.submit.connection(),
                ..said
            };
            let nodes = SlurmNodes {
                slurm: Slurm::clone(slurm),
                hardware: said.hardware.to_owned(),
                os: said.os.to_owned(),
            };
            Arc::new(SlurmHost::new(of(submit, state), nodes, state.clone()))
        }
    }
}
