//! This machine as a host. The main type is [`Here`].

use std::{
    env,
    io::{self, ErrorKind},
    os::fd::OwnedFd,
    path::PathBuf,
    process::Stdio,
    sync::Arc,
    time::Duration,
};

use async_trait::async_trait;
use record::connection::SshAddress;
use tokio::{
    io::AsyncReadExt as _,
    net::{TcpStream, UnixStream},
    process::{Child, ChildStderr, Command},
    sync::Mutex,
    task::JoinHandle,
    time::sleep,
};

use super::{Deployed, Exit, Host, HostError, Listener, Program, ProgramEnd, RunningProgram, ssh::SshHost};
use crate::{lease, state_directory::StateDirectory, workload_binary};

/// All that a program gets of the surroundings in which `matrix` was started.
const HANDED_ON: [&str; 2] = ["PATH", "HOME"];
/// Of a long complaint the end is kept.
const LAST_WORDS: usize = 64 << 10;
/// How long a program that has ended may still have words on the way. Something that it started may keep its standard
/// error open for ever.
const WORDS_ON_THE_WAY: Duration = Duration::from_secs(1);
/// How long it takes a child from its fork to its exec, and how often that is waited for.
const BUSY: Duration = Duration::from_millis(20);
const MOST_BUSY: u32 = 50;
/// As a shell says that a file is there and is no program.
const NOT_A_PROGRAM: i32 = 126;
/// As a shell says that there is no such program.
const NO_SUCH_PROGRAM: i32 = 127;

/// This machine.
#[derive(Debug, Clone)]
pub struct Here {
    name: String,
    state: StateDirectory,
    lease: PathBuf,
}

impl Here {
    /// Under that name in the matrix file, with what is put on it in this state directory.
    #[must_use]
    pub fn new(name: &str, state: StateDirectory) -> Self {
        Self::leased_at(name, state, lease::of_this_machine())
    }

    /// The same, with a lease of its own.
    #[must_use]
    pub fn leased_at(name: &str, state: StateDirectory, lease: PathBuf) -> Self {
        Self {
            name: name.to_owned(),
            state,
            lease,
        }
    }

    fn refused(&self, action: String, source: io::Error) -> HostError {
        HostError::Refused {
            host: self.name.clone(),
            action,
            hint: None,
            source: source.into(),
        }
    }
}

#[async_trait]
impl Host for Here {
    fn name(&self) -> &str {
        &self.name
    }

    fn is_this_machine(&self) -> bool {
        true
    }

    async fn start(&self, program: &Program) -> Result<RunningProgram, HostError> {
        let refused = |error| self.refused(format!("starting {}", program.file.display()), error);
        let (ours, theirs) = pair().map_err(refused)?;
        let output = theirs.try_clone().map_err(refused)?;
        let mut command = Command::new(&program.file);
        command
            .args(&program.arguments)
            .env_clear()
            .envs(
                HANDED_ON
                    .iter()
                    .filter_map(|name| Some((name, env::var_os(name)?))),
            )
            .current_dir("/")
            // A terminal's Ctrl-C is for us: what is to end then is told so.
            .process_group(0)
            .stdin(Stdio::from(theirs))
            .stdout(Stdio::from(output))
            .stderr(Stdio::piped());
        let mut busy = 0;
        let started = loop {
            match workload_binary::start(|| command.spawn()) {
                // A child that something else in this process has just forked has the file open for writing until its exec.
                Err(error) if error.kind() == ErrorKind::ExecutableFileBusy && busy < MOST_BUSY => {
                    busy += 1;
                    sleep(BUSY).await;
                }
                started => break started,
            }
        };
        let end: Box<dyn ProgramEnd> = match started {
            Ok(mut child) => Box::new(ChildEnd {
                host: self.name.clone(),
                last_words: child.stderr.take().map(LastWords::keep),
                child,
            }),
            Err(error) => Box::new(NeverStarted::of(&error).ok_or(error).map_err(refused)?),
        };
        // The command has the other end of the stream, whose closing is to be seen.
        drop(command);
        Ok(RunningProgram { stream: ours, end })
    }

    async fn connect(&self, listener: &Listener) -> Result<UnixStream, HostError> {
        match listener {
            Listener::Unix(path) => UnixStream::connect(path)
                .await
                .map_err(|error| self.refused(format!("connecting to {}", path.display()), error)),
            Listener::Tcp { host, port } => {
                let refused = |error| self.refused(format!("connecting to {host}:{port}"), error);
                let mut there = TcpStream::connect((host.as_str(), *port))
                    .await
                    .map_err(refused)?;
                there.set_nodelay(true).map_err(refused)?;
                let (ours, mut theirs) = UnixStream::pair().map_err(refused)?;
                // What breaks on one side ends the other: there is nobody else to tell.
                tokio::spawn(async move { tokio::io::copy_bidirectional(&mut theirs, &mut there).await });
                Ok(ours)
            }
        }
    }

