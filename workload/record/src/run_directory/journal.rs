//! `events.jsonl`: what happened, one line an event, appended and synced before the thing it announces is done. The main
//! types are [`Event`], [`JournalEntry`] and [`Journal`].
//!
//! Intent comes before effect: [`Event::EnvironmentCreating`] names every resource before it exists, so that whatever
//! a crash leaves behind can be found. Nothing else knows the state of a run.

use std::io::{BufRead as _, BufReader, Read as _};

use serde::{Deserialize, Serialize};

use super::{
    Chain, Place,
    chain::Changed,
    reading::{ReadError, from_json, values_in},
};
use crate::{
    name::name,
    progress::Progress,
    reason,
    window::{Impossible, Verdict},
};

/// One line of the journal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JournalEntry {
    /// When, RFC 3339 with microseconds, UTC; of runs of earlier versions, with milliseconds.
    pub at: String,
    /// What happened.
    #[serde(flatten)]
    pub event: Event,
}

impl JournalEntry {
    /// What happened at that time. Of words that are another machine's, or a workload's, it has as much as is kept of a
    /// [reason](crate::reason).
    #[must_use]
    pub fn new(at: String, mut event: Event) -> Self {
        event.shorten();
        Self { at, event }
    }
}

/// What happened. Scenarios are named by their slug, which is their identity everywhere.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "kebab-case")]
pub enum Event {
    /// A process began to work on the run, first or after an interruption.
    RunStarted {
        /// Its process number.
        pid: u32,
        /// Whether this goes on with an earlier start.
        resumed: bool,
        /// SHA-256 of `manifest.json`, in hexadecimal; none in runs of earlier versions.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        manifest_sha256: Option<String>,
        /// That of `plan.json`.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        plan_sha256: Option<String>,
    },
    /// The host is held by another; waiting for it.
    HostBusy {
        /// The host.
        host: String,
        /// Who holds it, since when.
        holder: String,
    },
    /// Work on a scenario began: of several rounds, on its environment of one.
    ScenarioStarted {
        /// The scenario.
        #[serde(deserialize_with = "name")]
        scenario: String,
        /// The windows that are still wanted.
        windows: Vec<u32>,
        /// The round of its environment, from 1; none where each scenario has one environment.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        round: Option<u32>,
    },
    /// An environment and its resources are about to be created.
    EnvironmentCreating {
        /// The scenario.
        #[serde(deserialize_with = "name")]
        scenario: String,
        /// The environment's name; unique for ever.
        #[serde(deserialize_with = "name")]
        environment: String,
        /// The provider.
        provider: String,
        /// The windows it is to measure.
        windows: Vec<u32>,
        /// The round of its environment, from 1; none where each scenario has one environment.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        round: Option<u32>,
        /// All that will be created.
        resources: Vec<Resource>,
    },
    /// The environment exists and the workload was started in it.
    EnvironmentCreated {
        /// The scenario.
        #[serde(deserialize_with = "name")]
        scenario: String,
        /// The environment.
        #[serde(deserialize_with = "name")]
        environment: String,
        /// What the provider knows of it: engine version, image digest, …
        facts: serde_json::Map<String, serde_json::Value>,
    },
    /// The job of an environment stands so in its batch system now.
    JobChanged {
        /// The scenario.
        #[serde(deserialize_with = "name")]
        scenario: String,
        /// The environment.
        #[serde(deserialize_with = "name")]
        environment: String,
        /// Where it stands.
        #[serde(flatten)]
        standing: JobStanding,
    },
    /// An environment that an earlier process left was found again.
    EnvironmentFound {
        /// The scenario.
        #[serde(deserialize_with = "name")]
        scenario: String,
        /// The environment.
        #[serde(deserialize_with = "name")]
        environment: String,
        /// Whether its workload still runs.
        running: bool,
    },
    /// What the workload said. `Health` and `Notice` go to those who watch, not into the journal.
    Workload {
        /// The scenario.
        #[serde(deserialize_with = "name")]
        scenario: String,
        /// Its line.
        progress: Progress,
    },
    /// Nothing was heard of a workload that says how it is each second: it stands still, or its host or engine does.
    WorkloadSilent {
        /// The scenario.
        #[serde(deserialize_with = "name")]
        scenario: String,
        /// For how long, in seconds.
        for_s: u64,
    },
    /// It was heard of again.
    WorkloadHeard {
        /// The scenario.
        #[serde(deserialize_with = "name")]
        scenario: String,
        /// After how long, in seconds.
        after_s: u64,
    },
    /// What the environment was is about to be written to the scenario's `environment.json`.
    EnvironmentRecorded {
        /// The scenario.
        #[serde(deserialize_with = "name")]
        scenario: String,
        /// The environment.
        #[serde(deserialize_with = "name")]
        environment: String,
        /// The file's SHA-256, in hexadecimal.
        sha256: String,
    },
    /// A window is in the run directory, whole and verified.
    WindowCollected {
        /// The scenario.
        #[serde(deserialize_with = "name")]
        scenario: String,
        /// The environment that measured it.
        #[serde(deserialize_with = "name")]
        environment: String,
        /// Its number.
        window: u32,
        /// What it is worth.
        verdict: Verdict,
        /// SHA-256 of its `window.json` as it is in the run directory, in hexadecimal; none in runs of earlier versions.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        sha256: Option<String>,
    },
    /// A window broke; what there is of it is kept aside and never counted.
    WindowBroken {
        /// The scenario.
        #[serde(deserialize_with = "name")]
        scenario: String,
        /// The environment that measured it.
        #[serde(deserialize_with = "name")]
        environment: String,
        /// Its number.
        window: u32,
        /// The reason, as reports print it.
        reason: String,
    },
    /// The environment's resources are about to be removed.
    EnvironmentDiscarding {
        /// The scenario.
        #[serde(deserialize_with = "name")]
        scenario: String,
        /// The environment.
        #[serde(deserialize_with = "name")]
        environment: String,
    },
    /// None of the environment's resources is left.
    EnvironmentDiscarded {
        /// The scenario.
        #[serde(deserialize_with = "name")]
        scenario: String,
        /// The environment.
        #[serde(deserialize_with = "name")]
        environment: String,
    },
    /// The environment stays, as it was wished: for `matrix shell`, until `matrix clean`.
    EnvironmentKept {
        /// The scenario.
        #[serde(deserialize_with = "name")]
        scenario: String,
        /// The environment.
        #[serde(deserialize_with = "name")]
        environment: String,
    },
    /// Work on a scenario ended: of several rounds, on its environment of one.
    ScenarioFinished {
        /// The scenario.
        #[serde(deserialize_with = "name")]
        scenario: String,
        /// How the scenario ended.
        outcome: Outcome,
        /// Why, if not completed.
        reason: Option<String>,
        /// What to do about it.
        hint: Option<String>,
        /// The round of its environment, from 1; none where each scenario has one environment.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        round: Option<u32>,
    },
    /// The process that worked on the run left, and jobs of the run go on.
    RunLeft,
    /// All scenarios have an outcome.
    RunFinished,
    /// The run was asked to stop; it can be resumed.
    RunInterrupted,
}

