//! What the values within the windows of a scenario have to do with each other, and whether its windows are steady: what a
//! reader of the counts, which take values for independent, has to know. The main type is [`WithinWindows`].

use crate::{
    dependence::Dependence, run::ScenarioRun, run_directory::SLICES, sample::Sample,
    settings::ReportSettings, steadiness::Steadiness,
};

/// Within the windows of one scenario that count.
#[derive(Debug, Clone, PartialEq)]
pub struct WithinWindows {
    /// How values depend on each other; none where no two differ.
    pub dependence: Option<Dependence>,
    /// The windows that are not steady, by number.
    pub unsteady: Vec<(u32, Steadiness)>,
}

impl WithinWindows {
    /// Those of a scenario; none without a window that counts. What is left out of a sample is not looked at here either.
    #[must_use]
    pub fn of(scenario: &ScenarioRun, samples: &[Sample], settings: &ReportSettings) -> Option<Self> {
        let samples: Vec<&Sample> = samples
            .iter()
            .filter(|sample| sample.scenario == scenario.planned.id)
            .collect();
        if samples.is_empty() {
            return None;
        }
        let windows: Vec<&[f64]> = samples.iter().map(|sample| sample.errors_m.as_slice()).collect();
        let dependence = Dependence::of(&windows);
        let block = dependence.as_ref().map_or(1, Dependence::block);
        let unsteady = samples
            .iter()
            .filter_map(|sample| {
                let (_, _, trace) = scenario
                    .counted()
                    .find(|(number, _, _)| *number == sample.window)?;
                let left_out = (sample.first_period as usize - 1) * SLICES;
                let slices = trace.slices_m.get(left_out..).unwrap_or_default();
                let found = Steadiness::of(slices, SLICES, &sample.errors_m, block, settings.seed);
                (!found.is_steady()).then_some((sample.window, found))
            })
            .collect();
        Some(Self { dependence, unsteady })
    }
}
