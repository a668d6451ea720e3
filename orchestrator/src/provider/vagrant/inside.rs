//! The inside of a machine as a host: what SSH reaches, as long as there is a machine. The main type is [`Inside`].

use std::{
    fs::File,
    io::{self, Write as _},
    os::fd::AsRawFd as _,
    path::PathBuf,
    sync::Arc,
    time::Duration,
};

use async_trait::async_trait;
use rustix::fs::{MemfdFlags, memfd_create};
use tokio::net::UnixStream;

use super::{RUNNING, machine::Machine};
use crate::{
    host::{Deployed, Host, HostError, Listener, Program, RunningProgram, output},
    provider::ProviderError,
};

/// How long it may take to become root.
const TIMEOUT: Duration = Duration::from_secs(60);

/// The same program, run by root: networks of the kernel's, real-time priorities and tcpdump are for root alone.
fn as_root(program: &Program) -> Program {
    let arguments = ["-n".into(), "--".into(), program.file.clone().into_os_string()];
    Program::new(
        "sudo",
        arguments.into_iter().chain(program.arguments.iter().cloned()),
    )
}

/// A private key in a file that is on no disk and goes with this process, however that ends.
struct Key(File);

impl Key {
    fn of(key: &[u8]) -> Result<Self, ProviderError> {
        let keep = || -> io::Result<File> {
            let mut file = File::from(memfd_create("matrix-key", MemfdFlags::CLOEXEC)?);
            file.write_all(key)?;
            Ok(file)
        };
        keep().map(Self).map_err(|source| ProviderError::File {
            action: "write",
            path: "a machine's key into memory".into(),
            source,
        })
    }

    /// Its name, for this process alone.
    fn path(&self) -> PathBuf {
        format!("/proc/self/fd/{}", self.0.as_raw_fd()).into()
    }
}

/// A machine, from within.
pub struct Inside {
    ssh: Arc<dyn Host>,
    machine: Machine,
    /// Whether who is let in may become root there.
    becomes_root: bool,
    /// What lets us in, for as long as it is needed.
    _key: Key,
}

impl Inside {
    /// Of a machine that runs, reached from its host.
    ///
    /// # Errors
    /// When Vagrant does not say the way.
    pub async fn of(host: &Arc<dyn Host>, machine: Machine, name: &str) -> Result<Self, ProviderError> {
        let way = machine.way_in().await?;
        let mut refusal = None;
        for identity in &way.identities {
            let key = Key::of(&machine.key(identity).await?)?;
            let ssh = host.machine_behind(name, way.address.clone(), key.path());
            // Boxes let their user do so by convention, and a machine of ours is ours altogether.
            let asking = as_root(&Program::new::<&str>("true", []));
            match output(ssh.as_ref(), &asking, b"", TIMEOUT).await {
                Ok((exit, _)) => {
                    return Ok(Self {
                        ssh,
                        machine,
                        becomes_root: exit.success(),
                        _key: key,
                    });
                }
                // Another key may be the one that the machine knows.
                Err(error) => refusal = Some(error.into()),
            }
        }
        Err(refusal.unwrap_or_else(|| machine.without_a_key()))
    }

    /// A connection that is lost may come back, but not to a machine that is gone.
    async fn explained(&self, error: HostError) -> HostError {
        if !error.is_passing() && !matches!(error, HostError::Unreachable { .. }) {
            return error;
        }
        match self.machine.state().await {
            Ok(state) if state != RUNNING => HostError::Refused {
                host: self.ssh.name().to_owned(),
                action: "going on".to_owned(),
                hint: Some(
                    "somebody else stopped or removed the machine, or it crashed; `matrix resume` measures again what \
                     is missing"
                        .to_owned(),
                ),
                source: format!("the machine does not run any more: Vagrant calls it `{state}`").into(),
            },
            _ => error,
        }
    }
}

#[async_trait]
impl Host for Inside {
    fn name(&self) -> &str {
        self.ssh.name()
    }

    async fn start(&self, program: &Program) -> Result<RunningProgram, HostError> {
        let started = match self.becomes_root {
            true => self.ssh.start(&as_root(program)).await,
            false => self.ssh.start(program).await,
        };
        match started {
            Ok(running) => Ok(running),
            Err(error) => Err(self.explained(error).await),
        }
    }

    async fn connect(&self, listener: &Listener) -> Result<UnixStream, HostError> {
        match self.ssh.connect(listener).await {
            Ok(stream) => Ok(stream),
            Err(error) => Err(self.explained(error).await),
        }
    }

    async fn deploy(&self) -> Result<Deployed, HostError> {
        match self.ssh.deploy().await {
            Ok(deployed) => Ok(deployed),
            Err(error) => Err(self.explained(error).await),
        }
    }

    fn terminal(&self, program: &Program) -> std::process::Command {
        self.ssh.terminal(program)
    }

    fn machine_behind(
        &self,
        name: &str,
        address: record::connection::SshAddress,
        identity: PathBuf,
    ) -> Arc<dyn Host> {
        self.ssh.machine_behind(name, address, identity)
    }
}
