//! The ball on the plate, one axis at a time: `Y/U = 1 / (16 s (b1 s + b0))` and `X/Y = -7 / s²`, with U the motor's
//! voltage, Y the plate's angle and X the ball's position. The motor's shaft turns 16 times as far as the plate.
//!
//! A step is exact while no limit is met: the voltage is held constant over a step, so that the matrix exponential of
//! the augmented system gives the state at its end (zero-order hold; Van Loan, *Computing integrals involving the
//! matrix exponential*, 1978). The main types are [`PlantModel`] and [`AxisState`].
//!
//! The paper names the limits and not what happens there. Here they are mechanical stops, seen at the end of each step:
//! at ±32° the plate stands still (its rate becomes zero if it was turning outward) and turns back as soon as the motor
//! pulls it; at ±3.1 m the ball has met the rim and lost its speed outward. There is no limit on the voltage, since
//! none is given.

use std::time::Duration;

use nalgebra::{SMatrix, SVector};

use crate::settings::PlantSettings;

/// Turns of the motor's shaft for one turn of the plate.
pub const GEAR_RATIO: f64 = 16.0;

/// The ball's acceleration for a plate angle of one radian, in m/s².
const BALL_GAIN: f64 = -7.0;

/// One axis: what the plant publishes and the controller receives.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct AxisState {
    /// Ball position, in metres.
    pub position_m: f64,
    /// Ball speed, in metres a second.
    pub speed_m_s: f64,
    /// Angle of the motor's shaft, in radians: 16 × the plate's.
    pub angle_rad: f64,
    /// Its rate, in radians a second.
    pub angle_rate_rad_s: f64,
}

/// One axis of the plant, made discrete for one length of step.
#[derive(Debug, Clone, PartialEq)]
pub struct PlantModel {
    /// State to state over one step. The state is shaft angle, its rate, position, speed.
    transition: SMatrix<f64, 4, 4>,
    /// Voltage to state over one step.
    input: SVector<f64, 4>,
    shaft_limit_rad: f64,
    position_limit_m: f64,
}

impl PlantModel {
    /// The plant of the settings with steps of this length.
    #[must_use]
    pub fn new(settings: &PlantSettings, step: Duration) -> Self {
        let mut augmented = SMatrix::<f64, 5, 5>::zeros();
        augmented[(0, 1)] = 1.0;
        augmented[(1, 1)] = -settings.b0 / settings.b1;
        augmented[(1, 4)] = 1.0 / settings.b1;
        augmented[(2, 3)] = 1.0;
        augmented[(3, 0)] = BALL_GAIN / GEAR_RATIO;
        let exact = (augmented * step.as_secs_f64()).exp();
        Self {
            transition: exact.fixed_view::<4, 4>(0, 0).into_owned(),
            input: exact.fixed_view::<4, 1>(0, 4).into_owned(),
            shaft_limit_rad: settings.angle_limit_deg.to_radians() * GEAR_RATIO,
            position_limit_m: settings.position_limit_m,
        }
    }

    /// The state one step later, the voltage held.
    #[must_use]
    pub fn step(&self, state: &AxisState, voltage_v: f64) -> AxisState {
        let before = SVector::<f64, 4>::new(
            state.angle_rad,
            state.angle_rate_rad_s,
            state.position_m,
            state.speed_m_s,
        );
        let after = self.transition * before + self.input * voltage_v;
        let (angle_rad, angle_rate_rad_s) = stopped_at(self.shaft_limit_rad, after[0], after[1]);
        let (position_m, speed_m_s) = stopped_at(self.position_limit_m, after[2], after[3]);
        AxisState {
            position_m,
            speed_m_s,
            angle_rad,
            angle_rate_rad_s,
        }
    }

    /// Whether the plate is at one of its stops.
    #[must_use]
    pub fn is_at_angle_limit(&self, state: &AxisState) -> bool {
        state.angle_rad.abs() >= self.shaft_limit_rad
    }
}

