//! Follows a workload until it ends: what it says goes into the journal, a silence is told, a stop is passed on.

use std::collections::BTreeSet;

use record::{progress::Progress, run_directory::Event};
use tokio::time::{Instant, sleep_until, timeout};

use super::ScenarioError;
use crate::{
    provider::{Environment, EnvironmentRequest, News, Provider},
    run::{
        Run,
        silence::{self, Silence, Step},
    },
};

/// What a workload said until it ended.
#[derive(Debug, Default)]
pub(super) struct Heard {
    /// Its last word on how it ended, if it had one.
    pub(super) last: Option<Progress>,
    /// The windows that it has completed.
    pub(super) completed: BTreeSet<u32>,
}

/// A workload says some ten things about its network and nodes, and two of each window.
fn most_lines(request: &EnvironmentRequest) -> usize {
    100 + 4 * request.windows.len()
}

impl Run<'_> {
    /// Passes on what the workload says until it ends; its last conclusive line.
    pub(super) async fn follow(
        &self,
        provider: &dyn Provider,
        environment: &mut Box<dyn Environment>,
        request: &EnvironmentRequest,
    ) -> Result<Heard, ScenarioError> {
        let mut heard = Heard::default();
        let mut asked_to_stop = false;
        let mut reconnected = false;
        let mut told = Vec::new();
        let mut silence = Silence::since(Instant::now());
        let scenario = || request.scenario.clone();
        loop {
            let news = tokio::select! {
                news = environment.next_news() => news,
                () = self.stop.requested(), if !asked_to_stop => {
                    asked_to_stop = true;
                    silence.stop_was_asked(Instant::now());
                    match timeout(silence::STOPS_WITHIN, environment.stop()).await {
                        Ok(stopped) => stopped?,
                        Err(_) => return Err(ScenarioError::StandsStill { lasted: silence.lasted(Instant::now()) }),
                    }
                    continue;
                }
                () = sleep_until(silence.due()) => {
                    if environment.may_be_silent() {
                        silence.end(Instant::now());
                        continue;
                    }
                    match silence.go_on(Instant::now()) {
                        Step::Tell(lasted) => self.events.emit(Event::WorkloadSilent {
                            scenario: scenario(),
                            for_s: lasted.as_secs(),
                        })?,
                        Step::GiveUp(lasted) => return Err(ScenarioError::StandsStill { lasted }),
                    }
                    continue;
                }
            };
            if let Ok(Some(_)) = news
                && let Some(lasted) = silence.end(Instant::now())
            {
                self.events.emit(Event::WorkloadHeard {
                    scenario: scenario(),
                    after_s: lasted.as_secs(),
                })?;
            }
            match news {
                Ok(Some(News::Job(standing))) => self.job_changed(request, &standing)?,
                // One that was found again says everything again.
                Ok(Some(News::Workload(progress))) if told.contains(&progress) => {}
                Ok(Some(News::Workload(progress))) => {
                    if progress.is_journaled() {
                        told.push(progress.clone());
                    }
                    // Another machine says it, and the journal keeps it.
                    if told.len() > most_lines(request) {
                        return Err(ScenarioError::SaysTooMuch { lines: told.len() });
                    }
                    self.events.emit(Event::Workload {
                        scenario: scenario(),
                        progress: progress.clone(),
                    })?;
                    match progress {
                        Progress::WindowComplete { window, .. } => {
                            heard.completed.insert(window);
                        }
                        Progress::Finished | Progress::Stopped { .. } | Progress::Failed { .. } => {
                            heard.last = Some(progress);
                        }
                        _ => {}
                    }
                }
                Ok(None) => return Ok(heard),
                // An engine that was restarted forgets its listeners, not its containers: look once more.
                Err(error) if !reconnected => match provider.find(request).await {
                    Ok(Some(found)) => {
                        reconnected = true;
                        *environment = found;
                    }
                    Ok(None) | Err(_) => return Err(error.into()),
                },
                Err(error) => return Err(error.into()),
            }
        }
    }
}
