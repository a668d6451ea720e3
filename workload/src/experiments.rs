//! The experiments that there are. The main function is [`of`].

use std::sync::{Arc, atomic::AtomicBool};

use record::{progress::Part, settings::Settings};

use crate::{
    ball_on_plate::{self, BallOnPlate, Simulated},
    command::{self, Command},
    experiment::{Experiment, ExperimentError, Reporter},
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

/// Runs what is on the network that settings ask for, without measuring, until `stop` is set: of the ball on the plate those of our
/// nodes that are not in `without`, of a command nothing, since its nodes are started for a window.
///
/// # Errors
/// If the platform lacks something.
pub fn rehearse(
    settings: &Settings,
    without: &[Part],
    reporter: &Reporter,
    stop: &Arc<AtomicBool>,
) -> Result<(), ExperimentError> {
    match settings.experiment {
        None => ball_on_plate::rehearse(settings, without, reporter, stop),
        Some(_) => command::rehearse(settings, reporter, stop),
    }
}
