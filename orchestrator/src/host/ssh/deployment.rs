//! Putting the workload on a host. The main function is [`deploy`].
//!
//! It goes where a `matrix` on the host would put it (`StateDirectory`), under a name with its hash: what is there is
//! compared and not sent again, and nothing that runs is ever written over.

use std::{
    path::{Path, PathBuf},
    time::Duration,
};

use super::{SshHost, command_line::of_script};
use crate::{
    host::{Deployed, HostError, output::answer},
    provider::Cause,
    workload_binary::{
        self,
        machine::{Machine, NoWorkload, UnknownMachine},
    },
};

/// What is asked of the host.
const TAKING: &str = "taking the workload";
/// Megabytes over a bad line.
const PATIENCE: Duration = Duration::from_secs(600);

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

/// The SHA-256 of `$1`, if it is there.
const HASH: &str = r#"[ ! -x "$1" ] || sha256sum < "$1""#;

/// Standard input becomes `$1/$2` if its SHA-256 is `$3`.
const PUT: &str = r#"
set -eu
umask 022
mkdir -p "$1"
file=$1/.$2.$$
trap 'rm -f "$file"' EXIT HUP INT TERM
cat > "$file"
case $(sha256sum < "$file") in
    "$3 "*) ;;
    *) echo "what has arrived is not what was sent" >&2; exit 1 ;;
esac
chmod 755 "$file"
mv -f "$file" "$1/$2"
"#;

/// Why a host gets no workload.
#[derive(Debug, thiserror::Error)]
enum NoDeployment {
    #[error("it runs {0}, and the workload is a program for Linux")]
    System(String),
    #[error(transparent)]
    Machine(#[from] UnknownMachine),
    #[error(transparent)]
    Workload(#[from] NoWorkload),
    #[error("it answered `{0}` where its system, machine and state directory were asked for")]
    Answer(String),
    #[error("{0}")]
    Said(String),
}

impl NoDeployment {
    fn hint(&self) -> Option<String> {
        match self {
            Self::System(_) => {
                Some("have the workload run in a virtual machine or a container there".to_owned())
            }
            Self::Workload(none) => Some(none.hint()),
            Self::Machine(_) => None,
            Self::Answer(_) => {
                Some("a login shell may greet on a terminal only: see ~/.bashrc there".to_owned())
            }
            Self::Said(_) => {
                Some("it needs `sh`, `sha256sum` and a state directory that can be written".to_owned())
            }
        }
    }
}

/// Has the workload on the host, whatever it takes.
pub async fn deploy(host: &SshHost) -> Result<Deployed, HostError> {
    let said = run(host, LOOK, &[], &[]).await?;
    let (machine, state, lease) = read_look(&said).map_err(|error| refused(host, error))?;
    // Reading one from a disk, or hashing it, is done in no time beside the network's.
    let workload = machine.workload().map_err(|error| refused(host, error.into()))?;
    let sha256 = workload_binary::hash_of(&workload);
    let folder = state.join("bin");
    let name = format!("workload-{}", sha256.get(..16).unwrap_or_default());
    let program = folder.join(&name);
    let there = run(host, HASH, &[&text(&program)], &[]).await?;
    if there.split_whitespace().next() != Some(&sha256) {
        run(host, PUT, &[&text(&folder), &name, &sha256], &workload).await?;
    }
    Ok(Deployed {
        program,
        sha256,
        environments: state.join("environments"),
        lease,
    })
}

fn read_look(said: &str) -> Result<(Machine, PathBuf, PathBuf), NoDeployment> {
    let lines: Vec<&str> = said.lines().collect();
    match lines.as_slice() {
        ["Linux", machine, state, lease] if state.starts_with('/') => {
            Ok((machine.parse()?, PathBuf::from(state), PathBuf::from(lease)))
        }
        [system, _, state, _] if state.starts_with('/') => Err(NoDeployment::System((*system).to_owned())),
        _ => Err(NoDeployment::Answer(said.trim().to_owned())),
    }
}

/// What a script says that has to succeed.
async fn run(host: &SshHost, script: &str, arguments: &[&str], input: &[u8]) -> Result<String, HostError> {
    let starting = host.start_line(of_script(script, arguments));
    let (exit, said) = answer(&host.way.name, TAKING, starting, input, PATIENCE).await?;
    if exit.success() {
        return Ok(String::from_utf8_lossy(&said).into_owned());
    }
    let why = match exit.last_words.trim() {
        "" => format!("a script ended with {:?} and said nothing", exit.code),
        words => words.to_owned(),
    };
    Err(refused(host, NoDeployment::Said(why)))
}

fn refused(host: &SshHost, error: NoDeployment) -> HostError {
    HostError::Refused {
        host: host.way.name.clone(),
        action: TAKING.to_owned(),
        hint: error.hint(),
        source: Cause::from(error),
    }
}

/// A path that came as text.
fn text(path: &Path) -> String {
    path.to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[rstest::rstest]
    #[case("Linux\nx86_64\n/home/a/.local/state/matrix\n/l\n", Ok((Machine::X86_64, "/home/a/.local/state/matrix")))]
    #[case("Linux\naarch64\n/var/lib/matrix\n/l\n", Ok((Machine::Aarch64, "/var/lib/matrix")))]
    #[case(
        "Darwin\narm64\n/Users/a/.local/state/matrix\n/l\n",
        Err("it runs Darwin, and the workload is a program for Linux")
    )]
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
        #[case] answer: Result<(Machine, &str), &str>,
    ) {
        let read = read_look(said).map_err(|error| error.to_string());
        let answer = answer.map(|(machine, state)| (machine, state.into(), "/l".into()));
        assert_eq!(read, answer.map_err(str::to_owned));
    }
}
