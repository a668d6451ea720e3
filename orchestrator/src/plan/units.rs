//! What a design can say with the window or the environment as the unit: the smallest p, alone and in its family, how many units
//! can reach the level, and the shift that is found, by their number. The main type is [`Design`].

use record::{family::Member, report_settings::ReportSettings, run_directory::PlannedScenario};
use reports::analysis::setup::Experiments;
use schemars::JsonSchema;
use serde::Serialize;
use statistics::{
    noise_model::Tails,
    permutation,
    power::{self, Comparison, Levels, POWER, Power},
    relabelling::Effort,
    replicates,
};

use super::spell_p;
use crate::matrix_file::{Code, Diagnostic, MatrixFile};

/// What is compared: what a contrast of two scenarios takes for one observation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Unit {
    /// The level of a window.
    Window,
    /// The mean of an environment, beside that of the other scenario in the same round.
    Environment,
}

impl Unit {
    /// The smallest p that a report gives to so many units of each of two scenarios.
    fn smallest_p(self, units: usize, seed: u64) -> f64 {
        let effort = Effort::of_a_report(seed);
        match self {
            Self::Window => permutation::reachable_p(units, units, effort),
            Self::Environment => replicates::reachable_p(units, effort),
        }
    }

    /// The fewest units a scenario that reach a p below `alpha`.
    fn fewest(self, alpha: f64) -> Option<usize> {
        match self {
            Self::Window => power::fewest_windows(alpha),
            Self::Environment => replicates::fewest_rounds(alpha),
        }
    }

    /// The power of the test of so many units of each of two scenarios.
    fn power(self, units: usize, alpha: f64, levels: Levels, repeats: usize) -> Option<Power> {
        match self {
            Self::Window => {
                let comparison = Comparison {
                    n: units,
                    m: units,
                    alpha,
                };
                Power::simulated(comparison, levels, repeats)
            }
            Self::Environment => Power::of_rounds(units, alpha, levels, repeats),
        }
    }

    /// Several of them, which is what the setting of their number is called, too.
    #[must_use]
    pub const fn plural(self) -> &'static str {
        match self {
            Self::Window => "windows",
            Self::Environment => "environments",
        }
    }

    /// What spreads from unit to unit.
    #[must_use]
    pub const fn levels(self) -> &'static str {
        match self {
            Self::Window => "window levels",
            Self::Environment => "environment means within a round",
        }
    }

    /// So many of each of two scenarios, short.
    #[must_use]
    pub fn against(self, units: usize) -> String {
        match self {
            Self::Window => format!("{units} : {units}"),
            Self::Environment => format!("{units} rounds"),
        }
    }

    /// So many of each of two scenarios, in words.
    fn against_in_words(self, units: usize) -> String {
        match self {
            Self::Window => format!("{units} windows against {units}"),
            Self::Environment => self.against(units),
        }
    }
}

/// The pairs of scenarios of a plan that run and belong to the family.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, JsonSchema)]
pub struct Design {
    /// What is compared.
    pub unit: Unit,
    /// Units of the scenario that has fewest: of environments, the rounds that any two have in common.
    pub units: usize,
    /// Pairs of the family.
    pub pairs: usize,
    /// The level.
    pub alpha: f64,
    /// The smallest p of one pair.
    pub smallest_p: f64,
    /// The smallest that is left of it by Holm's adjustment.
    pub smallest_p_holm: f64,
    /// Units a scenario with which Holm's would be below the level.
    pub units_needed: Option<usize>,
}

impl Design {
    /// Of the scenarios that run, with the window as the unit; none without a pair.
    #[must_use]
    pub fn by_windows(scenarios: &[PlannedScenario], settings: &ReportSettings) -> Option<Self> {
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
        (pairs > 0).then(|| Self::with(Unit::Window, windows, pairs, settings))
    }

    /// The same with the environment as the unit; none where each scenario has one.
    #[must_use]
    pub fn by_environments(&self, scenarios: &[PlannedScenario], settings: &ReportSettings) -> Option<Self> {
        let running = scenarios.iter().filter(|scenario| scenario.runs());
        let environments = || running.clone().map(|scenario| scenario.settings.environments);
        let (fewest, most) = (environments().min()?, environments().max()?);
        (most > 1).then(|| Self::with(Unit::Environment, fewest, self.pairs, settings))
    }

