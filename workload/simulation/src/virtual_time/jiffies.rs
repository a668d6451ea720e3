//! The kernel's coarse clock, which all of TCP's timers but one run on. The main type is [`Jiffies`].
//!
//! A timer never fires early: the timer wheel rounds it up to the next tick of its level, of which the first has ticks of
//! a jiffy for up to 63 jiffies ahead and each further one ticks eight times as long for eight times as far
//! (`calc_index`, `calc_wheel_index` in `kernel/time/timer.c`). A timeout of 240 ms so takes 240 to 244 ms at 250 Hz, and
//! one of 256 ms takes up to 288.

/// Debian's kernels, and this project's guests.
pub const DEBIAN_HZ: i64 = 250;

/// How far ahead the first level of the wheel reaches, and by how many bits each further level is coarser.
const FIRST_LEVEL_JIFFIES: i64 = 63;
const LEVEL_BITS: u32 = 3;
const LEVELS: u32 = 9;

/// The clock that counts timer interrupts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Jiffies {
    tick_ns: i64,
    /// How long the clock has been running when virtual time begins.
    phase_ns: i64,
}

/// When a timer is due.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Expiry {
    /// The jiffy that was asked for.
    pub jiffy: i64,
    /// When the wheel lets it fire.
    pub fires_ns: i64,
}

impl Jiffies {
    /// A clock of so many ticks a second that has been running for `phase_ns` at time zero.
    #[must_use]
    pub fn new(hz: i64, phase_ns: i64) -> Self {
        Self {
            tick_ns: 1_000_000_000 / hz.max(1),
            phase_ns,
        }
    }

    /// How many jiffies have passed.
    #[must_use]
    pub fn count(&self, now_ns: i64) -> i64 {
        now_ns.saturating_add(self.phase_ns).div_euclid(self.tick_ns)
    }

    /// A duration, rounded up (`usecs_to_jiffies`).
    #[must_use]
    pub fn of_us(&self, us: i64) -> i64 {
        let tick_us = self.tick_us();
        (us + tick_us - 1).div_euclid(tick_us)
    }

    /// A number of jiffies as a duration.
    #[must_use]
    pub fn in_us(&self, jiffies: i64) -> i64 {
        jiffies.saturating_mul(self.tick_us())
    }

    /// When a timer that is set now fires.
    #[must_use]
    pub fn after(&self, now_ns: i64, jiffies: i64) -> Expiry {
        let jiffy = self.count(now_ns).saturating_add(jiffies.max(0));
        let level = (0..LEVELS - 1)
            .find(|level| jiffies < FIRST_LEVEL_JIFFIES << (level * LEVEL_BITS))
            .unwrap_or(LEVELS - 1);
        let shift = level * LEVEL_BITS;
        let fires = ((jiffy >> shift) + 1) << shift;
        Expiry {
            jiffy,
            fires_ns: fires.saturating_mul(self.tick_ns) - self.phase_ns,
        }
    }

    fn tick_us(&self) -> i64 {
        (self.tick_ns / 1000).max(1)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rstest::rstest;

    use super::*;

    const MS: i64 = 1_000_000;

    #[rstest]
    #[case::exactly_at_a_tick(0, 60, 244)]
    #[case::just_before_the_next(3_999_999, 60, 244)]
    #[case::at_the_next(4_000_000, 60, 248)]
    #[case::last_of_the_first_level(0, 62, 252)]
    #[case::first_of_the_second_level(0, 63, 256)]
    #[case::second_level_in_steps_of_32_ms(0, 64, 288)]
    #[case::third_level_in_steps_of_256_ms(0, 504, 2048)]
    fn a_timer_fires_at_the_next_tick_of_its_level(
        #[case] now_ns: i64,
        #[case] jiffies: i64,
        #[case] fires_ms: i64,
    ) {
        let clock = Jiffies::new(DEBIAN_HZ, 0);
        assert_eq!(clock.after(now_ns, jiffies).fires_ns, fires_ms * MS);
    }

    #[test]
    fn microseconds_are_rounded_up_to_jiffies() {
        let clock = Jiffies::new(DEBIAN_HZ, 0);
        assert_eq!([0, 1, 4000, 4001].map(|us| clock.of_us(us)), [0, 1, 1, 2]);
    }

    proptest! {
        #[test]
        fn no_timer_fires_early_or_more_than_an_eighth_and_a_jiffy_late(
            now_ns in 0..10_000_000_000_i64,
            phase_ns in 0..10_000_000_000_i64,
            jiffies in 1..20_000_i64,
        ) {
            let clock = Jiffies::new(DEBIAN_HZ, phase_ns);
            let wait_ns = clock.after(now_ns, jiffies).fires_ns - now_ns;
            prop_assert!(wait_ns > jiffies * 4 * MS - 4 * MS);
            prop_assert!(clock.count(now_ns + wait_ns) > clock.count(now_ns) + jiffies);
            // A level begins at 63 of its own ticks and the tick is an eighth of the next level's.
            prop_assert!(wait_ns <= (jiffies + 1 + jiffies * 8 / 63) * 4 * MS);
        }
    }
}