impl Event {
    /// Brings the words that there may be most of to what is kept of a reason.
    fn shorten(&mut self) {
        match self {
            Self::WindowBroken { reason, .. } => reason::shorten(Some(reason)),
            Self::ScenarioFinished { reason, hint, .. } => reason::shorten(reason.iter_mut().chain(hint)),
            Self::Workload { progress, .. } => progress.shorten(),
            _ => {}
        }
    }
}

/// Where a job stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Standing {
    /// It waits for its turn.
    Waits,
    /// It waits for what will never be.
    WaitsForEver,
    /// It runs, or is just beginning or ending.
    Runs,
    /// It has ended, or was taken back.
    Ended,
    /// Its node failed or was taken away; the scenario is none the worse.
    LostItsNode,
}

impl Standing {
    /// Whether it has not ended.
    #[must_use]
    pub const fn is_alive(self) -> bool {
        matches!(self, Self::Waits | Self::WaitsForEver | Self::Runs)
    }
}

/// Where a job stands, with its batch system's own words.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct JobStanding {
    /// Its number.
    pub job: String,
    /// What its state means.
    pub standing: Standing,
    /// The system's word for its state, such as `PENDING`.
    pub state: String,
    /// Why it waits or has ended.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// The node that it runs or ran on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub node: Option<String>,
    /// When it began or may begin, in the cluster's time zone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start: Option<String>,
}

