//! The controller: for each axis a PD controller on ball position gives the wanted plate angle, and a PD controller on the
//! motor's shaft gives its voltage. The main type is [`Controller`].
//!
//! Source: the author's public code (docs/paper.md); the paper has `(Kd s² + Kp s)/s` on the error, without gains.
//! `a = Kp·e + Kd·ẋ` with `e = r − x`, Kp −1.312 and Kd 1.299: the ball rolls *against* the plate's angle (`X/Y = -7/s²`),
//! so that a negative Kp drives it towards the reference and a positive Kd on the measured speed brakes it.
//! `u = Kp·(16 a − θ) ± Kd·θ̇` with Kp 5.79 and Kd 0.22 for the shaft, where positive voltage means positive angle. The
//! author's code adds the last term, which is positive feedback of the rate; subtracted, it damps ([`Feedback`]).
//!
//! With rates from the plant, exact delays of 20 ms each way (phase zero) and the author's reference this gives mean
//! |r − x| = 0.118 m a period for the ball's true position and 0.120 m for the received one; see [`crate::closed_loop`].

use record::{
    control_log::ControlRow,
    settings::{Feedback, Limit, PdGains, Rates, Settings, StepOrder},
};

use crate::plant::{AUTHORS_PI, AxisState, GEAR_RATIO};

/// Both PD controllers of both axes, and what they remember from step to step.
#[derive(Debug, Clone, PartialEq)]
pub struct Controller {
    position: PdGains,
    angle: PdGains,
    /// 1 or −1.
    angle_rate_sign: f64,
    wanted_limit_rad: f64,
    order: StepOrder,
    history: Option<History>,
    /// The action that was computed last.
    action_v: [f64; 2],
}

/// For backward differences: the state that the step before used, `[x, y]`; all zero at first.
#[derive(Debug, Clone, Copy, PartialEq)]
struct History {
    step_s: f64,
    before: [AxisState; 2],
}

/// One control step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Action {
    /// The states that it used, `[x, y]`, with the rates that it used.
    pub used: [AxisState; 2],
    /// What it computed, in volts, `[x, y]`.
    pub computed_v: [f64; 2],
}

impl Action {
    /// The row of `control.csv` with what was wanted, known and commanded; its number and times are still zero.
    #[must_use]
    pub fn row(&self, reference_m: [f64; 2]) -> ControlRow {
        let [x, y] = self.used;
        ControlRow {
            reference_x_m: reference_m[0],
            reference_y_m: reference_m[1],
            x_m: x.position_m,
            x_rate_m_s: x.speed_m_s,
            angle_x_rad: x.angle_rad,
            angle_x_rate_rad_s: x.angle_rate_rad_s,
            y_m: y.position_m,
            y_rate_m_s: y.speed_m_s,
            angle_y_rad: y.angle_rad,
            angle_y_rate_rad_s: y.angle_rate_rad_s,
            command_x_v: self.computed_v[0],
            command_y_v: self.computed_v[1],
            ..ControlRow::default()
        }
    }
}

impl Controller {
    /// As the settings have it.
    #[must_use]
    pub fn new(settings: &Settings) -> Self {
        let control = &settings.control;
        let history = match control.rates {
            Rates::Sent => None,
            Rates::Differenced => Some(History {
                step_s: settings.rate.step().as_secs_f64(),
                before: [AxisState::default(); 2],
            }),
        };
        Self {
            position: control.position,
            angle: control.angle,
            angle_rate_sign: match control.angle_rate_feedback {
                Feedback::Positive => 1.0,
                Feedback::Negative => -1.0,
            },
            wanted_limit_rad: match control.wanted_limit_deg {
                Limit::Above(degrees) => degrees * AUTHORS_PI / 180.0,
                Limit::Never => f64::INFINITY,
            },
            order: control.order,
            history,
            action_v: [0.0; 2],
        }
    }

    /// What is sent before the newest state is looked at, in volts: the action of the step before, where the settings say
    /// so.
    #[must_use]
    pub fn sends_first(&self) -> Option<[f64; 2]> {
        match self.order {
            StepOrder::SendFirst => Some(self.action_v),
            StepOrder::TakeFirst => None,
        }
    }

    /// Computes the action for wanted positions, in metres, and the newest received state; none if none has arrived yet.
    pub fn step(&mut self, reference_m: [f64; 2], newest: Option<[AxisState; 2]>) -> Action {
        let used = match &mut self.history {
            None => newest.unwrap_or_default(),
            Some(history) => match newest {
                Some(newest) => history.differenced(newest),
                // Nothing is known of the plant: the action stays what it was.
                None => {
                    return Action {
                        used: [AxisState::default(); 2],
                        computed_v: self.action_v,
                    };
                }
            },
        };
        let [x, y] = used;
        self.action_v = [
            self.voltage_v(reference_m[0], &x),
            self.voltage_v(reference_m[1], &y),
        ];
        Action {
            used,
            computed_v: self.action_v,
        }
    }

