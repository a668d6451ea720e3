//! The settings of the ball on the plate: the path that it is to follow, the plant and its controllers.

use serde::{Deserialize, Serialize};

use super::{Discretization, Feedback, Limit, PlantSends, Rates, ReferenceBy, StepOrder};
use crate::quantity::TimeSpan;

/// The path `x = a cos(2πft) sin(4πft)`, `y = a cos(2πft) sin(2πft)` with `f = 1/period`, in metres.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct ReferenceSettings {
    /// The amplitude `a`, in metres.
    pub amplitude_m: f64,
    /// What it is evaluated at.
    pub by: ReferenceBy,
}

impl Default for ReferenceSettings {
    fn default() -> Self {
        Self {
            amplitude_m: 2.0,
            by: ReferenceBy::Step,
        }
    }
}

/// The plant, one for each axis. The paper's is `Y/U = 1 / (16 s (b1 s + b0))`, `X/Y = -7 / s²`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct PlantSettings {
    /// The motor's `b1`.
    pub b1: f64,
    /// The motor's `b0`.
    pub b0: f64,
    /// The plate tilts this far each way, in degrees: a sixteenth of what the motor's shaft turns.
    pub angle_limit_deg: f64,
    /// The ball meets the rim at this distance from the centre, in metres.
    pub position_limit_m: f64,
    /// How motor and ball go from one step to the next.
    pub discretization: Discretization,
    /// When the plant publishes its state.
    pub sends: PlantSends,
}

impl Default for PlantSettings {
    fn default() -> Self {
        Self {
            b1: 0.01176,
            b0: 0.58823,
            angle_limit_deg: 32.0,
            position_limit_m: 3.1,
            discretization: Discretization::ZeroOrderHold,
            sends: PlantSends::OnTick,
        }
    }
}

/// The gains, the same for both axes, and when the controller ticks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct ControlSettings {
    /// Ball position to wanted plate angle.
    pub position: PdGains,
    /// Motor shaft angle (16 × the plate's) to motor voltage.
    pub angle: PdGains,
    /// How long after the plant's tick the controller's comes. It decides how many steps old the state is that the
    /// controller sees, so it is a setting and not a matter of which process started first.
    pub phase: TimeSpan,
    /// Where the rates come from.
    pub rates: Rates,
    /// The sign with which the inner loop takes the shaft's rate.
    pub angle_rate_feedback: Feedback,
    /// The wanted plate angle, before the gear, is cut to this many degrees each way; `never` for no limit.
    pub wanted_limit_deg: Limit<f64>,
    /// What comes first in a step.
    pub order: StepOrder,
}

impl Default for ControlSettings {
    fn default() -> Self {
        Self {
            position: PdGains {
                kp: -1.312,
                kd: 1.299,
            },
            angle: PdGains { kp: 5.79, kd: 0.22 },
            phase: TimeSpan::from_millis(10),
            rates: Rates::Sent,
            angle_rate_feedback: Feedback::Negative,
            wanted_limit_deg: Limit::Never,
            order: StepOrder::TakeFirst,
        }
    }
}

/// The gains of one PD controller; `kd` acts on the measured rate.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct PdGains {
    /// On the error.
    pub kp: f64,
    /// On the measured rate.
    pub kd: f64,
}
