//! What the control loops need of the operating system: the monotonic clock, sleep until an absolute time, real-time
//! priority and locked memory. What was refused is said in the kernel's words ([`RealtimeGrant`]), never passed over.
//!
//! Sources: clock_nanosleep(2), sched(7), mlock(2).

pub mod latest;
pub mod priority;

use nix::{
    errno::Errno,
    sys::{
        mman::{MlockAllFlags, mlockall},
        time::{TimeSpec, TimeValLike as _},
    },
    time::{ClockId, ClockNanosleepFlags, clock_getres, clock_gettime, clock_nanosleep},
};
use record::{platform::RealtimeGrant, settings::RealtimeSettings};

/// The monotonic clock, in nanoseconds since some time before the process began.
#[must_use]
pub fn monotonic_ns() -> i64 {
    read(ClockId::CLOCK_MONOTONIC)
}

/// The wall clock, in nanoseconds since 1970.
#[must_use]
pub fn unix_ns() -> i64 {
    read(ClockId::CLOCK_REALTIME)
}

/// The resolution of the monotonic clock, in nanoseconds.
#[must_use]
pub fn resolution_ns() -> i64 {
    clock_getres(ClockId::CLOCK_MONOTONIC).map_or(0, |time| time.num_nanoseconds())
}

fn read(clock: ClockId) -> i64 {
    // Neither clock can fail on Linux: both are there since 2.6.
    clock_gettime(clock).map_or(0, |time| time.num_nanoseconds())
}

/// Sleeps until the monotonic clock shows that time; returns at once if it has passed.
pub fn sleep_until(monotonic_ns: i64) {
    let deadline = TimeSpec::nanoseconds(monotonic_ns);
    // An absolute deadline makes repeating the call after a signal exact.
    while clock_nanosleep(
        ClockId::CLOCK_MONOTONIC,
        ClockNanosleepFlags::TIMER_ABSTIME,
        &deadline,
    ) == Err(Errno::EINTR)
    {}
}

/// Asks for SCHED_FIFO for the calling thread. The grant's part about memory is left as it is.
#[must_use]
pub fn enter_realtime(settings: &RealtimeSettings) -> RealtimeGrant {
    let refusal = priority::request_fifo(settings.priority).err();
    RealtimeGrant {
        priority_asked: settings.priority,
        priority_granted: if refusal.is_none() { settings.priority } else { 0 },
        priority_refusal: refusal.map(|errno| refused("SCHED_FIFO", errno)),
        ..RealtimeGrant::default()
    }
}

/// Locks all memory that the process has now, stacks included, and so brings it in. Memory that comes later is not
/// locked (MCL_FUTURE): under a limit a later allocation would fail then, and the loops make none.
pub fn lock_memory(settings: &RealtimeSettings, grant: &mut RealtimeGrant) {
    grant.lock_asked = settings.lock_memory;
    if settings.lock_memory {
        let outcome = mlockall(MlockAllFlags::MCL_CURRENT);
        grant.locked = outcome.is_ok();
        grant.lock_refusal = outcome.err().map(|errno| refused("mlockall", errno));
    }
}

fn refused(call: &str, errno: Errno) -> String {
    format!("{call}: {} ({errno:?})", errno.desc())
}

#[cfg(test)]
mod tests {
    use super::*;

    const NANOSECONDS: i64 = 1_000_000_000;

    #[test]
    fn a_deadline_is_never_met_early() {
        let deadline_ns = monotonic_ns() + 2_000_000;
        sleep_until(deadline_ns);
        assert!(monotonic_ns() >= deadline_ns);
    }

    #[test]
    fn a_deadline_in_the_past_is_no_wait() {
        let began_ns = monotonic_ns();
        sleep_until(began_ns - 3600 * NANOSECONDS);
        assert!(monotonic_ns() - began_ns < NANOSECONDS);
    }

    #[test]
    fn asking_for_nothing_is_refused_nothing() {
        let settings = RealtimeSettings {
            priority: 0,
            lock_memory: false,
        };
        let mut grant = enter_realtime(&settings);
        lock_memory(&settings, &mut grant);
        assert_eq!(grant, RealtimeGrant::default());
    }

    #[test]
    fn an_impossible_priority_is_refused_in_the_kernels_words() {
        let grant = enter_realtime(&RealtimeSettings {
            priority: 100,
            lock_memory: false,
        });
        assert_eq!(grant.priority_granted, 0);
        assert_eq!(
            grant.priority_refusal.as_deref(),
            Some("SCHED_FIFO: Invalid argument (EINVAL)")
        );
    }
}
