//! Whether a window is steady: how long it warms up, and whether its level changes on the way. What is found is said; a
//! warm-up is cut only if the settings ask for it ([`record::report_settings::WarmUp`]). The main type is [`Stationarity`].
//!
//! - **Warm-up** by MSER (White, *An effective truncation heuristic for bias reduction in simulation output*, 1997): the
//!   d that minimises Σ_{i ≥ d} (x_i − x̄_d)² / (n − d)², over slices of a period, so that a transient shorter than a period
//!   is seen. The error goes up and down with the reference within each period; the median of each slice of the period
//!   over all periods is taken off before.
//!   A best cut at about half of the window is no warm-up: White takes it for too few data, and what lasts as long is told
//!   as a change of level.
//! - **A change of level** by the largest CUSUM, max |Σ_{i ≤ k} (x_i − x̄)|, its p by permuting blocks of periods, since
//!   neighbours are correlated (Kirch, *Block permutation principles for the change analysis of dependent data*, 2007). How
//!   long a block is comes from values without the change ([`dependence_but_for_changes`]): a step makes all values go
//!   together, and would hide itself in blocks of its own length. As blocks are few, the CUSUM must also be beyond what
//!   Kolmogorov's limit allows it.

use std::fmt;

use crate::{
    dependence::Dependence,
    effect::median,
    relabelling::{Coverage, Effort, Relabellings},
};

/// A change of level is told below this p.
pub const CHANGE_LEVEL: f64 = 0.01;

/// Where Kolmogorov's limit distribution, that of the largest |Brownian bridge|, leaves [`CHANGE_LEVEL`].
const CHANGE_LIMIT: f64 = 1.627_6;

/// With five blocks or fewer no order of them is rare enough.
const LEAST_BLOCKS: usize = 6;

/// Periods below which no warm-up is looked for.
const LEAST_PERIODS: usize = 4;

/// What was found of one window.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Stationarity {
    /// Warm-up in periods, where it is longer than chance makes it.
    pub warm_up: Option<f64>,
    /// The level's change, where there is one.
    pub change: Option<Change>,
    /// Why no warm-up could be looked for; none where it was.
    pub warm_up_unseen: Option<Unseen>,
    /// Why no change of level could be looked for; none where it was.
    pub change_unseen: Option<Unseen>,
}

/// Why something could not be looked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unseen {
    /// A period has no slices.
    NoSlices,
    /// There are fewer than so many periods.
    FewPeriods(usize),
    /// There are fewer than six blocks of so many periods.
    FewBlocks(usize),
}

impl fmt::Display for Unseen {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoSlices => write!(f, "a tenth of a period is no whole number of steps"),
            Self::FewPeriods(least) => write!(f, "fewer than {least} periods"),
            Self::FewBlocks(block) => write!(f, "fewer than {LEAST_BLOCKS} blocks of {block} periods"),
        }
    }
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

