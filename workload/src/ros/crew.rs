//! The threads of one master or one node: counted, bounded, and waited for at its end. The main type is [`Crew`].
//!
//! There is no pool: a thread belongs to the network namespace of the thread that made it, so each is made from one of
//! its own master's or node's.

use std::{
    io,
    sync::{Arc, Condvar, Mutex, PoisonError},
    thread,
    time::Duration,
};

use super::stop::Stop;

/// Enough for XML of the allowed nesting, and little to lock into memory.
const STACK_BYTES: usize = 256 * 1024;

/// More than the experiment needs tenfold; what a flood of connections may cost at most.
const MOST_THREADS: usize = 128;

/// Threads that end when their stop is raised.
#[derive(Debug, Clone)]
pub(super) struct Crew {
    stop: Stop,
    live: Arc<(Mutex<usize>, Condvar)>,
}

impl Crew {
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
    pub fn dismiss(&self, patience: Duration) -> bool {
        self.stop.raise();
        let (live, ended) = &*self.live;
        let live = live.lock().unwrap_or_else(PoisonError::into_inner);
        let waited = ended.wait_timeout_while(live, patience, |live| *live > 0);
        *waited.unwrap_or_else(PoisonError::into_inner).0 == 0
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
        let crew = Crew::new().unwrap();
        let stop = crew.stop().clone();
        crew.spawn("waits", move || drop(stop.wait(&[], None))).unwrap();
        assert!(crew.dismiss(Duration::from_secs(10)));
    }

    #[test]
    fn a_crew_has_a_largest_size() {
        let crew = Crew::new().unwrap();
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
}
