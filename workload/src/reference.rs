//! The path that the ball is to follow: periodic, so that one period's mean error is one value of the sample.
//!
//! Source: the author's public code, `x = a cos(2πft) sin(4πft)`, `y = a cos(2πft) sin(2πft)` with `f = 1/T`: in the
//! plane a figure of eight and a half. The main type is [`Reference`].

use std::f64::consts::TAU;

use crate::settings::Settings;

/// The path of one experiment, by control step.
///
/// It is asked by step and not by time: steps are counted within the period first, so that every period has the very
/// same values, however long the run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reference {
    amplitude_m: f64,
    steps_per_period: u64,
}

impl Reference {
    /// The path that the settings describe.
    #[must_use]
    pub fn new(settings: &Settings) -> Self {
        Self {
            amplitude_m: settings.reference.amplitude_m,
            steps_per_period: settings.steps_per_period().max(1),
        }
    }

    /// The wanted position `[x, y]` at a control step, in metres.
    #[must_use]
    pub fn at_step(&self, step: u64) -> [f64; 2] {
        let phase = TAU * (step % self.steps_per_period) as f64 / self.steps_per_period as f64;
        let common = self.amplitude_m * phase.cos();
        [common * (2.0 * phase).sin(), common * phase.sin()]
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rstest::rstest;

    use super::*;

    #[rstest]
    #[case::start(0, [0.0, 0.0])]
    #[case::an_eighth(625, [2.0 * 0.5_f64.sqrt(), 1.0])]
    #[case::a_quarter(1250, [0.0, 0.0])]
    #[case::three_eighths(1875, [2.0 * 0.5_f64.sqrt(), -1.0])]
    #[case::half(2500, [0.0, 0.0])]
    fn the_papers_path_has_these_points(#[case] step: u64, #[case] wanted: [f64; 2]) {
        let at = Reference::new(&Settings::default()).at_step(step);
        assert!(
            (at[0] - wanted[0]).abs() < 1e-12 && (at[1] - wanted[1]).abs() < 1e-12,
            "{at:?}"
        );
    }

    proptest! {
        #[test]
        fn every_period_is_the_same_to_the_bit(step in 0_u64..5000, period in 0_u64..1_000_000) {
            let reference = Reference::new(&Settings::default());
            prop_assert_eq!(reference.at_step(step), reference.at_step(step + 5000 * period));
        }

        #[test]
        fn the_path_stays_within_its_amplitude(step: u64) {
            let [x, y] = Reference::new(&Settings::default()).at_step(step);
            prop_assert!(x.abs() <= 2.0 && y.abs() <= 2.0);
        }
    }
}