    fn voltage_v(&self, reference_m: f64, state: &AxisState) -> f64 {
        let wanted_plate_rad =
            self.position.kp * (reference_m - state.position_m) + self.position.kd * state.speed_m_s;
        let wanted_plate_rad = wanted_plate_rad.clamp(-self.wanted_limit_rad, self.wanted_limit_rad);
        let shaft_error_rad = GEAR_RATIO * wanted_plate_rad - state.angle_rad;
        self.angle.kp * shaft_error_rad + self.angle_rate_sign * self.angle.kd * state.angle_rate_rad_s
    }
}

impl History {
    fn differenced(&mut self, newest: [AxisState; 2]) -> [AxisState; 2] {
        let before = std::mem::replace(&mut self.before, newest);
        let [x, y] = newest;
        let [x_before, y_before] = before;
        [self.of_axis(&x, &x_before), self.of_axis(&y, &y_before)]
    }

    fn of_axis(&self, now: &AxisState, before: &AxisState) -> AxisState {
        AxisState {
            speed_m_s: (now.position_m - before.position_m) / self.step_s,
            angle_rate_rad_s: (now.angle_rad - before.angle_rad) / self.step_s,
            ..*now
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::approx_constant)]

    use record::settings::Dynamics;
    use rstest::rstest;

    use super::*;

    fn state(position_m: f64, speed_m_s: f64, angle_rad: f64, angle_rate_rad_s: f64) -> AxisState {
        AxisState {
            position_m,
            speed_m_s,
            angle_rad,
            angle_rate_rad_s,
        }
    }

    fn controller(dynamics: Dynamics) -> Controller {
        Controller::new(&Settings::of(dynamics))
    }

    #[rstest]
    #[case::at_rest_where_wanted(0.5, state(0.5, 0.0, 0.0, 0.0), 0.0)]
    #[case::ball_behind_tilts_down(1.0, state(0.0, 0.0, 0.0, 0.0), 5.79 * 16.0 * -1.312)]
    #[case::ball_moving_tilts_up(0.0, state(0.0, 1.0, 0.0, 0.0), 5.79 * 16.0 * 1.299)]
    #[case::shaft_turned_is_turned_back(0.0, state(0.0, 0.0, 1.0, 0.0), -5.79)]
    #[case::shaft_turning_is_braked(0.0, state(0.0, 0.0, 0.0, 1.0), -0.22)]
    fn the_gains_act_with_these_signs(
        #[case] reference_m: f64,
        #[case] state: AxisState,
        #[case] wanted_v: f64,
    ) {
        let action =
            controller(Dynamics::Robust).step([reference_m, 0.0], Some([state, AxisState::default()]));
        assert!((action.computed_v[0] - wanted_v).abs() < 1e-12, "{action:?}");
    }

    #[test]
    fn the_author_adds_what_a_turning_shaft_gives() {
        let mut controller = controller(Dynamics::Author);
        let axes = |angle_rad| Some([state(0.0, 0.0, angle_rad, 0.0), AxisState::default()]);
        controller.step([0.0; 2], axes(0.0));
        let action = controller.step([0.0; 2], axes(0.02));
        // One radian a second over a step of 20 ms.
        assert!((action.used[0].angle_rate_rad_s - 1.0).abs() < 1e-12);
        assert!(
            (action.computed_v[0] - (-5.79 * 0.02 + 0.22)).abs() < 1e-12,
            "{action:?}"
        );
    }

    #[test]
    fn a_state_used_twice_has_no_rate_and_one_after_a_lost_state_has_twice_the_rate() {
        let mut controller = controller(Dynamics::Author);
        let mut speed = |position_m| {
            let axes = [state(position_m, 0.0, 0.0, 0.0), AxisState::default()];
            controller.step([0.0; 2], Some(axes)).used[0].speed_m_s
        };
        // The ball rolls 10 mm a step.
        speed(0.00);
        assert!((speed(0.01) - 0.5).abs() < 1e-12);
        assert_eq!(speed(0.01), 0.0);
        assert!((speed(0.03) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn the_author_sends_what_the_step_before_computed_and_nothing_before_the_first_state() {
        let mut controller = controller(Dynamics::Author);
        assert_eq!(controller.sends_first(), Some([0.0, 0.0]));
        assert_eq!(controller.step([1.0, 0.0], None).computed_v, [0.0, 0.0]);
        assert_eq!(controller.sends_first(), Some([0.0, 0.0]));
        let action = controller.step([1.0, 0.0], Some([AxisState::default(); 2]));
        assert_ne!(action.computed_v, [0.0, 0.0]);
        assert_eq!(controller.sends_first(), Some(action.computed_v));
    }

    #[test]
    fn the_wanted_angle_is_cut_at_the_authors_52_degrees() {
        let action = controller(Dynamics::Author).step([3.0, 0.0], Some([AxisState::default(); 2]));
        let limit_rad = 52.0 * 3.14 / 180.0;
        assert!(
            (action.computed_v[0] + 5.79 * 16.0 * limit_rad).abs() < 1e-9,
            "{action:?}"
        );
    }
}
