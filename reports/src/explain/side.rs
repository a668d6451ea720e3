//! A scenario of a run whose error is to be explained: its platforms and errors, unit by unit. The main type is [`Side`].

use rayon::prelude::*;
use record::{
    report_settings::ReportSettings,
    run_directory::{PlannedScenario, ReadError, RunDirectory, RunRecords},
    settings::{Settings, SimulationSettings},
};
use simulation::closed_loop::Platform;

use super::{ExplainError, Unit};
use crate::{
    analysis::{
        fields::differing,
        quantity::Quantity,
        sample::{Sample, samples},
    },
    fit::{self, FitError},
    input::run::{Run, ScenarioRun},
};

/// A run whose scenarios are explained.
pub struct Source<'a> {
    directory: &'a RunDirectory,
    records: RunRecords,
    run: &'a Run,
}

impl<'a> Source<'a> {
    /// A run as it was read, with its records.
    ///
    /// # Errors
    /// When the records cannot be read.
    pub fn of(directory: &'a RunDirectory, run: &'a Run) -> Result<Self, ReadError> {
        Ok(Self {
            directory,
            records: RunRecords::read_unpruned(directory)?,
            run,
        })
    }
}

/// A scenario with its windows that count.
pub(super) struct Side<'a> {
    source: &'a Source<'a>,
    pub planned: &'a PlannedScenario,
    samples: Vec<Sample>,
}

/// What is known of some windows of a scenario.
pub(super) struct Observed {
    /// Their mean error, in metres.
    pub error_m: f64,
    /// The platform that they were on, with the share of packets that the links lost.
    pub platform: Platform,
    /// Whether it has what messages take beside the links.
    pub has_captures: bool,
    pub remarks: Vec<String>,
}

impl<'a> Side<'a> {
    /// The scenario that is called that, by letter or slug.
    pub fn of(source: &'a Source<'a>, asked: &str) -> Result<Self, ExplainError> {
        let plan = &source.records.plan;
        let is_it = |planned: &&PlannedScenario| planned.is_called(asked);
        let Some(planned) = plan.scenarios.iter().find(is_it) else {
            return Err(ExplainError::NoSuchScenario {
                asked: asked.to_owned(),
                known: plan.scenarios.iter().map(|planned| planned.id.clone()).collect(),
            });
        };
        let settings = &source.run.manifest.report;
        let mut samples = samples(source.run, settings, &Quantity::tracking_error(settings));
        samples.retain(|sample| sample.scenario == planned.id);
        match samples.is_empty() || planned.settings.experiment.is_some() {
            true => Err(ExplainError::NoWindow {
                scenario: planned.id.clone(),
            }),
            false => Ok(Self {
                source,
                planned,
                samples,
            }),
        }
    }

    /// How the samples are made.
    pub fn report(&self) -> &ReportSettings {
        &self.source.run.manifest.report
    }

    /// The name of its run.
    pub fn run(&self) -> &str {
        &self.source.run.manifest.run
    }

    /// Its mean error over all windows, in metres.
    pub fn error_m(&self) -> f64 {
        mean_level(&self.samples.iter().collect::<Vec<_>>())
    }

    /// The errors of all periods, in metres.
    pub fn errors_m(&self) -> Vec<f64> {
        self.samples
            .iter()
            .flat_map(|sample| &sample.values)
            .copied()
            .collect()
    }

    /// They may differ in what a platform is and in the links.
    pub fn check_the_same([a, b]: [&Self; 2]) -> Result<(), ExplainError> {
        let rest = |side: &Self| {
            let mut settings = side.planned.settings.clone();
            let defaults = Settings::of(settings.dynamics);
            settings.simulation = None;
            settings.capture = defaults.capture;
            settings.realtime = defaults.realtime;
            settings.validity = defaults.validity;
            settings.network = defaults.network;
            settings.windows = defaults.windows;
            settings.environments = defaults.environments;
            serde_json::to_value(settings).unwrap_or_default()
        };
        let fields = differing(&rest(a), &rest(b));
        match fields.is_empty() {
            true => Ok(()),
            false => Err(ExplainError::OtherExperiment {
                scenarios: [a, b].map(|side| side.planned.id.clone()),
                fields: fields.into_iter().map(|(field, ..)| field).collect(),
            }),
        }
    }

