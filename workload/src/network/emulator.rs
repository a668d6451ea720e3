//! Drives a [`Fabric`] in real time: reads what the hosts send from their TAP devices and writes what is due. The main
//! type is [`Emulator`].
//!
//! One thread does it all. It sleeps in ppoll(2) until a host sends or the next packet is due, with the kernel's timer
//! slack turned off, and in steady state allocates nothing.

use std::{
    os::fd::AsFd,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use nix::{
    errno::Errno,
    poll::{PollFd, PollFlags, ppoll},
    sys::{
        eventfd::{EfdFlags, EventFd},
        prctl,
        time::TimeSpec,
    },
};
use record::window::LinkRecord;

use super::{
    device::Tap,
    error::NetworkError,
    fabric::{Delivery, FRAME_BYTES, Fabric},
    namespace::errno,
    release_lateness::{ReleaseCounts, ReleaseLateness},
};
use crate::{capabilities::drop_unneeded, realtime::priority::request_fifo};

/// How many frames are read from one host before the others and what is due have their turn.
const READ_BATCH: usize = 32;

/// When to try again to publish the counts, if somebody was just reading them.
const PUBLISH_RETRY: Duration = Duration::from_millis(1);

/// The thread that carries packets between the hosts, until it is stopped or dropped.
#[derive(Debug)]
pub struct Emulator {
    status: Arc<Mutex<Status>>,
    impaired: Arc<AtomicBool>,
    release_lateness: Arc<ReleaseLateness>,
    stop: Arc<EventFd>,
    thread: Option<JoinHandle<()>>,
}

/// What others may know of the emulator.
#[derive(Debug, Clone)]
struct Status {
    links: Vec<LinkRecord>,
    failure: Option<NetworkError>,
}

impl Emulator {
    /// Starts carrying packets between the hosts' devices, which are in the topology's order; the links are
    /// impaired from [`Self::impair`] on. The thread asks for the SCHED_FIFO priority if it is not 0, and goes on without it where it is refused.
    ///
    /// # Errors
    /// If the thread cannot be started.
    pub fn start(taps: Vec<Tap>, fabric: Fabric, fifo_priority: u8) -> Result<Self, NetworkError> {
        let mut links = Vec::new();
        fabric.record_links(&mut links);
        let status = Arc::new(Mutex::new(Status { links, failure: None }));
        let release_lateness = fabric.release_lateness();
        let stop = EventFd::from_flags(EfdFlags::EFD_CLOEXEC | EfdFlags::EFD_NONBLOCK);
        let stop = Arc::new(stop.map_err(|source| NetworkError::Thread { source })?);
        let impaired = Arc::new(AtomicBool::new(false));
        let clock = Clock::start();
        let (stopped, wanted, told) = (stop.clone(), impaired.clone(), status.clone());
        let thread = thread::Builder::new().name("emulator".into()).spawn(move || {
            // It was started before the right to make namespaces was given up.
            drop_unneeded();
            // Neither is an error: what was granted of the real-time wishes is asked and recorded by the experiment.
            let _ = prctl::set_timerslack(1);
            let _ = request_fifo(fifo_priority);
            let carrier = Carrier {
                taps: &taps,
                fabric,
                impairment: Some(wanted),
                clock,
                status: &told,
                published: true,
            };
            let outcome = carrier.carry(&stopped);
            lock(&told).failure = outcome.err();
        });
        let thread = thread.map_err(|error| NetworkError::Thread {
            source: errno(&error),
        })?;
        Ok(Self {
            status,
            impaired,
            release_lateness,
            stop,
            thread: Some(thread),
        })
    }

    /// Impairs every packet that a host sends after this call.
    pub fn impair(&self) {
        self.impaired.store(true, Ordering::Release);
    }

    /// What went through the links so far.
    #[must_use]
    pub fn links(&self) -> Vec<LinkRecord> {
        lock(&self.status).links.clone()
    }

    /// How late packets were let go so far.
    #[must_use]
    pub fn release_lateness(&self) -> ReleaseCounts {
        self.release_lateness.counts()
    }

    /// Why it stopped, if it did.
    #[must_use]
    pub fn failure(&self) -> Option<NetworkError> {
        lock(&self.status).failure.clone()
    }
}

impl Drop for Emulator {
    fn drop(&mut self) {
        // The counter of an eventfd that is written once cannot overflow, and a thread that panicked is gone anyway.
        let _ = self.stop.write(1);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// The emulator thread's own state.
struct Carrier<'a> {
    taps: &'a [Tap],
    fabric: Fabric,
    /// Whether the links are to be impaired, until they are.
    impairment: Option<Arc<AtomicBool>>,
    clock: Clock,
    status: &'a Mutex<Status>,
    published: bool,
}

impl Carrier<'_> {
    fn carry(mut self, stop: &EventFd) -> Result<(), NetworkError> {
        let mut buffer = [0; FRAME_BYTES];
        let interest = |fd| PollFd::new(fd, PollFlags::POLLIN);
        // Once, so that waiting allocates nothing.
        let stops = [interest(stop.as_fd())].into_iter();
        let mut fds: Vec<PollFd<'_>> = stops
            .chain(self.taps.iter().map(|tap| interest(tap.as_fd())))
            .collect();
        loop {
            self.wait(&mut fds)?;
            let Some((stop, hosts)) = fds.split_first() else {
                return Ok(());
            };
            if stop.any().unwrap_or(false) {
                return Ok(());
            }
            self.deliver_due();
            for (host, fd) in hosts.iter().enumerate() {
                if fd.any().unwrap_or(false) {
                    self.read(host, &mut buffer)?;
                }
            }
            self.deliver_due();
            self.publish();
        }
    }

    /// Sleeps until a host has sent something, the next packet is due, or it is time to stop.
    fn wait(&self, fds: &mut [PollFd<'_>]) -> Result<(), NetworkError> {
        match ppoll(fds, self.timeout().map(TimeSpec::from), None) {
            Ok(_) | Err(Errno::EINTR) => Ok(()),
            Err(source) => Err(NetworkError::Carrying {
                action: "waiting for packets",
                source,
            }),
        }
    }

    /// How long nothing needs to be done unless a host sends.
    fn timeout(&self) -> Option<Duration> {
        let now_ns = self.clock.now_ns();
        let until_due = self
            .fabric
            .next_due_ns()
            .map(|due_ns| Duration::from_nanos(due_ns.saturating_sub(now_ns)));
        let until_retry = (!self.published).then_some(PUBLISH_RETRY);
        until_due.into_iter().chain(until_retry).min()
    }

    fn deliver_due(&mut self) {
        let mut hosts = Hosts {
            taps: self.taps,
            clock: &self.clock,
        };
        self.fabric.advance(self.clock.now_ns(), &mut hosts);
    }

    fn read(&mut self, host: usize, buffer: &mut [u8]) -> Result<(), NetworkError> {
        let Some(tap) = self.taps.get(host) else {
            return Ok(());
        };
        for _ in 0..READ_BATCH {
            let received = tap.receive(buffer);
            let received = received.map_err(|source| NetworkError::Carrying {
                action: "reading what a host sent",
                source,
            })?;
            let Some(frame) = received.and_then(|bytes| buffer.get(..bytes)) else {
                return Ok(());
            };
            self.impair_if_wanted();
            self.fabric.send(self.clock.now_ns(), host, frame);
        }
        Ok(())
    }

    /// Asked for each frame after it was read, so that none that was sent after the wish goes free.
    fn impair_if_wanted(&mut self) {
        let is_set = |wanted: &mut Arc<AtomicBool>| wanted.load(Ordering::Acquire);
        if self.impairment.take_if(is_set).is_some() {
            self.fabric.impair();
        }
    }

    /// Never waits for a reader, who may run at a lower priority.
    fn publish(&mut self) {
        let status = self.status.try_lock();
        self.published = status.is_ok();
        if let Ok(mut status) = status {
            self.fabric.record_links(&mut status.links);
        }
    }
}

/// The hosts as the fabric sees them.
struct Hosts<'a> {
    taps: &'a [Tap],
    clock: &'a Clock,
}

impl Delivery for Hosts<'_> {
    fn deliver(&mut self, host: usize, _due_ns: u64, frame: &[u8]) -> Option<u64> {
        self.taps.get(host)?.send(frame).ok()?;
        Some(self.clock.now_ns())
    }
}

/// The monotonic clock from the emulator's start.
struct Clock {
    origin: Instant,
}

impl Clock {
    fn start() -> Self {
        Self {
            origin: Instant::now(),
        }
    }

    fn now_ns(&self) -> u64 {
        u64::try_from(self.origin.elapsed().as_nanos()).unwrap_or(u64::MAX)
    }
}

/// The status is whole whenever the lock is free, also after a panic.
fn lock(status: &Mutex<Status>) -> MutexGuard<'_, Status> {
    status.lock().unwrap_or_else(PoisonError::into_inner)
}