impl JobStanding {
    /// Whether it stands elsewhere later. A forecast alone changes all the time.
    #[must_use]
    pub fn has_changed(&self, later: &Self) -> bool {
        let without_forecast = |it: &Self| Self {
            start: None,
            ..it.clone()
        };
        without_forecast(self) != without_forecast(later)
    }
}

/// How a scenario ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Outcome {
    /// All windows are there.
    Completed,
    /// The workload said that the experiment went wrong.
    Failed,
    /// The infrastructure failed; says nothing of the experiment.
    Errored,
    /// It was asked to stop.
    Interrupted,
}

impl Outcome {
    /// Its name, as the journal has it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Completed => "completed",
            Self::Failed => "failed",
            Self::Errored => "errored",
            Self::Interrupted => "interrupted",
        }
    }
}

/// One thing that exists outside the run directory because of us.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Resource {
    /// The host it is on.
    pub host: String,
    /// What it is: `container`, `volume`, `image`, `process`, `directory`, `machine` or `bridge`.
    pub kind: String,
    /// The name by which the provider finds it.
    pub name: String,
}

/// Two hundred events a scenario of a hundred windows, and a thousand scenarios: a quarter of it.
const LONGEST: u64 = 256 << 20;
/// A line that names ten thousand windows, as many as a scenario may have, is a quarter of it.
const LONGEST_LINE: usize = 256 << 10;
/// Values of such a line, as [`values_in`] counts them.
const MOST_VALUES: usize = 1 << 15;
/// What the entries may take in memory. Those of a thousand scenarios with a hundred windows each take 150 MB.
const MOST_MEMORY: usize = 192 << 20;

/// A journal as it was read.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Journal {
    /// Its entries, in the order they were written.
    pub entries: Vec<JournalEntry>,
    /// The numbers of lines that a crash cut, from 1. What they were to announce had not been done.
    pub cut_lines: Vec<usize>,
    /// The checksums of the lines that are entries: the next one goes on from here.
    pub chain: Chain,
}

impl Journal {
    /// Whether all that it says is as it was written: journals of earlier versions do not know.
    #[must_use]
    pub fn is_checked(&self) -> bool {
        self.entries.is_empty() || self.chain.is_checked()
    }

