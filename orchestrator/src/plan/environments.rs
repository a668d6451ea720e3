//! What a design can say with the environment as the unit: the smallest p, alone and in its family, and how many environments would
//! do. The main type is [`EnvironmentDesign`].

use record::run_directory::PlannedScenario;
use schemars::JsonSchema;
use serde::Serialize;
use statistics::replicates::{fewest_rounds, smallest_p};

use super::{WindowDesign, spell_p};
use crate::matrix_file::{Code, Diagnostic, MatrixFile};

/// The pairs of scenarios of a plan that run and belong to the family, where scenarios have several environments.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, JsonSchema)]
pub struct EnvironmentDesign {
    /// Environments of the scenario that has fewest: the rounds that any two have in common.
    pub environments: u32,
    /// Pairs of the family.
    pub pairs: usize,
    /// The level.
    pub alpha: f64,
    /// The smallest p of one pair.
    pub smallest_p: f64,
    /// The smallest that is left of it by Holm's adjustment.
    pub smallest_p_holm: f64,
    /// Environments a scenario with which Holm's would be below the level.
    pub environments_needed: Option<usize>,
}

impl EnvironmentDesign {
    /// That of the scenarios that run, whose family is known by its windows; none where each has one environment.
    #[must_use]
    pub fn of(scenarios: &[PlannedScenario], windows: &WindowDesign) -> Option<Self> {
        let running = scenarios.iter().filter(|scenario| scenario.runs());
        let environments = || running.clone().map(|scenario| scenario.settings.environments);
        let (fewest, most) = (environments().min()?, environments().max()?);
        (most > 1).then(|| Self::with(fewest, windows.pairs, windows.alpha))
    }

    fn with(environments: u32, pairs: usize, alpha: f64) -> Self {
        let smallest = smallest_p(environments as usize);
        Self {
            environments,
            pairs,
            alpha,
            smallest_p: smallest,
            smallest_p_holm: (smallest * pairs as f64).min(1.0),
            environments_needed: fewest_rounds(alpha / pairs.max(1) as f64),
        }
    }

    /// Whether the level can be reached in the family.
    #[must_use]
    pub fn can_reject(&self) -> bool {
        self.smallest_p_holm < self.alpha
    }

    /// That the level cannot be reached in the family, and what would do; none where it can.
    #[must_use]
    pub fn warning(&self, file: &MatrixFile) -> Option<Diagnostic> {
        if self.can_reject() {
            return None;
        }
        let message = format!(
            "with environments as units no comparison can ever reject: {} rounds reach p = {} at best, {} by Holm in a family of {}, \
             not below α = {}",
            self.environments,
            spell_p(self.smallest_p),
            spell_p(self.smallest_p_holm),
            self.pairs,
            self.alpha,
        );
        let help = match self.environments_needed {
            Some(environments) => format!(
                "write `environments: {environments}` under `workload:`, a smaller `family` or a larger `alpha`"
            ),
            None => "write a larger `alpha` under `report:`".to_owned(),
        };
        let span = file.place_of("workload.environments");
        Some(Diagnostic::warning(&file.source, Code::NeverRejects, span, message).help(help))
    }

    /// For a person, in a line.
    #[must_use]
    pub fn as_text(&self) -> String {
        let can = if self.can_reject() { "below" } else { "NOT below" };
        let needed = match self.environments_needed {
            Some(environments) if !self.can_reject() => format!("; {environments} environments would do"),
            _ => String::new(),
        };
        format!(
            "environments as units: smallest p {:.2e} in {} rounds, {:.2e} by Holm in a family of {}, {can} alpha = {}{needed}\n",
            self.smallest_p, self.environments, self.smallest_p_holm, self.pairs, self.alpha
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn six_environments_do_for_one_pair_at_a_twentieth_and_ten_for_twenty_one() {
        let one = EnvironmentDesign::with(6, 1, 0.05);
        assert!(one.can_reject() && !EnvironmentDesign::with(5, 1, 0.05).can_reject());
        let family = EnvironmentDesign::with(6, 21, 0.05);
        assert_eq!(
            (family.can_reject(), family.environments_needed),
            (false, Some(10))
        );
        assert!(
            family
                .as_text()
                .ends_with("NOT below alpha = 0.05; 10 environments would do\n")
        );
    }
}
