//! The lines of JSON by which a running workload says where it is, on standard output and in `progress.jsonl`.
//! The main type is [`Progress`].

use serde::{Deserialize, Serialize};

use super::{platform::PlatformChange, window::Verdict};
use crate::{reason, virtual_host::VirtualHost};

/// One of the two nodes that make the loop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Part {
    /// `/plant`.
    Plant,
    /// `/controller`.
    Controller,
}

impl Part {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Plant, Self::Controller];

    /// Where it runs.
    #[must_use]
    pub const fn host(self) -> VirtualHost {
        match self {
            Self::Plant => VirtualHost::STA2,
            Self::Controller => VirtualHost::STA1,
        }
    }

    /// Its name on the command line and in progress.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Plant => "plant",
            Self::Controller => "controller",
        }
    }
}

impl Progress {
    /// Whether it says that the workload lives, which is for who watches now and for no record.
    #[must_use]
    pub const fn is_sign_of_life(&self) -> bool {
        matches!(self, Self::Health { .. } | Self::Running { .. } | Self::Preparing)
    }

    /// Whether it belongs into the journal. Notices come as often as strangers wish, and are in the windows' records.
    #[must_use]
    pub const fn is_journaled(&self) -> bool {
        !self.is_sign_of_life() && !matches!(self, Self::Notice { .. })
    }

    /// Brings its words to what is kept of a [reason](crate::reason).
    pub(crate) fn shorten(&mut self) {
        match self {
            Self::WindowComplete { reason, .. } => reason::shorten(reason),
            Self::Failed { reason, hint, .. } => reason::shorten(hint.iter_mut().chain([reason])),
            Self::Notice { text, .. } => reason::shorten([text]),
            _ => {}
        }
    }
}

/// One line.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "kebab-case")]
pub enum Progress {
    /// The process runs; nothing is set up yet.
    Started {
        /// Its process number, as it sees itself.
        pid: u32,
    },
    /// The virtual hosts are up and linked.
    NetworkUp,
    /// Controller and plant are connected by their topics both ways.
    Connected,
    /// Nothing is measured: master and nodes run until they are told to stop.
    Rehearsing {
        /// The master's address.
        master: String,
        /// Our nodes that run.
        nodes: Vec<Part>,
    },
    /// Something happened between the ROS master or a node and a peer: one came, went or was refused.
    Notice {
        /// The host that says it.
        host: VirtualHost,
        /// In words.
        text: String,
    },
    /// The command that comes before the windows runs; about once a second.
    Preparing,
    /// The first control step of the run has been done, or the first window's command is about to be called.
    Measuring {
        /// The first window's number.
        window: u32,
    },
    /// About once a second while measuring.
    Health {
        /// The window under way.
        window: u32,
        /// Control steps done in it.
        steps_done: u64,
        /// Control steps that it has.
        steps_expected: u64,
        /// Steps of it that missed their deadline so far.
        missed_deadlines: u64,
        /// The latest start of a step since the last line, after it was due.
        worst_lateness_ns: i64,
    },
    /// About once a second while a window's command runs.
    Running {
        /// The window under way.
        window: u32,
        /// For how long its command has been running, in milliseconds.
        elapsed_ms: u64,
    },
    /// A window is on disk, whole, with its `window.json`.
    WindowComplete {
        /// Its number.
        window: u32,
        /// What it is worth.
        verdict: Verdict,
        /// Why, of one that is invalid.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        reason: Option<String>,
    },
    /// After the windows the platform was not what it had been before them.
    PlatformChanged {
        /// What changed.
        changes: Vec<PlatformChange>,
    },
    /// The run ended early because it was asked to; the window under way is marked incomplete.
    Stopped {
        /// The window that was cut.
        window: u32,
    },
    /// All windows are on disk.
    Finished,
    /// The experiment could not go on.
    Failed {
        /// What failed, with its causes.
        reason: String,
        /// What to do about it.
        hint: Option<String>,
        /// True when the platform did not offer what is needed, false when the experiment itself went wrong.
        platform: bool,
    },
}
