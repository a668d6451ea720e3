//! Times at which a whole machine stands still. The main type is [`Stalls`].

use oorandom::Rand64;
use record::platform_model::StallModel;

/// From the end of the draws of one second to those of the next.
const SECOND_NS: i64 = 1_000_000_000;

/// All stalls of a machine, in order, for ever. Clones have the same: whatever runs on the machine has one.
#[derive(Debug, Clone)]
pub struct Stalls {
    model: StallModel,
    chance: Rand64,
    /// The part that comes next, and where the machine goes on after those before it.
    part: i64,
    over_ns: i64,
    /// The stall of the part before that has not begun at the latest time that was asked for.
    ahead: Option<Stall>,
}

#[derive(Debug, Clone, Copy)]
struct Stall {
    begins_ns: i64,
    ends_ns: i64,
}

impl Stalls {
    /// A machine that never stands still.
    #[must_use]
    pub fn none() -> Self {
        Self::new(&StallModel::default(), 0)
    }

    /// Those of a model, drawn from a seed.
    #[must_use]
    pub fn new(model: &StallModel, seed: u64) -> Self {
        Self {
            model: model.clone(),
            chance: Rand64::new(u128::from(seed)),
            part: 0,
            over_ns: i64::MIN,
            ahead: None,
        }
    }

    /// When what is due then can happen: then, unless the machine stands still, else once it goes on. Times that are asked for never go
    /// back.
    pub fn over_ns(&mut self, due_ns: i64) -> i64 {
        if self.model.per_hour <= 0.0 {
            return due_ns;
        }
        loop {
            match self.ahead {
                Some(stall) if stall.begins_ns > due_ns => break,
                Some(stall) => {
                    self.over_ns = self.over_ns.max(stall.ends_ns);
                    self.ahead = None;
                }
                None if self.part * Self::PART_NS > due_ns => break,
                None => self.ahead = self.draw(),
            }
        }
        due_ns.max(self.over_ns)
    }

    const PART_NS: i64 = SECOND_NS / StallModel::PARTS_OF_A_SECOND as i64;

    fn draw(&mut self) -> Option<Stall> {
        let begins_ns = self.part * Self::PART_NS;
        self.part += 1;
        let probability = self.model.per_hour / StallModel::MOST_PER_HOUR;
        if self.chance.rand_float() >= probability {
            return None;
        }
        let within_ns = (self.chance.rand_float() * Self::PART_NS as f64) as i64;
        let length_ns = self.model.length.at_ns(self.chance.rand_float());
        Some(Stall {
            begins_ns: begins_ns + within_ns,
            ends_ns: begins_ns + within_ns + length_ns,
        })
    }
}

#[cfg(test)]
mod tests {
    use record::{platform_model::Quantiles, quantity::TimeSpan};

    use super::*;

    fn model(per_hour: f64, length_ms: u64) -> StallModel {
        StallModel {
            per_hour,
            length: Quantiles::always(TimeSpan::from_millis(length_ms)),
        }
    }

    const HOUR_MS: i64 = 3_600_000;

    /// How long each millisecond of an hour has to wait, in milliseconds.
    fn waits(stalls: &mut Stalls) -> Vec<i64> {
        (0..HOUR_MS)
            .map(|ms| stalls.over_ns(ms * 1_000_000) - ms * 1_000_000)
            .map(|ns| ns / 1_000_000)
            .collect()
    }

    #[test]
    fn a_machine_without_stalls_never_waits() {
        assert!(waits(&mut Stalls::none()).iter().all(|wait| *wait == 0));
    }

    #[test]
    fn as_many_begin_in_an_hour_as_are_to_and_each_lasts_as_long_as_it_is_to() {
        let waits = waits(&mut Stalls::new(&model(600.0, 50), 7));
        let stood = waits.iter().filter(|wait| **wait > 0).count();
        // 600 of 50 ms, five standard deviations of a Poisson number either side; few fall into another.
        assert!((23_800..36_200).contains(&stood), "{stood}");
        assert!(waits.contains(&49));
        let falls = waits.windows(2).all(|pair| pair[1] >= pair[0] - 1);
        assert!(falls, "whoever comes later waits less, or for a later stall");
    }

    #[test]
    fn clones_stand_still_at_the_same_times_whatever_is_asked_of_each() {
        let mut often = Stalls::new(&model(3600.0, 300), 3);
        let mut seldom = often.clone();
        let waits = waits(&mut often);
        for ms in (0..HOUR_MS).step_by(977) {
            let wait = seldom.over_ns(ms * 1_000_000) / 1_000_000 - ms;
            assert_eq!(wait, waits[usize::try_from(ms).unwrap()], "{ms}");
        }
    }

    #[test]
    fn a_stall_before_time_zero_is_none() {
        let mut stalls = Stalls::new(&model(3600.0, 10), 1);
        assert_eq!(stalls.over_ns(-5), -5);
    }
}
