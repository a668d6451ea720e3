//! What is done in one go: a scenario in one round, which has an environment of its own. The main type is [`Unit`].

use std::ops::RangeInclusive;

use record::run_directory::{PlanRecord, PlannedScenario};

/// A scenario in one round.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Unit<'a> {
    /// The scenario.
    pub planned: &'a PlannedScenario,
    /// The round, from 1.
    pub round: u32,
}

impl<'a> Unit<'a> {
    /// Those of a plan that run, in the order they run.
    #[must_use]
    pub fn all(plan: &'a PlanRecord) -> Vec<Self> {
        let units = plan.rounds().flat_map(|(round, order)| {
            order.iter().filter_map(move |id| {
                let planned = plan.scenarios.iter().find(|planned| planned.id == *id)?;
                let runs = planned.runs() && round <= planned.settings.environments;
                runs.then_some(Self { planned, round })
            })
        });
        units.collect()
    }

    /// The host that runs it.
    #[must_use]
    pub fn host(&self) -> &'a str {
        self.planned.host_in(self.round)
    }

    /// Whether it is computed in virtual time, so that nothing on the host can disturb it.
    #[must_use]
    pub const fn is_computed(&self) -> bool {
        self.planned.settings.simulation.is_some()
    }

    /// The numbers of its windows.
    #[must_use]
    pub const fn windows(&self) -> RangeInclusive<u32> {
        self.planned.settings.windows_of_round(self.round)
    }
}
