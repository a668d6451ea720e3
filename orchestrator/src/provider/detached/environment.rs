//! A live environment that a agent keeps. The main type is [`DetachedEnvironment`].

use std::{io, path::Path, sync::Arc};

use async_trait::async_trait;
use record::{detached, progress::Progress, run_directory::ClockDrift};
use serde_json::{Map, Value, json};
use tokio::{io::AsyncReadExt as _, net::UnixStream, task::JoinHandle, time::Instant};

use super::{AgentClient, ClockReading, transfer};
use crate::{
    host::{Exit, HostError},
    provider::{
        Ended, Environment, EnvironmentRequest, ProviderError,
        backoff::{Backoff, retried},
        data_folder::Allowance,
        lines::Lines,
    },
};

const FOLLOWING: &str = "following the workload's lines";

/// An environment of a agent, by its name.
pub struct DetachedEnvironment {
    agent: Arc<AgentClient>,
    environment: String,
    allowance: Allowance,
    facts: Map<String, Value>,
    /// Its machine's clock before it measured, or when it was found again.
    clock: ClockReading,
    /// Whether it ran when it was created or found.
    ran: bool,
    following: Option<Following>,
    lines: Lines,
    /// How many bytes of its lines have come: where the next connection goes on.
    received: u64,
    /// Whether these are all there will ever be.
    complete: bool,
    backoff: Backoff,
    last_line: Option<Progress>,
}

/// `workload detached follow`, running.
struct Following {
    stream: UnixStream,
    /// A task, so that waiting for it can be given up and taken up again.
    end: JoinHandle<Result<Exit, HostError>>,
    since: Instant,
}

impl DetachedEnvironment {
    /// That of this request; with what explains it, its machine's clock, and whether its workload runs.
    #[must_use]
    pub fn new(
        agent: Arc<AgentClient>,
        request: &EnvironmentRequest,
        facts: Map<String, Value>,
        clock: ClockReading,
        running: bool,
    ) -> Self {
        Self {
            agent,
            environment: request.environment.clone(),
            allowance: Allowance::of(request),
            facts,
            clock,
            ran: running,
            following: None,
            lines: Lines::default(),
            received: 0,
            complete: false,
            backoff: Backoff::default(),
            last_line: None,
        }
    }

    /// Takes in more of the lines, or notices that there are no more. Cancel-safe: what has come is kept, and a connection
    /// that was being made is made again.
    async fn take_in(&mut self) -> Result<(), ProviderError> {
        self.backoff.pause().await;
        let following = match &mut self.following {
            Some(following) => following,
            none => {
                let running = self.agent.follow(&self.environment, self.received).await?;
                none.insert(Following {
                    stream: running.stream,
                    end: tokio::spawn(running.end.wait()),
                    since: Instant::now(),
                })
            }
        };
        let mut piece = [0_u8; 8192];
        // However the stream ends, the program's end says what that means.
        let read = following.stream.read(&mut piece).await.unwrap_or(0);
        self.backoff.restore(Instant::now(), following.since);
        if read > 0 {
            self.received += read as u64;
            self.lines.push(piece.get(..read).unwrap_or_default());
            return Ok(());
        }
        let end = (&mut following.end).await;
        self.following = None;
        let exit = end.map_err(|error| ProviderError::Disconnected {
            platform: format!("host `{}`", self.agent.host()),
            action: FOLLOWING.to_owned(),
            source: io::Error::other(error).into(),
        })??;
        if !exit.success() {
            return Err(self.agent.refusal(FOLLOWING, &exit));
        }
        self.complete = true;
        Ok(())
    }
}

#[async_trait]
impl Environment for DetachedEnvironment {
    fn facts(&self) -> Map<String, Value> {
        self.facts.clone()
    }

    fn running(&self) -> bool {
        self.ran
    }

    async fn next_progress(&mut self) -> Result<Option<Progress>, ProviderError> {
        loop {
            if let Some(line) = self.lines.next_line()? {
                self.last_line = Some(line.clone());
                return Ok(Some(line));
            }
            if self.complete {
                return Ok(None);
            }
            if let Err(error) = self.take_in().await {
                self.backoff.after(error)?;
            }
        }
    }

    async fn stop(&mut self) -> Result<(), ProviderError> {
        retried(|| self.agent.stop(&self.environment)).await.map(drop)
    }

    async fn ended(&mut self) -> Result<Ended, ProviderError> {
        while self.next_progress().await?.is_some() {}
        let ending = retried(|| self.agent.ending(&self.environment)).await?;
        // Its lines ended before it did: whatever cut them says nothing of the workload.
        if ending.running {
            return Err(ProviderError::Disconnected {
                platform: format!("host `{}`", self.agent.host()),
                action: FOLLOWING.to_owned(),
                source: io::Error::other("the lines ended and the workload did not").into(),
            });
        }
        let ended = match ending.ended {
            Some(detached::Ended::Code(code)) => Ended::by_exit_code(code.into()),
            Some(detached::Ended::Signal(signal)) => Ended::by_signal(signal.into()),
            None => Ended::by_last_line(self.last_line.as_ref()),
        };
        // Windows do not go lost for a fact.
        if let Ok((after, _)) = ClockReading::of(&self.agent).await {
            self.facts
                .insert(ClockDrift::FACT.to_owned(), json!(self.clock.drift_until(&after)));
        }
        Ok(ended.with_last_words(&ending.last_words))
    }

    async fn collect(&mut self, into: &Path) -> Result<(), ProviderError> {
        transfer::collect(&self.agent, &self.environment, into, &self.allowance).await
    }

    async fn discard(self: Box<Self>) -> Result<(), ProviderError> {
        retried(|| self.agent.remove(&self.environment)).await.map(drop)
    }
}
