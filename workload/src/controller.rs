//! The controller, one axis at a time: a PD controller on ball position gives the wanted plate angle, a PD controller
//! on the motor's shaft gives its voltage. The main type is [`Controller`].
//!
//! Source: the author's public code. `a = Kp·e + Kd·ẋ` with `e = r − x` and Kp −1.312, Kd 1.299: the ball rolls
//! *against* the plate's angle (`X/Y = -7/s²`), so that a negative Kp drives it towards the reference and a positive Kd
//! on the measured speed brakes it. `u = Kp·(16 a − θ) − Kd·θ̇` with Kp 5.79, Kd 0.22 for the shaft, where positive
//! voltage means positive angle. Rates are the ones that the plant measured, not differences of what was received: a
//! message that is late must not become a jump of the rate.
//!
//! With exact delays of 20 ms each way (phase zero) and the paper's reference this gives mean |r − x| = 0.118 m a
//! period for the ball's true position and 0.120 m for the received one; see [`crate::simulation`].

use crate::{
    plant::{AxisState, GEAR_RATIO},
    settings::{ControlSettings, PdGains},
};

/// Both PD controllers of one axis. It has no memory.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Controller {
    position: PdGains,
    angle: PdGains,
}

impl Controller {
    /// With the gains of the settings.
    #[must_use]
    pub fn new(settings: &ControlSettings) -> Self {
        Self {
            position: settings.position,
            angle: settings.angle,
        }
    }

    /// The motor voltage for a wanted position, in metres, and a received state.
    #[must_use]
    pub fn voltage_v(&self, reference_m: f64, state: &AxisState) -> f64 {
        let wanted_plate_rad =
            self.position.kp * (reference_m - state.position_m) + self.position.kd * state.speed_m_s;
        let shaft_error_rad = GEAR_RATIO * wanted_plate_rad - state.angle_rad;
        self.angle.kp * shaft_error_rad - self.angle.kd * state.angle_rate_rad_s
    }
}

#[cfg(test)]
mod tests {
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
        let voltage_v = Controller::new(&ControlSettings::default()).voltage_v(reference_m, &state);
        assert!((voltage_v - wanted_v).abs() < 1e-12, "{voltage_v}");
    }
}