    fn with(unit: Unit, units: u32, pairs: usize, settings: &ReportSettings) -> Self {
        let (units, alpha) = (units as usize, settings.alpha);
        let smallest = unit.smallest_p(units, settings.seed);
        Self {
            unit,
            units,
            pairs,
            alpha,
            smallest_p: smallest,
            smallest_p_holm: (smallest * pairs as f64).min(1.0),
            units_needed: unit.fewest(alpha / pairs as f64),
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
        let setting = self.unit.plural();
        let message = format!(
            "with {setting} as units no comparison can ever reject: {} reach p = {} at best, {} by Holm in a family of {}, not below \
             α = {}",
            self.unit.against_in_words(self.units),
            spell_p(self.smallest_p),
            spell_p(self.smallest_p_holm),
            self.pairs,
            self.alpha,
        );
        let help = match self.units_needed {
            Some(units) => {
                format!(
                    "write `{setting}: {units}` under `workload:`, a smaller `family` or a larger `alpha`"
                )
            }
            None => "write a larger `alpha` under `report:`".to_owned(),
        };
        let span = file.place_of(&format!("workload.{setting}"));
        Some(Diagnostic::warning(&file.source, Code::NeverRejects, span, message).help(help))
    }

    /// For a person, in a line.
    #[must_use]
    pub fn as_text(&self) -> String {
        let units = self.unit.plural();
        let can = if self.can_reject() { "below" } else { "NOT below" };
        let needed = match self.units_needed {
            Some(needed) if !self.can_reject() => format!("; {needed} {units} can reach it"),
            _ => String::new(),
        };
        format!(
            "{units} as units: smallest p {:.2e} at {}, {:.2e} by Holm in a family of {}, {can} alpha = {}{needed}\n",
            self.smallest_p,
            self.unit.against(self.units),
            self.smallest_p_holm,
            self.pairs,
            self.alpha
        )
    }

    /// The shift of levels that one pair finds, at the level that Holm's first step leaves: of this many units and of more.
    /// Simulates, which takes some tenths of a second.
    #[must_use]
    pub fn power(&self, spread: Option<LevelSpread>) -> DesignPower {
        let freedom = spread.and_then(|spread| spread.freedom);
        let alpha = self.alpha / self.pairs as f64;
        let point = |units: usize| {
            let of = |tails, repeats| self.unit.power(units, alpha, Levels { tails, freedom }, repeats);
            let shift_sd = of(Tails::Normal, power::REPEATS)?.shift(POWER);
            Some(PowerPoint {
                units,
                shift_sd,
                shift: spread.map(|spread| shift_sd * spread.deviation),
                power_heavy_tails: of(Tails::Heavy, power::REPEATS / 5)?.of(shift_sd),
            })
        };
        let begin = if self.can_reject() {
            Some(self.units)
        } else {
            self.units_needed
        };
        // A third more, twice and three times as many.
        let numbers = begin
            .into_iter()
            .flat_map(|least| [least, least + least.div_ceil(3), 2 * least, 3 * least]);
        DesignPower {
            unit: self.unit,
            power: POWER,
            alpha,
            spread: spread.map(|spread| spread.deviation),
            spread_freedom: freedom,
            curve: numbers.filter_map(point).collect(),
        }
    }
}

/// How much the levels of units are taken to spread.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LevelSpread {
    /// Their standard deviation, in the unit of the metric.
    pub deviation: f64,
    /// Degrees of freedom of its estimate; none where it is assumed.
    pub freedom: Option<usize>,
}

/// What one pair shows, by the number of units.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct DesignPower {
    /// What is compared.
    pub unit: Unit,
    /// The probability with which the shifts of `curve` are found.
    pub power: f64,
    /// The level of one pair: that of Holm's first step.
    pub alpha: f64,
    /// The standard deviation of window levels, or of environment means within a round, in the unit of the metric; null without `--pilot`,
    /// `--window-sd` and `--environment-sd`.
    pub spread: Option<f64>,
    /// Degrees of freedom of its estimate by the pilot, whose uncertainty is in the shifts; null without a pilot.
    pub spread_freedom: Option<usize>,
    /// For this many units a scenario and for more; the first is the plan's if its units can reach the level.
    pub curve: Vec<PowerPoint>,
}

impl DesignPower {
    /// That of so many units; none where they cannot reach the level.
    #[must_use]
    pub fn at(&self, units: usize) -> Option<&PowerPoint> {
        self.curve.iter().find(|point| point.units == units)
    }
}

