//! What an environment costs beside its windows, by the journal's stamps. The main function is [`stays`].

use std::collections::{BTreeMap, HashMap};

use record::{
    progress::Progress,
    run_directory::{Event, Journal},
    settings::Settings,
};

/// An environment from the line that announces it until it was gone.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stay {
    /// How long it took, in seconds.
    pub took_s: f64,
    /// How many windows it measured.
    pub windows: usize,
}

impl Stay {
    /// What it took beyond its windows, in seconds: being made, connected, collected and removed.
    #[must_use]
    pub fn overhead_s(&self, settings: &Settings) -> f64 {
        let windows_s = self.windows as f64 * settings.window.as_secs_f64();
        (self.took_s - windows_s).max(0.0)
    }
}

/// The stays of the environments of each scenario, by slug, in the order of their ends. Left out are those that were found again, that
/// were kept or that gave fewer windows than were wanted: they say nothing of what another environment would take.
#[must_use]
pub fn stays(journal: &Journal) -> BTreeMap<String, Vec<Stay>> {
    struct Begun<'a> {
        environment: &'a str,
        at: &'a str,
        wanted: usize,
        complete: usize,
    }
    // Of a scenario one environment is at work at a time.
    let mut begun: HashMap<&str, Begun<'_>> = HashMap::new();
    let mut stays: BTreeMap<String, Vec<Stay>> = BTreeMap::new();
    for entry in &journal.entries {
        match &entry.event {
            Event::EnvironmentCreating {
                scenario,
                environment,
                windows,
                ..
            } => {
                let begin = Begun {
                    environment,
                    at: &entry.at,
                    wanted: windows.len(),
                    complete: 0,
                };
                begun.insert(scenario, begin);
            }
            Event::EnvironmentFound { scenario, .. } => {
                begun.remove(scenario.as_str());
            }
            Event::Workload {
                scenario,
                progress: Progress::WindowComplete { .. },
            } => {
                if let Some(begun) = begun.get_mut(scenario.as_str()) {
                    begun.complete += 1;
                }
            }
            Event::EnvironmentDiscarded {
                scenario,
                environment,
            } => {
                let whole =
                    |begun: &Begun<'_>| begun.environment == environment && begun.complete == begun.wanted;
                if let Some(begun) = begun.remove(scenario.as_str()).filter(whole)
                    && let Some(took_s) = seconds_between(begun.at, &entry.at)
                {
                    let stay = Stay {
                        took_s,
                        windows: begun.wanted,
                    };
                    stays.entry(scenario.clone()).or_default().push(stay);
                }
            }
            _ => {}
        }
    }
    stays
}

/// Of two stamps of the journal, RFC 3339; none where a clock was put back between them.
pub(crate) fn seconds_between(from: &str, to: &str) -> Option<f64> {
    let time = |at: &str| humantime::parse_rfc3339(at).ok();
    let took = time(to)?.duration_since(time(from)?).ok()?;
    Some(took.as_secs_f64())
}

#[cfg(test)]
mod tests {
    use record::{run_directory::JournalEntry, window::Verdict};

    use super::*;

    fn journal(events: Vec<(&str, Event)>) -> Journal {
        let entries = events.into_iter().map(|(second, event)| JournalEntry {
            at: format!("2026-11-24T00:00:{second}.000Z"),
            event,
        });
        Journal {
            entries: entries.collect(),
            ..Journal::default()
        }
    }

    fn creating(environment: &str) -> Event {
        Event::EnvironmentCreating {
            scenario: "s".into(),
            environment: environment.into(),
            provider: "fake".into(),
            windows: vec![1, 2],
            resources: Vec::new(),
            round: None,
        }
    }

    fn complete(window: u32) -> Event {
        Event::Workload {
            scenario: "s".into(),
            progress: Progress::WindowComplete {
                window,
                verdict: Verdict::Valid,
                reason: None,
            },
        }
    }

    fn discarded(environment: &str) -> Event {
        Event::EnvironmentDiscarded {
            scenario: "s".into(),
            environment: environment.into(),
        }
    }

    #[test]
    fn an_environment_that_was_cut_short_says_nothing_of_what_another_would_take() {
        let journal = journal(vec![
            ("00", creating("e-1")),
            ("10", complete(1)),
            ("11", discarded("e-1")),
            ("20", creating("e-2")),
            ("30", complete(1)),
            ("38", complete(2)),
            ("41", discarded("e-2")),
        ]);
        let stay = Stay {
            took_s: 21.0,
            windows: 2,
        };
        assert_eq!(stays(&journal), BTreeMap::from([("s".to_owned(), vec![stay])]));
        let settings = Settings {
            window: record::quantity::TimeSpan::from_secs(8),
            ..Settings::default()
        };
        assert!((stay.overhead_s(&settings) - 5.0).abs() < 1e-9);
    }
}
