//! The packets compared as the tracking error is: one value a period, every window against every other. The main type is
//! [`TrafficTally`].

use std::borrow::Cow;

use super::{DirectionTraffic, Quantity, Traffic, WindowTraffic};
use crate::{
    comparison::{Tally, WindowValues, tallies},
    packets::Topic,
    settings::ReportSettings,
};

/// The counts of one quantity in one direction.
#[derive(Debug, Clone, PartialEq)]
pub struct TrafficTally {
    /// Which direction.
    pub topic: Topic,
    /// Which quantity.
    pub quantity: Quantity,
    /// As those of the tracking error: of each scenario with itself and with each other.
    pub tallies: Vec<Tally>,
}

/// Those of all quantities in both directions.
#[must_use]
pub fn compared(traffic: &Traffic, settings: &ReportSettings) -> Vec<TrafficTally> {
    let mut compared = Vec::new();
    for topic in Topic::ALL {
        for quantity in Quantity::ALL {
            let windows: Vec<WindowValues<'_>> = traffic
                .scenarios
                .iter()
                .flat_map(|(id, scenario)| scenario.windows.iter().map(move |window| (id, window)))
                .map(|(id, window)| WindowValues {
                    scenario: id,
                    window: window.window,
                    values: Cow::Owned(window.values(topic, quantity, settings)),
                })
                .filter(|window| !window.values.is_empty())
                .collect();
            compared.push(TrafficTally {
                topic,
                quantity,
                tallies: tallies(&windows, settings),
            });
        }
    }
    compared
}

impl WindowTraffic {
    /// One direction.
    #[must_use]
    pub fn direction(&self, topic: Topic) -> &DirectionTraffic {
        let [state, command] = &self.directions;
        match topic {
            Topic::State => state,
            Topic::Command => command,
        }
    }

    /// The values of the periods that count: those that the tracking error is taken of, and of which the packets say it.
    #[must_use]
    pub fn values(&self, topic: Topic, quantity: Quantity, settings: &ReportSettings) -> Vec<f64> {
        let periods = self.direction(topic).periods.iter();
        let counted = periods.skip(settings.discarded(self.starts_run) as usize);
        counted.filter_map(|period| quantity.of(period)).collect()
    }
}