/// The shift that so many units find.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, JsonSchema)]
pub struct PowerPoint {
    /// Units of each of the two scenarios.
    pub units: usize,
    /// In standard deviations of the units' levels, if these are normal and the units independent.
    pub shift_sd: f64,
    /// The same in the unit of the metric; null if the standard deviation is not known.
    pub shift: Option<f64>,
    /// The probability with which the shift is found if levels have heavy tails (Student's t with 3 degrees of freedom).
    pub power_heavy_tails: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn design(unit: Unit, units: u32, pairs: usize, alpha: f64) -> Design {
        let settings = ReportSettings {
            alpha,
            ..ReportSettings::default()
        };
        Design::with(unit, units, pairs, &settings)
    }

    #[test]
    fn the_papers_four_windows_cannot_reach_its_alpha() {
        let of = |windows| design(Unit::Window, windows, 21, 0.001);
        let paper = of(4);
        assert!(!paper.can_reject());
        assert_eq!(paper.units_needed, Some(9));
        assert!(of(9).can_reject() && !of(8).can_reject());
        let power = paper.power(None);
        assert_eq!(power.at(4), None);
        let windows: Vec<usize> = power.curve.iter().map(|point| point.units).collect();
        assert_eq!(
            windows,
            [9, 12, 18],
            "27 are drawn, and 1e-4 is not below the level"
        );
    }

    #[test]
    fn six_environments_do_for_one_pair_at_a_twentieth_and_ten_for_twenty_one() {
        let of = |environments, pairs| design(Unit::Environment, environments, pairs, 0.05);
        assert!(of(6, 1).can_reject() && !of(5, 1).can_reject());
        let family = of(6, 21);
        assert_eq!((family.can_reject(), family.units_needed), (false, Some(10)));
        assert!(
            family
                .as_text()
                .ends_with("NOT below alpha = 0.05; 10 environments can reach it\n")
        );
    }

    // 2⁴⁰ flips are too many to count, and of those drawn one in 10 000 is the least.
    #[test]
    fn environments_whose_flips_are_drawn_reach_no_smaller_p_than_one_of_the_draws() {
        let many = design(Unit::Environment, 40, 21, 0.001);
        assert_eq!((many.smallest_p, many.can_reject()), (1e-4, false));
        assert!(design(Unit::Environment, 32, 21, 0.001).can_reject());
    }

    // Nine windows reach the level where they are wholly apart, which 3.67 standard deviations do in 80 %: Student's formula said 3.0.
    #[test]
    fn windows_that_can_just_reach_the_level_find_only_what_sets_them_wholly_apart() {
        let power = design(Unit::Window, 9, 21, 0.001).power(None);
        let shift = power.at(9).unwrap().shift_sd;
        assert!((3.63..3.71).contains(&shift), "{shift}");
    }

    // Six rounds reach 0.05 where all six differences have one sign. The differences have √2 standard deviations of an environment:
    // six of six are above 0 in 80 % where one is in 0.8^(1/6) = 0.9635, at 1.793 · √2 = 2.536.
    #[test]
    fn environments_that_can_just_reach_the_level_find_only_what_moves_every_round() {
        let power = design(Unit::Environment, 6, 1, 0.05).power(None);
        let shift = power.at(6).unwrap().shift_sd;
        assert!((2.49..2.58).contains(&shift), "{shift}");
    }

    #[test]
    fn more_units_find_smaller_shifts() {
        let assumed = LevelSpread {
            deviation: 0.001,
            freedom: None,
        };
        for unit in [Unit::Window, Unit::Environment] {
            let power = design(unit, 8, 1, 0.05).power(Some(assumed));
            let shifts: Vec<f64> = power.curve.iter().filter_map(|point| point.shift).collect();
            assert_eq!(shifts.len(), 4);
            assert!(shifts.windows(2).all(|pair| pair[1] < pair[0]), "{shifts:?}");
            assert!(shifts[0] < 0.002);
            let heavy = power.curve.iter().map(|point| point.power_heavy_tails);
            assert!(
                heavy.clone().all(|power| (0.7..0.95).contains(&power)),
                "{power:?}"
            );
        }
    }

    #[test]
    fn a_pilot_of_few_windows_says_less_than_an_assumption() {
        let spread = |freedom| {
            Some(LevelSpread {
                deviation: 0.001,
                freedom,
            })
        };
        let shift = |freedom| {
            let power = design(Unit::Window, 7, 1, 0.001).power(spread(freedom));
            power.curve[0].shift.unwrap()
        };
        let (assumed, few, many) = (shift(None), shift(Some(3)), shift(Some(60)));
        assert!(assumed < many && many < few, "{assumed} {many} {few}");
    }
}