    /// Reads a journal. Lines that a crash cut are the last ones, or followed by a new start, which may have been cut
    /// too: those are left out and remarked.
    ///
    /// # Errors
    /// When the file is missing or cannot be read, another line is not an event, or one is not as it was written.
    pub fn read(place: &Place) -> Result<Self, ReadError> {
        let file = place
            .open_within(LONGEST)
            .map_err(|source| ReadError::io(place, source))?;
        let mut file = BufReader::new(file);
        let mut journal = Self::default();
        let mut unreadable = Vec::new();
        let mut memory = 0;
        let mut text = Vec::new();
        // Line by line: with the text beside them, the entries would take twice as much. By bytes, since a crash may cut a
        // character in two.
        for line in 1.. {
            text.clear();
            let most = LONGEST_LINE as u64 + 1;
            let read = file.by_ref().take(most).read_until(b'\n', &mut text);
            if read.map_err(|source| ReadError::io(place, source))? == 0 {
                break;
            }
            let bytes = text.strip_suffix(b"\n").unwrap_or(&text);
            let values = values_in(bytes);
            let too_many = |field, many| Err(ReadError::impossible(place, Impossible::count(field, many)));
            if bytes.len() > LONGEST_LINE {
                return too_many("bytes of a line", bytes.len());
            }
            if values > MOST_VALUES {
                return too_many("values of a line", values);
            }
            if bytes.trim_ascii().is_empty() {
                continue;
            }
            // The checksum is of the line, and is looked at below.
            let entry = from_json(bytes).map(|JournalEntry { at, event }| JournalEntry::new(at, event));
            let per_value = match &entry {
                // Facts are values of any kind.
                Ok(entry) if matches!(entry.event, Event::EnvironmentCreated { .. }) => 256,
                _ => 24,
            };
            memory += size_of::<JournalEntry>() + bytes.len() + per_value * values;
            if memory > MOST_MEMORY {
                return too_many("lines", line);
            }
            match entry {
                Err(source) => unreadable.push((line, source)),
                Ok(entry) => {
                    let begins = matches!(entry.event, Event::RunStarted { .. });
                    let mut cut = unreadable.drain(..);
                    if let Some((line, source)) = cut.next() {
                        if !begins {
                            return Err(ReadError::Journal {
                                path: place.path(),
                                line,
                                source,
                            });
                        }
                        journal.cut_lines.push(line);
                    }
                    journal.cut_lines.extend(cut.map(|(line, _)| line));
                    let followed = journal.chain.follow(bytes);
                    followed.map_err(|Changed| ReadError::Damaged {
                        path: place.path(),
                        how: format!("line {line}, or one before it, is not as it was written"),
                    })?;
                    journal.entries.push(entry);
                }
            }
        }
        journal.cut_lines.extend(unreadable.iter().map(|(line, _)| line));
        Ok(journal)
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use rstest::rstest;

    use super::*;

    const STARTED: &str = r#"{"at":"2026-11-21T04:00:00.000Z","event":"run-started","pid":7,"resumed":true}"#;
    const INTERRUPTED: &str = r#"{"at":"2026-11-21T04:00:01.000Z","event":"run-interrupted"}"#;
    const CUT: &str = r#"{"at":"2026-11-21T04:00:02.000Z","event":"run-fin"#;

    fn read(lines: &[&str]) -> Result<Journal, ReadError> {
        let folder = tempfile::tempdir().unwrap();
        let place = Place::root(folder.path()).join("events.jsonl");
        fs::write(place.path(), lines.join("\n")).unwrap();
        Journal::read(&place)
    }

    #[rstest]
    #[case(&[STARTED, INTERRUPTED], 2, &[])]
    #[case(&[STARTED, CUT], 1, &[2])]
    #[case(&[STARTED, CUT, ""], 1, &[2])]
    #[case(&[STARTED, CUT, STARTED, INTERRUPTED, CUT], 3, &[2, 5])]
    #[case(&[STARTED, CUT, CUT], 1, &[2, 3])]
    #[case(&[STARTED, CUT, CUT, STARTED, INTERRUPTED], 3, &[2, 3])]
    #[case(&[], 0, &[])]
    fn a_line_that_a_crash_cut_is_left_out_and_remarked(
        #[case] lines: &[&str],
        #[case] entries: usize,
        #[case] cut: &[usize],
    ) {
        let journal = read(lines).unwrap();
        assert_eq!(
            (journal.entries.len(), journal.cut_lines.as_slice()),
            (entries, cut)
        );
    }

    #[rstest]
    #[case(&[STARTED, CUT, INTERRUPTED], 2)]
    #[case(&[STARTED, CUT, CUT, INTERRUPTED], 2)]
    #[case(&["not json", INTERRUPTED], 1)]
    #[case(&[STARTED, r#"{"at":"x","event":"of-the-future"}"#, INTERRUPTED], 2)]
    fn garbage_in_the_midst_is_an_error_with_its_line(#[case] lines: &[&str], #[case] wrong: usize) {
        let Err(ReadError::Journal { line, .. }) = read(lines) else {
            panic!("expected a journal error")
        };
        assert_eq!(line, wrong);
    }

    #[test]
    fn a_journal_of_more_short_lines_than_any_run_has_is_refused() {
        let line = r#"{"at":"","event":"run-finished"}"#;
        let error = read(&vec![line; 2_000_000]).unwrap_err();
        assert!(matches!(error, ReadError::Impossible { .. }), "{error:?}");
        // Of a thousand scenarios with a hundred windows each, and as long as real ones.
        let window = r#"{"at":"2026-11-22T06:20:33.045Z","event":"window-collected","scenario":"x86-64-debian-12-docker-loss-1pct","environment":"matrix-20261122-062012-7030-x86-64-debian-12-docker-loss-1pct-1","window":1,"verdict":"valid","sha256":"709f9bcccc99c1d9ad1f1b822886e8a095677cdf9516345c0cccc140b1d16341"}"#;
        assert_eq!(read(&vec![window; 220_000]).unwrap().entries.len(), 220_000);
    }

    #[test]
    fn a_journal_of_lines_that_are_no_events_is_refused_before_they_fill_the_memory() {
        let error = read(&vec!["x"; 3_000_000]).unwrap_err();
        assert!(matches!(error, ReadError::Impossible { .. }), "{error:?}");
    }

    #[rstest]
    #[case::values(format!("[{}]", vec![r#"{"":0}"#; 20_000].join(",")))]
    #[case::text(format!("\"{}\"", "x".repeat(LONGEST_LINE)))]
    fn a_line_with_more_than_any_event_has_is_refused(#[case] fact: String) {
        let created = |fact: &str| {
            format!(
                r#"{{"at":"2026-11-21T04:00:00.000Z","event":"environment-created","scenario":"a","environment":"a-1","facts":{{"z":{fact}}}}}"#
            )
        };
        assert_eq!(read(&[STARTED, &created("1")]).unwrap().entries.len(), 2);
        let error = read(&[STARTED, &created(&fact)]).unwrap_err();
        assert!(matches!(error, ReadError::Impossible { .. }), "{error:?}");
    }

    #[test]
    fn facts_of_many_environments_that_fill_the_memory_are_refused() {
        let facts = vec![r#"{"":0}"#; 5_000].join(",");
        let line = format!(
            r#"{{"at":"2026-11-21T04:00:00.000Z","event":"environment-created","scenario":"a","environment":"a-1","facts":{{"z":[{facts}]}}}}"#
        );
        let error = read(&vec![line.as_str(); 100]).unwrap_err();
        assert!(matches!(error, ReadError::Impossible { .. }), "{error:?}");
    }

    #[rstest]
    #[case::of_a_window_that_broke(r#""event":"window-broken","environment":"a-1","window":1"#)]
    #[case::of_a_scenario_that_failed(r#""event":"scenario-finished","outcome":"failed","hint":null"#)]
    fn words_are_bounded_and_their_line_has_its_checksum(#[case] event: &str) {
        let broken = |reason: &str| {
            serde_json::from_str::<JournalEntry>(&format!(
                r#"{{"at":"2026-11-21T04:00:00.000Z",{event},"scenario":"a","reason":"{reason}"}}"#
            ))
            .unwrap()
        };
        let mut chain = Chain::default();
        let mut line = |reason: &str| String::from_utf8(chain.line(&broken(reason)).unwrap()).unwrap();
        let lines = [line(&"r".repeat(100_000)), line("it is cut")];
        let found = read(&[lines[0].trim_end(), lines[1].trim_end()]).unwrap();
        assert!(found.is_checked());
        let reasons = found.entries.iter().map(|entry| match &entry.event {
            Event::WindowBroken { reason, .. } => reason.len(),
            Event::ScenarioFinished { reason, .. } => reason.as_ref().map_or(0, String::len),
            _ => 0,
        });
        assert!(
            reasons.clone().all(|bytes| (1..1100).contains(&bytes)),
            "{:?}",
            reasons.collect::<Vec<_>>()
        );
        assert_eq!(found.entries[1], broken("it is cut"));
    }

    #[test]
    fn a_host_is_as_earlier_versions_called_it() {
        let busy = r#"{"at":"2026-11-21T04:00:00.000Z","event":"host-busy","host":"this machine","holder":"process 7"}"#;
        assert_eq!(read(&[STARTED, busy]).unwrap().entries.len(), 2);
    }

    #[test]
    fn a_missing_journal_is_a_half_written_run() {
        let error = Journal::read(&Place::root("/nowhere").join("events.jsonl")).unwrap_err();
        assert!(matches!(error, ReadError::HalfWritten { .. }));
    }
}