    /// What differs by itself from one to the next: environments where there are several, else windows.
    fn units(&self) -> (Unit, Vec<Vec<u32>>) {
        let round = |window: u32| self.planned.settings.round_of(window);
        let windows: Vec<u32> = self.samples.iter().map(|sample| sample.window).collect();
        let rounds = windows.chunk_by(|window, next| round(*window) == round(*next));
        let rounds: Vec<Vec<u32>> = rounds.map(<[u32]>::to_vec).collect();
        match rounds.len() {
            0 | 1 => (
                Unit::Windows,
                windows.into_iter().map(|window| vec![window]).collect(),
            ),
            _ => (Unit::Environments, rounds),
        }
    }

    /// The windows of both in as many groups as the smaller one has units, and what the units are.
    pub fn groups(sides: [&Self; 2]) -> (Unit, [Vec<Vec<u32>>; 2]) {
        let [(unit_a, a), (unit_b, b)] = sides.map(Self::units);
        let unit = match (unit_a, unit_b) {
            (Unit::Environments, Unit::Environments) => Unit::Environments,
            _ => Unit::Windows,
        };
        let groups = a.len().min(b.len());
        let grouped = |units: Vec<Vec<u32>>| {
            let mut grouped = vec![Vec::new(); groups];
            for (at, windows) in units.into_iter().enumerate() {
                if let Some(group) = grouped.get_mut(at % groups.max(1)) {
                    group.extend(windows);
                }
            }
            grouped
        };
        (unit, [grouped(a), grouped(b)])
    }

    /// What each group of windows was on, and its error.
    pub fn observe(&self, groups: &[Vec<u32>]) -> Result<Vec<Observed>, FitError> {
        let observed: Vec<Result<Observed, FitError>> = groups
            .par_iter()
            .map(|windows| self.observe_group(windows))
            .collect();
        observed.into_iter().collect()
    }

    fn observe_group(&self, windows: &[u32]) -> Result<Observed, FitError> {
        let Source {
            directory, records, ..
        } = self.source;
        let known = records.state.scenario(&self.planned.slug);
        let fitted = fit::of_scenario(directory, &records.manifest.run, self.planned, &known, windows)?;
        let mut settings = self.planned.settings.clone();
        let mut remarks = Vec::new();
        let has_captures = fitted.as_ref().is_some_and(|fitted| fitted.has_captures);
        settings.simulation = fitted.map(|fitted| {
            let own = fitted.remarks.iter();
            remarks.extend(own.map(|remark| format!("{}: {remark}", self.planned.id)));
            SimulationSettings {
                platform: fitted.model,
                ..SimulationSettings::default()
            }
        });
        let mut platform = Platform::of(&settings);
        if let Some(lost) = self.share_lost(windows) {
            platform.network.impairment.loss = lost;
        }
        let own = self
            .samples
            .iter()
            .filter(|sample| windows.contains(&sample.window));
        Ok(Observed {
            error_m: mean_level(&own.collect::<Vec<_>>()),
            platform,
            has_captures,
            remarks,
        })
    }

    /// What the run has of it.
    fn scenario(&self) -> Option<&ScenarioRun> {
        let mut scenarios = self.source.run.scenarios.iter();
        scenarios.find(|scenario| scenario.planned.id == self.planned.id)
    }

    /// Whether its numbers were computed and not measured.
    pub fn is_simulated(&self) -> bool {
        self.scenario().is_some_and(ScenarioRun::is_simulated)
    }

    /// Of the packets that were offered to an end of a link; none if the links were not counted.
    fn share_lost(&self, windows: &[u32]) -> Option<f64> {
        let scenario = self.scenario()?;
        let records = scenario.counted().filter(|(window, ..)| windows.contains(window));
        let passes = records
            .flat_map(|(_, record, _)| &record.links)
            .flat_map(|link| [link.up, link.down]);
        let (offered, lost) = passes.fold((0_u64, 0_u64), |(offered, lost), pass| {
            (
                pass.offered.saturating_add(offered),
                pass.lost.saturating_add(lost),
            )
        });
        (offered > 0).then(|| (lost as f64 / offered as f64).min(1.0))
    }
}

/// The mean over windows of their mean errors.
fn mean_level(samples: &[&Sample]) -> f64 {
    let levels = samples
        .iter()
        .map(|sample| sample.values.iter().sum::<f64>() / sample.values.len() as f64);
    levels.sum::<f64>() / samples.len() as f64
}
