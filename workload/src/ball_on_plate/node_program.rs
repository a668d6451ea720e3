//! A node as a process of its own: what runs behind `workload node`, in the network namespace of its virtual host. It is
//! told what to do on standard input and says what it does on standard output ([`super::node_messages`]). The function is
//! [`serve`].

use std::{
    io::{self, BufRead as _, Write as _},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc::{Receiver, RecvTimeoutError, channel},
    },
    thread,
    time::{Duration, Instant},
};

use record::{
    causes::with_causes,
    platform::RealtimeGrant,
    settings::{RosMaster, Settings},
};
use rtrb::Consumer;
use simulation::schedule::Schedule;

use super::{
    connection::{Side, TIMEOUT, Tenancy},
    loop_threads::LoopThread,
    loops::Shared,
    node_messages::{MASTER, Order, Program, Report},
};
use crate::experiment::ExperimentError;
use crate::{
    realtime::lock_memory,
    ros::{Notice, Notices},
    virtual_hosts,
};

/// How often the queue of rows is emptied. It holds far more.
const DRAIN_EVERY: Duration = Duration::from_millis(50);
/// Rows in one report.
const MOST_ROWS: usize = 256;
/// Notices that wait to be said; what is more is forgotten.
const MOST_WAITING: usize = 256;

/// Runs the program until its input ends. True if nothing went wrong; what did is said on standard output.
#[must_use]
pub fn serve(program: Program, settings: &Settings) -> bool {
    match try_serve(program, settings) {
        Ok(()) => true,
        Err(error) => {
            say(&Report::Failed {
                reason: with_causes(&error),
                hint: error.hint(),
                platform: error.is_of_platform(),
            });
            false
        }
    }
}

fn try_serve(program: Program, settings: &Settings) -> Result<(), ExperimentError> {
    let stop = Arc::new(AtomicBool::new(false));
    let orders = Orders::read(&stop)?;
    let (notices, queue) = Notices::queue(MOST_WAITING);
    let told = Told { orders, queue, stop };
    match program {
        Program::Master => serve_master(&told, notices),
        Program::Plant => {
            let side = Side::open_plant(settings, &virtual_hosts::uri(MASTER.1), notices)?;
            serve_loop(settings, &told, side, LoopThread::plant, |rows| Report::Plant {
                rows,
            })
        }
        Program::Controller => {
            let side = Side::open_controller(settings, &virtual_hosts::uri(MASTER.1), notices)?;
            serve_loop(settings, &told, side, LoopThread::controller, |rows| {
                Report::Control { rows }
            })
        }
    }
}

/// What others tell this program.
struct Told {
    orders: Orders,
    queue: Receiver<Notice>,
    /// Set when the loop is to end.
    stop: Arc<AtomicBool>,
}

fn serve_master(told: &Told, notices: Notices) -> Result<(), ExperimentError> {
    let master = virtual_hosts::start_master(RosMaster::Embedded, MASTER, notices)?;
    say(&Report::Connected);
    while told.orders.wait(DRAIN_EVERY) {
        say_notices(&told.queue);
    }
    master.stop()
}

/// A node with its loop: connected, begun, followed to its end. Its connections stay until the input ends.
fn serve_loop<E, R>(
    settings: &Settings,
    told: &Told,
    side: Side<E>,
    start: impl FnOnce(&Settings, E) -> Result<(LoopThread, Consumer<R>, RealtimeGrant), ExperimentError>,
    report: impl Fn(Vec<R>) -> Report,
) -> Result<(), ExperimentError> {
    let connected = side.wait(Instant::now() + TIMEOUT, &told.stop);
    say_notices(&told.queue);
    let connected = connected?;
    let (tenancy, ends) = side.into_parts();
    if !connected {
        tenancy.end();
        return Ok(());
    }
    say(&Report::Connected);
    let (thread, mut rows, mut grant) = start(settings, ends)?;
    lock_memory(&settings.realtime, &mut grant);
    say(&Report::Ready { grant });
    let Some((schedule, zero_ns)) = told.orders.begin() else {
        thread.join()?;
        tenancy.end();
        return Ok(());
    };
    let shared = Shared {
        zero_ns,
        stop: Arc::clone(&told.stop),
        log_dropped: Arc::new(AtomicU64::new(0)),
    };
    thread.begin(schedule, &shared)?;
    loop {
        // Seen before the queue is emptied, or its last rows would stay in it.
        let ended = rows.is_abandoned();
        while !rows.is_empty() {
            let some = std::iter::from_fn(|| rows.pop().ok()).take(MOST_ROWS);
            say(&report(some.collect()));
        }
        say_notices(&told.queue);
        if ended {
            break;
        }
        thread::sleep(DRAIN_EVERY);
    }
    say(&Report::Ended {
        log_dropped: shared.log_dropped.load(Ordering::Relaxed),
    });
    // The other loop may not have ended: the connections stay until it has.
    while told.orders.wait(DRAIN_EVERY) {}
    finish(thread, tenancy)
}

fn finish(thread: LoopThread, tenancy: Tenancy) -> Result<(), ExperimentError> {
    let publisher = thread.join()?;
    drop(publisher);
    tenancy.end();
    Ok(())
}

/// One line. If nobody reads it any more, the input has ended too.
fn say(report: &Report) {
    let mut out = io::stdout().lock();
    let _ = serde_json::to_writer(&mut out, report)
        .map_err(io::Error::from)
        .and_then(|()| out.write_all(b"\n"))
        .and_then(|()| out.flush());
}

fn say_notices(queue: &Receiver<Notice>) {
    for notice in queue.try_iter().take(MOST_WAITING) {
        say(&Report::Notice {
            text: notice.to_string(),
        });
    }
}

/// What comes on standard input.
struct Orders {
    begins: Receiver<(Schedule, i64)>,
}

impl Orders {
    /// Begins to read. `stop` is set when the loop is to end, and when there is nobody any more who could say so.
    fn read(stop: &Arc<AtomicBool>) -> Result<Self, ExperimentError> {
        let stop = Arc::clone(stop);
        let (begin, begins) = channel();
        let name = "orders";
        let reader = thread::Builder::new().name(name.into()).spawn(move || {
            for line in io::stdin().lock().lines() {
                let order = line.ok().and_then(|line| serde_json::from_str(&line).ok());
                match order {
                    Some(Order::Begin { schedule, zero_ns }) => drop(begin.send((schedule, zero_ns))),
                    Some(Order::Stop) | None => stop.store(true, Ordering::Relaxed),
                }
            }
            stop.store(true, Ordering::Relaxed);
        });
        reader.map_err(|source| ExperimentError::Thread {
            name: name.into(),
            source,
        })?;
        Ok(Self { begins })
    }

    /// Waits for the order to begin; none if the input ended without it.
    fn begin(&self) -> Option<(Schedule, i64)> {
        self.begins.recv().ok()
    }

    /// Whether the input still has not ended after that time.
    fn wait(&self, time: Duration) -> bool {
        !matches!(
            self.begins.recv_timeout(time),
            Err(RecvTimeoutError::Disconnected)
        )
    }
}