/// Value and rate with a mechanical stop at ±`limit`.
fn stopped_at(limit: f64, value: f64, rate: f64) -> (f64, f64) {
    if value.abs() < limit {
        (value, rate)
    } else if value * rate > 0.0 {
        (limit.copysign(value), 0.0)
    } else {
        (limit.copysign(value), rate)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const STEP: Duration = Duration::from_millis(20);

    fn model() -> PlantModel {
        PlantModel::new(&PlantSettings::default(), STEP)
    }

    /// The motor's answer to a constant voltage has a closed form, and the ball's is its double integral.
    #[test]
    fn a_step_is_the_closed_form_solution() {
        let (b1, b0, u) = (0.01176, 0.58823, 0.5);
        let (h, tau, rate) = (STEP.as_secs_f64(), b1 / b0, u / b0);
        let decay = (-h / tau).exp();
        let after = model().step(&AxisState::default(), u);
        let angle = rate * (h - tau * (1.0 - decay));
        assert!((after.angle_rad - angle).abs() < 1e-15, "{after:?}");
        assert!(
            (after.angle_rate_rad_s - rate * (1.0 - decay)).abs() < 1e-14,
            "{after:?}"
        );
        let speed = -7.0 / 16.0 * rate * (h * h / 2.0 - tau * h + tau * tau * (1.0 - decay));
        assert!((after.speed_m_s - speed).abs() < 1e-16, "{after:?}");
        let position = -7.0 / 16.0
            * rate
            * (h.powi(3) / 6.0 - tau * h * h / 2.0 + tau * tau * h - tau.powi(3) * (1.0 - decay));
        assert!((after.position_m - position).abs() < 1e-16, "{after:?}");
    }

    #[test]
    fn a_tilted_plate_lets_the_ball_roll_at_seven_times_its_angle() {
        let mut state = AxisState {
            angle_rad: 16.0 * 0.01,
            ..AxisState::default()
        };
        for _ in 0..50 {
            state = model().step(&state, 0.0);
        }
        assert!((state.speed_m_s + 0.07).abs() < 1e-12, "{state:?}");
        assert!((state.position_m + 0.035).abs() < 1e-12, "{state:?}");
    }

    #[test]
    fn at_its_stop_the_plate_stands_still_and_comes_back_at_once() {
        let model = model();
        let mut state = AxisState::default();
        for _ in 0..100 {
            state = model.step(&state, 24.0);
        }
        assert!(model.is_at_angle_limit(&state));
        assert_eq!(state.angle_rad, 16.0 * 32_f64.to_radians());
        assert_eq!(state.angle_rate_rad_s, 0.0);
        assert!(model.step(&state, -1.0).angle_rad < state.angle_rad);
    }

    #[test]
    fn at_the_rim_the_ball_has_lost_its_speed() {
        let mut state = AxisState {
            speed_m_s: 3.0,
            ..AxisState::default()
        };
        for _ in 0..100 {
            state = model().step(&state, 0.0);
        }
        assert_eq!((state.position_m, state.speed_m_s), (3.1, 0.0));
    }

    fn free_state() -> impl Strategy<Value = AxisState> {
        (-1.0..1.0, -1.0..1.0, -1.0..1.0, -1.0..1.0).prop_map(|(position_m, speed_m_s, angle_rad, rate)| {
            AxisState {
                position_m,
                speed_m_s,
                angle_rad,
                angle_rate_rad_s: rate,
            }
        })
    }

    proptest! {
        #[test]
        fn two_steps_are_one_step_of_twice_the_length(state in free_state(), voltage in -5.0..5.0) {
            let once = PlantModel::new(&PlantSettings::default(), 2 * STEP).step(&state, voltage);
            let twice = model().step(&model().step(&state, voltage), voltage);
            prop_assert!((once.position_m - twice.position_m).abs() < 1e-12);
            prop_assert!((once.angle_rad - twice.angle_rad).abs() < 1e-12);
        }

        #[test]
        fn no_voltage_takes_the_plant_beyond_its_limits(
            state in free_state(),
            voltages in prop::collection::vec(-1e3..1e3, 1..200),
        ) {
            let model = model();
            let mut state = state;
            for voltage in voltages {
                state = model.step(&state, voltage);
                prop_assert!(state.position_m.abs() <= 3.1);
                prop_assert!(state.angle_rad.abs() <= 16.0 * 32_f64.to_radians());
            }
        }
    }
}
