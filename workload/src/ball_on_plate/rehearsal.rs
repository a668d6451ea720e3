//! The experiment without measuring: network, master and nodes run until they are told to stop, and nothing is written.
//! It is for ROS's tools, and for nodes of one's own in place of the plant or the controller. The main function is
//! [`rehearse`].

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    thread,
    time::Duration,
};

use record::{
    progress::{Part, Progress},
    settings::Settings,
    virtual_host::VirtualHost,
};
use simulation::schedule::Schedule;

use super::{
    AHEAD_NS,
    connection::{Side, Tenancy},
    loop_threads::LoopThread,
    loops::Shared,
    nanoseconds,
    node_messages::MASTER,
};
use crate::experiment::{ExperimentError, Reporter};
use crate::{
    capabilities::drop_unneeded,
    network,
    realtime::{monotonic_ns, priority::above},
    ros::Notices,
    virtual_hosts::{self, NamespaceEntries, NoticeQueue, on_host},
};

/// How often it is looked whether it is to end, and what there is to say.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// Runs until `stop` is set, with those of our nodes that are not in `without`.
///
/// # Errors
/// If the platform lacks something.
pub fn rehearse(
    settings: &Settings,
    without: &[Part],
    reporter: &Reporter,
    stop: &Arc<AtomicBool>,
) -> Result<(), ExperimentError> {
    let network = network::open(&settings.network, above(settings.realtime.priority))?;
    drop_unneeded();
    let network = network.as_ref();
    // Nodes of others come at any time: there is no moment from which on all are connected.
    network.impair()?;
    let _entries = NamespaceEntries::open(network)?;
    reporter.say(&Progress::NetworkUp);
    let mut board = NoticeQueue::on(VirtualHost::OF_THE_BALL);
    let notices = board.of(VirtualHost::H1);
    let program = settings.ros.master;
    let master = on_host(network, VirtualHost::H1, move || {
        virtual_hosts::start_master(program, MASTER, notices)
    })?;
    let uri = virtual_hosts::uri(MASTER.1);
    let mut tenancies = Vec::new();
    let mut threads = Vec::new();
    let parts: Vec<_> = Part::ALL
        .into_iter()
        .filter(|part| !without.contains(part))
        .collect();
    for part in &parts {
        let (tenancy, thread) = start(*part, settings, network, &uri, board.of(part.host()))?;
        tenancies.push(tenancy);
        threads.push(thread);
    }
    begin(settings, &parts, &threads, stop)?;
    reporter.say(&Progress::Rehearsing {
        master: uri,
        nodes: parts,
    });
    while !stop.load(Ordering::Relaxed) {
        board.look(|progress| reporter.say(progress));
        thread::sleep(LOOK_EVERY);
    }
    let ended: Vec<_> = threads.into_iter().map(LoopThread::join).collect();
    tenancies.into_iter().for_each(Tenancy::end);
    master.stop()?;
    ended.into_iter().try_for_each(|ended| ended.map(drop))
}

/// One of our nodes with its loop, which waits to begin.
fn start(
    part: Part,
    settings: &Settings,
    network: &dyn network::Network,
    uri: &str,
    notices: Notices,
) -> Result<(Tenancy, LoopThread), ExperimentError> {
    let host = part.host();
    let (given, uri) = (settings.clone(), uri.to_owned());
    match part {
        Part::Plant => {
            let side = on_host(network, host, move || {
                Ok(Side::open_plant(&given, &uri, notices)?)
            })?;
            let (tenancy, ends) = side.into_parts();
            // Nobody reads what the loop logs: its queue fills, and it goes on.
            Ok((tenancy, LoopThread::plant(settings, ends)?.0))
        }
        Part::Controller => {
            let side = on_host(network, host, move || {
                Ok(Side::open_controller(&given, &uri, notices)?)
            })?;
            let (tenancy, ends) = side.into_parts();
            Ok((tenancy, LoopThread::controller(settings, ends)?.0))
        }
    }
}

/// Begins the loops, without an end.
fn begin(
    settings: &Settings,
    parts: &[Part],
    threads: &[LoopThread],
    stop: &Arc<AtomicBool>,
) -> Result<(), ExperimentError> {
    let phase_ns = nanoseconds(settings.control.phase.duration());
    let shared = Shared {
        zero_ns: monotonic_ns() + AHEAD_NS + phase_ns,
        stop: Arc::clone(stop),
        log_dropped: Arc::new(AtomicU64::new(0)),
    };
    for (part, thread) in parts.iter().zip(threads) {
        let ahead_ns = match part {
            Part::Plant => phase_ns,
            Part::Controller => 0,
        };
        let schedule = Schedule {
            first_ns: shared.zero_ns - ahead_ns,
            step_ns: nanoseconds(settings.rate.step()),
            steps: u64::MAX,
        };
        thread.begin(schedule, &shared)?;
    }
    Ok(())
}
