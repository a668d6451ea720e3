//! What a design can say with the window as the unit: the smallest p, alone and in its family, how many windows would do,
//! and the shift that would be found, given how much window levels spread. The main type is [`WindowDesign`].

use record::{family::Member, report_settings::ReportSettings, run_directory::PlannedScenario};
use reports::{
    analysis::{power, setup::Experiments},
    statistics::permutation::smallest_p,
};
use schemars::JsonSchema;
use serde::Serialize;

use super::spell_p;
use crate::matrix_file::{Code, Diagnostic, MatrixFile};

/// The pairs of scenarios of a plan that run and belong to the family.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, JsonSchema)]
pub struct WindowDesign {
    /// Windows of the scenario that has fewest.
    pub windows: u32,
    /// Pairs of the family.
    pub pairs: usize,
    /// The level.
    pub alpha: f64,
    /// The smallest p of one pair.
    pub smallest_p: f64,
    /// The smallest that is left of it by Holm's adjustment.
    pub smallest_p_holm: f64,
    /// Windows a scenario with which Holm's would be below the level.
    pub windows_needed: Option<usize>,
}

impl WindowDesign {
    /// That of the scenarios that run; none without a pair.
    #[must_use]
    pub fn of(scenarios: &[PlannedScenario], settings: &ReportSettings) -> Option<Self> {
        let alpha = settings.alpha;
        let running: Vec<&PlannedScenario> = scenarios.iter().filter(|scenario| scenario.runs()).collect();
        let members: Vec<Member<'_>> = running
            .iter()
            .map(|scenario| {
                let is_control = settings.is_control(scenario);
                Member::new(&scenario.id, &scenario.slug, is_control, &scenario.axes)
            })
            .collect();
        let experiments = Experiments::of(running.iter().map(|scenario| &scenario.settings));
        let is_unlike = |a, b| experiments.are_unlike(a, b);
        let pairs = settings.family.asked(&members, is_unlike).len();
        let windows = running.iter().map(|scenario| scenario.settings.windows).min()?;
        if pairs == 0 {
            return None;
        }
        let smallest = smallest_p(windows as usize, windows as usize);
        Some(Self {
            windows,
            pairs,
            alpha,
            smallest_p: smallest,
            smallest_p_holm: (smallest * pairs as f64).min(1.0),
            windows_needed: power::fewest_windows(alpha / pairs as f64),
        })
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
            "with windows as units no comparison can ever reject: {w} windows against {w} reach p = {} at best, {} by Holm in a \
             family of {}, not below α = {}",
            spell_p(self.smallest_p),
            spell_p(self.smallest_p_holm),
            self.pairs,
            self.alpha,
            w = self.windows,
        );
        let help = match self.windows_needed {
            Some(windows) => format!(
                "write `windows: {windows}` under `workload:`, a smaller `family` or a larger `alpha`"
            ),
            None => "write a larger `alpha` under `report:`".to_owned(),
        };
        let span = file.place_of("workload.windows");
        Some(Diagnostic::warning(&file.source, Code::NeverRejects, span, message).help(help))
    }

    /// The shift of window levels, in metres, that one pair finds with 80 % power at the level that Holm's first step
    /// leaves, if levels spread by so much; none where the level cannot be reached.
    #[must_use]
    pub fn detectable_shift_m(&self, spread_m: f64) -> Option<f64> {
        let windows = self.windows as usize;
        power::detectable_shift(windows, windows, spread_m, self.alpha / self.pairs as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn design(windows: u32, pairs: usize, alpha: f64) -> WindowDesign {
        let smallest = smallest_p(windows as usize, windows as usize);
        WindowDesign {
            windows,
            pairs,
            alpha,
            smallest_p: smallest,
            smallest_p_holm: smallest * pairs as f64,
            windows_needed: power::fewest_windows(alpha / pairs as f64),
        }
    }

    #[test]
    fn the_papers_four_windows_cannot_reach_its_alpha() {
        let paper = design(4, 21, 0.001);
        assert!(!paper.can_reject());
        assert_eq!(paper.detectable_shift_m(0.001), None);
        assert_eq!(paper.windows_needed, Some(9));
        assert!(design(9, 21, 0.001).can_reject() && !design(8, 21, 0.001).can_reject());
    }

    #[test]
    fn more_windows_find_smaller_shifts() {
        let few = design(8, 1, 0.05).detectable_shift_m(0.001).unwrap();
        let many = design(16, 1, 0.05).detectable_shift_m(0.001).unwrap();
        assert!(many < few && few < 0.002, "{few} {many}");
    }
}
