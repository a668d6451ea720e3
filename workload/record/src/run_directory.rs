//! The run directory: everything one `matrix run` produced, and all that a report needs.
//!
//! ```text
//! runs/<run id>/
//!   manifest.json       what was asked: Manifest
//!   plan.json           every scenario, feasible or not, and the order: PlanRecord
//!   events.jsonl        what happened: one JournalEntry a line
//!   experiment.tar.lz4  the files of a user's experiment, if it has any
//!   scenarios/<slug>/   environment.json, window-1/ … window-4/, broken/…
//!   pruned.json         only if `matrix prune` removed what was measured
//!   report/             written by `reports`
//! ```
//!
//! The orchestrator writes with the types that reports read.
//! The main type is [`RunDirectory`].

// The workload, which is built with an older compiler, has none of this.
#![allow(clippy::incompatible_msrv)]

mod chain;
mod clock_drift;
mod control_trace;
mod environment;
mod facts;
mod journal;
mod lines;
mod log;
mod manifest;
mod number;
mod place;
mod plan;
mod plant_trace;
mod reading;
mod records;
mod state;
mod whole;

use std::{
    io,
    path::{Path, PathBuf},
};

pub use cap_std::fs::OpenOptions;
pub use chain::Chain;
pub use clock_drift::ClockDrift;
pub use control_trace::{ControlTrace, Expected, PeriodError, PeriodPath, SLICES};
pub use environment::{Difference, EnvironmentRecord, RecordedPlatform};
pub use facts::{EngineParts, VagrantBox, fact};
pub use journal::{Event, JobStanding, Journal, JournalEntry, Outcome, Resource, Standing};
pub use log::{Fault, LogError};
pub use manifest::{HostRecord, Manifest, RecordedConnection, Revision};
pub use place::{FileDigest, Kind, Place, Unfinished};
pub use plan::{PlanRecord, PlannedScenario, letter};
pub use plant_trace::PlantTrace;
pub use reading::{
    LONGEST_RECORD, ReadError, from_json, read_environment, read_file, read_record, read_window, values_in,
};
pub use records::RunRecords;
pub use state::{
    BrokenWindow, Collected, MadeEnvironment, OpenEnvironment, RoundState, RunState, ScenarioState,
};
pub use whole::{NotWhole, ensure_file_is_whole, ensure_window_is_whole, read_whole_record};

use crate::layout;

/// Version of the run directory's layout and of the files in it.
pub const FORMAT: u32 = 1;

/// Where things are in a run directory. It only knows names; nothing is opened.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RunDirectory(Place);

impl RunDirectory {
    /// The run directory at `path`.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self(Place::root(path))
    }

    /// One that was found in a folder of run directories, which may be anyone's: it is opened through no link.
    #[must_use]
    pub fn found(place: &Place) -> Self {
        Self(place.as_root())
    }

    /// The same one, not held open: it is opened anew when it is looked at, and must be the same folder then.
    ///
    /// # Errors
    /// When it cannot be opened now.
    pub fn to_reopen(&self) -> io::Result<Self> {
        self.0.to_reopen().map(Self)
    }

    /// The directory itself.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.0.base()
    }

    /// The directory itself, as a place.
    #[must_use]
    pub fn root(&self) -> &Place {
        &self.0
    }

    /// What was asked.
    #[must_use]
    pub fn manifest(&self) -> Place {
        self.0.join("manifest.json")
    }

    /// Every scenario and the order.
    #[must_use]
    pub fn plan(&self) -> Place {
        self.0.join("plan.json")
    }

    /// The journal.
    #[must_use]
    pub fn journal(&self) -> Place {
        self.0.join("events.jsonl")
    }

    /// The files of a user's experiment ([`crate::transfer::files`]), if it has any.
    #[must_use]
    pub fn experiment(&self) -> Place {
        self.0.join("experiment.tar.lz4")
    }

    /// The lock that the process holds which works on this run.
    #[must_use]
    pub fn lock(&self) -> Place {
        self.0.join("lock")
    }

    /// A scenario's folder.
    #[must_use]
    pub fn scenario(&self, slug: &str) -> Place {
        self.0.join("scenarios").join(slug)
    }

    /// What a scenario's platform was.
    #[must_use]
    pub fn environment(&self, slug: &str) -> Place {
        self.scenario(slug).join(layout::ENVIRONMENT)
    }

    /// A window's folder; windows count from 1.
    #[must_use]
    pub fn window(&self, slug: &str, window: u32) -> Place {
        self.scenario(slug).join(layout::window_folder(window))
    }

    /// Where what broke of an environment's windows is kept: never counted, never thrown away.
    #[must_use]
    pub fn broken(&self, slug: &str, environment: &str) -> Place {
        self.scenario(slug).join("broken").join(environment)
    }

    /// What is kept of a run of which `matrix prune` removed what was measured; not there before.
    #[must_use]
    pub fn pruned(&self) -> Place {
        self.0.join("pruned.json")
    }

    /// Where the report goes.
    #[must_use]
    pub fn report(&self) -> Place {
        self.0.join("report")
    }
}
