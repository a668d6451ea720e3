//! The sample of a window: one error a period, in the metric of the settings. The main type is [`Sample`].

use record::{
    report_settings::{ReportSettings, WarmUp},
    run_directory::{ControlTrace, SLICES},
    window::WindowRecord,
};

use crate::{input::run::Run, statistics::stationarity};

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
