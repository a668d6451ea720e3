//! What the values within the windows of a scenario have to do with each other, and whether its windows are steady: what a
//! reader of the counts, which take values for independent, has to know. The main type is [`WithinWindows`].

use record::{report_settings::ReportSettings, run_directory::SLICES};
use statistics::{
    dependence::Dependence,
    stationarity::{self, Stationarity, Unseen},
};

use crate::{
    analysis::sample::Sample,
    input::{run::ScenarioRun, window_data::WindowData},
};

/// Within the windows of one scenario that count.
#[derive(Debug, Clone, PartialEq)]
pub struct WithinWindows {
    /// How values depend on each other; none where no two differ.
    pub dependence: Option<Dependence>,
    /// How many periods were cut of which windows, because these warmed up; only if that was asked for.
    pub cut: Vec<(u32, u32)>,
    /// The windows of which what is left is not steady, by number.
    pub unsteady: Vec<(u32, Stationarity)>,
    /// Windows that count.
    pub windows: usize,
    /// What could not be looked for in which windows, and why.
    pub unseen: Vec<(u32, Look, Unseen)>,
    /// Periods in a block when a change of level is looked for.
    pub change_block: usize,
}

/// What a window is looked at for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Look {
    /// A warm-up.
    WarmUp,
    /// A change of level.
    Change,
}

impl Look {
    /// Both.
    pub const ALL: [Self; 2] = [Self::WarmUp, Self::Change];

    /// Its name in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::WarmUp => "warm-up",
            Self::Change => "change of level",
        }
    }
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
        let windows: Vec<&[f64]> = samples.iter().map(|sample| sample.values.as_slice()).collect();
        let dependence = Dependence::of(&windows);
        let noise = stationarity::dependence_but_for_changes(&windows);
        let (mut cut, mut unsteady, mut unseen) = (Vec::new(), Vec::new(), Vec::new());
        for sample in &samples {
            let Some((number, record, data)) =
                scenario.counted().find(|(number, _, _)| *number == sample.window)
            else {
                continue;
            };
            let left_out = sample.first_value.saturating_sub(1);
            match left_out.saturating_sub(settings.discarded(record.starts_run)) {
                0 => {}
                periods => cut.push((number, periods)),
            }
            let (slices, per_value) = match data {
                WindowData::Ball(trace) => (trace.slices_m.get(left_out as usize * SLICES..), SLICES),
                // Nothing finer is known of a command than its values.
                WindowData::Command(_) => (Some(sample.values.as_slice()), 1),
            };
            let slices = slices.unwrap_or_default();
            let found = Stationarity::of(slices, per_value, &sample.values, noise.as_ref(), settings.seed);
            for (look, why) in Look::ALL
                .into_iter()
                .zip([found.warm_up_unseen, found.change_unseen])
            {
                unseen.extend(why.map(|why| (number, look, why)));
            }
            if !found.is_steady() {
                unsteady.push((number, found));
            }
        }
        Some(Self {
            dependence,
            cut,
            unsteady,
            windows: samples.len(),
            unseen,
            change_block: noise.as_ref().map_or(1, Dependence::block),
        })
    }

    /// Whether any window could be looked at for anything.
    #[must_use]
    pub fn is_looked_at(&self) -> bool {
        self.unseen.len() < Look::ALL.len() * self.windows
    }
}
