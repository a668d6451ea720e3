//! The ball on the plate, one axis at a time. The paper has `Y/U = 1 / (16 s (b1 s + b0))` and `X/Y = -7 / s²`, with U the
//! motor's voltage, Y the plate's angle and X the ball's position; the motor's shaft turns 16 times as far as the plate. The
//! main types are [`Plant`] and [`PlantModel`].
//!
//! Two ways to make it discrete ([`Discretization`]):
//!
//! - `zero-order-hold` is exact while no limit is met: the voltage is held over a step, so that the matrix exponential of the
//!   augmented system gives the state at its end (Van Loan, *Computing integrals involving the matrix exponential*, 1978).
//! - `author` has the difference equations of the author's public code (docs/paper.md):
//!   `θ[n] = (h²/b1) u + (2 − b0 h/b1) θ[n−1] − θ[n−2]` and `x[n] = −7 h² θ[n]/16 + 2 x[n−1] − x[n−2]`. Of the motor's
//!   equation the forward difference would have `(1 − b0 h/b1)` before `θ[n−2]`: as it is, the motor does not damp.
//!
//! The limits are not of the paper, which says ±32° of the linear map between plate and shaft alone. With
//! `zero-order-hold` they are mechanical stops, seen at the end of each step: the plate stands still (its rate becomes zero if
//! it was turning outward) and turns back as soon as the motor pulls it; the ball has met the rim and lost its speed outward.
//! With `author` the values are cut and nothing else, as in the code. There is no limit on the voltage in either.

use std::time::Duration;

use nalgebra::{SMatrix, SVector};
use record::settings::{Discretization, PlantSettings};

/// Turns of the motor's shaft for one turn of the plate.
pub const GEAR_RATIO: f64 = 16.0;

/// The ball's acceleration for a plate angle of one radian, in m/s².
const BALL_GAIN: f64 = -7.0;

/// One axis.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct AxisState {
    /// Ball position, in metres.
    pub position_m: f64,
    /// Ball speed, in metres a second; with the author's difference equations the backward difference over a step.
    pub speed_m_s: f64,
    /// Angle of the motor's shaft, in radians: 16 × the plate's.
    pub angle_rad: f64,
    /// Its rate, in radians a second; a backward difference as above.
    pub angle_rate_rad_s: f64,
}

/// One axis of the plant, made discrete for one length of step.
#[derive(Debug, Clone, PartialEq)]
pub struct PlantModel {
    law: Law,
    shaft_limit_rad: f64,
    position_limit_m: f64,
}

/// From one step to the next, without limits.
#[derive(Debug, Clone, PartialEq)]
enum Law {
    ZeroOrderHold {
        /// State to state over one step. The state is shaft angle, its rate, position, speed.
        transition: Box<SMatrix<f64, 4, 4>>,
        /// Voltage to state over one step.
        input: SVector<f64, 4>,
    },
    Author {
        step_s: f64,
        /// `h²/b1`.
        of_voltage: f64,
        /// `b0 h/b1`.
        of_angle: f64,
        /// `−7 h²/16`.
        of_shaft: f64,
    },
}

impl PlantModel {
    /// The plant of the settings with steps of this length.
    #[must_use]
    pub fn new(settings: &PlantSettings, step: Duration) -> Self {
        let (law, radians_per_degree) = match settings.discretization {
            Discretization::ZeroOrderHold => (Law::zero_order_hold(settings, step), 1_f64.to_radians()),
            Discretization::Author => (Law::author(settings, step), AUTHORS_PI / 180.0),
        };
        Self {
            law,
            shaft_limit_rad: settings.angle_limit_deg * GEAR_RATIO * radians_per_degree,
            position_limit_m: settings.position_limit_m,
        }
    }

    /// The state one step later, the voltage held.
    #[must_use]
    pub fn step(&self, state: &AxisState, voltage_v: f64) -> AxisState {
        match &self.law {
            Law::ZeroOrderHold { transition, input } => {
                let before = SVector::<f64, 4>::new(
                    state.angle_rad,
                    state.angle_rate_rad_s,
                    state.position_m,
                    state.speed_m_s,
                );
                let after = **transition * before + *input * voltage_v;
                let (angle_rad, angle_rate_rad_s) = stopped_at(self.shaft_limit_rad, after[0], after[1]);
                let (position_m, speed_m_s) = stopped_at(self.position_limit_m, after[2], after[3]);
                AxisState {
                    position_m,
                    speed_m_s,
                    angle_rad,
                    angle_rate_rad_s,
                }
            }
            Law::Author {
                step_s,
                of_voltage,
                of_angle,
                of_shaft,
            } => {
                let AxisState {
                    position_m: x,
                    speed_m_s: v,
                    angle_rad: theta,
                    angle_rate_rad_s: omega,
                } = state;
                // 2 θ[n−1] − θ[n−2] is θ[n−1] and what it rose by since; the same for x.
                let angle_rad = of_voltage * voltage_v + theta + step_s * omega - of_angle * theta;
                let angle_rad = angle_rad.clamp(-self.shaft_limit_rad, self.shaft_limit_rad);
                let position_m = of_shaft * angle_rad + x + step_s * v;
                let position_m = position_m.clamp(-self.position_limit_m, self.position_limit_m);
                AxisState {
                    position_m,
                    speed_m_s: (position_m - x) / step_s,
                    angle_rad,
                    angle_rate_rad_s: (angle_rad - theta) / step_s,
                }
            }
        }
    }

