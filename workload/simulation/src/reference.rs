//! The path that the ball is to follow: periodic, so that one period's mean error is one value of the sample.
//!
//! Source: the author's public code (docs/paper.md), `x = a cos(2πft) sin(4πft)`, `y = a cos(2πft) sin(2πft)` with `f = 1/T`: in the
//! plane a figure of eight and a half. The main type is [`Reference`].

use std::f64::consts::TAU;

use record::settings::{ReferenceBy, Settings};

/// The path of one experiment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reference {
    amplitude_m: f64,
    steps_per_period: u64,
    period_ns: i64,
    by: ReferenceBy,
}

impl Reference {
    /// The path that the settings describe.
    #[must_use]
    pub fn new(settings: &Settings) -> Self {
        Self {
            amplitude_m: settings.reference.amplitude_m,
            steps_per_period: settings.steps_per_period().max(1),
            period_ns: i64::try_from(settings.period.as_nanos())
                .unwrap_or(i64::MAX)
                .max(1),
            by: settings.reference.by,
        }
    }

    /// The wanted position `[x, y]` of a control step that began when the experiment's clock showed `clock_ns`, in
    /// metres. By step, steps are counted within the period first, so that every period has the very same values, however
    /// long the run.
    #[must_use]
    pub fn at(&self, step: u64, clock_ns: i64) -> [f64; 2] {
        let of_period = match self.by {
            ReferenceBy::Step => (step % self.steps_per_period) as f64 / self.steps_per_period as f64,
            ReferenceBy::Clock => clock_ns.rem_euclid(self.period_ns) as f64 / self.period_ns as f64,
        };
        let phase = TAU * of_period;
        // Not those of the C library, whose last digit is another one on another machine.
        let common = self.amplitude_m * libm::cos(phase);
        [common * libm::sin(2.0 * phase), common * libm::sin(phase)]
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use record::settings::Dynamics;
    use rstest::rstest;

    use super::*;

    const STEP_NS: i64 = 20_000_000;

    fn reference(dynamics: Dynamics) -> Reference {
        Reference::new(&Settings::of(dynamics))
    }

    #[rstest]
    #[case::start(0, [0.0, 0.0])]
    #[case::an_eighth(625, [2.0 * 0.5_f64.sqrt(), 1.0])]
    #[case::a_quarter(1250, [0.0, 0.0])]
    #[case::three_eighths(1875, [2.0 * 0.5_f64.sqrt(), -1.0])]
    #[case::half(2500, [0.0, 0.0])]
    fn the_authors_path_has_these_points_by_step_and_by_clock(#[case] step: u64, #[case] wanted: [f64; 2]) {
        for dynamics in Dynamics::ALL {
            let at = reference(dynamics).at(step, step as i64 * STEP_NS);
            assert!(
                (at[0] - wanted[0]).abs() < 1e-12 && (at[1] - wanted[1]).abs() < 1e-12,
                "{at:?}"
            );
        }
    }

    #[test]
    fn by_clock_a_late_step_has_a_later_reference_and_by_step_it_has_not() {
        let (due_ns, late_ns) = (100 * STEP_NS, 100 * STEP_NS + 7_000_000);
        let by_clock = reference(Dynamics::Author);
        assert_ne!(by_clock.at(100, late_ns), by_clock.at(100, due_ns));
        let by_step = reference(Dynamics::Robust);
        assert_eq!(by_step.at(100, late_ns), by_step.at(100, due_ns));
    }

    proptest! {
        #[test]
        fn every_period_is_the_same_to_the_bit(step in 0_u64..5000, period in 0_u64..1_000_000) {
            let later = step + 5000 * period;
            for dynamics in Dynamics::ALL {
                let reference = reference(dynamics);
                prop_assert_eq!(
                    reference.at(step, step as i64 * STEP_NS),
                    reference.at(later, later as i64 * STEP_NS)
                );
            }
        }

        #[test]
        fn the_path_stays_within_its_amplitude(step: u64, clock_ns: i64) {
            for dynamics in Dynamics::ALL {
                let [x, y] = reference(dynamics).at(step, clock_ns);
                prop_assert!(x.abs() <= 2.0 && y.abs() <= 2.0);
            }
        }
    }
}
