//! The sample of a window: the values of one metric. The main type is [`Sample`].

use record::{
    report_settings::{ReportSettings, WarmUp},
    run_directory::{ControlTrace, SLICES},
    window::WindowRecord,
};
use statistics::{effect, power::Spread, stationarity};

use crate::{
    analysis::quantity::Quantity,
    input::{
        run::Run,
        window_data::{MetricData, WindowData},
    },
};

/// The values of one window that counts.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// The scenario's letter.
    pub scenario: String,
    /// The window, from 1.
    pub window: u32,
    /// The number of the first value that is in it, from 1; of the ball on the plate a value is a period.
    pub first_value: u32,
    /// Never empty, and in the unit of the metric.
    pub values: Vec<f64>,
}

/// The samples of a run, by scenario and window. A window of which no value is left gives none.
#[must_use]
pub fn samples(run: &Run, settings: &ReportSettings, quantity: &Quantity) -> Vec<Sample> {
    run.scenarios
        .iter()
        .flat_map(|scenario| scenario.counted().map(move |counted| (scenario, counted)))
        .map(|(scenario, (window, record, data))| {
            // Of runs that were put together one may have another unit under the same name.
            let (left_out, values) = match quantity.is_of(&scenario.planned.settings) {
                true => values(record, data, settings, quantity),
                false => (0, Vec::new()),
            };
            Sample {
                scenario: scenario.planned.id.clone(),
                window,
                first_value: left_out.saturating_add(1),
                values,
            }
        })
        .filter(|sample| !sample.values.is_empty())
        .collect()
}

/// The means of a scenario's windows that count, by its letter.
#[must_use]
pub fn levels(samples: &[Sample], scenario: &str) -> Vec<f64> {
    let own = samples.iter().filter(|sample| sample.scenario == scenario);
    own.filter_map(|sample| effect::level(&sample.values)).collect()
}

/// The values of a window, and how many before them are left out.
fn values(
    record: &WindowRecord,
    data: &WindowData,
    settings: &ReportSettings,
    quantity: &Quantity,
) -> (u32, Vec<f64>) {
    match data {
        WindowData::Ball(trace) if quantity.is_tracking_error => {
            let left_out = left_out(record, trace, settings);
            let counted = trace.periods.iter().skip(left_out as usize);
            (
                left_out,
                counted.map(|period| settings.metric.of(period)).collect(),
            )
        }
        data => match data.metric(&quantity.name) {
            Some(MetricData::Values(values)) => (0, values.clone()),
            _ => (0, Vec::new()),
        },
    }
}

/// The spread of window levels within scenarios, pooled; none where no scenario has two windows.
#[must_use]
pub fn spread_of_levels(samples: &[Sample]) -> Option<Spread> {
    let scenarios = samples.chunk_by(|a, b| a.scenario == b.scenario);
    Spread::pooled(scenarios.map(|of_one| -> Vec<f64> {
        let levels = of_one.iter().map(|sample| effect::level(&sample.values));
        levels.flatten().collect()
    }))
}

/// How many periods at a window's start are not in its sample.
fn left_out(record: &WindowRecord, trace: &ControlTrace, settings: &ReportSettings) -> u32 {
    let discarded = settings.discarded(record.starts_run);
    discarded.saturating_add(match settings.warm_up {
        WarmUp::Flag => 0,
        WarmUp::Cut => {
            let slices = trace
                .slices_m
                .get(discarded as usize * SLICES..)
                .unwrap_or_default();
            stationarity::warm_up(slices, SLICES).map_or(0, |periods| periods.ceil() as u32)
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_spread_is_within_scenarios_and_not_between_them() {
        let sample = |scenario: &str, level: f64| Sample {
            scenario: scenario.to_owned(),
            window: 1,
            first_value: 1,
            values: vec![level],
        };
        let samples = [
            sample("a", 1.0),
            sample("a", 3.0),
            sample("b", 11.0),
            sample("b", 13.0),
        ];
        let spread = spread_of_levels(&samples).unwrap();
        assert!((spread.deviation - 2.0_f64.sqrt()).abs() < 1e-12);
        assert_eq!(spread.freedom, 2);
        assert_eq!(spread_of_levels(&samples[..1]), None);
    }
}
