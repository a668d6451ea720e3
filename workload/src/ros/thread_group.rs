//! The threads of one master or one node: counted, bounded, and waited for at its end. The main type is [`ThreadGroup`].
//!
//! There is no pool: a thread belongs to the network namespace of the thread that made it, so each is made from one of
//! its own master's or node's.

use std::{
    io,
    sync::{
        Arc, Condvar, Mutex, PoisonError,
        atomic::{AtomicUsize, Ordering},
    },
    thread,
    time::Duration,
};

use super::stop::Stop;

/// Enough for XML of the allowed nesting, and little to lock into memory.
const STACK_BYTES: usize = 256 * 1024;

/// More than the experiment needs tenfold; what a flood of connections may cost at most.
const MOST_THREADS: usize = 128;

/// Of these, those that one listener's connections may have: two listeners' together leave enough for the node itself.
const MOST_GUESTS: usize = 48;

/// Called at the start of each thread that receives messages, in that thread: to raise its priority, say.
pub type ThreadSetup = Arc<dyn Fn() + Send + Sync>;

/// Threads that end when their stop is raised.
#[derive(Debug, Clone)]
pub(super) struct ThreadGroup {
    stop: Stop,
    live: Arc<(Mutex<usize>, Condvar)>,
}

impl ThreadGroup {
    pub fn new() -> io::Result<Self> {
        Ok(Self {
            stop: Stop::new()?,
            live: Arc::default(),
        })
    }

    pub fn stop(&self) -> &Stop {
        &self.stop
    }

    /// Runs `work` on a thread of its own. Names are cut to 15 bytes by the kernel.
    pub fn spawn(&self, name: &str, work: impl FnOnce() + Send + 'static) -> io::Result<()> {
        let member = self.enrol()?;
        thread::Builder::new()
            .name(name.to_owned())
            .stack_size(STACK_BYTES)
            .spawn(move || {
                let _member = member;
                work();
            })?;
        Ok(())
    }

    /// Raises the stop and waits until all threads have ended, or the time is over; says whether they have.
    pub fn dismiss(&self, timeout: Duration) -> bool {
        self.stop.raise();
        let (live, ended) = &*self.live;
        let live = live.lock().unwrap_or_else(PoisonError::into_inner);
        let waited = ended.wait_timeout_while(live, timeout, |live| *live > 0);
        *waited.unwrap_or_else(PoisonError::into_inner).0 == 0
    }

    /// For the connections that others make to one listener.
    pub fn guests(&self) -> Guests {
        Guests {
            crew: self.clone(),
            live: Arc::default(),
        }
    }

    fn enrol(&self) -> io::Result<Member> {
        let mut live = self.live.0.lock().unwrap_or_else(PoisonError::into_inner);
        if *live >= MOST_THREADS {
            return Err(io::Error::new(
                io::ErrorKind::QuotaExceeded,
                format!("{MOST_THREADS} threads are busy"),
            ));
        }
        *live += 1;
        Ok(Member(Arc::clone(&self.live)))
    }
}

/// The threads of one listener's connections. However many connect, they take none from the node itself or from another
/// listener.
#[derive(Debug, Clone)]
pub(super) struct Guests {
    crew: ThreadGroup,
    live: Arc<AtomicUsize>,
}

impl Guests {
    /// Runs `work`, as [`ThreadGroup::spawn`], if there is room for one more.
    pub fn spawn(&self, name: &str, work: impl FnOnce() + Send + 'static) -> io::Result<()> {
        let guest = Guest(Arc::clone(&self.live));
        if self.live.fetch_add(1, Ordering::AcqRel) >= MOST_GUESTS {
            return Err(io::Error::new(
                io::ErrorKind::QuotaExceeded,
                format!("{MOST_GUESTS} connections are being served"),
            ));
        }
        self.crew.spawn(name, move || {
            let _guest = guest;
            work();
        })
    }

    /// Whether there are so many that idle ones should go.
    pub fn are_many(&self) -> bool {
        self.live.load(Ordering::Acquire) > MOST_GUESTS / 2
    }

    pub fn stop(&self) -> &Stop {
        self.crew.stop()
    }
}

/// Counted while it lives.
struct Guest(Arc<AtomicUsize>);

impl Drop for Guest {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::AcqRel);
    }
}

/// Counted while it lives, whichever way its thread ends.
struct Member(Arc<(Mutex<usize>, Condvar)>);

impl Drop for Member {
    fn drop(&mut self) {
        let (live, ended) = &*self.0;
        *live.lock().unwrap_or_else(PoisonError::into_inner) -= 1;
        ended.notify_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dismissed_crew_has_ended_even_where_a_thread_waited_for_ever() {
        let crew = ThreadGroup::new().unwrap();
        let stop = crew.stop().clone();
        crew.spawn("waits", move || drop(stop.wait(&[], None))).unwrap();
        assert!(crew.dismiss(Duration::from_secs(10)));
    }

    #[test]
    fn a_crew_has_a_largest_size() {
        let crew = ThreadGroup::new().unwrap();
        for _ in 0..MOST_THREADS {
            let stop = crew.stop().clone();
            crew.spawn("waits", move || drop(stop.wait(&[], None))).unwrap();
        }
        assert_eq!(
            crew.spawn("one more", || {}).unwrap_err().kind(),
            io::ErrorKind::QuotaExceeded
        );
        assert!(crew.dismiss(Duration::from_secs(10)));
    }

    #[test]
    fn guests_take_no_place_of_the_node_or_of_another_listener() {
        let crew = ThreadGroup::new().unwrap();
        let wait = || {
            let stop = crew.stop().clone();
            move || drop(stop.wait(&[], None))
        };
        for guests in [crew.guests(), crew.guests()] {
            for place in 0..MOST_GUESTS {
                assert_eq!(guests.are_many(), place > MOST_GUESTS / 2);
                guests.spawn("guest", wait()).unwrap();
            }
            let refused = guests.spawn("one more", || {}).unwrap_err();
            assert_eq!(refused.kind(), io::ErrorKind::QuotaExceeded);
        }
        for _ in 0..MOST_THREADS - 2 * MOST_GUESTS {
            crew.spawn("own", wait()).unwrap();
        }
        assert!(crew.dismiss(Duration::from_secs(10)));
    }

    #[test]
    fn a_guest_that_has_gone_leaves_its_place() {
        let crew = ThreadGroup::new().unwrap();
        let guests = crew.guests();
        for _ in 0..3 * MOST_GUESTS {
            let (ends, ended) = std::sync::mpsc::channel();
            let guest = guests.live.clone();
            guests.spawn("guest", move || ends.send(()).unwrap()).unwrap();
            ended.recv().unwrap();
            while guest.load(Ordering::Acquire) > 0 {
                thread::yield_now();
            }
        }
    }
}
