//! The experiments that there are. The function is [`of`].

use record::settings::Settings;

use crate::{ball_on_plate::BallOnPlate, command::Command, experiment::Experiment};

/// The one that settings ask for.
#[must_use]
pub fn of(settings: &Settings) -> &'static dyn Experiment {
    match settings.experiment {
        None => &BallOnPlate,
        Some(_) => &Command,
    }
}