impl Stationarity {
    /// That of a window: its `slices`, of which each period has `per_period`, and its `periods`, which depend on each other
    /// as in `noise` ([`dependence_but_for_changes`]).
    #[must_use]
    pub fn of(
        slices: &[f64],
        per_period: usize,
        periods: &[f64],
        noise: Option<&Dependence>,
        seed: u64,
    ) -> Self {
        let block = noise.map_or(1, Dependence::block);
        let warm_up_unseen = match slices.len() {
            0 if periods.len() >= LEAST_PERIODS => Some(Unseen::NoSlices),
            few if per_period == 0 || few < LEAST_PERIODS * per_period => {
                Some(Unseen::FewPeriods(LEAST_PERIODS))
            }
            _ => None,
        };
        let change_unseen = (periods.len() / block < LEAST_BLOCKS).then_some(match block {
            1 => Unseen::FewPeriods(LEAST_BLOCKS),
            block => Unseen::FewBlocks(block),
        });
        Self {
            warm_up: warm_up(slices, per_period),
            change: change(periods, block, noise.map_or(1.0, |noise| noise.time), seed),
            warm_up_unseen,
            change_unseen,
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

/// How many periods a window of such `slices` warms up for, where that is longer than chance makes it, and where it is not
/// half of the window, to a period.
#[must_use]
pub fn warm_up(slices: &[f64], per_period: usize) -> Option<f64> {
    if per_period == 0 || slices.len() < LEAST_PERIODS * per_period {
        return None;
    }
    let flat = without_cycle(slices, per_period);
    let d = mser(&flat);
    if d + per_period > flat.len() / 2 {
        return None;
    }
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

/// How the values of windows depend on each other, each window's largest step taken off: the means before and behind its
/// largest CUSUM. None where no two values differ then.
///
/// Taking two means off makes ρ(1) smaller, by about (2 + 4ρ)/n of windows of n values. The autocorrelation time is
/// therefore at least that of AR(1) noise with ρ(1) so much larger.
#[must_use]
pub fn dependence_but_for_changes(windows: &[&[f64]]) -> Option<Dependence> {
    let flat: Vec<Vec<f64>> = windows.iter().map(|window| without_step(window)).collect();
    let flat: Vec<&[f64]> = flat.iter().map(Vec::as_slice).collect();
    let found = Dependence::of(&flat)?;
    let each = found.n as f64 / flat.iter().filter(|window| !window.is_empty()).count() as f64;
    let rho = found.lag_one();
    let rho = (rho + (2.0 + 4.0 * rho) / each).clamp(0.0, 0.95);
    let time = found.time.max((1.0 + rho) / (1.0 - rho));
    Some(Dependence {
        time,
        effective: found.n as f64 / time,
        ..found
    })
}

/// Values less the mean of their side of the largest CUSUM.
fn without_step(values: &[f64]) -> Vec<f64> {
    let Some((mean, _)) = mean_and_deviation(values) else {
        return Vec::new();
    };
    let (_, after) = largest_cusum(values.iter(), mean);
    let (before, behind) = values.split_at(after.min(values.len()));
    let largest = values.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
    let level = |side: &[f64]| mean_and_deviation(side).map_or(0.0, |(mean, _)| mean);
    let flat = |side: &[f64]| {
        let level = level(side);
        // Equal values differ from their mean by rounding.
        let less = side.iter().map(|value| value - level);
        less.map(|rest| if rest.abs() <= largest * 1e-12 { 0.0 } else { rest })
            .collect::<Vec<f64>>()
    };
    [flat(before), flat(behind)].concat()
}

fn change(periods: &[f64], block: usize, time: f64, seed: u64) -> Option<Change> {
    let block = block.max(1);
    let blocks = periods.len() / block;
    if blocks < LEAST_BLOCKS {
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
    let permuted = Relabellings::of(&sizes, effort, |order| {
        let permuted = order
            .iter()
            .filter_map(|part| parts.get(*part))
            .copied()
            .flatten();
        largest_cusum(permuted, mean).0
    });
    let p = permuted.test().p;
    let (largest, after) = largest_cusum(values.iter(), mean);
    let squares: f64 = without_step(values).iter().map(|rest| rest * rest).sum();
    let count = values.len() as f64;
    // Two means were taken off.
    let scale = (squares / (count - 2.0) * count * time).sqrt();
    let (before, behind) = values.split_at_checked(after)?;
    let by = mean_and_deviation(behind)?.0 - mean_and_deviation(before)?.0;
    debug_assert!(matches!(
        permuted.coverage,
        Coverage::Exact | Coverage::MonteCarlo
    ));
    (p < CHANGE_LEVEL && largest > CHANGE_LIMIT * scale).then_some(Change {
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
    use rstest::rstest;

    use super::*;
    use crate::noise_model::Noise;

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
        let change = change(&periods, 1, 1.0, 0).unwrap();
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
        let change = change(&periods, 4, 2.0, 0).unwrap();
        assert!((29..=31).contains(&change.after), "{change:?}");
        assert!((change.by - 4.0).abs() < 0.8 && change.p < 0.01, "{change:?}");
    }

    #[test]
    fn steady_noise_is_seldom_called_unsteady() {
        let mut random = Noise::new(4);
        let warm = (0..60).filter(|_| warm_up(&random.ar1(600, 0.7), 10).is_some());
        assert!(warm.count() <= 2);
    }

    /// What is found of the windows of one scenario, without slices.
    fn changes(windows: &[Vec<f64>], seed: u64) -> Vec<Stationarity> {
        let windows: Vec<&[f64]> = windows.iter().map(Vec::as_slice).collect();
        let noise = dependence_but_for_changes(&windows);
        let found = windows
            .iter()
            .map(|window| Stationarity::of(&[], 10, window, noise.as_ref(), seed));
        found.collect()
    }

    // docs/statistics/within.md has the rates of more of them.
    #[rstest]
    #[case(0.0)]
    #[case(0.5)]
    #[case(0.7)]
    fn steady_windows_change_about_as_often_as_the_level_says(#[case] phi: f64) {
        let mut random = Noise::new(79);
        let mut told = 0;
        for seed in 0..150 {
            let windows: Vec<Vec<f64>> = (0..4).map(|_| random.ar1(60, phi)).collect();
            let found = changes(&windows, seed);
            told += found.iter().filter(|found| found.change.is_some()).count();
        }
        assert!(told <= 12, "{told} of 600 at a nominal 6");
    }

    #[rstest]
    fn a_step_does_not_hide_itself_however_large_it_is(
        #[values(2.0, 5.0, 20.0)] step: f64,
        #[values(20, 30, 40)] after: usize,
        #[values(1, 4)] windows_with_it: usize,
    ) {
        // A small step is not where it seems to the period.
        let room = if step < 3.0 { 6 } else { 2 };
        let mut random = Noise::new(7);
        let mut windows: Vec<Vec<f64>> = (0..4).map(|_| random.ar1(60, 0.0)).collect();
        for window in windows.iter_mut().take(windows_with_it) {
            for value in window.iter_mut().skip(after) {
                *value += step;
            }
        }
        for (at, found) in changes(&windows, 1).iter().enumerate() {
            match found.change {
                Some(change) if at < windows_with_it => {
                    assert!(change.after.abs_diff(after) <= room, "{change:?}");
                    assert!((change.by - step).abs() < 0.8, "{change:?}");
                }
                found => assert!(found.is_none() && at >= windows_with_it, "{at}: {found:?}"),
            }
        }
    }

    #[test]
    fn the_dependence_is_that_of_the_noise_and_not_of_the_step() {
        let mut random = Noise::new(11);
        let mut windows: Vec<Vec<f64>> = (0..4).map(|_| random.ar1(60, 0.0)).collect();
        for value in windows.iter_mut().flat_map(|window| window.iter_mut().skip(30)) {
            *value += 20.0;
        }
        let windows: Vec<&[f64]> = windows.iter().map(Vec::as_slice).collect();
        assert!(Dependence::block_of(&windows) > 20);
        let found = dependence_but_for_changes(&windows).unwrap();
        assert!(found.block() <= 4, "{found:?}");
        // Nothing but a step leaves nothing that depends on anything.
        let mut bare = [0.1; 12];
        bare[6..].fill(0.3);
        assert_eq!(dependence_but_for_changes(&[&bare]), None);
    }

    #[test]
    fn a_step_in_the_middle_is_no_warm_up() {
        let mut random = Noise::new(12);
        // With the first period left out and with it.
        for periods in [59, 60] {
            let mut slices = random.ar1(10 * periods, 0.3);
            for slice in slices.iter_mut().take(10 * (periods - 30)) {
                *slice += 20.0;
            }
            assert_eq!(warm_up(&slices, 10), None);
        }
    }

    #[test]
    fn too_little_to_look_at_is_not_called_unsteady_and_says_why() {
        let found = Stationarity::of(&[], 10, &[], None, 0);
        assert!(found.is_steady());
        assert_eq!(found.warm_up_unseen, Some(Unseen::FewPeriods(4)));
        assert_eq!(found.change_unseen, Some(Unseen::FewPeriods(6)));
        let flat = Stationarity::of(&[1.0; 100], 10, &[1.0; 10], None, 0);
        assert_eq!(flat, Stationarity::default(), "looked at, and steady");
        let mut random = Noise::new(13);
        let window = random.ar1(60, 0.97);
        let noise = dependence_but_for_changes(&[&window]).unwrap();
        let found = Stationarity::of(&[], 10, &window, Some(&noise), 0);
        assert_eq!(found.warm_up_unseen, Some(Unseen::NoSlices));
        assert_eq!(found.change_unseen, Some(Unseen::FewBlocks(noise.block())));
    }
}
