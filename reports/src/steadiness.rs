//! Whether a window is steady: how long it warms up, and whether its level changes on the way. What is found is said; a
//! warm-up is cut only if the settings ask for it ([`crate::settings::WarmUp`]). The main type is [`Steadiness`].
//!
//! - **Warm-up** by MSER (White, *An effective truncation heuristic for bias reduction in simulation output*, 1997): the
//!   d that minimises Σ_{i ≥ d} (x_i − x̄_d)² / (n − d)², over slices of a period, so that a transient shorter than a period
//!   is seen. The error goes up and down with the reference within each period; the median of each slice of the period
//!   over all periods is taken off before.
//! - **A change of level** by the largest CUSUM, max |Σ_{i ≤ k} (x_i − x̄)|, its p by dealing blocks of periods anew, since
//!   neighbours are correlated (Kirch, *Block permutation principles for the change analysis of dependent data*, 2007).

use crate::effect::median;
use crate::relabelling::{Coverage, Effort, Relabellings};

/// A change of level is told below this p.
pub const CHANGE_LEVEL: f64 = 0.01;

/// What was found of one window.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Steadiness {
    /// Warm-up in periods, where it is longer than chance makes it.
    pub warm_up: Option<f64>,
    /// The level's change, where there is one.
    pub change: Option<Change>,
}

/// A change of level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Change {
    /// Periods before it.
    pub after: usize,
    /// By how much, in the unit of the values.
    pub by: f64,
    /// The p-value of the largest CUSUM.
    pub p: f64,
}

impl Steadiness {
    /// That of a window: its `slices`, of which each period has `per_period`, and its `periods`, of which `block`
    /// neighbours are taken together.
    #[must_use]
    pub fn of(slices: &[f64], per_period: usize, periods: &[f64], block: usize, seed: u64) -> Self {
        Self {
            warm_up: warm_up(slices, per_period),
            change: change(periods, block, seed),
        }
    }

    /// Whether nothing was found.
    #[must_use]
    pub const fn is_steady(&self) -> bool {
        self.warm_up.is_none() && self.change.is_none()
    }
}

/// The start's level must differ from the rest's by more than this many standard deviations of a slice, for its length by
/// MSER to be told: MSER alone nearly always finds some slices to cut in steady noise.
const LEAST_LEVEL: f64 = 3.0;

/// How many periods a window of such `slices` warms up for, where that is longer than chance makes it.
#[must_use]
pub fn warm_up(slices: &[f64], per_period: usize) -> Option<f64> {
    if per_period == 0 || slices.len() < 4 * per_period {
        return None;
    }
    let flat = without_cycle(slices, per_period);
    let d = mser(&flat);
    let (start, rest) = flat.split_at_checked(d)?;
    let (level, spread) = mean_and_deviation(rest)?;
    let (first, _) = mean_and_deviation(start)?;
    // Slices of a period are no independent values: the level is held against the spread of one of them.
    ((first - level).abs() > LEAST_LEVEL * spread).then(|| d as f64 / per_period as f64)
}

/// How many values to cut, by MSER; at most half of them.
fn mser(values: &[f64]) -> usize {
    let mut best = (f64::INFINITY, 0);
    let (mut sum, mut squares, mut count) = (0.0, 0.0, 0.0);
    // From the end: each step adds one value to those that stay.
    for (d, value) in values.iter().enumerate().rev() {
        sum += value;
        squares += value * value;
        count += 1.0;
        let statistic = (squares - sum * sum / count) / (count * count);
        if d <= values.len() / 2 && statistic <= best.0 {
            best = (statistic, d);
        }
    }
    best.1
}

fn without_cycle(slices: &[f64], per_period: usize) -> Vec<f64> {
    let usual: Vec<f64> = (0..per_period)
        .map(|phase| {
            median(slices.iter().skip(phase).step_by(per_period).copied().collect()).unwrap_or_default()
        })
        .collect();
    slices
        .iter()
        .zip(usual.iter().cycle())
        .map(|(slice, usual)| slice - usual)
        .collect()
}

fn mean_and_deviation(values: &[f64]) -> Option<(f64, f64)> {
    if values.is_empty() {
        return None;
    }
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / count;
    Some((mean, variance.sqrt()))
}

