//! A node that is a process of its own, seen from the workload: started in its virtual host, followed, and ended. The main
//! type is [`NodeProcess`]; what runs in the process is [`super::node_program`].
//!
//! Each has a thread of the workload that stays for as long as the process does, since the process ends with the thread that
//! started it ([`child_process`]), and that reads what it says.

use std::{
    io::{self, Read as _, Write as _},
    os::fd::AsFd as _,
    process::{Child, ChildStdin, ChildStdout, Command, Stdio},
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc::{Receiver, RecvTimeoutError, Sender, channel},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use nix::{
    poll::{PollFd, PollFlags, PollTimeout, poll},
    unistd::Pid,
};
use record::{control_log::ControlRow, plant_log::PlantRow, platform::RealtimeGrant, settings::Settings};
use rtrb::Producer;
use simulation::schedule::Schedule;

use super::node_messages::{Order, Program, Report};
use crate::experiment::ExperimentError;
use crate::{
    child_process,
    ros::{Notice, Notices},
    virtual_hosts::RunningMaster,
};

/// How often its thread looks whether the process is to stop.
const LOOK_EVERY_MS: u16 = 100;
/// For the process to close its connections and end.
const END_TIMEOUT: Duration = Duration::from_secs(10);
/// The longest line that is read; a report has at most 256 rows.
const LONGEST_LINE: usize = 1 << 20;

/// Where the rows of a node go.
pub enum Rows {
    /// It has none.
    None,
    /// The controller's.
    Control(Producer<ControlRow>),
    /// The plant's.
    Plant(Producer<PlantRow>),
}

/// What a process is given.
pub struct Given {
    /// Where its rows go.
    pub rows: Rows,
    /// Where its notices go.
    pub notices: Notices,
    /// Tells it to stop.
    pub stop: Arc<AtomicBool>,
    /// Counts rows that found no room.
    pub log_dropped: Arc<AtomicU64>,
}

/// A running node.
pub struct NodeProcess {
    program: Program,
    pid: Pid,
    orders: Arc<Mutex<Option<ChildStdin>>>,
    events: Receiver<Event>,
    closing: Arc<AtomicBool>,
    attendant: JoinHandle<()>,
}

/// What its thread tells.
enum Event {
    Connected,
    Ready(RealtimeGrant),
    Ended,
    Failed(ExperimentError),
}

impl NodeProcess {
    /// Starts it in the calling thread's network namespace.
    ///
    /// # Errors
    /// If it cannot be started.
    pub fn start(program: Program, settings: &Settings, given: Given) -> Result<Self, ExperimentError> {
        // Plain data can always be written as JSON.
        let settings = serde_json::to_string(settings).unwrap_or_default();
        let (started, to_start) = channel();
        let (tell, events) = channel();
        let orders = Arc::new(Mutex::new(None));
        let closing = Arc::new(AtomicBool::new(false));
        let mut attendant = Attendant {
            program,
            given,
            orders: Arc::clone(&orders),
            closing: Arc::clone(&closing),
            tell,
            has_ended: false,
        };
        let name = program.name();
        let thread = thread::Builder::new().name(name.into()).spawn(move || {
            let child = spawn(program, &settings);
            let child = match child {
                Ok((child, stdin)) => {
                    *attendant.orders.lock().unwrap_or_else(PoisonError::into_inner) = Some(stdin);
                    let _ = started.send(Ok(child_process::pid(&child)));
                    child
                }
                Err(error) => return drop(started.send(Err(error))),
            };
            attendant.follow(child);
        });
        let attendant = thread.map_err(|source| ExperimentError::Thread {
            name: name.into(),
            source,
        })?;
        let pid = to_start
            .recv()
            .map_err(|_| ExperimentError::ThreadEnded { name: name.into() })?
            .map_err(|source| ExperimentError::Process { name, source })?;
        Ok(Self {
            program,
            pid,
            orders,
            events,
            closing,
            attendant,
        })
    }

    /// Its number.
    #[must_use]
    pub const fn pid(&self) -> Pid {
        self.pid
    }

    /// Waits until it is connected. False if it was told to stop.
    ///
    /// # Errors
    /// If it failed, or the time is over.
    pub fn wait_until_connected(
        &self,
        deadline: Instant,
        stop: &AtomicBool,
    ) -> Result<bool, ExperimentError> {
        let step = Duration::from_millis(LOOK_EVERY_MS.into());
        while !stop.load(Ordering::Relaxed) {
            match self.events.recv_timeout(step) {
                Ok(Event::Connected) => return Ok(true),
                Ok(Event::Failed(error)) => return Err(error),
                Ok(_) | Err(RecvTimeoutError::Disconnected) => return Err(self.ended_early()),
                Err(RecvTimeoutError::Timeout) if Instant::now() < deadline => {}
                Err(RecvTimeoutError::Timeout) => return Err(self.failed("it did not connect in time")),
            }
        }
        Ok(false)
    }

    /// Waits until its loop is ready.
    ///
    /// # Errors
    /// If it failed.
    pub fn wait_until_ready(&self) -> Result<RealtimeGrant, ExperimentError> {
        match self.events.recv() {
            Ok(Event::Ready(grant)) => Ok(grant),
            Ok(Event::Failed(error)) => Err(error),
            _ => Err(self.ended_early()),
        }
    }

    /// Tells its loop to begin.
    ///
    /// # Errors
    /// If it has ended.
    pub fn begin(&self, schedule: Schedule, zero_ns: i64) -> Result<(), ExperimentError> {
        give(&self.orders, &Order::Begin { schedule, zero_ns }).map_err(|_| self.ended_early())
    }

    /// Waits until its loop has ended; its connections stay.
    ///
    /// # Errors
    /// If it failed.
    pub fn wait_until_ended(&self) -> Result<(), ExperimentError> {
        match self.events.recv() {
            Ok(Event::Ended) => Ok(()),
            Ok(Event::Failed(error)) => Err(error),
            _ => Err(self.ended_early()),
        }
    }

    /// Has it close its connections and end, within some ten seconds. What goes wrong meanwhile concerns nothing that was
    /// measured.
    ///
    /// # Errors
    /// If it had failed before, and nobody has heard of it.
    pub fn close(self) -> Result<(), ExperimentError> {
        self.hang_up();
        let _ = self.attendant.join();
        let failed = self.events.try_iter().find_map(|event| match event {
            Event::Failed(error) => Some(error),
            _ => None,
        });
        failed.map_or(Ok(()), Err)
    }

    /// Has it close its connections and end, without waiting.
    pub fn hang_up(&self) {
        self.closing.store(true, Ordering::Relaxed);
        drop(self.orders.lock().unwrap_or_else(PoisonError::into_inner).take());
    }

    fn ended_early(&self) -> ExperimentError {
        self.failed("it ended early")
    }

    fn failed(&self, reason: &str) -> ExperimentError {
        ExperimentError::Node {
            name: self.program.name(),
            reason: reason.to_owned(),
            hint: None,
            platform: false,
        }
    }
}

impl RunningMaster for NodeProcess {
    fn stop(self: Box<Self>) -> Result<(), ExperimentError> {
        self.close()
    }
}

fn spawn(program: Program, settings: &str) -> io::Result<(Child, ChildStdin)> {
    // The very bytes that run, even if the file has been replaced or removed.
    let mut command = Command::new("/proc/self/exe");
    command
        .args(["node", program.name(), "--settings", settings])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped());
    let mut child = child_process::spawn(&mut command)?;
    let stdin = child.stdin.take().ok_or(io::ErrorKind::BrokenPipe)?;
    Ok((child, stdin))
}

