//! The experiment, wired up: network, captures, nodes, loops, windows. The main function is [`run`].
//!
//! ```text
//! h1    ROS master
//! sta1  /controller   states -> slot -> controller loop -> /command
//! sta2  /plant        commands -> slot -> plant loop -> /state
//!
//! both loops -> queues -> Recorder -> control.csv, captures -> sealer -> window.json
//! ```
//!
//! The experiment's clock is zero at the first control step. It is chosen shortly ahead once both topics are connected;
//! the plant's first step comes `control.phase` before it. A step of the plant publishes the state of that instant and
//! applies the newest command until the next one; a step of the controller uses the newest state, as in
//! [`crate::simulation`].
//!
//! Who is urgent: the emulator above all, since it stands for hardware; then the loops and the threads that receive
//! for them; everything else has no priority, and the sealer less than that.

mod conditions;
mod connection;
mod control_file;
mod doors;
mod error;
mod lateness;
mod loop_threads;
mod loops;
mod master;
pub mod message;
mod notice_board;
mod on_host;
mod open_window;
mod platform_watch;
mod recorder;
mod rehearsal;
mod reporter;
mod schedule;
mod slot;
mod snapshot;
mod validity;
mod window_folder;

use std::{
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::Duration,
};

use self::{
    connection::Connection,
    doors::Doors,
    loop_threads::LoopThreads,
    loops::Shared,
    notice_board::NoticeBoard,
    open_window::WindowShape,
    platform_watch::PlatformWatch,
    recorder::{Recorder, Sources},
    schedule::Schedule,
};
pub use self::{
    error::ExperimentError,
    master::{survey as survey_master, uri as master_uri},
    recorder::Ending,
    rehearsal::rehearse,
    reporter::Reporter,
    window_folder::write_whole,
};
use crate::{
    capture::Capture,
    network::{self, Network},
    realtime::{lock_memory, monotonic_ns},
    record::progress::Progress,
    settings::{ImpairedFrom, Settings},
    virtual_host::VirtualHost,
};

/// How far ahead the plant's first step is chosen: room to tell the loops. The first window's files and captures have
/// `control.phase` besides.
const AHEAD_NS: i64 = 5_000_000;

/// What is to be measured.
#[derive(Debug, Clone, PartialEq)]
pub struct Request {
    /// The environment's name.
    pub environment: String,
    /// How; without problems.
    pub settings: Settings,
    /// Where the data go.
    pub data: PathBuf,
    /// Numbers of the windows, one contiguous stretch of the loops.
    pub windows: Vec<u32>,
}

/// Measures all windows, or until `stop` is set. Everything it made is gone afterwards, except the data.
///
/// # Errors
/// If the platform lacks something or the experiment goes wrong. Windows that were complete by then are on disk.
pub fn run(
    request: &Request,
    reporter: &Reporter,
    stop: &Arc<AtomicBool>,
) -> Result<Ending, ExperimentError> {
    let settings = &request.settings;
    let first = request.windows.first().copied().unwrap_or(1);
    let network = network::open(&settings.network, emulator_priority(settings))?;
    let _doors = Doors::open(network.as_ref())?;
    reporter.say(&Progress::NetworkUp);
    if settings.network.impaired_from == ImpairedFrom::Start {
        network.impair()?;
    }
    let watch = PlatformWatch::start(&request.data, settings.ros.master)?;
    let captures = start_captures(settings, network.as_ref())?;
    let mut board = NoticeBoard::new();
    let connection = Connection::open(network.as_ref(), settings, &board, stop);
    // Those of connecting belong to no window. Where it failed they explain why.
    let failed = connection.is_err();
    board.look(|progress| {
        if failed {
            reporter.say(progress);
        }
    });
    let Some(connection) = connection? else {
        return Ok(Ending::Stopped { window: first });
    };
    if settings.network.impaired_from == ImpairedFrom::Connection {
        network.impair()?;
    }
    keep_transcript(request, network.as_ref())?;
    reporter.say(&Progress::Connected);
    let (nodes, plant, controller) = connection.into_ends();
    let (threads, queues, mut grant) = LoopThreads::start(settings, plant, controller)?;
    // After all threads have their stacks.
    lock_memory(&settings.realtime, &mut grant);
    watch.granted(grant);
    let sources = Sources {
        rows: queues.rows,
        ticks: queues.ticks,
        captures,
        network: network.as_ref(),
        board,
        shared: Shared {
            zero_ns: monotonic_ns() + AHEAD_NS + nanoseconds(settings.control.phase.duration()),
            stop: Arc::clone(stop),
            log_dropped: Arc::new(AtomicU64::new(0)),
        },
    };
    let outcome = measure(request, reporter, &threads, sources);
    if outcome.is_err() {
        stop.store(true, Ordering::Relaxed);
    }
    let joined = threads.join();
    nodes.close();
    // Again, with what went through the links.
    let kept = keep_transcript(request, network.as_ref());
    let watched = watch.finish();
    let ending = outcome?;
    joined?;
    kept?;
    let changes = watched?;
    if !changes.is_empty() {
        reporter.say(&Progress::PlatformChanged { changes });
    }
    Ok(ending)
}

/// Above the loops, unless nothing is to be urgent.
fn emulator_priority(settings: &Settings) -> u8 {
    match settings.realtime.priority {
        0 => 0,
        priority => (priority + 1).min(99),
    }
}

fn start_captures(
    settings: &Settings,
    network: &dyn Network,
) -> Result<Vec<(VirtualHost, Capture)>, ExperimentError> {
    let hosts = VirtualHost::ALL.into_iter().filter(|_| settings.capture.enabled);
    hosts
        .map(|host| Ok((host, Capture::start(network, host, &settings.capture)?)))
        .collect()
}

/// Writes `network.txt`, if there is something to tell.
fn keep_transcript(request: &Request, network: &dyn Network) -> Result<(), ExperimentError> {
    let Some(transcript) = network.transcript() else {
        return Ok(());
    };
    let path = request.data.join("network.txt");
    std::fs::write(&path, transcript).map_err(|source| ExperimentError::Write { path, source })
}

/// Chooses the experiment's zero, begins the loops and records them to their end.
fn measure(
    request: &Request,
    reporter: &Reporter,
    threads: &LoopThreads,
    sources: Sources<'_>,
) -> Result<Ending, ExperimentError> {
    let settings = &request.settings;
    let step_ns = nanoseconds(settings.rate.step());
    let shape = WindowShape {
        environment: request.environment.clone(),
        steps: settings.steps_per_window(),
        step_ns,
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
        first_ns: shared.zero_ns - nanoseconds(settings.control.phase.duration()),
        ..controller
    };
    threads.begin(plant, controller, &shared)?;
    Recorder::begin(sources, shape, &request.windows, &request.data, reporter)?.run()
}

fn nanoseconds(duration: Duration) -> i64 {
    i64::try_from(duration.as_nanos()).unwrap_or(i64::MAX)
}
