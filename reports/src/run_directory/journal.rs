//! `events.jsonl`: what happened, one line an event, appended and synced before the thing it announces is done. The main
//! types are [`JournalEntry`] and [`Event`].
//!
//! Intent comes before effect: [`Event::EnvironmentCreating`] names every resource before it exists, so that whatever
//! a crash leaves behind can be found. Nothing else knows the state of a run.

use serde::{Deserialize, Serialize};
use workload::record::{progress::Progress, window::Verdict};

/// One line of the journal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct JournalEntry {
    /// When, RFC 3339 with milliseconds, UTC.
    pub at: String,
    /// What.
    #[serde(flatten)]
    pub event: Event,
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
    },
    /// The host is held by another; waiting for it.
    HostBusy {
        /// The host.
        host: String,
        /// Who holds it, since when.
        holder: String,
    },
    /// Work on a scenario began.
    ScenarioStarted {
        /// The scenario.
        scenario: String,
        /// The windows that are still wanted.
        windows: Vec<u32>,
    },
    /// An environment and its resources are about to be created.
    EnvironmentCreating {
        /// The scenario.
        scenario: String,
        /// The environment's name; unique for ever.
        environment: String,
        /// The provider.
        provider: String,
        /// The windows it is to measure.
        windows: Vec<u32>,
        /// All that will be created.
        resources: Vec<Resource>,
    },
    /// The environment exists and the workload was started in it.
    EnvironmentCreated {
        /// The scenario.
        scenario: String,
        /// The environment.
        environment: String,
        /// What the provider knows of it: engine version, image digest, …
        facts: serde_json::Map<String, serde_json::Value>,
    },
    /// An environment that an earlier process left was found again.
    EnvironmentFound {
        /// The scenario.
        scenario: String,
        /// The environment.
        environment: String,
        /// Whether its workload still runs.
        running: bool,
    },
    /// What the workload said. `Health` goes to those who watch, not into the journal.
    Workload {
        /// The scenario.
        scenario: String,
        /// Its line.
        progress: Progress,
    },
    /// A window is in the run directory, whole and verified.
    WindowCollected {
        /// The scenario.
        scenario: String,
        /// The environment that measured it.
        environment: String,
        /// Its number.
        window: u32,
        /// What it is worth.
        verdict: Verdict,
    },
    /// A window broke; what there is of it is kept aside and never counted.
    WindowBroken {
        /// The scenario.
        scenario: String,
        /// The environment that measured it.
        environment: String,
        /// Its number.
        window: u32,
        /// Why.
        reason: String,
    },
    /// The environment's resources are about to be removed.
    EnvironmentDiscarding {
        /// The scenario.
        scenario: String,
        /// The environment.
        environment: String,
    },
    /// None of the environment's resources is left.
    EnvironmentDiscarded {
        /// The scenario.
        scenario: String,
        /// The environment.
        environment: String,
    },
    /// Work on a scenario ended.
    ScenarioFinished {
        /// The scenario.
        scenario: String,
        /// How.
        outcome: Outcome,
        /// Why, if not completed.
        reason: Option<String>,
        /// What to do about it.
        hint: Option<String>,
    },
    /// All scenarios have an outcome.
    RunFinished,
    /// The run was asked to stop; it can be resumed.
    RunInterrupted,
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

/// One thing that exists outside the run directory because of us.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Resource {
    /// The host it is on.
    pub host: String,
    /// What it is: `container`, `volume`, `image`, `process`, `directory`.
    pub kind: String,
    /// Its name.
    pub name: String,
}
