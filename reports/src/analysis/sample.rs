//! The sample of a window: one error a period, in the metric of the settings. The main type is [`Sample`].

use record::{
    report_settings::{ReportSettings, WarmUp},
    run_directory::{ControlTrace, SLICES},
    window::WindowRecord,
};
use statistics::{effect, power::Spread, stationarity};

use crate::input::run::Run;

/// The period errors of one window that counts.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// The scenario's letter.
    pub scenario: String,
    /// The window, from 1.
    pub window: u32,
    /// The number of the first period that is in it, from 1.
    pub first_period: u32,
    /// One error a period, in metres.
    pub errors_m: Vec<f64>,
}

/// The samples of a run, by scenario and window. A window of which no period is left gives none.
#[must_use]
pub fn samples(run: &Run, settings: &ReportSettings) -> Vec<Sample> {
    run.scenarios
        .iter()
        .flat_map(|scenario| scenario.counted().map(move |counted| (scenario, counted)))
        .map(|(scenario, (window, record, trace))| {
            let left_out = left_out(record, trace, settings);
            let counted = trace.periods.iter().skip(left_out as usize);
            Sample {
                scenario: scenario.planned.id.clone(),
                window,
                first_period: left_out.saturating_add(1),
                errors_m: counted.map(|period| settings.metric.of(period)).collect(),
            }
        })
        .filter(|sample| !sample.errors_m.is_empty())
        .collect()
}

/// The spread of window levels within scenarios, pooled, in metres; none where no scenario has two windows.
#[must_use]
pub fn spread_of_levels(samples: &[Sample]) -> Option<Spread> {
    let scenarios = samples.chunk_by(|a, b| a.scenario == b.scenario);
    Spread::pooled(scenarios.map(|of_one| -> Vec<f64> {
        let levels = of_one.iter().map(|sample| effect::level(&sample.errors_m));
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
            first_period: 1,
            errors_m: vec![level],
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
