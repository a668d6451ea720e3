//! Which kinds of hosts a matrix file names. The main function is [`all`].

use std::sync::Arc;

use record::connection::{Connection, Slurm, Submit};

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
    Hosts::new(state).of(said)
}

/// Those that one call of `matrix` works with, in their order.
pub fn all<'a>(said: impl IntoIterator<Item = Said<'a>>, state: &StateDirectory) -> Vec<Arc<dyn Host>> {
    let mut hosts = Hosts::new(state);
    said.into_iter().map(|said| hosts.of(said)).collect()
}

/// Hosts as they are made.
struct Hosts<'a> {
    state: &'a StateDirectory,
    /// The submit hosts: the nodes of a cluster may be many hosts, and that machine is logged in to once for all of them.
    submit: Vec<(Submit, Arc<dyn Host>)>,
}

impl<'a> Hosts<'a> {
    const fn new(state: &'a StateDirectory) -> Self {
        Self {
            state,
            submit: Vec::new(),
        }
    }

    fn of(&mut self, said: Said<'_>) -> Arc<dyn Host> {
        let name = said.name;
        match said.connection {
            Connection::Local => Arc::new(Here::new(name, self.state.clone())),
            Connection::Ssh(ssh) => Arc::new(SshHost::new(
                name,
                ssh.clone(),
                Trust::KnownHosts,
                SshClient::of_this_user(),
            )),
            Connection::Slurm(slurm) => {
                let nodes = SlurmNodes {
                    slurm: Slurm::clone(slurm),
                    hardware: said.hardware.to_owned(),
                    os: said.os.to_owned(),
                };
                let submit = self.submit_host(said, &slurm.submit);
                Arc::new(SlurmHost::new(name, submit, nodes, self.state.clone()))
            }
        }
    }

    fn submit_host(&mut self, said: Said<'_>, submit: &Submit) -> Arc<dyn Host> {
        if let Some((_, host)) = self.submit.iter().find(|(known, _)| known == submit) {
            return Arc::clone(host);
        }
        let host = self.of(Said {
            connection: submit.connection(),
            ..said
        });
        self.submit.push((submit.clone(), Arc::clone(&host)));
        host
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn said<'a>(name: &'a str, connection: &'a Connection) -> Said<'a> {
        Said {
            name,
            connection,
            hardware: "x86_64",
            os: "debian-12",
        }
    }

    #[test]
    fn the_nodes_of_a_cluster_share_their_submit_host_and_keep_their_names() {
        let connection = |text: &str| serde_yaml::from_str::<Connection>(text).unwrap();
        let there = connection("slurm: {submit: {ssh: me@login.invalid}, nodelist: n1}");
        let its_twin = connection("slurm: {submit: {ssh: me@login.invalid}, nodelist: n2}");
        let elsewhere = connection("slurm: {submit: {ssh: me@other.invalid}}");
        let state = StateDirectory::new("/nowhere");
        let mut hosts = Hosts::new(&state);
        let made = [("lab-n1", &there), ("lab-n2", &its_twin), ("other", &elsewhere)]
            .map(|(name, connection)| hosts.of(said(name, connection)));
        assert_eq!(hosts.submit.len(), 2);
        let names: Vec<_> = made.iter().map(|host| host.name()).collect();
        assert_eq!(names, ["lab-n1", "lab-n2", "other"]);
    }
}
