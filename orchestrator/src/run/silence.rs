//! A workload of which nothing is heard: it stands still, or its host or engine does. The main type is [`Silence`].
//!
//! A workload that measures says how it is each second, so that silence means something.

use std::time::Duration;

use tokio::time::Instant;

use crate::provider::backoff;

/// It is told this long after the last word, and again each time the silence has doubled.
const TOLD_AFTER: Duration = Duration::from_secs(10);
/// What was asked to stop closes its files first.
pub const STOPS_WITHIN: Duration = Duration::from_secs(30);

/// What is to be done when [`Silence::due`] has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// Somebody is to be told how long nothing was heard.
    Tell(Duration),
    /// Nothing will be heard any more.
    GiveUp(Duration),
}

/// The time since the last word.
#[derive(Debug)]
pub struct Silence {
    heard: Instant,
    /// After which silence somebody is told next.
    next: Duration,
    /// After which silence nothing is expected any more.
    timeout: Duration,
}

impl Silence {
    /// From now on.
    #[must_use]
    pub fn since(now: Instant) -> Self {
        Self {
            heard: now,
            next: TOLD_AFTER,
            timeout: backoff::IN_ALL,
        }
    }

    /// How long nothing has been heard.
    #[must_use]
    pub fn lasted(&self, now: Instant) -> Duration {
        now.duration_since(self.heard)
    }

    /// A word was heard; how long it was waited for, if somebody was told so.
    pub fn end(&mut self, now: Instant) -> Option<Duration> {
        let lasted = self.lasted(now);
        let told = self.next > TOLD_AFTER;
        self.heard = now;
        self.next = TOLD_AFTER;
        told.then_some(lasted)
    }

    /// It is asked to stop, and has less time from now on.
    pub fn stop_was_asked(&mut self, now: Instant) {
        self.timeout = self.lasted(now) + STOPS_WITHIN;
    }

    /// When there is something to do if nothing is heard until then.
    #[must_use]
    pub fn due(&self) -> Instant {
        self.heard + self.next.min(self.timeout)
    }

    /// What there is to do then.
    pub fn go_on(&mut self, now: Instant) -> Step {
        let lasted = self.lasted(now);
        if lasted >= self.timeout {
            return Step::GiveUp(lasted);
        }
        self.next *= 2;
        Step::Tell(lasted)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seconds(seconds: u64) -> Duration {
        Duration::from_secs(seconds)
    }

    /// What is done in a silence that does not end, each after how many seconds.
    fn steps(mut silence: Silence) -> Vec<Step> {
        let mut steps = Vec::new();
        loop {
            let step = silence.go_on(silence.due());
            steps.push(step);
            if let Step::GiveUp(_) = step {
                return steps;
            }
        }
    }

    #[test]
    fn a_silence_is_told_after_ten_seconds_and_given_up_after_ten_minutes() {
        let mut expected = [10, 20, 40, 80, 160, 320]
            .map(|after| Step::Tell(seconds(after)))
            .to_vec();
        expected.push(Step::GiveUp(seconds(600)));
        assert_eq!(steps(Silence::since(Instant::now())), expected);
    }

    #[test]
    fn a_workload_that_was_asked_to_stop_has_half_a_minute() {
        let begun = Instant::now();
        let mut silence = Silence::since(begun);
        silence.stop_was_asked(begun + seconds(4));
        let mut expected = [10, 20].map(|after| Step::Tell(seconds(after))).to_vec();
        expected.push(Step::GiveUp(seconds(34)));
        assert_eq!(steps(silence), expected);
    }

    #[test]
    fn the_end_of_a_silence_is_told_to_who_was_told_of_it() {
        let begun = Instant::now();
        let at = |after| begun + seconds(after);
        let mut silence = Silence::since(begun);
        assert_eq!(silence.end(at(9)), None);
        assert_eq!(silence.go_on(at(19)), Step::Tell(seconds(10)));
        assert_eq!(silence.end(at(24)), Some(seconds(15)));
        assert_eq!(silence.due(), at(34));
    }
}
