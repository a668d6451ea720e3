//! Putting the workload on a host, or what stands in for its agent where no workload runs. The main function is
//! [`deploy`].
//!
//! It goes where a `matrix` on the host would put it (`StateDirectory`), under a name with its hash: what is there is
//! compared and not sent again, and nothing that runs is ever written over.

use std::{borrow::Cow, path::PathBuf};

use super::SshHost;
use crate::{
    host::{
        Deployed, HostError,
        script::{NotInstalled, Shell},
    },
    workload_binary::machine::Machine,
};

/// What the host is and where its state directory is. As `StateDirectory` decides it: what is not absolute is ignored.
const LOOK: &str = r#"
state=/var/lib/matrix
case ${HOME-} in /*) state=$HOME/.local/state/matrix ;; esac
case ${XDG_STATE_HOME-} in /*) state=$XDG_STATE_HOME/matrix ;; esac
case ${MATRIX_STATE_DIR-} in /*) state=$MATRIX_STATE_DIR ;; esac
lease=/tmp/matrix-host.lease
case ${MATRIX_LEASE-} in /*) lease=$MATRIX_LEASE ;; esac
printf '%s\n' "$(uname -s)" "$(uname -m)" "$state" "$lease"
"#;

/// On systems where the workload does not run: what can be asked of them all the same.
const STAND_IN: &str = include_str!("stand_in.pl");

/// What a host says when it is looked at.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Look {
    /// None where the system is not Linux.
    machine: Option<Machine>,
    state: PathBuf,
    lease: PathBuf,
}

/// Has the program on the host, whatever it takes.
pub async fn deploy(host: &SshHost) -> Result<Deployed, HostError> {
    let shell = Shell::Login(host);
    let said = shell.run(LOOK, &[], &[]).await?;
    let look = read_look(&said).map_err(|error| shell.refused(error))?;
    let (kind, program) = match look.machine {
        // Reading one from a disk, or hashing it, is done in no time beside the network's.
        Some(machine) => (
            "workload",
            machine.workload().map_err(|error| shell.refused(error.into()))?,
        ),
        None => ("stand-in", Cow::Borrowed(STAND_IN.as_bytes())),
    };
    let installed = shell.install(&look.state.join("bin"), kind, &program).await?;
    Ok(Deployed {
        program: installed.file,
        sha256: installed.sha256,
        environments: look.state.join("environments"),
        lease: look.lease,
    })
}

fn read_look(said: &str) -> Result<Look, NotInstalled> {
    let lines: Vec<&str> = said.lines().collect();
    match lines.as_slice() {
        [system, machine, state, lease] if state.starts_with('/') => Ok(Look {
            machine: match *system {
                "Linux" => Some(machine.parse()?),
                _ => None,
            },
            state: PathBuf::from(state),
            lease: PathBuf::from(lease),
        }),
        _ => Err(NotInstalled::Answer(said.trim().to_owned())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[rstest::rstest]
    #[case("Linux\nx86_64\n/home/a/.local/state/matrix\n/l\n", Ok((Some(Machine::X86_64), "/home/a/.local/state/matrix")))]
    #[case("Linux\naarch64\n/var/lib/matrix\n/l\n", Ok((Some(Machine::Aarch64), "/var/lib/matrix")))]
    #[case("Darwin\narm64\n/Users/a/.local/state/matrix\n/l\n", Ok((None, "/Users/a/.local/state/matrix")))]
    #[case(
        "Linux\nriscv64\n/m\n/l\n",
        Err("there is no workload for riscv64: it is built for x86_64, i686 and aarch64")
    )]
    #[case(
        "Welcome!\nLinux\nx86_64\n/m\n/l\n",
        Err(
            "it answered `Welcome!\nLinux\nx86_64\n/m\n/l` where its system, machine and state directory were asked for"
        )
    )]
    fn what_a_host_is_decides_what_it_gets(
        #[case] said: &str,
        #[case] answer: Result<(Option<Machine>, &str), &str>,
    ) {
        let read = read_look(said).map_err(|error| error.to_string());
        let answer = answer.map(|(machine, state)| Look {
            machine,
            state: state.into(),
            lease: "/l".into(),
        });
        assert_eq!(read, answer.map_err(str::to_owned));
    }
}
