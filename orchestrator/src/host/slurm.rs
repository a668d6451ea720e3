//! The nodes of a Slurm cluster as one host. The main type is [`SlurmHost`].
//!
//! Which node measures is known when a job begins. Until then there is the submit host, which sees the same folder: programs are
//! started there, and none of them is the workload.

use std::{
    path::{Path, PathBuf},
    process,
    sync::Arc,
};

use async_trait::async_trait;
use record::connection::{Connection, SshAddress};
use tokio::{net::UnixStream, sync::OnceCell};

use super::{
    Deployed, Host, HostError, Listener, Program, RunningProgram,
    nodes::SlurmNodes,
    script::{Installed, NotInstalled, Shell},
};
use crate::{lease, state_directory::StateDirectory, workload_binary::machine::Machine};

/// What a job runs: the words after the script's are the workload, its root, its environment, the hardware and the operating system
/// that are said, and the file of the node's lease. Not one of them is in the script's text.
const JOB: &str = r#"#!/bin/sh
# matrix: the workload of one environment.
exec "$1" detached job --root "$2" --environment "$3" --hardware "$4" --os "$5" --lease "$6" \
    --job "${SLURM_JOB_ID:?}" --node "${SLURMD_NODENAME:?}"
"#;

/// What a job runs that only looks what its node is and whether it has what a scenario needs: the words after the script's are the
/// workload, the settings and the root. Its answers are JSON, one after another, the last one whether this user may use an engine.
const PROBE: &str = r#"#!/bin/sh
# matrix: what this node has.
"$1" check --settings "$2" && "$1" detached platform --root "$3" || exit
if [ -w /var/run/docker.sock ]; then echo true; else echo false; fi
"#;

/// What the submit host is, and where a state directory of `matrix` is there.
const LOOK: &str = r#"
case ${HOME-} in /*) state=$HOME/.local/state/matrix ;; *) state=/var/lib/matrix ;; esac
printf '%s\n' "$(uname -m)" "$state"
"#;

/// What a job runs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct JobPrograms {
    /// The script.
    pub script: PathBuf,
    /// The script of a job that only looks.
    pub probe: PathBuf,
    /// The workload for the nodes' hardware.
    pub workload: PathBuf,
    /// Its SHA-256, in hexadecimal.
    pub workload_sha256: String,
}

/// A cluster's nodes, behind its submit host.
pub struct SlurmHost {
    name: String,
    submit: Arc<dyn Host>,
    nodes: SlurmNodes,
    state: StateDirectory,
    deployed: OnceCell<Deployed>,
}

impl SlurmHost {
    /// Those nodes, with the files of jobs in this state directory where the submit host is this machine and no `root` is said.
    #[must_use]
    pub fn new(name: &str, submit: Arc<dyn Host>, nodes: SlurmNodes, state: StateDirectory) -> Self {
        Self {
            name: name.to_owned(),
            submit,
            nodes,
            state,
            deployed: OnceCell::new(),
        }
    }

    /// The submit host's machine, and the folder that the nodes see too.
    async fn look(&self) -> Result<(Machine, PathBuf), HostError> {
        let shell = Shell::Plain(self.submit.as_ref());
        let said = shell.run(LOOK, &[], &[]).await?;
        let lines: Vec<&str> = said.lines().collect();
        let [machine, state] = lines.as_slice() else {
            return Err(shell.refused(NotInstalled::Answer(said.trim().to_owned())));
        };
        let machine = machine
            .parse()
            .map_err(|error| shell.refused(NotInstalled::Machine(error)))?;
        let root = match (&self.nodes.slurm.root, self.nodes.slurm.submit.connection()) {
            (Some(root), _) => root.clone(),
            (None, Connection::Local) => self.state.path().to_owned(),
            (None, _) => PathBuf::from(state),
        };
        Ok((machine, root))
    }

    async fn put(&self) -> Result<Deployed, HostError> {
        let (machine, root) = self.look().await?;
        let shell = Shell::Plain(self.submit.as_ref());
        let workload = machine
            .workload()
            .map_err(|error| shell.refused(NotInstalled::Workload(error)))?;
        let installed = shell.install(&root.join("bin"), "workload", &workload).await?;
        Ok(Deployed {
            program: installed.file,
            sha256: installed.sha256,
            // Not among those of the submit host, of which each has its process there.
            environments: root.join("jobs"),
            lease: PathBuf::from(lease::OF_A_MACHINE),
        })
    }
}

/// Puts what a job runs where the nodes see it, if it is not there yet.
///
/// # Errors
/// When there is no workload for the hardware that is said, or the submit host cannot be reached or refuses.
pub async fn install(host: &dyn Host, nodes: &SlurmNodes) -> Result<JobPrograms, HostError> {
    let shell = Shell::Plain(host);
    // Beside the submit host's own.
    let own = host.deploy().await?;
    let bin = own.program.parent().unwrap_or(Path::new("/"));
    let installed = match nodes.hardware.parse::<Machine>().ok() {
        Some(machine) => {
            let workload = machine
                .workload()
                .map_err(|error| shell.refused(NotInstalled::Workload(error)))?;
            shell.install(bin, "workload", &workload).await?
        }
        // A name of the user's own says nothing of the machine.
        None => Installed {
            file: own.program.clone(),
            sha256: own.sha256,
        },
    };
    let script = shell.install(bin, "job", JOB.as_bytes()).await?;
    let probe = shell.install(bin, "probe", PROBE.as_bytes()).await?;
    Ok(JobPrograms {
        script: script.file,
        probe: probe.file,
        workload: installed.file,
        workload_sha256: installed.sha256,
    })
}

/// Makes a folder where the nodes see it.
///
/// # Errors
/// When the submit host cannot be reached or refuses.
pub async fn make_folder(host: &dyn Host, folder: &Path) -> Result<(), HostError> {
    let folder = folder.to_string_lossy();
    Shell::Plain(host)
        .run(r#"mkdir -p "$1""#, &[&folder], &[])
        .await
        .map(drop)
}

/// Reads a small file that a job has written, and removes it.
///
/// # Errors
/// When it is not there, or the submit host cannot be reached or refuses.
pub async fn take_file(host: &dyn Host, file: &Path) -> Result<String, HostError> {
    let file = file.to_string_lossy();
    Shell::Plain(host)
        .run(r#"head -c 65536 "$1" && rm -f "$1""#, &[&file], &[])
        .await
}

#[async_trait]
impl Host for SlurmHost {
    fn name(&self) -> &str {
        &self.name
    }

    fn nodes(&self) -> Option<&SlurmNodes> {
        Some(&self.nodes)
    }

    async fn start(&self, program: &Program) -> Result<RunningProgram, HostError> {
        self.submit.start(program).await
    }

    async fn connect(&self, listener: &Listener) -> Result<UnixStream, HostError> {
        self.submit.connect(listener).await
    }

    /// That for the submit host, which sees to the folders of environments.
    async fn deploy(&self) -> Result<Deployed, HostError> {
        // There are many jobs, and all have the same.
        self.deployed.get_or_try_init(|| self.put()).await.cloned()
    }

    fn terminal(&self, program: &Program) -> process::Command {
        self.submit.terminal(program)
    }

    fn machine_behind(&self, name: &str, address: SshAddress, identity: PathBuf) -> Arc<dyn Host> {
        self.submit.machine_behind(name, address, identity)
    }
}