    /// Whether the plate is at one of its stops.
    #[must_use]
    pub fn is_at_angle_limit(&self, state: &AxisState) -> bool {
        state.angle_rad.abs() >= self.shaft_limit_rad
    }
}

/// Both axes of the plant, tick by tick.
#[derive(Debug, Clone, PartialEq)]
pub struct Plant {
    model: PlantModel,
    discretization: Discretization,
    axes: [AxisState; 2],
}

impl Plant {
    /// At rest in the middle of the plate.
    #[must_use]
    pub fn new(settings: &PlantSettings, step: Duration) -> Self {
        Self {
            model: PlantModel::new(settings, step),
            discretization: settings.discretization,
            axes: [AxisState::default(); 2],
        }
    }

    /// A tick with the newest command `[x, y]` in volts: gives the state `[x, y]` from it on. The author's difference
    /// equations act at the tick, a held voltage from the tick on.
    pub fn tick(&mut self, voltage_v: [f64; 2]) -> [AxisState; 2] {
        let ([x, y], [x_v, y_v]) = (self.axes, voltage_v);
        let next = [self.model.step(&x, x_v), self.model.step(&y, y_v)];
        let before = std::mem::replace(&mut self.axes, next);
        match self.discretization {
            Discretization::Author => next,
            Discretization::ZeroOrderHold => before,
        }
    }

    /// Whether the plate is at one of its stops on an axis of that state.
    #[must_use]
    pub fn is_at_angle_limit(&self, axes: &[AxisState; 2]) -> bool {
        axes.iter().any(|axis| self.model.is_at_angle_limit(axis))
    }
}

/// What the author's code takes for π in its limits.
#[allow(clippy::approx_constant)]
pub const AUTHORS_PI: f64 = 3.14;

impl Law {
    fn zero_order_hold(settings: &PlantSettings, step: Duration) -> Self {
        let mut augmented = SMatrix::<f64, 5, 5>::zeros();
        augmented[(0, 1)] = 1.0;
        augmented[(1, 1)] = -settings.b0 / settings.b1;
        augmented[(1, 4)] = 1.0 / settings.b1;
        augmented[(2, 3)] = 1.0;
        augmented[(3, 0)] = BALL_GAIN / GEAR_RATIO;
        let exact = (augmented * step.as_secs_f64()).exp();
        Self::ZeroOrderHold {
            transition: Box::new(exact.fixed_view::<4, 4>(0, 0).into_owned()),
            input: exact.fixed_view::<4, 1>(0, 4).into_owned(),
        }
    }

    fn author(settings: &PlantSettings, step: Duration) -> Self {
        let step_s = step.as_secs_f64();
        Self::Author {
            step_s,
            of_voltage: step_s * step_s / settings.b1,
            of_angle: settings.b0 * step_s / settings.b1,
            of_shaft: BALL_GAIN * step_s * step_s / GEAR_RATIO,
        }
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
    #![allow(clippy::approx_constant)]

    use proptest::prelude::*;
    use record::settings::{Dynamics, Settings};

    use super::*;

    const STEP: Duration = Duration::from_millis(20);

    fn model() -> PlantModel {
        PlantModel::new(&PlantSettings::default(), STEP)
    }

    fn author() -> PlantModel {
        PlantModel::new(&Settings::of(Dynamics::Author).plant, STEP)
    }

    /// The two difference equations once more, in the form in which docs/paper.md has them.
    #[test]
    fn the_authors_steps_are_his_difference_equations() {
        let (alpha, beta, h) = (0.01176, 0.58823, 0.02);
        let (mut theta, mut x) = ([0.0_f64; 2], [0.0_f64; 2]);
        let mut state = AxisState::default();
        for n in 0..40 {
            let u = 0.3 * f64::from(n % 7) - 0.8;
            let next = h * h / alpha * u + (2.0 - beta * h / alpha) * theta[1] - theta[0];
            let next = next.clamp(-52.0 * 3.14 / 180.0, 52.0 * 3.14 / 180.0);
            theta = [theta[1], next];
            x = [x[1], -7.0 * h * h * theta[1] / 16.0 + 2.0 * x[1] - x[0]];
            state = author().step(&state, u);
            assert!(
                (state.angle_rad - theta[1]).abs() < 1e-12,
                "{n}: {state:?} {theta:?}"
            );
            assert!((state.position_m - x[1]).abs() < 1e-12, "{n}: {state:?} {x:?}");
        }
    }

    #[test]
    fn the_authors_motor_swings_for_ever_and_the_papers_comes_to_rest() {
        let swing = |model: &PlantModel| {
            let mut state = model.step(&AxisState::default(), 1.0);
            let mut largest_late = 0.0_f64;
            for n in 0..600 {
                let before = state.angle_rad;
                state = model.step(&state, 0.0);
                if n > 500 {
                    largest_late = largest_late.max((state.angle_rad - before).abs());
                }
            }
            largest_late
        };
        assert!(swing(&author()) > 0.03, "{}", swing(&author()));
        assert!(swing(&model()) < 1e-12, "{}", swing(&model()));
    }

    #[test]
    fn the_authors_limits_cut_the_shaft_at_52_degrees_and_the_ball_at_3_1_m() {
        let mut state = AxisState::default();
        for _ in 0..2000 {
            state = author().step(&state, 100.0);
            assert!(state.angle_rad <= 52.0 * 3.14 / 180.0 + 1e-12);
        }
        assert_eq!(state.position_m, -3.1);
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
