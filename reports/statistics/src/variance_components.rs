//! Where numbers that were measured in levels get their variance from: values in windows, windows in environments, environments in
//! scenarios, scenarios in nights. The main type is [`Components`]; [`NextHour`] says which level is worth the next hour.
//!
//! The model is nested and random: a value is the sum of one draw for each level it is in. The estimators are those of Kalibera and
//! Jones (*Rigorous Benchmarking in Reasonable Time*, ISMM 2013, 5), with levels from 1, the lowest, and r_i repetitions at level i:
//!
//! ```text
//! S_i² = the variance of the means of level i's members around the mean of what they are in, averaged over all of those
//! T_1² = S_1²,   T_i² = S_i² − S_(i−1)² / r_(i−1)                      unbiased; below 0 by chance where the level adds little
//! r_i  = √( c_(i+1) / c_i · T_i² / T_(i+1)² )                          repetitions that cost least, for costs c
//! ```
//!
//! Two things are ours. Numbers of repetitions may differ: means are taken unweighted, and 1 / r is the mean over the members, which
//! for two levels keeps T² unbiased (Searle, Casella and McCulloch, *Variance Components*, 1992, 3.6: unweighted means) and with equal
//! numbers is theirs. And values of a window that depend on each other are worth fewer than they are: the caller says how many.
//!
//! Intervals are those of Ting, Burdick, Graybill, Jeyaratnam and Lu (*Confidence intervals on linear combinations of variance
//! components that are unrestricted in sign*, J. Statistical Computation and Simulation 35, 1990), for a difference of two mean
//! squares. They take the draws for normal. With two or three members a level they are as wide as they must be.

use statrs::distribution::{ChiSquared, ContinuousCDF, FisherSnedecor};

use crate::effect::{CONFIDENCE, Interval};

/// What was measured, in levels. All leaves are equally deep.
#[derive(Debug, Clone, PartialEq)]
pub enum Nested {
    /// The values of the lowest level that were measured together.
    Leaf(Leaf),
    /// What contains others of the level below.
    Group(Vec<Self>),
}

/// Values that were measured together.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Leaf {
    /// Their mean.
    pub mean: f64,
    /// Their variance, by n − 1.
    pub variance: f64,
    /// How many independent values they are worth for their mean; at most how many they are.
    pub worth: f64,
}

impl Leaf {
    /// Of values, each of which is worth 1 / `time` independent ones: their autocorrelation time, 1 for independent values. None
    /// of fewer than two.
    #[must_use]
    pub fn of(values: &[f64], time: f64) -> Option<Self> {
        let n = values.len() as f64;
        if values.len() < 2 {
            return None;
        }
        let mean = values.iter().sum::<f64>() / n;
        let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
        Some(Self {
            mean,
            variance: squares / (n - 1.0),
            worth: (n / time.max(1.0)).max(1.0),
        })
    }
}

/// What a level adds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Component {
    /// T²: the variance that the level adds, unbiased, and so below 0 at times. In the square of the values' unit.
    pub variance: f64,
    /// An interval for it at [`CONFIDENCE`]; none where its degrees of freedom give none. Cut at 0.
    pub interval: Option<Interval>,
    /// S²: the variance of the level's means, which has those of the levels below in it.
    pub of_means: f64,
    /// Degrees of freedom of S².
    pub freedom: f64,
}

impl Component {
    /// Its standard deviation: 0 where the estimate of the variance is below.
    #[must_use]
    pub fn spread(&self) -> f64 {
        self.variance.max(0.0).sqrt()
    }
}

/// Why it is not known what a level adds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unknown {
    /// There is one of the level in each of the next, so that nothing varies.
    OneEach,
    /// There is one of the level below in each, so that its variance is in this one's.
    NotSeparated,
}

impl Unknown {
    /// In words, for a level and the one below it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::OneEach => "one each",
            Self::NotSeparated => "not separated",
        }
    }
}

/// What each level adds, the lowest first.
#[derive(Debug, Clone, PartialEq)]
pub struct Components(pub Vec<Result<Component, Unknown>>);

/// Sums over a level.
#[derive(Debug, Clone, Copy, Default)]
struct Level {
    squares: f64,
    freedom: f64,
    /// The mean of 1 / r over the members of a group, times the group's degrees of freedom, summed.
    shares: f64,
}

impl Components {
    /// Those that several trees have together, such as one for each scenario: what is between trees is no component. None without a
    /// tree, and where leaves are not equally deep.
    #[must_use]
    pub fn of(trees: &[Nested]) -> Option<Self> {
        let depth = trees.first()?.depth()?;
        let mut levels = vec![Level::default(); depth];
        for tree in trees {
            if tree.depth() != Some(depth) {
                return None;
            }
            tree.add_to(&mut levels)?;
        }
        let mut found: Vec<Result<Component, Unknown>> = Vec::new();
        let mut below: Option<&Level> = None;
        for level in &levels {
            found.push(component(level, below));
            below = Some(level);
        }
        Some(Self(found))
    }