fn give(orders: &Mutex<Option<ChildStdin>>, order: &Order) -> io::Result<()> {
    let mut line = serde_json::to_vec(order)?;
    line.push(b'\n');
    let mut orders = orders.lock().unwrap_or_else(PoisonError::into_inner);
    let stdin = orders.as_mut().ok_or(io::ErrorKind::BrokenPipe)?;
    stdin.write_all(&line)?;
    stdin.flush()
}

/// The thread that the process belongs to.
struct Attendant {
    program: Program,
    given: Given,
    orders: Arc<Mutex<Option<ChildStdin>>>,
    closing: Arc<AtomicBool>,
    tell: Sender<Event>,
    has_ended: bool,
}

impl Attendant {
    /// Passes on what the process says, until it has ended.
    fn follow(&mut self, mut child: Child) {
        let outcome = match child.stdout.take() {
            Some(stdout) => self.listen(stdout),
            None => Err(io::ErrorKind::BrokenPipe.into()),
        };
        // Whoever waits for rows sees that there are no more.
        self.given.rows = Rows::None;
        if outcome.is_err() {
            let _ = child.kill();
        }
        let status = child.wait();
        if !self.has_ended && !self.closing.load(Ordering::Relaxed) {
            let reason = match (outcome, status) {
                (Err(error), _) => format!("what it says cannot be read: {error}"),
                (Ok(()), Ok(status)) => format!("it ended early: {status}"),
                (Ok(()), Err(error)) => format!("it ended early: {error}"),
            };
            self.fail(ExperimentError::Node {
                name: self.program.name(),
                reason,
                hint: None,
                platform: false,
            });
        }
    }

