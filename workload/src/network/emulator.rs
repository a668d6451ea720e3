//! Drives a [`Star`] in real time: reads what the hosts send from their TAP devices and writes what is due. The main
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
use record::{virtual_host::VirtualHost, window::LinkRecord};
use simulation::link::Impairment;

use super::{
    device::Tap,
    error::NetworkError,
    namespace::errno,
    release_lateness::{ReleaseCounts, ReleaseLateness},
    star::{Delivery, FRAME_BYTES, Star},
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
    links: [LinkRecord; 3],
    failure: Option<NetworkError>,
}

impl Emulator {
    /// Starts carrying packets between the hosts' devices, which are in [`VirtualHost::ALL`]'s order; the links are
    /// impaired from [`Self::impair`] on. The thread asks for the SCHED_FIFO priority if it is not 0, and goes on without it where it is refused.
    ///
    /// # Errors
    /// If the thread cannot be started.
    pub fn start(
        taps: [Tap; 3],
        star: Star,
        impairment: Impairment,
        fifo_priority: u8,
    ) -> Result<Self, NetworkError> {
        let status = Arc::new(Mutex::new(Status {
            links: star.links(),
            failure: None,
        }));
        let release_lateness = star.release_lateness();
        let stop = EventFd::from_flags(EfdFlags::EFD_CLOEXEC | EfdFlags::EFD_NONBLOCK);
        let stop = Arc::new(stop.map_err(|source| NetworkError::Thread { source })?);
        let impaired = Arc::new(AtomicBool::new(false));
        let mut carrier = Carrier {
            taps,
            star,
            pending: Some(PendingImpairment {
                impairment,
                wanted: impaired.clone(),
            }),
            clock: Clock::start(),
            status: status.clone(),
            published: true,
        };
        let stopped = stop.clone();
        let thread = thread::Builder::new().name("emulator".into()).spawn(move || {
            // It was started before the right to make namespaces was given up.
            drop_unneeded();
            // Neither is an error: what was granted of the real-time wishes is asked and recorded by the experiment.
            let _ = prctl::set_timerslack(1);
            let _ = request_fifo(fifo_priority);
            let outcome = carrier.carry(&stopped);
            lock(&carrier.status).failure = outcome.err();
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
    pub fn links(&self) -> [LinkRecord; 3] {
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
struct Carrier {
    taps: [Tap; 3],
    star: Star,
    /// Until it is put upon the star.
    pending: Option<PendingImpairment>,
    clock: Clock,
    status: Arc<Mutex<Status>>,
    published: bool,
}

/// What the links are to do to packets once that is wanted.
struct PendingImpairment {
    impairment: Impairment,
    wanted: Arc<AtomicBool>,
}

impl Carrier {
    fn carry(&mut self, stop: &EventFd) -> Result<(), NetworkError> {
        let mut buffer = [0; FRAME_BYTES];
        loop {
            let ready = self.wait(stop)?;
            if ready.stop {
                return Ok(());
            }
            self.deliver_due();
            for host in VirtualHost::ALL {
                if ready.hosts[host.index()] {
                    self.read(host, &mut buffer)?;
                }
            }
            self.deliver_due();
            self.publish();
        }
    }

    /// Sleeps until a host has sent something, the next packet is due, or it is time to stop.
    fn wait(&self, stop: &EventFd) -> Result<Ready, NetworkError> {
        let interest = |fd| PollFd::new(fd, PollFlags::POLLIN);
        let [h1, sta1, sta2] = &self.taps;
        let mut fds = [
            interest(h1.as_fd()),
            interest(sta1.as_fd()),
            interest(sta2.as_fd()),
            interest(stop.as_fd()),
        ];
        match ppoll(&mut fds, self.timeout().map(TimeSpec::from), None) {
            Ok(_) | Err(Errno::EINTR) => {}
            Err(source) => {
                return Err(NetworkError::Carrying {
                    action: "waiting for packets",
                    source,
                });
            }
        }
        let [h1, sta1, sta2, stop] = fds.map(|fd| fd.any().unwrap_or(false));
        Ok(Ready {
            hosts: [h1, sta1, sta2],
            stop,
        })
    }

    /// How long nothing needs to be done unless a host sends.
    fn timeout(&self) -> Option<Duration> {
        let now_ns = self.clock.now_ns();
        let until_due = self
            .star
            .next_due_ns()
            .map(|due_ns| Duration::from_nanos(due_ns.saturating_sub(now_ns)));
        let until_retry = (!self.published).then_some(PUBLISH_RETRY);
        until_due.into_iter().chain(until_retry).min()
    }

    fn deliver_due(&mut self) {
        let mut hosts = Hosts {
            taps: &self.taps,
            clock: &self.clock,
        };
        self.star.advance(self.clock.now_ns(), &mut hosts);
    }

    fn read(&mut self, host: VirtualHost, buffer: &mut [u8]) -> Result<(), NetworkError> {
        for _ in 0..READ_BATCH {
            let received = self.taps[host.index()].receive(buffer);
            let received = received.map_err(|source| NetworkError::Carrying {
                action: "reading what a host sent",
                source,
            })?;
            let Some(frame) = received.and_then(|bytes| buffer.get(..bytes)) else {
                return Ok(());
            };
            self.impair_if_wanted();
            self.star.send(self.clock.now_ns(), host, frame);
        }
        Ok(())
    }

    /// Asked for each frame after it was read, so that none that was sent after the wish goes free.
    fn impair_if_wanted(&mut self) {
        let wanted = |pending: &mut PendingImpairment| pending.wanted.load(Ordering::Acquire);
        if let Some(PendingImpairment { impairment, .. }) = self.pending.take_if(wanted) {
            self.star.impair(impairment);
        }
    }

    /// Never waits for a reader, who may run at a lower priority.
    fn publish(&mut self) {
        let status = self.status.try_lock();
        self.published = status.is_ok();
        if let Ok(mut status) = status {
            status.links = self.star.links();
        }
    }
}

/// Who has something for the emulator.
struct Ready {
    hosts: [bool; 3],
    stop: bool,
}

/// The hosts as the star sees them.
struct Hosts<'a> {
    taps: &'a [Tap; 3],
    clock: &'a Clock,
}

impl Delivery for Hosts<'_> {
    fn deliver(&mut self, host: VirtualHost, _due_ns: u64, frame: &[u8]) -> Option<u64> {
        self.taps[host.index()].send(frame).ok()?;
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