    /// That of a level, from 1, if it is known.
    #[must_use]
    pub fn level(&self, level: usize) -> Option<&Component> {
        self.0.get(level.checked_sub(1)?)?.as_ref().ok()
    }
}

fn component(level: &Level, below: Option<&Level>) -> Result<Component, Unknown> {
    if level.freedom <= 0.0 {
        return Err(Unknown::OneEach);
    }
    let of_means = level.squares / level.freedom;
    let Some(below) = below else {
        return Ok(Component {
            variance: of_means,
            interval: interval(of_means, level.freedom, None),
            of_means,
            freedom: level.freedom,
        });
    };
    if below.freedom <= 0.0 {
        return Err(Unknown::NotSeparated);
    }
    let taken_off = below.squares / below.freedom * (level.shares / level.freedom);
    Ok(Component {
        variance: of_means - taken_off,
        interval: interval(of_means, level.freedom, Some((taken_off, below.freedom))),
        of_means,
        freedom: level.freedom,
    })
}

impl Nested {
    /// How many levels there are, that of values included; none where leaves are not equally deep, or a group is empty.
    fn depth(&self) -> Option<usize> {
        let Self::Group(members) = self else {
            return Some(1);
        };
        let depth = members.first()?.depth()?;
        let is_even = members.iter().all(|member| member.depth() == Some(depth));
        is_even.then_some(depth + 1)
    }

    /// Its mean and how many members it has, with what it adds to each level added.
    fn add_to(&self, levels: &mut [Level]) -> Option<(f64, f64)> {
        let (level, below) = levels.split_last_mut()?;
        match self {
            Self::Leaf(leaf) => {
                // The mean of values that depend on each other has the freedom of what they are worth.
                let freedom = (leaf.worth - 1.0).max(0.0);
                level.squares += leaf.variance * freedom;
                level.freedom += freedom;
                Some((leaf.mean, leaf.worth))
            }
            Self::Group(members) => {
                let parts: Option<Vec<(f64, f64)>> =
                    members.iter().map(|member| member.add_to(below)).collect();
                let parts = parts?;
                let count = parts.len() as f64;
                let mean = parts.iter().map(|(mean, _)| mean).sum::<f64>() / count;
                let share = parts.iter().map(|(_, members)| 1.0 / members).sum::<f64>() / count;
                level.squares += parts.iter().map(|(part, _)| (part - mean).powi(2)).sum::<f64>();
                level.freedom += count - 1.0;
                level.shares += share * (count - 1.0);
                Some((mean, count))
            }
        }
    }
}

/// The interval of a mean square of so many degrees of freedom, less another one; cut at 0.
fn interval(first: f64, freedom: f64, less: Option<(f64, f64)>) -> Option<Interval> {
    let outside = (1.0 - CONFIDENCE) / 2.0;
    let [own_low, own_high] = shrinkages(freedom, outside)?;
    let (low, high) = match less {
        None => (first * (1.0 - own_low), first * (1.0 + own_high)),
        Some((second, other)) => {
            let [other_low, other_high] = shrinkages(other, outside)?;
            let ratio = FisherSnedecor::new(freedom, other).ok()?;
            let (upper, lower) = (ratio.inverse_cdf(1.0 - outside), ratio.inverse_cdf(outside));
            let cross_low = ((upper - 1.0).powi(2) - (own_low * upper).powi(2) - other_high.powi(2)) / upper;
            let cross_high = ((1.0 - lower).powi(2) - (own_high * lower).powi(2) - other_low.powi(2)) / lower;
            let down = (own_low * first).powi(2) + (other_high * second).powi(2) + cross_low * first * second;
            let up = (own_high * first).powi(2) + (other_low * second).powi(2) + cross_high * first * second;
            let estimate = first - second;
            (estimate - down.max(0.0).sqrt(), estimate + up.max(0.0).sqrt())
        }
    };
    (low.is_finite() && high.is_finite()).then_some(Interval {
        low: low.max(0.0),
        high: high.max(0.0),
        confidence: CONFIDENCE,
    })
}

/// By what share a mean square is to be taken down and up for its own interval: G = 1 − ν / χ²(1 − q) and H = ν / χ²(q) − 1.
fn shrinkages(freedom: f64, outside: f64) -> Option<[f64; 2]> {
    let squared = ChiSquared::new(freedom).ok()?;
    let low = 1.0 - freedom / squared.inverse_cdf(1.0 - outside);
    let high = freedom / squared.inverse_cdf(outside) - 1.0;
    Some([low, high])
}

const HOUR_S: f64 = 3600.0;

