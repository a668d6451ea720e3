//! What a lost connection costs: pauses, which grow, and at last the wish to go on. The main type is [`Backoff`].

use std::{future::Future, time::Duration};

use tokio::time::Instant;

use super::ProviderError;

const FIRST_PAUSE: Duration = Duration::from_secs(1);
const LONGEST_PAUSE: Duration = Duration::from_secs(30);
/// How long something that was reached once is waited for: a restart of a host or of its network takes minutes.
pub const IN_ALL: Duration = Duration::from_secs(600);

/// With a host or an engine that was reached once and is not now.
#[derive(Debug, Clone)]
pub struct Backoff {
    pause: Duration,
    /// Since when it is lost.
    lost: Option<Instant>,
    /// When it is tried next.
    next: Option<Instant>,
}

impl Default for Backoff {
    fn default() -> Self {
        Self {
            pause: FIRST_PAUSE,
            lost: None,
            next: None,
        }
    }
}

impl Backoff {
    /// Takes notice of an error, after which [`Self::pause`] waits.
    ///
    /// # Errors
    /// The same, when trying again does not help or was tried for long enough.
    pub fn after(&mut self, error: ProviderError) -> Result<(), ProviderError> {
        self.after_at(Instant::now(), error)
    }

    fn after_at(&mut self, now: Instant, error: ProviderError) -> Result<(), ProviderError> {
        let lost = *self.lost.get_or_insert(now);
        if !error.is_passing() || now.duration_since(lost) > IN_ALL {
            return Err(error);
        }
        self.next = Some(now + self.pause);
        self.pause = (self.pause * 2).min(LONGEST_PAUSE);
        Ok(())
    }

    /// Waits until the next try is due. Cancel-safe.
    pub async fn pause(&self) {
        if let Some(next) = self.next {
            tokio::time::sleep_until(next).await;
        }
    }

    /// Takes notice that there is a connection now, which was made at `since`: one that lasts longer than any pause begins
    /// a new count.
    pub fn restore(&mut self, now: Instant, since: Instant) {
        if now.duration_since(since) > LONGEST_PAUSE {
            *self = Self::default();
        }
    }
}

/// Calls again what a lost connection cut, which must be as good as calling it once.
///
/// # Errors
/// What the last call ended with.
pub async fn retried<T, F>(call: impl Fn() -> F) -> Result<T, ProviderError>
where
    F: Future<Output = Result<T, ProviderError>>,
{
    let mut backoff = Backoff::default();
    loop {
        backoff.pause().await;
        match call().await {
            Ok(answer) => return Ok(answer),
            Err(error) => backoff.after(error)?,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lost() -> ProviderError {
        ProviderError::Disconnected {
            platform: "host `there`".to_owned(),
            action: "asking".to_owned(),
            source: "cut".into(),
        }
    }

    /// Tries that all end with a lost connection: when each was made, in seconds after the first.
    fn tries() -> Vec<u64> {
        let mut backoff = Backoff::default();
        let begun = Instant::now();
        let mut now = begun;
        let mut tries = Vec::new();
        loop {
            tries.push(now.duration_since(begun).as_secs());
            if backoff.after_at(now, lost()).is_err() {
                return tries;
            }
            now = backoff.next.unwrap();
        }
    }

    #[test]
    fn pauses_grow_and_a_host_that_stays_away_is_given_up_after_ten_minutes() {
        let tries = tries();
        assert_eq!(tries.get(..8).unwrap(), [0, 1, 3, 7, 15, 31, 61, 91]);
        assert!((600..=630).contains(tries.last().unwrap()), "{tries:?}");
    }

    #[test]
    fn a_no_is_not_asked_again() {
        let no = ProviderError::OutOfOrder { reason: "no" };
        assert!(Backoff::default().after(no).is_err());
    }

    #[test]
    fn a_connection_that_lasted_begins_a_new_count() {
        let mut backoff = Backoff::default();
        let begun = Instant::now();
        backoff.after_at(begun, lost()).unwrap();
        backoff.restore(begun + LONGEST_PAUSE, begun);
        assert!(backoff.lost.is_some(), "it lasted as long as a pause");
        backoff.restore(begun + LONGEST_PAUSE * 2, begun);
        assert!(backoff.lost.is_none() && backoff.next.is_none());
    }
}
