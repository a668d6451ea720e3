//! Following what a container's main process says, from its first line, in a task of its own, also beyond a cut of the way
//! to the engine and a restart of the engine. The main type is [`Follower`].

use std::{
    pin::pin,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use bollard::{
    errors::Error,
    query_parameters::{LogsOptionsBuilder, WaitContainerOptionsBuilder},
};
use futures_util::{StreamExt as _, TryStreamExt as _};
use record::progress::Progress;
use tokio::{sync::mpsc, task::JoinHandle, time::Instant};

use super::engine::{Engine, is_missing, translate};
use crate::provider::{ProviderError, backoff::Backoff, lines::Lines};

/// Lines that wait to be taken; beyond that the engine waits, which keeps them in the container's log.
const WAITING_LINES: usize = 64;
/// Between the end of a container's log and the engine's knowing that it has ended.
const TIMEOUT: Duration = Duration::from_secs(10);
/// An engine that removes a container takes a second or two.
const REMOVED_WITHIN: Duration = Duration::from_secs(30);
const ACTION: &str = "following the workload's lines";

/// The lines of one container.
#[derive(Debug)]
pub struct Follower {
    lines: mpsc::Receiver<Result<Progress, ProviderError>>,
    task: JoinHandle<()>,
    broken: bool,
    was_cut: Arc<AtomicBool>,
}

impl Follower {
    /// Begins to follow.
    pub fn of(engine: Engine, container: String) -> Self {
        let (sender, lines) = mpsc::channel(WAITING_LINES);
        let was_cut = Arc::new(AtomicBool::new(false));
        let cut = Arc::clone(&was_cut);
        let task = tokio::spawn(async move {
            if let Err(error) = tell(&engine, &container, &sender, &cut).await {
                // Nobody is there to be told if this fails.
                let _ = sender.send(Err(error)).await;
            }
        });
        Self {
            lines,
            task,
            broken: false,
            was_cut,
        }
    }

    /// Whether the engine was lost for a time.
    pub fn was_cut(&self) -> bool {
        self.was_cut.load(Ordering::Relaxed)
    }

    /// The next line; none when the container has ended and all its lines were taken. Cancel-safe.
    ///
    /// # Errors
    /// When the engine stays away: from then on there are no more lines, though the container may go on.
    pub async fn next(&mut self) -> Result<Option<Progress>, ProviderError> {
        if self.broken {
            return Err(translate(
                ACTION,
                std::io::Error::from(std::io::ErrorKind::NotConnected).into(),
            ));
        }
        let next = self.lines.recv().await.transpose();
        self.broken = next.is_err();
        next
    }
}

impl Drop for Follower {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// Sends every line once; returns when the container has ended.
async fn tell(
    engine: &Engine,
    container: &str,
    sender: &mpsc::Sender<Result<Progress, ProviderError>>,
    was_cut: &AtomicBool,
) -> Result<(), ProviderError> {
    let mut taken = Taken::default();
    loop {
        taken.backoff.pause().await;
        match taken.follow(engine, container, sender).await {
            Ok(()) => return Ok(()),
            Err(error) => engine.after(&mut taken.backoff, error)?,
        }
        was_cut.store(true, Ordering::Relaxed);
    }
}

/// What was taken in of a container's log, over however many connections.
#[derive(Default)]
struct Taken {
    lines: Lines,
    bytes: usize,
    backoff: Backoff,
}

impl Taken {
    /// Follows the log until the container has ended. An engine hands a log out from its beginning, or from a moment that
    /// several lines may share; so from its beginning, and what was taken before is left out.
    async fn follow(
        &mut self,
        engine: &Engine,
        container: &str,
        sender: &mpsc::Sender<Result<Progress, ProviderError>>,
    ) -> Result<(), ProviderError> {
        let options = LogsOptionsBuilder::default()
            .follow(true)
            .stdout(true)
            .tail("all")
            .build();
        let since = Instant::now();
        let mut known = self.bytes;
        let (api, allowance) = engine.to_follow().map_err(|error| translate(ACTION, error))?;
        let mut pieces = pin!(api.logs(container, Some(options)));
        while let Some(piece) = pieces
            .try_next()
            .await
            .map_err(|error| translate(ACTION, error))?
        {
            allowance.renew();
            self.backoff.restore(Instant::now(), since);
            let piece = piece.into_bytes();
            let (before, new) = piece.split_at(known.min(piece.len()));
            known -= before.len();
            self.bytes += new.len();
            self.lines.push(new);
            while let Some(line) = self.lines.next_line()? {
                if sender.send(Ok(line)).await.is_err() {
                    return Ok(());
                }
            }
        }
        // The log also ends when the engine does: only the container's own end is the end of its lines.
        match tokio::time::timeout(TIMEOUT, until_ended(engine, container)).await {
            Ok(ended) => ended,
            Err(_) => Err(translate(
                ACTION,
                std::io::Error::from(std::io::ErrorKind::UnexpectedEof).into(),
            )),
        }
    }
}

/// Waits until a container does not run, or not any more.
///
/// # Errors
/// When the engine stops answering.
pub async fn until_ended(engine: &Engine, container: &str) -> Result<(), ProviderError> {
    wait(engine, container, "not-running")
        .await
        .map_err(|error| translate("waiting for the container's end", error))
}

/// Waits until a container that somebody is removing is gone.
///
/// # Errors
/// When the engine stops answering, or does not remove it in time.
pub async fn until_removed(engine: &Engine, container: &str) -> Result<(), ProviderError> {
    let action = "waiting for a container that somebody is removing";
    match tokio::time::timeout(REMOVED_WITHIN, wait(engine, container, "removed")).await {
        Ok(Err(error)) if !is_missing(&error) => Err(translate(action, error)),
        Ok(_) => Ok(()),
        Err(_) => Err(ProviderError::TimedOut {
            action: action.to_owned(),
            after: REMOVED_WITHIN,
        }),
    }
}

async fn wait(engine: &Engine, container: &str, condition: &str) -> Result<(), Error> {
    let options = WaitContainerOptionsBuilder::default()
        .condition(condition)
        .build();
    let mut answers = pin!(engine.api.wait_container(container, Some(options)));
    match answers.next().await {
        // bollard makes an error of an exit code that is not 0.
        Some(Ok(_) | Err(Error::DockerContainerWaitError { .. })) => Ok(()),
        Some(Err(error)) => Err(error),
        None => Err(std::io::Error::from(std::io::ErrorKind::UnexpectedEof).into()),
    }
}
