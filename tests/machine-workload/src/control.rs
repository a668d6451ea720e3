//! A loop that does nothing but sleep, at the priority of the control loops. What it is late is the machine's doing: of a
//! hypervisor that gives the processors to others, above all. Tests that measure times run beside it.

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle},
    time::Duration,
};

use record::settings::RealtimeSettings;
use workload::realtime::{enter_realtime, monotonic_ns, sleep_until};

const PERIOD: Duration = Duration::from_millis(2);
/// How late the loop was, in nanoseconds.
#[derive(Debug, Clone, Copy)]
pub struct Lateness {
    /// Of 99 in a hundred wakings, the largest.
    pub p99_ns: i64,
    /// Of all.
    pub max_ns: i64,
}

/// The loop, while it runs.
struct Control {
    stop: Arc<AtomicBool>,
    thread: JoinHandle<Vec<i64>>,
}

impl Control {
    fn start() -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let thread = thread::spawn(move || {
            let _grant = enter_realtime(&RealtimeSettings::default());
            let period_ns = i64::try_from(PERIOD.as_nanos()).unwrap();
            let mut due_ns = monotonic_ns();
            let mut late_ns = Vec::new();
            loop {
                due_ns += period_ns;
                sleep_until(due_ns);
                late_ns.push(monotonic_ns() - due_ns);
                if stopped.load(Ordering::Relaxed) {
                    return late_ns;
                }
            }
        });
        Self { stop, thread }
    }

    fn end(self) -> Lateness {
        self.stop.store(true, Ordering::Relaxed);
        let mut late_ns = self.thread.join().unwrap();
        late_ns.sort_unstable();
        Lateness {
            p99_ns: late_ns[late_ns.len() * 99 / 100],
            max_ns: late_ns[late_ns.len() - 1],
        }
    }
}

/// What it returns, or how it panicked, and how late the loop was meanwhile.
pub fn beside<T>(measured: impl FnOnce() -> T) -> (thread::Result<T>, Lateness) {
    let control = Control::start();
    let outcome = catch_unwind(AssertUnwindSafe(measured));
    (outcome, control.end())
}
