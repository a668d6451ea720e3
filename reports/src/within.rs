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
    /// How many periods were cut of which windows, because these warmed up; only if that was asked for.
    pub cut: Vec<(u32, u32)>,
    /// The windows of which what is left is not steady, by number.
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
        let (mut cut, mut unsteady) = (Vec::new(), Vec::new());
        for sample in samples {
            let Some((number, record, trace)) =
                scenario.counted().find(|(number, _, _)| *number == sample.window)
            else {
                continue;
            };
            let left_out = sample.first_period.saturating_sub(1);
            match left_out.saturating_sub(settings.discarded(record.starts_run)) {
                0 => {}
                periods => cut.push((number, periods)),
            }
            let slices = trace
                .slices_m
                .get(left_out as usize * SLICES..)
                .unwrap_or_default();
            let found = Steadiness::of(slices, SLICES, &sample.errors_m, block, settings.seed);
            if !found.is_steady() {
                unsteady.push((number, found));
            }
        }
        Some(Self {
            dependence,
            cut,
            unsteady,
        })
    }
}