    async fn deploy(&self) -> Result<Deployed, HostError> {
        let state = self.state.clone();
        let action = || "writing the workload".to_owned();
        // Megabytes are read and compared: not on a thread that others wait for.
        let installed = tokio::task::spawn_blocking(move || workload_binary::installed(&state))
            .await
            .map_err(|error| self.refused(action(), io::Error::other(error)))?;
        let program = installed.map_err(|error| HostError::Refused {
            host: self.name.clone(),
            action: action(),
            hint: error.hint(),
            source: error.into(),
        })?;
        Ok(Deployed {
            program,
            sha256: workload_binary::sha256().to_owned(),
            environments: self.state.environments(),
            lease: self.lease.clone(),
        })
    }

    fn terminal(&self, program: &Program) -> std::process::Command {
        let mut command = std::process::Command::new(&program.file);
        command.args(&program.arguments);
        command
    }

    fn machine_behind(&self, name: &str, address: SshAddress, identity: PathBuf) -> Arc<dyn Host> {
        Arc::new(SshHost::made_by_us(name, address, identity, None))
    }
}

/// A stream of ours, and what becomes a program's standard input and output, which block as programs expect.
fn pair() -> io::Result<(UnixStream, OwnedFd)> {
    let (ours, theirs) = std::os::unix::net::UnixStream::pair()?;
    ours.set_nonblocking(true)?;
    Ok((UnixStream::from_std(ours)?, theirs.into()))
}

/// The end of a process of ours.
struct ChildEnd {
    host: String,
    child: Child,
    last_words: Option<LastWords>,
}

#[async_trait]
impl ProgramEnd for ChildEnd {
    async fn wait(mut self: Box<Self>) -> Result<Exit, HostError> {
        let status = self.child.wait().await.map_err(|error| HostError::Refused {
            host: self.host.clone(),
            action: "waiting for a program".to_owned(),
            hint: None,
            source: error.into(),
        })?;
        let last_words = match self.last_words.take() {
            Some(words) => words.told().await,
            None => String::new(),
        };
        Ok(Exit {
            code: status.code(),
            last_words,
        })
    }
}

/// The end of what could not be started.
struct NeverStarted(Exit);

impl NeverStarted {
    /// As a shell would say it; none if it would be the machine that refuses.
    fn of(error: &io::Error) -> Option<Self> {
        let code = match error.kind() {
            ErrorKind::NotFound => NO_SUCH_PROGRAM,
            ErrorKind::PermissionDenied => NOT_A_PROGRAM,
            _ => return None,
        };
        Some(Self(Exit {
            code: Some(code),
            last_words: error.to_string(),
        }))
    }
}

#[async_trait]
impl ProgramEnd for NeverStarted {
    async fn wait(self: Box<Self>) -> Result<Exit, HostError> {
        Ok(self.0)
    }
}

/// The end of a standard error, which is read all the time so that its writer never has to wait.
struct LastWords {
    kept: Arc<Mutex<Vec<u8>>>,
    reading: JoinHandle<()>,
}

impl LastWords {
    fn keep(mut errors: ChildStderr) -> Self {
        let kept = Arc::new(Mutex::new(Vec::new()));
        let keeping = Arc::clone(&kept);
        let reading = tokio::spawn(async move {
            let mut piece = vec![0_u8; 8 << 10];
            while let Ok(read @ 1..) = errors.read(&mut piece).await {
                let mut kept = keeping.lock().await;
                kept.extend_from_slice(piece.get(..read).unwrap_or_default());
                let surplus = kept.len().saturating_sub(LAST_WORDS);
                kept.drain(..surplus);
            }
        });
        Self { kept, reading }
    }

    async fn told(mut self) -> String {
        // Whoever else has it open may go on: what is there by now is what the program said.
        let _ = tokio::time::timeout(WORDS_ON_THE_WAY, &mut self.reading).await;
        String::from_utf8_lossy(&self.kept.lock().await).into_owned()
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[tokio::test]
    async fn a_program_that_is_still_open_for_writing_is_started_when_it_is_not_any_more() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("true");
        fs::copy("/bin/true", &file).unwrap();
        let writing = fs::OpenOptions::new().append(true).open(&file).unwrap();
        let here = Here::new("here", StateDirectory::new(folder.path()));
        let program = Program::new(&file, Vec::<String>::new());
        // On one thread: the first try is over before the file is closed.
        let (started, ()) = tokio::join!(here.start(&program), async move { drop(writing) });
        let exit = started.unwrap().end.wait().await.unwrap();
        assert!(exit.success(), "{exit:?}");
    }
}
