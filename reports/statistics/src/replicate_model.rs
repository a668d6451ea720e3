//! Made-up runs of scenarios that are all alike, in worlds where windows are not independent, and how often tests of them by windows
//! and by environments find a difference. The main function is [`false_rejections`].

use oorandom::Rand64;

use crate::{
    multiplicity::holm,
    noise_model::Noise,
    permutation,
    relabelling::{Effort, shuffle},
    replicates::Rounds,
};

/// What makes windows of one environment, or of one hour, alike. All is in standard deviations of window levels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct World {
    /// What it is, in words.
    pub name: &'static str,
    /// The autocorrelation of successive windows of the run, whatever environment they are of.
    pub phi: f64,
    /// How far levels move from the first to the last window of the run.
    pub drift: f64,
    /// The standard deviation of what an environment adds to all its windows.
    pub environment: f64,
}

impl World {
    const ALIKE: Self = Self {
        name: "independent windows",
        phi: 0.0,
        drift: 0.0,
        environment: 0.0,
    };

    /// Those that a test by windows was tried in, and an environment effect of two standard deviations.
    pub const ALL: [Self; 7] = [
        Self::ALIKE,
        Self {
            name: "AR .3 between successive windows",
            phi: 0.3,
            ..Self::ALIKE
        },
        Self {
            name: "AR .6 between successive windows",
            phi: 0.6,
            ..Self::ALIKE
        },
        Self {
            name: "linear drift of 2 sd over the run",
            drift: 2.0,
            ..Self::ALIKE
        },
        Self {
            name: "environment effect of .5 sd",
            environment: 0.5,
            ..Self::ALIKE
        },
        Self {
            name: "environment effect of 1 sd",
            environment: 1.0,
            ..Self::ALIKE
        },
        Self {
            name: "environment effect of 2 sd",
            environment: 2.0,
            ..Self::ALIKE
        },
    ];
}

/// How many of what are measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Design {
    /// Scenarios.
    pub scenarios: usize,
    /// Environments of each.
    pub rounds: usize,
    /// Windows in each environment.
    pub windows: usize,
}

/// How often something was found where there is nothing, as shares of the runs.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct FalseRejections {
    /// Of the first two scenarios, by the permutation test of windows.
    pub pair_by_windows: f64,
    /// Of any pair, by Holm's p of the same.
    pub any_by_windows: f64,
    /// Of the first two scenarios, by the test of environments within rounds.
    pub pair_by_environments: f64,
    /// Of any pair, by Holm's p of the same.
    pub any_by_environments: f64,
}

impl FalseRejections {
    /// The standard error that so many runs leave on a share.
    #[must_use]
    pub fn error(share: f64, runs: usize) -> f64 {
        (share * (1.0 - share) / runs as f64).sqrt()
    }
}

/// The levels of windows, by scenario, round and window.
type Levels = Vec<Vec<Vec<f64>>>;

/// Makes so many runs, and counts the p-values below `alpha`. All pairs of scenarios are the family.
#[must_use]
pub fn false_rejections(design: Design, world: World, alpha: f64, runs: usize, seed: u64) -> FalseRejections {
    let mut noise = Noise::new(seed);
    let mut order = Rand64::new(u128::from(seed) ^ 0x0DE5);
    let effort = Effort {
        enumerate: 20_000,
        draws: 1_999,
        seed,
    };
    let mut found = FalseRejections::default();
    let count = |to: &mut f64, is_found: bool| *to += f64::from(u8::from(is_found)) / runs as f64;
    for _ in 0..runs {
        let levels = made_up(design, world, &mut noise, &mut order);
        let (mut by_windows, mut by_environments) = (Vec::new(), Vec::new());
        for (at, a) in levels.iter().enumerate() {
            for b in levels.iter().skip(at + 1) {
                let test = permutation::mean_difference(&a.concat(), &b.concat(), effort);
                by_windows.push(test.map_or(1.0, |test| test.p));
                let pairs = std::iter::zip(a, b).map(|(a, b)| (mean(a), mean(b)));
                by_environments.push(Rounds::of(pairs).map_or(1.0, |rounds| rounds.test(effort).p));
            }
        }
        let is_below = |p: &[f64]| p.first().is_some_and(|p| *p <= alpha);
        let any_below = |p: &[f64]| holm(p).iter().any(|p| *p <= alpha);
        count(&mut found.pair_by_windows, is_below(&by_windows));
        count(&mut found.any_by_windows, any_below(&by_windows));
        count(&mut found.pair_by_environments, is_below(&by_environments));
        count(&mut found.any_by_environments, any_below(&by_environments));
    }
    found
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// A run: in each round the scenarios come in an order of its own, and a scenario's windows one after another.
fn made_up(design: Design, world: World, noise: &mut Noise, order: &mut Rand64) -> Levels {
    let all = design.scenarios * design.rounds * design.windows;
    let mut in_time = noise.ar1(all, world.phi).into_iter().enumerate();
    let mut levels: Levels = vec![Vec::new(); design.scenarios];
    for _ in 0..design.rounds {
        let mut turns: Vec<usize> = (0..design.scenarios).collect();
        shuffle(&mut turns, order);
        for scenario in turns {
            let environment = world.environment * noise.normal();
            let windows = in_time.by_ref().take(design.windows);
            let drifted =
                |(at, level): (usize, f64)| level + environment + world.drift * at as f64 / all as f64;
            levels[scenario].push(windows.map(drifted).collect());
        }
    }
    levels
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    const RUNS: usize = 400;

    fn limit(alpha: f64) -> f64 {
        // Three standard errors: of the seven worlds together, one in fifty seeds is above by chance.
        alpha + 3.0 * FalseRejections::error(alpha, RUNS)
    }

    #[rstest]
    fn environments_within_rounds_err_as_often_as_is_said_in_every_world(
        #[values(0, 1, 2, 3, 4, 5, 6)] world: usize,
    ) {
        let design = Design {
            scenarios: 3,
            rounds: 8,
            windows: 2,
        };
        let world = World::ALL[world];
        let found = false_rejections(design, world, 0.05, RUNS, 11);
        assert!(found.pair_by_environments <= limit(0.05), "{world:?}: {found:?}");
        assert!(found.any_by_environments <= limit(0.05), "{world:?}: {found:?}");
    }

    #[test]
    fn windows_of_one_environment_are_no_independent_units() {
        let once = Design {
            scenarios: 2,
            rounds: 1,
            windows: 8,
        };
        let [independent, .., two_sd] = World::ALL;
        let [alike, apart] = [independent, two_sd].map(|world| false_rejections(once, world, 0.05, RUNS, 3));
        assert!(alike.pair_by_windows <= limit(0.05), "{alike:?}");
        assert!(apart.pair_by_windows > 0.5, "{apart:?}");
        // One round says nothing, and says so.
        assert_eq!(apart.pair_by_environments, 0.0);
    }
}
