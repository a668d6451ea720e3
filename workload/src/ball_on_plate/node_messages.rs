//! What the workload and a node that is a process of its own say to each other, as lines of JSON: [`Order`] on the node's
//! standard input, [`Report`] on its standard output. When its input ends, the node closes its connections and ends.

use std::net::Ipv4Addr;

use record::{
    control_log::ControlRow, plant_log::PlantRow, platform::RealtimeGrant, topology,
    virtual_host::VirtualHost,
};
use serde::{Deserialize, Serialize};
use simulation::schedule::Schedule;

/// Where the master is: on the first host.
pub const MASTER: (VirtualHost, Ipv4Addr) = (VirtualHost::H1, topology::address(0));

/// Which program a process is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Program {
    /// The workload's own ROS master.
    Master,
    /// The plant.
    Plant,
    /// The controller.
    Controller,
}

impl Program {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Master, Self::Plant, Self::Controller];

    /// Where it runs.
    #[must_use]
    pub const fn host(self) -> VirtualHost {
        match self {
            Self::Master => VirtualHost::H1,
            Self::Plant => VirtualHost::STA2,
            Self::Controller => VirtualHost::STA1,
        }
    }

    /// Its name on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Master => "master",
            Self::Plant => "plant",
            Self::Controller => "controller",
        }
    }
}

/// From the workload to the node.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "order", rename_all = "kebab-case")]
pub enum Order {
    /// The loop begins.
    Begin {
        /// When its steps are due, on the monotonic clock.
        schedule: Schedule,
        /// When the experiment's clock shows zero, on the monotonic clock.
        zero_ns: i64,
    },
    /// The loop ends before its time.
    Stop,
}

/// From the node to the workload.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "report", rename_all = "kebab-case")]
pub enum Report {
    /// The master listens, or the node's topics are connected both ways.
    Connected,
    /// The loop is ready, with what it was granted.
    Ready {
        /// By the operating system.
        grant: RealtimeGrant,
    },
    /// Control steps, in order.
    Control {
        /// One a step.
        rows: Vec<ControlRow>,
    },
    /// Ticks of the plant, in order.
    Plant {
        /// One a tick.
        rows: Vec<PlantRow>,
    },
    /// Something that the node has to say.
    Notice {
        /// In words.
        text: String,
    },
    /// The loop has ended; all its rows have been said.
    Ended {
        /// Rows for which the queue had no room.
        log_dropped: u64,
    },
    /// It cannot go on.
    Failed {
        /// Why, with the causes.
        reason: String,
        /// What to do about it, where that is known.
        hint: Option<String>,
        /// Whether the platform did not offer what is needed.
        platform: bool,
    },
}