    fn listen(&mut self, mut stdout: ChildStdout) -> io::Result<()> {
        let mut told_to_stop = false;
        let mut closing_since = None;
        let mut lines = Vec::new();
        let mut chunk = vec![0; 64 * 1024];
        loop {
            if !told_to_stop && self.given.stop.load(Ordering::Relaxed) {
                told_to_stop = true;
                // If it has ended, its output ends too.
                let _ = give(&self.orders, &Order::Stop);
            }
            if self.closing.load(Ordering::Relaxed) {
                let since = *closing_since.get_or_insert_with(Instant::now);
                if since.elapsed() > END_TIMEOUT {
                    return Err(io::ErrorKind::TimedOut.into());
                }
            }
            let mut ready = [PollFd::new(stdout.as_fd(), PollFlags::POLLIN)];
            match poll(&mut ready, PollTimeout::from(LOOK_EVERY_MS)) {
                Ok(0) | Err(nix::errno::Errno::EINTR) => continue,
                Ok(_) => {}
                Err(error) => return Err(error.into()),
            }
            let read = stdout.read(&mut chunk)?;
            let Some(some) = chunk.get(..read).filter(|some| !some.is_empty()) else {
                return Ok(());
            };
            lines.extend_from_slice(some);
            while let Some(end) = lines.iter().position(|byte| *byte == b'\n') {
                let line: Vec<u8> = lines.drain(..=end).collect();
                self.hear(serde_json::from_slice(&line)?);
            }
            if lines.len() > LONGEST_LINE {
                return Err(io::ErrorKind::FileTooLarge.into());
            }
        }
    }

    fn hear(&mut self, report: Report) {
        match (report, &mut self.given.rows) {
            (Report::Control { rows }, Rows::Control(queue)) => {
                push_all(queue, rows, &self.given.log_dropped);
            }
            (Report::Plant { rows }, Rows::Plant(queue)) => push_all(queue, rows, &self.given.log_dropped),
            (Report::Control { .. } | Report::Plant { .. }, _) => {}
            (Report::Connected, _) => drop(self.tell.send(Event::Connected)),
            (Report::Ready { grant }, _) => drop(self.tell.send(Event::Ready(grant))),
            (Report::Notice { text }, _) => self.given.notices.send(Notice::Relayed { text }),
            (Report::Ended { log_dropped }, _) => {
                self.has_ended = true;
                self.given.log_dropped.fetch_add(log_dropped, Ordering::Relaxed);
                self.given.rows = Rows::None;
                let _ = self.tell.send(Event::Ended);
            }
            (
                Report::Failed {
                    reason,
                    hint,
                    platform,
                },
                _,
            ) => {
                self.has_ended = true;
                let name = self.program.name();
                self.fail(ExperimentError::Node {
                    name,
                    reason,
                    hint,
                    platform,
                });
            }
        }
    }

    /// The other loop ends too, and the experiment with it.
    fn fail(&self, error: ExperimentError) {
        let _ = self.tell.send(Event::Failed(error));
        self.given.stop.store(true, Ordering::Relaxed);
    }
}

fn push_all<R>(queue: &mut Producer<R>, rows: Vec<R>, log_dropped: &AtomicU64) {
    for row in rows {
        if queue.push(row).is_err() {
            log_dropped.fetch_add(1, Ordering::Relaxed);
        }
    }
}
