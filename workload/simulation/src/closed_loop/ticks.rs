//! The ticks of a loop in virtual time. The main type is [`Ticks`].

use oorandom::Rand64;
use record::{platform_model::TickLateness, settings::LateTicks};

use crate::{
    schedule::{Schedule, Tick},
    stalls::Stalls,
};

/// A loop's schedule as a real loop follows it (`workload/src/ball_on_plate/schedule.rs`), for ever.
#[derive(Debug)]
pub(super) struct Ticks {
    schedule: Schedule,
    late_ticks: LateTicks,
    lateness: TickLateness,
    chance: Rand64,
    /// How late the newest tick was of itself.
    late_ns: i64,
    stalls: Stalls,
    next: Tick,
}

impl Ticks {
    pub fn new(
        schedule: Schedule,
        late_ticks: LateTicks,
        lateness: &TickLateness,
        chance: Rand64,
        stalls: Stalls,
    ) -> Self {
        let mut ticks = Self {
            schedule,
            late_ticks,
            lateness: lateness.clone(),
            chance,
            late_ns: 0,
            stalls,
            next: Tick::default(),
        };
        ticks.late_ns = ticks.drawn_ns();
        ticks.prepare(0, i64::MIN);
        ticks
    }

    /// When the next one begins.
    pub const fn next_ns(&self) -> i64 {
        self.next.began_ns
    }

    /// The next one, which takes no time.
    pub fn take(&mut self) -> Tick {
        let tick = self.next;
        let persistence = self.lateness.persistence.probability();
        if persistence <= 0.0 || self.chance.rand_float() >= persistence {
            self.late_ns = self.drawn_ns();
        }
        self.prepare(tick.step + 1, tick.began_ns);
        tick
    }

    /// Nothing is drawn where no tick is late.
    fn drawn_ns(&mut self) -> i64 {
        match self.lateness.late.0.is_empty() {
            true => 0,
            false => self.lateness.late.at_ns(self.chance.rand_float()),
        }
    }

    fn prepare(&mut self, pending: u64, not_before_ns: i64) {
        let wakes_ns = self.schedule.due_ns(pending) + self.late_ns;
        let began_ns = self.stalls.over_ns(wakes_ns.max(not_before_ns));
        self.next = self.schedule.tick(self.late_ticks, pending, began_ns);
    }
}

#[cfg(test)]
mod tests {
    use record::{
        platform_model::{Quantile, Quantiles},
        quantity::{Fraction, TimeSpan},
    };
    use rstest::rstest;

    use super::*;

    const MS: i64 = 1_000_000;

    fn ticks(late_ticks: LateTicks, share: f64, length_ms: u64) -> Ticks {
        let late = Quantiles::sometimes(share, TimeSpan::from_millis(length_ms));
        with(late_ticks, late, Fraction::default())
    }

    fn with(late_ticks: LateTicks, late: Quantiles, persistence: Fraction) -> Ticks {
        let schedule = Schedule {
            first_ns: 0,
            step_ns: 20 * MS,
            steps: u64::MAX,
        };
        let lateness = TickLateness { late, persistence };
        Ticks::new(schedule, late_ticks, &lateness, Rand64::new(1), Stalls::none())
    }

    #[rstest]
    #[case::lost(LateTicks::Lost, [(2, 50), (5, 110), (8, 170)])]
    #[case::caught_up(LateTicks::CaughtUp, [(0, 50), (1, 70), (2, 90)])]
    fn ticks_that_are_all_late_by_two_and_a_half_steps(
        #[case] late_ticks: LateTicks,
        #[case] expected: [(u64, i64); 3],
    ) {
        let mut ticks = ticks(late_ticks, 1.0, 50);
        let taken = [(); 3].map(|()| ticks.take());
        assert_eq!(taken.map(|tick| (tick.step, tick.began_ns / MS)), expected);
    }

    #[test]
    fn after_a_stall_what_is_caught_up_follows_at_once_and_in_order() {
        let mut ticks = ticks(LateTicks::CaughtUp, 0.05, 100);
        let taken: Vec<Tick> = (0..2000).map(|_| ticks.take()).collect();
        assert!(taken.iter().zip(0..).all(|(tick, step)| tick.step == step));
        assert!(taken.is_sorted_by_key(|tick| tick.began_ns));
        assert!(taken.iter().all(|tick| tick.began_ns - tick.due_ns <= 100 * MS));
        let at_once = taken
            .windows(2)
            .filter(|pair| pair[0].began_ns == pair[1].began_ns);
        assert!(at_once.count() > 200);
    }

    #[test]
    fn the_share_of_ticks_that_begin_late_is_that_which_was_asked_for() {
        let mut ticks = ticks(LateTicks::Lost, 0.1, 5);
        let late = (0..20_000).filter(|_| {
            let tick = ticks.take();
            tick.began_ns > tick.due_ns
        });
        // Five standard deviations either side.
        assert!((1788..2212).contains(&late.count()));
    }

    /// As many are as late as the one before as are to be, and the distribution stays.
    #[test]
    fn ticks_that_resemble_the_one_before_have_the_same_distribution() {
        let late = Quantiles(vec![
            Quantile(0.0, TimeSpan::default()),
            Quantile(1.0, TimeSpan::from_millis(1)),
        ]);
        let mut ticks = with(LateTicks::CaughtUp, late, Fraction::from_percent(60.0));
        let late: Vec<i64> = (0..20_000)
            .map(|_| ticks.take())
            .map(|tick| tick.began_ns - tick.due_ns)
            .collect();
        let same = late.windows(2).filter(|pair| pair[0] == pair[1]).count();
        // Five standard deviations either side of 60 %, and of the mean of a uniform distribution with that correlation.
        assert!((11_650..12_350).contains(&same), "{same}");
        let mean = late.iter().sum::<i64>() as f64 / late.len() as f64;
        assert!(
            (mean - 500_000.0).abs() < 5.0 * 288_700.0 * (4.0_f64 / 20_000.0).sqrt(),
            "{mean}"
        );
    }
}
