//! The lease of a host: one `matrix` at a time measures there, whichever machine it was started on. The main type is
//! [`HostLease`].
//!
//! ```text
//! HostLease ── workload detached lease ──> flock(2) on a file of the host's
//!              asks, beats, comes back after a cut
//! ```
//!
//! The lease is a program on the host that ends with its connection, so that the kernel gives the lease back whatever
//! becomes of us. After a cut the program comes back with the same token and takes over from its older self.

use std::{sync::Arc, time::Duration};

use futures_util::StreamExt as _;
use record::{
    call::{Detached, Lease},
    detached::{Failure, LeaseAnswer, LeaseRequest},
    quantity::TimeSpan,
};
use serde_json::{Map, Value};
use tokio::{
    io::AsyncWriteExt as _,
    net::unix::{OwnedReadHalf, OwnedWriteHalf},
    sync::{oneshot, watch},
    task::JoinHandle,
    time::{Instant, interval, sleep, timeout},
};
use tokio_util::codec::{FramedRead, LinesCodec};

use super::{Host, HostError, Program, ProgramEnd};
use crate::lease::Holder;

/// How long the host believes in a holder that says nothing. A cut that lasts longer gives the host to the next.
const BEAT: TimeSpan = TimeSpan::from_secs(5 * 60);
/// How often the host hears from us: twice may be lost.
const SAY: Duration = Duration::from_secs(90);
/// How long a lease that is given back may take to be free.
const GIVING_BACK: Duration = Duration::from_secs(5);
const FIRST_PAUSE: Duration = Duration::from_secs(1);
const LONGEST_PAUSE: Duration = Duration::from_secs(30);
const ACTION: &str = "leasing the host";

/// Where an asked lease stands.
#[derive(Debug, Clone)]
enum Standing {
    /// The host has not answered, or is out of reach for now.
    Asked,
    /// Another has it.
    Held(String),
    /// It is ours.
    Granted,
}

/// What is known of a lease that was asked for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Answer {
    /// It is ours.
    Granted,
    /// This holder has it, as it wishes to be called.
    HeldBy(String),
}

/// A host's lease, from when it is asked for until it is given back or dropped.
#[derive(Debug)]
pub struct HostLease {
    host: String,
    standing: watch::Receiver<Standing>,
    /// Whether it was told who has it.
    told: bool,
    give_back: oneshot::Sender<()>,
    keeping: JoinHandle<Option<HostError>>,
}

impl HostLease {
    /// Asks for it. Who comes back with the token of one who still has it takes over from them.
    #[must_use]
    pub fn ask(host: Arc<dyn Host>, token: &str, holder: &Holder) -> Self {
        let (tell, standing) = watch::channel(Standing::Asked);
        let (give_back, given_back) = oneshot::channel();
        let name = host.name().to_owned();
        Self {
            host: name,
            standing,
            told: false,
            give_back,
            keeping: tokio::spawn(keep(host, request(token, holder), tell, given_back)),
        }
    }

    /// Waits until it is ours, or another is known to have it. That is told once: called again, it waits until it is
    /// ours. Cancel-safe.
    ///
    /// # Errors
    /// When the host cannot be asked. Asking with a new lease may help then.
    pub async fn answer(&mut self) -> Result<Answer, HostError> {
        let told = self.told;
        let settled = |standing: &Standing| match standing {
            Standing::Asked => false,
            Standing::Held(_) => !told,
            Standing::Granted => true,
        };
        let standing = self.standing.wait_for(settled).await.map(|it| it.clone());
        match standing {
            Ok(Standing::Held(holder)) => {
                self.told = true;
                Ok(Answer::HeldBy(holder))
            }
            Ok(Standing::Granted | Standing::Asked) => Ok(Answer::Granted),
            Err(_) => Err(self.why_it_ended().await),
        }
    }

    async fn why_it_ended(&mut self) -> HostError {
        match (&mut self.keeping).await {
            Ok(Some(error)) => error,
            // It ends without one only when it is given back.
            Ok(None) | Err(_) => disconnected(&self.host),
        }
    }

    /// Gives it back, and waits until the next can have it.
    pub async fn give_back(self) {
        let _ = self.give_back.send(());
        // Beyond that it ends with our connection.
        let _ = timeout(GIVING_BACK, self.keeping).await;
    }
}

/// Whether somebody has a host's lease now.
///
/// # Errors
/// When the host cannot be asked.
pub async fn is_held(host: &dyn Host) -> Result<bool, HostError> {
    let nobody = LeaseRequest {
        token: format!("look-{}-{}", std::process::id(), crate::journal::now()),
        holder: Map::new(),
    };
    let mut link = Link::open(host, &nobody).await?;
    let Some(answer) = link.answer().await else {
        return Err(link.ended(host).await);
    };
    link.close().await;
    Ok(matches!(answer, LeaseAnswer::Held { .. }))
}

fn request(token: &str, holder: &Holder) -> LeaseRequest {
    let holder = match serde_json::to_value(holder) {
        Ok(Value::Object(holder)) => holder,
        _ => Map::new(),
    };
    LeaseRequest {
        token: token.to_owned(),
        holder,
    }
}

