//! Small scripts by which programs are put on a host that has no agent yet. The main type is [`Shell`].

use std::{
    path::{Path, PathBuf},
    time::Duration,
};

use super::{
    Host, HostError, Program,
    output::answer,
    ssh::{SshHost, script_line},
};
use crate::{
    failure::Cause,
    workload_binary::{
        self,
        machine::{NoWorkload, UnknownMachine},
    },
};

/// What is asked of the host.
const TAKING: &str = "taking the workload";
/// Megabytes over a bad line.
const TIMEOUT: Duration = Duration::from_secs(600);

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
pub enum NotInstalled {
    /// It is no machine that there is a workload for.
    #[error(transparent)]
    Machine(#[from] UnknownMachine),
    /// The workload for it is not there.
    #[error(transparent)]
    Workload(#[from] NoWorkload),
    /// It answered something else.
    #[error("it answered `{0}` where its system, machine and state directory were asked for")]
    Answer(String),
    /// A script failed.
    #[error("{0}")]
    Said(String),
}

impl NotInstalled {
    /// What to do about it.
    #[must_use]
    pub fn hint(&self) -> Option<String> {
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

/// A program as it is on a host.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Installed {
    /// Its file there.
    pub file: PathBuf,
    /// Its SHA-256, in hexadecimal.
    pub sha256: String,
}

/// What reads scripts on a host.
#[derive(Clone, Copy)]
pub enum Shell<'a> {
    /// With all the surroundings that a login has: they say where files belong.
    Login(&'a SshHost),
    /// With those of any program.
    Plain(&'a dyn Host),
}

impl Shell<'_> {
    fn host(&self) -> &str {
        match self {
            Self::Login(host) => host.name(),
            Self::Plain(host) => host.name(),
        }
    }

    /// What a script says that has to succeed. It has these as `$1`, `$2`, …
    ///
    /// # Errors
    /// When the host cannot be reached, or the script fails.
    pub async fn run(&self, script: &str, arguments: &[&str], input: &[u8]) -> Result<String, HostError> {
        let (exit, said) = match self {
            Self::Login(host) => {
                let starting = host.start_line(script_line(script, arguments));
                answer(host.name(), TAKING, starting, input, TIMEOUT).await?
            }
            Self::Plain(host) => {
                let words = ["-c", script, "sh"].into_iter().chain(arguments.iter().copied());
                let program = Program::new("sh", words);
                answer(host.name(), TAKING, host.start(&program), input, TIMEOUT).await?
            }
        };
        if exit.success() {
            return Ok(String::from_utf8_lossy(&said).into_owned());
        }
        let why = match exit.last_words.trim() {
            "" => format!("a script ended with {:?} and said nothing", exit.code),
            words => words.to_owned(),
        };
        Err(self.refused(NotInstalled::Said(why)))
    }

    /// Puts a program into a folder, under a name with its hash, if it is not there yet.
    ///
    /// # Errors
    /// When the host cannot be reached or refuses.
    pub async fn install(&self, folder: &Path, kind: &str, program: &[u8]) -> Result<Installed, HostError> {
        let sha256 = workload_binary::hash_of(program);
        let name = format!("{kind}-{}", sha256.get(..16).unwrap_or_default());
        let file = folder.join(&name);
        let there = self.run(HASH, &[&text(&file)], &[]).await?;
        if there.split_whitespace().next() != Some(&sha256) {
            self.run(PUT, &[&text(folder), &name, &sha256], program).await?;
        }
        Ok(Installed { file, sha256 })
    }

    /// The error of a host that gets no program.
    pub fn refused(&self, error: NotInstalled) -> HostError {
        let (host, hint) = (self.host().to_owned(), error.hint());
        match error {
            NotInstalled::Machine(_) | NotInstalled::Workload(_) => HostError::NoWorkload {
                host,
                hint,
                source: Cause::from(error),
            },
            NotInstalled::Answer(_) | NotInstalled::Said(_) => HostError::Refused {
                host,
                action: TAKING.to_owned(),
                hint,
                source: Cause::from(error),
            },
        }
    }
}

/// A path that came as text.
fn text(path: &Path) -> String {
    path.to_string_lossy().into_owned()
}