/// What one more of a level costs, in seconds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Costs {
    /// A window.
    pub window_s: f64,
    /// An environment, without its windows.
    pub environment_s: f64,
}

/// Where the next hour of measuring makes the mean of a scenario most certain.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NextHour {
    /// The share of the mean's variance that an hour spent on more windows in each environment takes off.
    pub by_windows: f64,
    /// The share that an hour spent on more environments takes off.
    pub by_environments: f64,
    /// The number of windows in an environment that makes the mean certain at the least cost; none where environments add no
    /// variance, so that one environment with all windows costs least.
    pub best_windows: Option<u32>,
}

impl NextHour {
    /// For a scenario of so many environments with so many windows each. `between_windows` is the variance of a window's mean within
    /// its environment, with what its values add (S² of windows), `between_environments` what environments add (T²). None
    /// without a cost or a variance.
    #[must_use]
    pub fn of(
        between_windows: f64,
        between_environments: f64,
        environments: f64,
        windows: f64,
        costs: Costs,
    ) -> Option<Self> {
        let environment = between_environments.max(0.0);
        let (all, costs_more) = (
            environment + between_windows / windows,
            costs.environment_s.max(0.0),
        );
        if !(all > 0.0 && costs.window_s > 0.0 && environments >= 1.0 && windows >= 1.0) {
            return None;
        }
        // The mean has the variance (T² + S²/r) / N. What an hour adds to r and to N need not be whole.
        let more_windows = HOUR_S / (environments * costs.window_s);
        let more_environments = HOUR_S / (costs_more + windows * costs.window_s);
        let best = (costs_more / costs.window_s * between_windows / environment)
            .sqrt()
            .ceil();
        Some(Self {
            by_windows: between_windows * (1.0 / windows - 1.0 / (windows + more_windows)) / all,
            by_environments: more_environments / (environments + more_environments),
            best_windows: (environment > 0.0).then_some(best.clamp(1.0, 10_000.0) as u32),
        })
    }

    /// Whether another environment is worth more than another window in each.
    #[must_use]
    pub fn prefers_environments(&self) -> bool {
        self.by_environments >= self.by_windows
    }
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;
    use crate::noise_model::Noise;

    fn leaf(values: &[f64]) -> Nested {
        Nested::Leaf(Leaf::of(values, 1.0).unwrap())
    }

    /// By hand, two values in two windows in two environments: [[1, 3], [4, 8]] and [[10, 10], [16, 20]].
    /// S_1² = (2 + 8 + 0 + 8) / 4 = 4.5. Window means 2, 6 and 10, 18: S_2² = (8 + 32) / 2 = 20, T_2² = 20 − 4.5/2 = 17.75.
    /// Environment means 4, 14: S_3² = 50, T_3² = 50 − 20/2 = 40.
    #[test]
    fn the_estimators_are_those_of_kalibera_and_jones() {
        let tree = Nested::Group(vec![
            Nested::Group(vec![leaf(&[1.0, 3.0]), leaf(&[4.0, 8.0])]),
            Nested::Group(vec![leaf(&[10.0, 10.0]), leaf(&[16.0, 20.0])]),
        ]);
        let components = Components::of(std::slice::from_ref(&tree)).unwrap();
        let found: Vec<(f64, f64, f64)> = (1..=3)
            .map(|level| components.level(level).unwrap())
            .map(|it| (it.of_means, it.variance, it.freedom))
            .collect();
        assert_eq!(found, [(4.5, 4.5, 4.0), (20.0, 17.75, 2.0), (50.0, 40.0, 1.0)]);
        // Two scenarios that are the same have the same components, with twice the degrees of freedom.
        let twice = Components::of(&[tree.clone(), tree]).unwrap();
        assert_eq!(
            twice.level(3).map(|it| (it.variance, it.freedom)),
            Some((40.0, 2.0))
        );
    }

    #[test]
    fn with_unequal_numbers_it_is_the_unweighted_means() {
        // By hand: windows of 2 and 4 values: S_1² = (2·1 + (4+0+0+4)/3·3) / 4 = 2.5; means 2 and 12: S_2² = 50;
        // T_2² = 50 − 2.5 · (1/2 + 1/4) / 2 = 49.0625.
        let tree = Nested::Group(vec![leaf(&[1.0, 3.0]), leaf(&[10.0, 12.0, 12.0, 14.0])]);
        let components = Components::of(&[tree]).unwrap();
        assert_eq!(components.level(1).unwrap().variance, 2.5);
        assert_eq!(components.level(2).unwrap().variance, 49.0625);
    }

