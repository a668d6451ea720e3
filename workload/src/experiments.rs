//! The experiments that there are. The function is [`of`].

use record::settings::Settings;

use crate::{
    ball_on_plate::{BallOnPlate, Simulated},
    command::Command,
    experiment::Experiment,
};

/// The one that settings ask for.
#[must_use]
pub fn of(settings: &Settings) -> &'static dyn Experiment {
    match (&settings.experiment, &settings.simulation) {
        (None, None) => &BallOnPlate,
        (None, Some(_)) => &Simulated,
        (Some(_), _) => &Command,
    }
}
