//! The packets compared as the tracking error is: one value a period, every window against every other. The main type is
//! [`TrafficTally`].

use std::borrow::Cow;

use captures::{
    packets::Topic,
    traffic::{Quantity, Traffic, WindowTraffic},
};
use record::report_settings::ReportSettings;

use crate::analysis::{
    comparison::{FrameError, Tally, WindowValues, tallies},
    pairs::Pairs,
    sample::Sample,
};

/// The counts of one quantity in one direction.
#[derive(Debug, Clone, PartialEq)]
pub struct TrafficTally {
    /// Which direction.
    pub topic: Topic,
    /// Which quantity.
    pub quantity: Quantity,
    /// As those of the tracking error: of each scenario with itself and with each other.
    pub tallies: Pairs<Tally>,
}

/// Those of all quantities in both directions, of the periods that the tracking error is taken of.
///
/// # Errors
/// When they cannot be counted.
pub fn compared(
    traffic: &Traffic,
    samples: &[Sample],
    settings: &ReportSettings,
) -> Result<Vec<TrafficTally>, FrameError> {
    let sampled = sampled(traffic, samples);
    let mut compared = Vec::new();
    for topic in Topic::ALL {
        for quantity in Quantity::ALL {
            let windows: Vec<WindowValues<'_>> = sampled
                .iter()
                .map(|(window, sample)| WindowValues {
                    scenario: &sample.scenario,
                    window: sample.window,
                    values: Cow::Owned(window.values(topic, quantity, sample.first_value)),
                })
                .filter(|window| !window.values.is_empty())
                .collect();
            compared.push(TrafficTally {
                topic,
                quantity,
                tallies: Pairs::new(tallies(&windows, settings)?),
            });
        }
    }
    Ok(compared)
}

/// The windows of which there are both captures and a sample, in the order of the samples.
#[must_use]
pub fn sampled<'a>(traffic: &'a Traffic, samples: &'a [Sample]) -> Vec<(&'a WindowTraffic, &'a Sample)> {
    let captured = |sample: &Sample| {
        let mut windows = traffic.scenarios.get(&sample.scenario)?.windows.iter();
        windows.find(|window| window.window == sample.window)
    };
    samples
        .iter()
        .filter_map(|sample| Some((captured(sample)?, sample)))
        .collect()
}
