//! Hosts over SSH. The main type is [`SshHost`].
//!
//! ```text
//! start, connect ──> a thread:  idle link, or a new one  ──>  channel  ──>  pump  ──> idle again
//!                <── a socket, whose other end the pump has
//! ```
//!
//! libssh2 does one thing at a time in a session, so that every stream has a session and a thread of its own. What a
//! stream leaves behind is a link that the next one need not log in for.

mod command_line;
pub(crate) mod configuration;
mod deployment;
mod error;
mod hop;
mod idle;
mod known_hosts;
mod link;
mod login;
mod pump;
mod small_file;
mod terminal;

use std::{
    io,
    os::unix::net::UnixStream as BlockingStream,
    path::PathBuf,
    process,
    sync::{Arc, Mutex, PoisonError},
    thread,
    time::Duration,
};

use async_trait::async_trait;
use record::connection::{Ssh, SshAddress};
use ssh2::{Channel, ErrorCode};
use tokio::{
    net::UnixStream,
    sync::{Semaphore, oneshot},
    time::timeout,
};

pub(super) use self::command_line::of_script as script_line;
pub use self::{
    configuration::SshClient,
    error::{HostKeyProblem, SshError},
    hop::Trust,
};
use self::{hop::Hop, idle::IdleLinks, link::Link, pump::Ended};
use super::{Deployed, Exit, Host, HostError, Listener, Program, ProgramEnd, RunningProgram};
use crate::failure::Cause;

/// How long it may take until a stream is there. Each part of the way has a bound of its own; this one is for an agent
/// that asks its user, and for names that nobody resolves.
const OPENING: Duration = Duration::from_secs(60);
/// How many streams are opened at once: an sshd drops some of those that log in beyond ten (`MaxStartups`).
const AT_ONCE: usize = 4;
/// `LIBSSH2_ERROR_CHANNEL_FAILURE` and `LIBSSH2_ERROR_CHANNEL_REQUEST_DENIED`: the host has answered, and said no.
const REFUSALS: [ErrorCode; 2] = [ErrorCode::Session(-21), ErrorCode::Session(-22)];

/// A machine that is reached over SSH.
pub struct SshHost {
    way: Arc<Way>,
    opening: Arc<Semaphore>,
}

/// How to get there, and what is left of having been there.
struct Way {
    name: String,
    ssh: Ssh,
    trust: Trust,
    client: SshClient,
    /// Through which it is reached, beside what the connection itself names.
    through: Option<Arc<Way>>,
    beat: Duration,
    route: Mutex<Option<Arc<[Hop]>>>,
    idle: IdleLinks,
}

/// What a stream is to be at the other end.
enum Opening {
    Command(String),
    Listener(Listener),
}

/// What an opened stream consists of.
struct Opened {
    stream: UnixStream,
    end: oneshot::Receiver<Result<Exit, HostError>>,
}

impl SshHost {
    /// The host of that name in the matrix file. Nothing is connected before something is asked of it.
    #[must_use]
    pub fn new(name: &str, ssh: Ssh, trust: Trust, client: SshClient) -> Self {
        Self::with_beat(name, ssh, trust, client, pump::BEAT)
    }

    /// A machine that we have just made: with its key, and through this other host.
    pub(super) fn made_by_us(
        name: &str,
        address: SshAddress,
        identity: PathBuf,
        through: Option<&Self>,
    ) -> Self {
        let ssh = Ssh {
            address,
            identity: Some(identity),
            jump: None,
            known_hosts: None,
        };
        // What the user has configured is for hosts of theirs, some of which may well have the same address.
        let client = SshClient {
            configuration: Some("/dev/null".into()),
            agent: None,
            ..SshClient::of_this_user()
        };
        let through = through.map(|host| Arc::clone(&host.way));
        Self::on(Way {
            through,
            ..Way::new(name, ssh, Trust::MadeByUs, client, pump::BEAT)
        })
    }

    /// One that is asked for a sign of life after so much silence, at least 2 s, and given up after four of them.
    #[must_use]
    pub fn with_beat(name: &str, ssh: Ssh, trust: Trust, client: SshClient, beat: Duration) -> Self {
        Self::on(Way::new(name, ssh, trust, client, beat))
    }