/// Has the lease until it is given back. A host that was reached once is asked again for as long as it takes: it may be
/// out of reach while windows are measured there.
async fn keep(
    host: Arc<dyn Host>,
    request: LeaseRequest,
    tell: watch::Sender<Standing>,
    mut given_back: oneshot::Receiver<()>,
) -> Option<HostError> {
    let mut pause = FIRST_PAUSE;
    let mut was_reached = false;
    loop {
        let begun = Instant::now();
        let opened = tokio::select! {
            opened = Link::open(host.as_ref(), &request) => opened,
            _ = &mut given_back => return None,
        };
        let error = match opened {
            Ok(mut link) => {
                tokio::select! {
                    answered = link.hold(&tell) => was_reached |= answered,
                    _ = &mut given_back => {
                        link.close().await;
                        return None;
                    }
                }
                link.ended(host.as_ref()).await
            }
            Err(error) => error,
        };
        if !was_reached || !may_pass(&error) {
            return Some(error);
        }
        tell.send_replace(Standing::Asked);
        if begun.elapsed() > LONGEST_PAUSE {
            pause = FIRST_PAUSE;
        }
        tokio::select! {
            () = sleep(pause) => {}
            _ = &mut given_back => return None,
        }
        pause = (pause * 2).min(LONGEST_PAUSE);
    }
}

fn may_pass(error: &HostError) -> bool {
    error.is_passing() || matches!(error, HostError::Unreachable { .. })
}

/// A holder as it wishes to be called.
fn named(held: Option<Map<String, Value>>) -> String {
    let holder = held.and_then(|held| serde_json::from_value::<Holder>(Value::Object(held)).ok());
    holder.map_or_else(|| "another process".to_owned(), |holder| holder.to_string())
}

/// A line with a holder is a few hundred bytes.
const LONGEST_ANSWER: usize = 64 << 10;

type Answers = FramedRead<OwnedReadHalf, LinesCodec>;

/// `workload detached lease`, running on a host.
struct Link {
    input: OwnedWriteHalf,
    lines: Answers,
    end: Box<dyn ProgramEnd>,
}

impl Link {
    async fn open(host: &dyn Host, request: &LeaseRequest) -> Result<Self, HostError> {
        let deployed = host.deploy().await?;
        let call = Detached::Lease(Lease {
            path: deployed.lease.clone(),
            beat: BEAT,
        });
        let program = Program::new(&deployed.program, call.arguments());
        let running = host.start(&program).await?;
        let (output, mut input) = running.stream.into_split();
        let mut line = serde_json::to_vec(request).unwrap_or_default();
        line.push(b'\n');
        // One that cannot be told anything has ended, and says why.
        let _ = input.write_all(&line).await;
        Ok(Self {
            input,
            lines: FramedRead::new(output, LinesCodec::new_with_max_length(LONGEST_ANSWER)),
            end: running.end,
        })
    }

    /// Passes on what it says and keeps it alive, until it ends; whether it ever answered.
    async fn hold(&mut self, tell: &watch::Sender<Standing>) -> bool {
        let mut beat = interval(SAY);
        let mut answered = false;
        loop {
            tokio::select! {
                answer = next(&mut self.lines) => {
                    let standing = match answer {
                        Some(LeaseAnswer::Granted { .. }) => Standing::Granted,
                        Some(LeaseAnswer::Held { held }) => Standing::Held(named(held)),
                        None => return answered,
                    };
                    answered = true;
                    tell.send_replace(standing);
                }
                // What cannot be said is noticed where the answer is awaited.
                _ = beat.tick() => drop(self.input.write_all(b"\n").await),
            }
        }
    }

    async fn answer(&mut self) -> Option<LeaseAnswer> {
        next(&mut self.lines).await
    }

    /// Ends the program and waits until it has ended.
    async fn close(mut self) {
        // The end of its input is its end.
        let _ = self.input.shutdown().await;
        let _ = self.end.wait().await;
    }

    /// What the end of the program means that should not have ended.
    async fn ended(self, host: &dyn Host) -> HostError {
        let exit = match self.end.wait().await {
            Ok(exit) => exit,
            Err(error) => return error,
        };
        let words = exit.last_words.trim();
        let last_line = words.lines().next_back().unwrap_or_default();
        let (hint, source) = match (exit.code, serde_json::from_str::<Failure>(last_line)) {
            (Some(1..), Ok(failure)) => (failure.hint, failure.error),
            (Some(code @ 1..), Err(_)) => {
                (None, format!("the workload ended with exit code {code}: {words}"))
            }
            // It ends with 0 when its input has ended, which was not our doing; and somebody may have killed it.
            _ => return disconnected(host.name()),
        };
        HostError::Refused {
            host: host.name().to_owned(),
            action: ACTION.to_owned(),
            hint: hint.or_else(|| Some("set MATRIX_LEASE there to a file that you may write to".to_owned())),
            source: source.into(),
        }
    }
}

/// The next answer; none where it says no more, or what no workload says. Cancel-safe.
async fn next(lines: &mut Answers) -> Option<LeaseAnswer> {
    let line = lines.next().await?.ok()?;
    serde_json::from_str(&line).ok()
}

fn disconnected(host: &str) -> HostError {
    HostError::Disconnected {
        host: host.to_owned(),
        action: ACTION.to_owned(),
        source: "the program that holds the lease has ended".into(),
    }
}
