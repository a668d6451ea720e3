//! What a design can say with the window as the unit: the smallest p, alone and in its family, how many windows can reach the
//! level, and the shift that is found, by windows. The main type is [`WindowDesign`].

use record::{family::Member, report_settings::ReportSettings, run_directory::PlannedScenario};
use reports::analysis::setup::Experiments;
use schemars::JsonSchema;
use serde::Serialize;
use statistics::{
    noise_model::Tails,
    permutation::reachable_p,
    power::{self, Comparison, Levels, POWER, Power},
    relabelling::Effort,
};

use super::spell_p;
use crate::matrix_file::{Code, Diagnostic, MatrixFile};

/// The smallest p that a report gives to so many windows against as many.
fn smallest_p(windows: u32, seed: u64) -> f64 {
    reachable_p(windows as usize, windows as usize, Effort::of_a_report(seed))
}

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
                let is_baseline = settings.is_baseline(scenario);
                Member::new(&scenario.id, &scenario.slug, is_baseline, &scenario.axes)
            })
            .collect();
        let experiments = Experiments::of(running.iter().map(|scenario| &scenario.settings));
        let is_unlike = |a, b| experiments.differ(a, b);
        let pairs = settings.family.asked(&members, is_unlike).len();
        let windows = running
            .iter()
            .map(|scenario| scenario.settings.all_windows())
            .min()?;
        if pairs == 0 {
            return None;
        }
        let smallest = smallest_p(windows, settings.seed);
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

    /// The shift of window levels that one pair finds, at the level that Holm's first step leaves: of this many windows and of
    /// more. Simulates, which takes some tenths of a second.
    #[must_use]
    pub fn power(&self, spread: Option<LevelSpread>) -> WindowPower {
        let freedom = spread.and_then(|spread| spread.freedom);
        let point = |windows: usize| {
            let comparison = Comparison {
                n: windows,
                m: windows,
                alpha: self.alpha / self.pairs as f64,
            };
            let of = |tails, repeats| Power::simulated(comparison, Levels { tails, freedom }, repeats);
            let shift_sd = of(Tails::Normal, power::REPEATS)?.shift(POWER);
            Some(PowerPoint {
                windows,
                shift_sd,
                shift_m: spread.map(|spread| shift_sd * spread.deviation_m),
                power_heavy_tails: of(Tails::Heavy, power::REPEATS / 5)?.of(shift_sd),
            })
        };
        let planned = self.windows as usize;
        let begin = if self.can_reject() {
            Some(planned)
        } else {
            self.windows_needed
        };
        // A third more, twice and three times as many.
        let numbers = begin
            .into_iter()
            .flat_map(|least| [least, least + least.div_ceil(3), 2 * least, 3 * least]);
        WindowPower {
            power: POWER,
            alpha: self.alpha / self.pairs as f64,
            spread_m: spread.map(|spread| spread.deviation_m),
            spread_freedom: freedom,
            curve: numbers.filter_map(point).collect(),
        }
    }
}

/// How much window levels are taken to spread.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LevelSpread {
    /// Their standard deviation, in metres.
    pub deviation_m: f64,
    /// Degrees of freedom of its estimate; none where it is assumed.
    pub freedom: Option<usize>,
}

/// What the window levels of one pair show, by the number of windows.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct WindowPower {
    /// The probability with which the shifts of `curve` are found.
    pub power: f64,
    /// The level of one pair: that of Holm's first step.
    pub alpha: f64,
    /// The standard deviation of window levels, in metres; null without `--pilot` and `--window-sd`.
    pub spread_m: Option<f64>,
    /// Degrees of freedom of its estimate by the pilot, whose uncertainty is in the shifts; null without a pilot.
    pub spread_freedom: Option<usize>,
    /// For this many windows a scenario and for more; the first is the plan's if its windows can reach the level.
    pub curve: Vec<PowerPoint>,
}

impl WindowPower {
    /// That of so many windows; none where they cannot reach the level.
    #[must_use]
    pub fn at(&self, windows: u32) -> Option<&PowerPoint> {
        self.curve.iter().find(|point| point.windows == windows as usize)
    }
}

/// The shift that so many windows find.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, JsonSchema)]
pub struct PowerPoint {
    /// Windows of each of the two scenarios.
    pub windows: usize,
    /// In standard deviations of window levels, if levels are normal and windows independent.
    pub shift_sd: f64,
    /// The same in metres; null if the standard deviation is not known.
    pub shift_m: Option<f64>,
    /// The probability with which the shift is found if levels have heavy tails (Student's t with 3 degrees of freedom).
    pub power_heavy_tails: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn design(windows: u32, pairs: usize, alpha: f64) -> WindowDesign {
        let smallest = smallest_p(windows, 1);
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
        assert_eq!(paper.windows_needed, Some(9));
        assert!(design(9, 21, 0.001).can_reject() && !design(8, 21, 0.001).can_reject());
        let power = paper.power(None);
        assert_eq!(power.at(4), None);
        let windows: Vec<usize> = power.curve.iter().map(|point| point.windows).collect();
        assert_eq!(
            windows,
            [9, 12, 18],
            "27 are drawn, and 1e-4 is not below the level"
        );
    }

    // Nine windows reach the level where they are wholly apart, which 3.67 standard deviations do in 80 %: Student's formula said 3.0.
    #[test]
    fn windows_that_can_just_reach_the_level_find_only_what_sets_them_wholly_apart() {
        let shift = design(9, 21, 0.001).power(None).at(9).unwrap().shift_sd;
        assert!((3.63..3.71).contains(&shift), "{shift}");
    }

    #[test]
    fn more_windows_find_smaller_shifts() {
        let assumed = LevelSpread {
            deviation_m: 0.001,
            freedom: None,
        };
        let power = design(8, 1, 0.05).power(Some(assumed));
        let shifts: Vec<f64> = power.curve.iter().filter_map(|point| point.shift_m).collect();
        assert_eq!(shifts.len(), 4);
        assert!(shifts.windows(2).all(|pair| pair[1] < pair[0]), "{shifts:?}");
        assert!(shifts[0] < 0.002);
        assert!(
            power
                .curve
                .iter()
                .all(|point| (0.7..0.95).contains(&point.power_heavy_tails))
        );
    }

    #[test]
    fn a_pilot_of_few_windows_says_less_than_an_assumption() {
        let spread = |freedom| {
            Some(LevelSpread {
                deviation_m: 0.001,
                freedom,
            })
        };
        let shift = |freedom| {
            design(7, 1, 0.001).power(spread(freedom)).curve[0]
                .shift_m
                .unwrap()
        };
        let (assumed, few, many) = (shift(None), shift(Some(3)), shift(Some(60)));
        assert!(assumed < many && many < few, "{assumed} {many} {few}");
    }
}
