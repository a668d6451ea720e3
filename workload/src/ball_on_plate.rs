//! The ball on the plate, the experiment that `matrix` has built in: network, captures, nodes, loops, windows. The main type is
//! [`BallOnPlate`].
//!
//! ```text
//! h1    ROS master
//! sta1  /controller   states -> latest value -> controller loop -> commands
//! sta2  /plant        commands -> latest value -> plant loop -> states
//!
//! both loops -> queues -> Recorder -> control.csv, plant.csv, captures -> sealer -> window.json
//! ```
//!
//! The three are threads of this process or processes of their own ([`nodes`]). The experiment's clock is zero at the first
//! control step. It is chosen shortly ahead once both topics are connected; the plant's first step comes `control.phase`
//! before it. What a step does is in [`loops`].
//!
//! Who is urgent: the emulator above all, since it stands for hardware; then the loops and the threads that receive
//! for them; everything else has no priority, and the sealer less than that.

mod connection;
mod lateness;
mod latest_value;
mod log_file;
mod loop_threads;
mod loops;
mod node_messages;
mod node_process;
mod node_program;
mod nodes;
mod open_window;
mod recorder;
mod rehearsal;
mod schedule;
mod simulated;

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::Duration,
};

use record::{
    platform::RosMasterRecord,
    progress::Progress,
    settings::{ImpairedFrom, Settings},
    virtual_host::VirtualHost,
};
use simulation::schedule::Schedule;

use self::{
    loops::Shared,
    nodes::{Loops, Nodes, Setting},
    open_window::WindowShape,
    recorder::{Recorder, Sources},
};
pub use self::{node_messages::Program, node_program::serve, rehearsal::rehearse, simulated::Simulated};
use crate::{
    capabilities::drop_unneeded,
    experiment::{Ending, Experiment, ExperimentError, PlatformWatch, Reporter, Request},
    network,
    realtime::{lock_memory, monotonic_ns, priority::above},
    virtual_hosts::{NamespaceEntries, NoticeQueue, keep_transcript, start_captures, version_of_master},
};

/// How far ahead the plant's first step is chosen: room to tell the loops. The first window's files and captures have
/// `control.phase` besides.
const AHEAD_NS: i64 = 5_000_000;

/// A ball that a controller keeps on its path over an emulated network.
pub struct BallOnPlate;

impl Experiment for BallOnPlate {
    fn begin(&self, _: &Settings) -> Result<(), ExperimentError> {
        Ok(network::become_namespace_root()?)
    }

    fn run(
        &self,
        request: &Request,
        reporter: &Reporter,
        stop: &Arc<AtomicBool>,
    ) -> Result<Ending, ExperimentError> {
        let settings = &request.settings;
        let first = request.windows.first().copied().unwrap_or(1);
        let network = network::open(&settings.network, above(settings.realtime.priority))?;
        // Before anything is read that comes over the network, and before any other program is started.
        drop_unneeded();
        let _entries = NamespaceEntries::open(network.as_ref())?;
        reporter.say(&Progress::NetworkUp);
        if settings.network.impaired_from == ImpairedFrom::Start {
            network.impair()?;
        }
        let program = settings.ros.master;
        let watch = PlatformWatch::start(&request.data, move || {
            Some(RosMasterRecord {
                program,
                version: version_of_master(program),
            })
        })?;
        let captures = start_captures(&settings.capture, network.as_ref())?;
        let mut board = NoticeQueue::on(VirtualHost::OF_THE_BALL);
        let log_dropped = Arc::new(AtomicU64::new(0));
        let nodes = Nodes::connect(&Setting {
            network: network.as_ref(),
            settings,
            board: &board,
            stop,
            log_dropped: &log_dropped,
        });
        // Those of connecting belong to no window. Where it failed they explain why.
        let failed = nodes.is_err();
        board.look(|progress| {
            if failed {
                reporter.say(progress);
            }
        });
        let Some(nodes) = nodes? else {
            return Ok(Ending::Stopped { window: first });
        };
        if settings.network.impaired_from == ImpairedFrom::Connection {
            network.impair()?;
        }
        keep_transcript(&request.data, network.as_ref())?;
        reporter.say(&Progress::Connected);
        let (mut loops, queues, mut grant) = nodes.start_loops(settings)?;
        // After all threads have their stacks.
        lock_memory(&settings.realtime, &mut grant);
        watch.granted(grant);
        let sources = Sources {
            rows: queues.rows,
            plant_rows: queues.plant_rows,
            processes: loops.processes(),
            captures,
            network: network.as_ref(),
            board,
            shared: Shared {
                zero_ns: monotonic_ns() + AHEAD_NS + nanoseconds(settings.control.phase.duration()),
                stop: Arc::clone(stop),
                log_dropped,
            },
        };
        let outcome = measure(request, reporter, &mut loops, sources);
        if outcome.is_err() {
            stop.store(true, Ordering::Relaxed);
        }
        let ended = loops.end();
        // Again, with what went through the links.
        let kept = keep_transcript(&request.data, network.as_ref());
        let watched = watch.finish();
        // What ended a loop is the cause of what the recorder could not go on without.
        ended?;
        let ending = outcome?;
        kept?;
        let changes = watched?;
        if !changes.is_empty() {
            reporter.say(&Progress::PlatformChanged { changes });
        }
        Ok(ending)
    }
}

/// Chooses the experiment's zero, begins the loops and records them to their end.
fn measure(
    request: &Request,
    reporter: &Reporter,
    loops: &mut Loops,
    sources: Sources<'_>,
) -> Result<Ending, ExperimentError> {
    let settings = &request.settings;
    let step_ns = nanoseconds(settings.rate.step());
    let shape = WindowShape {
        environment: request.environment.clone(),
        steps: settings.steps_per_window(),
        steps_per_period: settings.steps_per_period(),
        step_ns,
        phase_ns: nanoseconds(settings.control.phase.duration()),
        late_ticks: settings.loops.late_ticks,
        captures: sources.captures.len(),
        network_seed: sources.network.seed(),
        limits: settings.validity.clone(),
    };
    let shared = sources.shared.clone();
    let controller = Schedule {
        first_ns: shared.zero_ns,
        step_ns,
        steps: shape.steps * request.windows.len() as u64,
    };
    let plant = Schedule {
        first_ns: shared.zero_ns - shape.phase_ns,
        ..controller
    };
    loops.begin(plant, controller, &shared)?;
    Recorder::begin(sources, shape, &request.windows, &request.data, reporter)?.run()
}

fn nanoseconds(duration: Duration) -> i64 {
    i64::try_from(duration.as_nanos()).unwrap_or(i64::MAX)
}