    fn on(way: Way) -> Self {
        Self {
            way: Arc::new(way),
            opening: Arc::new(Semaphore::new(AT_ONCE)),
        }
    }

    /// Starts what a line tells the login shell.
    pub(super) async fn start_line(&self, line: String) -> Result<RunningProgram, HostError> {
        let opened = self.open(Opening::Command(line)).await?;
        Ok(RunningProgram {
            stream: opened.stream,
            end: Box::new(SshProgramEnd {
                way: Arc::clone(&self.way),
                end: opened.end,
            }),
        })
    }

    async fn open(&self, opening: Opening) -> Result<Opened, HostError> {
        let too_slow = |_| self.way.unreachable(SshError::TooSlow(OPENING));
        let turn = timeout(OPENING, Arc::clone(&self.opening).acquire_owned())
            .await
            .map_err(too_slow)?;
        let (tell_opened, opened) = oneshot::channel();
        let (tell_end, end) = oneshot::channel();
        let way = Arc::clone(&self.way);
        thread::Builder::new()
            .name(format!("ssh-{}", self.way.name))
            .spawn(move || {
                let there = way.open(&opening);
                drop(turn);
                match there {
                    // Whom it is for may have gone meanwhile.
                    Err(error) => drop(tell_opened.send(Err(error))),
                    Ok((link, channel, near, stream)) => {
                        drop(tell_opened.send(Ok(stream)));
                        way.serve(link, channel, near, tell_end);
                    }
                }
            })
            .map_err(|error| self.way.unreachable(error.into()))?;
        let opened = timeout(OPENING, opened).await.map_err(too_slow)?;
        // A thread that is gone has panicked.
        let stream = opened.map_err(|error| self.way.lost("opening a stream", error.into()))??;
        let stream = stream
            .set_nonblocking(true)
            .and_then(|()| UnixStream::from_std(stream))
            .map_err(|error| self.way.unreachable(error.into()))?;
        Ok(Opened { stream, end })
    }
}

#[async_trait]
impl Host for SshHost {
    fn name(&self) -> &str {
        &self.way.name
    }

    async fn start(&self, program: &Program) -> Result<RunningProgram, HostError> {
        let command = command_line::of_program(program)
            .map_err(|error| self.way.refused(&starting(program), error.into()))?;
        self.start_line(command).await
    }

    async fn connect(&self, listener: &Listener) -> Result<UnixStream, HostError> {
        Ok(self.open(Opening::Listener(listener.clone())).await?.stream)
    }

    async fn deploy(&self) -> Result<Deployed, HostError> {
        deployment::deploy(self).await
    }

    fn terminal(&self, program: &Program) -> process::Command {
        terminal::terminal(&self.way.ssh, program)
    }

    fn machine_behind(&self, name: &str, address: SshAddress, identity: PathBuf) -> Arc<dyn Host> {
        Arc::new(Self::made_by_us(name, address, identity, Some(self)))
    }
}

fn starting(program: &Program) -> String {
    format!("starting {}", program.file.display())
}

impl Way {
    fn new(name: &str, ssh: Ssh, trust: Trust, client: SshClient, beat: Duration) -> Self {
        Self {
            name: name.to_owned(),
            ssh,
            trust,
            client,
            through: None,
            beat,
            route: Mutex::default(),
            idle: IdleLinks::default(),
        }
    }

    /// A channel as it was asked for, on an idle link or a new one, and both ends of the socket that it is to have here.
    fn open(&self, opening: &Opening) -> Result<(Link, Channel, BlockingStream, BlockingStream), HostError> {
        let (near, stream) = BlockingStream::pair().map_err(|error| self.unreachable(error.into()))?;
        let (link, channel) = self.open_channel(opening)?;
        let channel = match opening {
            Opening::Listener(_) => channel,
            Opening::Command(command) => self.execute(channel, command)?,
        };
        Ok((link, channel, near, stream))
    }