    #[test]
    fn what_is_there_once_each_is_not_known_and_says_why() {
        let one_window = |values: &[f64]| Nested::Group(vec![leaf(values)]);
        let tree = Nested::Group(vec![one_window(&[1.0, 3.0]), one_window(&[4.0, 8.0])]);
        let components = Components::of(&[tree]).unwrap();
        assert_eq!(components.0[1], Err(Unknown::OneEach));
        assert_eq!(components.0[2], Err(Unknown::NotSeparated));
        assert!(Leaf::of(&[1.0], 1.0).is_none());
        let uneven = Nested::Group(vec![leaf(&[1.0, 2.0]), one_window(&[1.0, 3.0])]);
        assert_eq!(Components::of(&[uneven]), None);
        assert_eq!(Components::of(&[]), None);
    }

    #[test]
    fn values_that_depend_on_each_other_take_less_off() {
        let window = |level: f64, time: f64| {
            let values: Vec<f64> = (0..10).map(|k| level + f64::from(k % 2)).collect();
            Nested::Leaf(Leaf::of(&values, time).unwrap())
        };
        let of = |time| Components::of(&[Nested::Group(vec![window(0.0, time), window(1.0, time)])]).unwrap();
        let (independent, dependent) = (of(1.0), of(2.5));
        let between = |components: &Components| components.level(2).unwrap().variance;
        // S_1² is 10/36 either way: of ten values a tenth of it is taken off, of what is worth four a fourth.
        assert!((between(&independent) - (0.5 - 10.0 / 360.0)).abs() < 1e-12);
        assert!((between(&dependent) - (0.5 - 10.0 / 144.0)).abs() < 1e-12);
    }

    /// Made-up trees of normal draws with these standard deviations at the three levels.
    fn tree(noise: &mut Noise, environments: usize, windows: usize, spread: [f64; 3]) -> Nested {
        let environments = (0..environments).map(|_| {
            let environment = spread[2] * noise.normal();
            let windows = (0..windows).map(|_| {
                let level = environment + spread[1] * noise.normal();
                let values: Vec<f64> = (0..5).map(|_| level + spread[0] * noise.normal()).collect();
                leaf(&values)
            });
            Nested::Group(windows.collect())
        });
        Nested::Group(environments.collect())
    }

    #[rstest]
    #[case::environments_matter([1.0, 1.0, 2.0])]
    #[case::environments_add_nothing([1.0, 1.0, 0.0])]
    #[case::windows_add_nothing([1.0, 0.0, 1.0])]
    fn estimates_are_unbiased_and_intervals_cover(#[case] spread: [f64; 3]) {
        const REPEATS: usize = 1500;
        let mut noise = Noise::new(7);
        let mut sums = [0.0; 3];
        let mut covered = [0_usize; 3];
        for _ in 0..REPEATS {
            let components = Components::of(&[tree(&mut noise, 5, 3, spread)]).unwrap();
            for level in 0..3 {
                let found = components.level(level + 1).unwrap();
                let truth = spread[level].powi(2);
                sums[level] += found.variance;
                let interval = found.interval.unwrap();
                covered[level] += usize::from(interval.low <= truth && truth <= interval.high);
            }
        }
        for level in 0..3 {
            let (truth, mean) = (spread[level].powi(2), sums[level] / REPEATS as f64);
            // The estimate's standard deviation is at most 4 here: of 1500, 0.1.
            assert!(
                (mean - truth).abs() < 0.3 * truth.max(0.4),
                "level {level}: {mean} for {truth}"
            );
            let share = covered[level] as f64 / REPEATS as f64;
            assert!(share >= 0.93, "level {level}: {share}");
        }
    }

    #[test]
    fn the_next_hour_goes_where_the_variance_is() {
        let costs = Costs {
            window_s: 100.0,
            environment_s: 25.0,
        };
        let by_environment = NextHour::of(1.0, 4.0, 6.0, 4.0, costs).unwrap();
        assert!(by_environment.prefers_environments());
        // By hand: 3600/425 = 8.47 environments more than 6 leave 6/14.47; 6 windows more in each leave (4 + 1/10) / (4 + 1/4).
        assert!((by_environment.by_environments - (1.0 - 6.0 / (6.0 + 3600.0 / 425.0))).abs() < 1e-12);
        assert!((by_environment.by_windows - (1.0 - 4.1 / 4.25)).abs() < 1e-12);
        // √(25/100 · 1/4) = 0.25: one window an environment.
        assert_eq!(by_environment.best_windows, Some(1));
        let dear = Costs {
            environment_s: 10_000.0,
            ..costs
        };
        let by_window = NextHour::of(4.0, 0.25, 6.0, 4.0, dear).unwrap();
        assert!(!by_window.prefers_environments());
        // √(100 · 16) = 40.
        assert_eq!(by_window.best_windows, Some(40));
        assert_eq!(
            NextHour::of(1.0, 0.0, 2.0, 2.0, costs).unwrap().best_windows,
            None
        );
        assert_eq!(NextHour::of(0.0, 0.0, 2.0, 2.0, costs), None);
    }
}
