//! Putting the workload on a host, or what stands in for its agent where no workload runs. The main function is
//! [`deploy`].
//!
//! It goes where a `matrix` on the host would put it (`StateDirectory`), under a name with its hash: what is there is
//! compared and not sent again, and nothing that runs is ever written over.

use std::{
    borrow::Cow,
    path::{Path, PathBuf},
    time::Duration,
};

use super::{SshHost, command_line::of_script};
use crate::{
    failure::Cause,
    host::{Deployed, HostError, output::answer},
    workload_binary::{
        self,
        machine::{Machine, NoWorkload, UnknownMachine},
    },
};

/// What is asked of the host.
const TAKING: &str = "taking the workload";
/// Megabytes over a bad line.
const TIMEOUT: Duration = Duration::from_secs(600);

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

/// The SHA-256 of `$1`, if it is there. macOS has no sha256sum.
const HASH: &str = r#"
sum() { if command -v sha256sum >/dev/null; then sha256sum; else shasum -a 256; fi; }
[ ! -x "$1" ] || sum < "$1"
"#;

/// Standard input becomes `$1/$2` if its SHA-256 is `$3`.
const PUT: &str = r#"
set -eu
umask 022
sum() { if command -v sha256sum >/dev/null; then sha256sum; else shasum -a 256; fi; }
mkdir -p "$1"
file=$1/.$2.$$
trap 'rm -f "$file"' EXIT HUP INT TERM
cat > "$file"
case $(sum < "$file") in
    "$3 "*) ;;
    *) echo "what has arrived is not what was sent" >&2; exit 1 ;;
esac
chmod 755 "$file"
mv -f "$file" "$1/$2"
"#;

/// Why a host gets no workload.
#[derive(Debug, thiserror::Error)]
enum NoDeployment {
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
            Self::Workload(none) => Some(none.hint()),
            Self::Machine(_) => None,
            Self::Answer(_) => {
                Some("a login shell may greet on a terminal only: see ~/.bashrc there".to_owned())
            }
            Self::Said(_) => Some(
                "it needs `sh`, `sha256sum` or `shasum`, and a state directory that can be written"
                    .to_owned(),
            ),
        }
    }
}

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
    let said = run(host, LOOK, &[], &[]).await?;
    let look = read_look(&said).map_err(|error| refused(host, error))?;
    let (kind, program) = match look.machine {
        // Reading one from a disk, or hashing it, is done in no time beside the network's.
        Some(machine) => (
            "workload",
            machine.workload().map_err(|error| refused(host, error.into()))?,
        ),
        None => ("stand-in", Cow::Borrowed(STAND_IN.as_bytes())),
    };
    let sha256 = workload_binary::hash_of(&program);
    let folder = look.state.join("bin");
    let name = format!("{kind}-{}", sha256.get(..16).unwrap_or_default());
    let file = folder.join(&name);
    let there = run(host, HASH, &[&text(&file)], &[]).await?;
    if there.split_whitespace().next() != Some(&sha256) {
        run(host, PUT, &[&text(&folder), &name, &sha256], &program).await?;
    }
    Ok(Deployed {
        program: file,
        sha256,
        environments: look.state.join("environments"),
        lease: look.lease,
    })
}

fn read_look(said: &str) -> Result<Look, NoDeployment> {
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
        _ => Err(NoDeployment::Answer(said.trim().to_owned())),
    }
}

/// What a script says that has to succeed.
async fn run(host: &SshHost, script: &str, arguments: &[&str], input: &[u8]) -> Result<String, HostError> {
    let starting = host.start_line(of_script(script, arguments));
    let (exit, said) = answer(&host.way.name, TAKING, starting, input, TIMEOUT).await?;
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