    fn open_channel(&self, opening: &Opening) -> Result<(Link, Channel), HostError> {
        if let Some(link) = self.idle.take() {
            match opening.on(&link) {
                Ok(channel) => return Ok((link, channel)),
                Err(error) if is_refusal(&error) => return Err(self.refused(&opening.action(), error.into())),
                // It was cut while nobody used it, and so were the others.
                Err(_) => self.idle.clear(),
            }
        }
        let link = self
            .route()
            .and_then(|route| Link::connect(&route))
            .map_err(|error| self.unreachable(error))?;
        match opening.on(&link) {
            Ok(channel) => Ok((link, channel)),
            Err(error) if is_refusal(&error) => Err(self.refused(&opening.action(), error.into())),
            Err(error) => Err(self.lost(&opening.action(), error.into())),
        }
    }

    fn execute(&self, mut channel: Channel, command: &str) -> Result<Channel, HostError> {
        match channel.exec(command) {
            Ok(()) => Ok(channel),
            Err(error) if is_refusal(&error) => Err(self.refused("starting a program", error.into())),
            Err(error) => Err(self.lost("starting a program", error.into())),
        }
    }

    /// Where the host is; asked for once.
    fn route(&self) -> Result<Arc<[Hop]>, SshError> {
        let mut known = self.route.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(route) = &*known {
            return Ok(Arc::clone(route));
        }
        let before = match &self.through {
            Some(through) => through.route()?.to_vec(),
            None => Vec::new(),
        };
        let own = hop::route(&self.ssh, &self.trust, &self.client)?;
        let route: Arc<[Hop]> = before.into_iter().chain(own).collect();
        *known = Some(Arc::clone(&route));
        Ok(route)
    }

    /// Serves a stream to its end.
    fn serve(
        &self,
        link: Link,
        channel: Channel,
        near: BlockingStream,
        tell_end: oneshot::Sender<Result<Exit, HostError>>,
    ) {
        let ended = pump::pump(&link, channel, near, self.beat, &|| tell_end.is_closed());
        let end = match ended {
            Ok(Ended::There { code, last_words }) => {
                self.idle.put(link);
                Ok(Exit {
                    code,
                    last_words: String::from_utf8_lossy(&last_words).into_owned(),
                })
            }
            Ok(Ended::Here) => {
                self.idle.put(link);
                let dropped = io::Error::other("its stream was dropped before it had ended");
                Err(self.lost("waiting for a program", dropped.into()))
            }
            Err(error) => Err(self.lost("waiting for a program", error.into())),
        };
        // Nobody may want to know.
        drop(tell_end.send(end));
    }

    fn unreachable(&self, error: SshError) -> HostError {
        HostError::Unreachable {
            host: self.name.clone(),
            hint: error.hint(),
            source: error.into(),
        }
    }

    fn refused(&self, action: &str, source: Cause) -> HostError {
        HostError::Refused {
            host: self.name.clone(),
            action: action.to_owned(),
            hint: None,
            source,
        }
    }

    fn lost(&self, action: &str, source: Cause) -> HostError {
        HostError::Disconnected {
            host: self.name.clone(),
            action: action.to_owned(),
            source,
        }
    }
}

impl Opening {
    fn on(&self, link: &Link) -> Result<Channel, ssh2::Error> {
        match self {
            Self::Command(_) => link.program(),
            Self::Listener(Listener::Tcp { host, port }) => link.tcp(host, *port),
            Self::Listener(Listener::Unix(path)) => link.unix(&path.to_string_lossy()),
        }
    }

    fn action(&self) -> String {
        match self {
            Self::Command(_) => "starting a program".to_owned(),
            Self::Listener(Listener::Tcp { host, port }) => format!("connecting to {host}:{port}"),
            Self::Listener(Listener::Unix(path)) => format!("connecting to {}", path.display()),
        }
    }
}

/// Whether the host said no, and the link is as good as before.
fn is_refusal(error: &ssh2::Error) -> bool {
    REFUSALS.contains(&error.code())
}

/// The end of a program over SSH.
struct SshProgramEnd {
    way: Arc<Way>,
    end: oneshot::Receiver<Result<Exit, HostError>>,
}

#[async_trait]
impl ProgramEnd for SshProgramEnd {
    async fn wait(self: Box<Self>) -> Result<Exit, HostError> {
        match self.end.await {
            Ok(end) => end,
            // A thread that is gone has panicked.
            Err(error) => Err(self.way.lost("waiting for a program", error.into())),
        }
    }
}