fn change(periods: &[f64], block: usize, seed: u64) -> Option<Change> {
    let block = block.max(1);
    let blocks = periods.len() / block;
    // With five blocks or fewer no order of them is rare enough.
    if blocks < 6 {
        return None;
    }
    let values = periods.get(periods.len() - blocks * block..)?;
    let (mean, spread) = mean_and_deviation(values)?;
    if spread <= mean.abs() * 1e-12 {
        return None;
    }
    let parts: Vec<&[f64]> = values.chunks(block).collect();
    let effort = Effort {
        enumerate: 5_040,
        draws: 999,
        seed,
    };
    let sizes = vec![1; blocks];
    let dealt = Relabellings::of(&sizes, effort, |order| {
        let dealt = order
            .iter()
            .filter_map(|part| parts.get(*part))
            .copied()
            .flatten();
        largest_cusum(dealt, mean).0
    });
    let p = dealt.test().p;
    let (_, after) = largest_cusum(values.iter(), mean);
    let (before, behind) = values.split_at_checked(after)?;
    let by = mean_and_deviation(behind)?.0 - mean_and_deviation(before)?.0;
    debug_assert!(matches!(dealt.coverage, Coverage::Exact | Coverage::MonteCarlo));
    (p < CHANGE_LEVEL).then_some(Change {
        after: after + periods.len() - values.len(),
        by,
        p,
    })
}

/// The largest |Σ (x_i − x̄)| and after how many values it is.
fn largest_cusum<'a>(values: impl Iterator<Item = &'a f64>, mean: f64) -> (f64, usize) {
    let mut sum = 0.0;
    let mut largest = (0.0, 0);
    for (at, value) in values.enumerate() {
        sum += value - mean;
        if f64::abs(sum) > largest.0 {
            largest = (f64::abs(sum), at + 1);
        }
    }
    largest
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulation::Noise;

    #[test]
    fn mser_cuts_what_is_not_like_the_rest() {
        // By hand: five values at 5, then fifteen that go between 0 and 1. Cutting the five leaves a variance of about a
        // quarter over 15; any fewer leave a 5 in.
        let mut values = vec![5.0; 5];
        values.extend((0..15).map(|i| f64::from(i % 2)));
        assert_eq!(mser(&values), 5);
        assert_eq!(mser(&[1.0; 10]), 0);
        // As docs/statistics/within.md has it.
        assert_eq!(mser(&[5.0, 3.0, 1.0, 2.0, 1.0, 2.0, 1.0, 2.0]), 2);
    }

    #[test]
    fn six_periods_at_one_level_and_six_at_another_are_a_change_after_six() {
        let mut periods = [1.0; 12];
        periods[6..].fill(3.0);
        let (sum, after) = largest_cusum(periods.iter(), 2.0);
        assert_eq!((sum, after), (6.0, 6));
        let change = change(&periods, 1, 0).unwrap();
        assert_eq!((change.after, change.by), (6, 2.0));
        assert!(change.p < CHANGE_LEVEL, "{change:?}");
    }

    #[test]
    fn a_transient_shorter_than_a_period_is_seen_through_the_cycle() {
        let mut random = Noise::new(1);
        let noise = random.ar1(600, 0.3);
        let mut slices: Vec<f64> = noise
            .iter()
            .enumerate()
            .map(|(i, noise)| 10.0 * (i as f64 * std::f64::consts::TAU / 10.0).sin() + noise)
            .collect();
        assert_eq!(warm_up(&slices, 10), None);
        for slice in slices.iter_mut().take(6) {
            *slice += 30.0;
        }
        assert_eq!(warm_up(&slices, 10), Some(0.6));
    }

    #[test]
    fn a_step_is_found_where_it_is() {
        let mut random = Noise::new(2);
        let mut periods = random.ar1(60, 0.3);
        for period in periods.iter_mut().skip(30) {
            *period += 4.0;
        }
        let change = change(&periods, 4, 0).unwrap();
        assert!((29..=31).contains(&change.after), "{change:?}");
        assert!((change.by - 4.0).abs() < 0.8 && change.p < 0.01, "{change:?}");
    }

    #[test]
    fn steady_noise_is_seldom_called_unsteady() {
        let mut random = Noise::new(4);
        let mut told = [0; 2];
        for seed in 0..60 {
            let slices = random.ar1(600, 0.7);
            let periods = random.ar1(60, 0.5);
            let found = Steadiness::of(&slices, 10, &periods, 6, seed);
            told[0] += usize::from(found.warm_up.is_some());
            told[1] += usize::from(found.change.is_some());
        }
        assert!(told[0] <= 2 && told[1] <= 3, "{told:?} of 60");
    }

    #[test]
    fn too_little_to_look_at_is_not_called_unsteady() {
        assert!(Steadiness::of(&[], 10, &[], 1, 0).is_steady());
        assert!(Steadiness::of(&[1.0; 100], 10, &[1.0; 10], 1, 0).is_steady());
    }
}
