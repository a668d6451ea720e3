//! Steps in one direction, one after the other, that are one slope, and slopes that are known. The main function is [`with_slopes`].

use super::{Change, Kind, MISPLACED, Night, State};
use crate::{effect::median, trend::Trend};

/// The most nights that a line is fitted to; of longer stretches each second, third, … is used.
const LINE: usize = 150;
/// By how much a line must fit better than steps (Schwarz's criterion).
const BETTER: f64 = 6.0;
/// By how much a step must fit better than a line for a change to be none of a known slope.
const APART: f64 = 16.0;
/// Nights within which a known change is found to be part of a slope.
const SLOPE_SHOWS: usize = 150;

/// A known change that was part of a slope in one of the nights after it.
pub(super) struct KnownSlope {
    /// The night with which the change is known to begin.
    night: usize,
    rises: bool,
}

/// The known changes that are parts of slopes, as a watch finds them that does not know of them: a known change begins a new level, whose
/// first nights seldom show that a line goes on.
pub(super) fn known_slopes(nights: &[Night]) -> Vec<KnownSlope> {
    let mut open: Vec<usize> = (0..nights.len())
        .filter(|night| nights.get(*night).is_some_and(|it| it.is_known_change))
        .collect();
    let mut slopes = Vec::new();
    let mut unaware = State::default();
    for (newest, night) in nights.iter().enumerate() {
        open.retain(|known| newest < known + SLOPE_SHOWS);
        if open.is_empty() {
            break;
        }
        unaware.step(&Night {
            is_known_change: false,
            ..*night
        });
        if open.first().is_some_and(|known| newest < *known) {
            continue;
        }
        let values: Vec<f64> = unaware.values.clone();
        let changes = unaware.clone().into_changes(night.level);
        for slope in changes.iter().filter(|change| change.kind == Kind::Slope) {
            open.retain(|known| {
                let is_within = known + MISPLACED >= slope.at && *known < slope.ends;
                if is_within {
                    slopes.push(KnownSlope {
                        night: *known,
                        rises: rises(slope, &values),
                    });
                }
                !is_within
            });
        }
    }
    slopes
}

/// A known slope is known however far it goes: the changes after it that go the same way are its own, unless a step fits clearly better than
/// a line does since the change before.
pub(super) fn join_known_slopes(changes: &mut [Change], slopes: &[KnownSlope], nights: &[Night]) {
    let values: Vec<f64> = nights.iter().map(|night| night.value).collect();
    for slope in slopes {
        let mut from = slope.night;
        let after = |change: &&mut Change| change.withdrawn.is_none() && change.at + MISPLACED >= slope.night;
        for change in changes.iter_mut().filter(after) {
            if rises(change, &values) != slope.rises {
                break;
            }
            if change.known.is_empty() {
                let step = change.at.checked_sub(from).filter(|at| *at > 0);
                let stretch = values.get(from..change.ends).unwrap_or_default();
                let worse = step.and_then(|step| line_less_steps(stretch, &[step]));
                if worse.is_some_and(|worse| worse > APART) {
                    break;
                }
                change.kind = Kind::Slope;
                change.known.push(slope.night);
            }
            from = change.at.max(from);
        }
    }
}

fn rises(change: &Change, values: &[f64]) -> bool {
    let level = |from: usize, to: usize| median(values.get(from..to).unwrap_or_default().to_vec());
    level(change.begins, change.at) < level(change.at, change.ends)
}

/// Changes in one direction, one after the other, are a slope if a line fits better.
pub(super) fn with_slopes(changes: Vec<Change>, values: &[f64]) -> Vec<Change> {
    let mut kept: Vec<Change> = Vec::new();
    let (steps, mut others): (Vec<Change>, Vec<Change>) =
        changes.into_iter().partition(|change| change.withdrawn.is_none());
    let mut at = 0;
    while let Some(first) = steps.get(at) {
        let stairs = steps[at..]
            .iter()
            .take_while(|next| rises(next, values) == rises(first, values))
            .count();
        let slope = (1..=stairs).rev().find_map(|count| {
            let stairs = &steps[at..at + count];
            let ends = stairs.last()?.ends;
            let places: Vec<usize> = stairs.iter().map(|stair| stair.at).collect();
            let line = |from: usize| {
                let worse = line_less_steps(values.get(from..ends)?, &after_night(from, &places))?;
                (worse < -BETTER).then_some(())
            };
            // It may have begun with the level before, or with the change.
            line(first.begins).or_else(|| line(first.at))?;
            Some((count, ends))
        });
        match slope {
            Some((count, ends)) => {
                let stairs = &steps[at..at + count];
                kept.push(Change {
                    kind: Kind::Slope,
                    ends,
                    probability: stairs.iter().map(|it| it.probability).fold(1.0, f64::min),
                    known: stairs.iter().flat_map(|it| it.known.iter().copied()).collect(),
                    ..first.clone()
                });
                at += count;
            }
            None => {
                kept.push(first.clone());
                at += 1;
            }
        }
    }
    kept.append(&mut others);
    kept
}

/// The places after a night, counted from it.
fn after_night(from: usize, places: &[usize]) -> Vec<usize> {
    places
        .iter()
        .filter_map(|at| at.checked_sub(from))
        .filter(|at| *at > 0)
        .collect()
}

/// By how much a line fits worse than levels with steps between them, by Schwarz's criterion; below 0 if it fits better.
fn line_less_steps(values: &[f64], steps: &[usize]) -> Option<f64> {
    let every = values.len().div_ceil(LINE).max(1);
    let thinned: Vec<f64> = values.iter().copied().step_by(every).collect();
    let trend = Trend::of(&thinned)?;
    let slope = trend.slope / every as f64;
    let flat: Vec<f64> = values
        .iter()
        .enumerate()
        .map(|(night, value)| value - slope * night as f64)
        .collect();
    let line = badness(distances(&flat), values.len(), 2);
    let ends = steps.iter().copied().chain([values.len()]);
    let mut begins = 0;
    let mut sum = 0.0;
    for end in ends {
        sum += distances(values.get(begins..end).unwrap_or_default());
        begins = end;
    }
    // The places of the steps, and the levels.
    Some(line - badness(sum, values.len(), 2 * steps.len() + 1))
}

fn distances(values: &[f64]) -> f64 {
    let middle = median(values.to_vec()).unwrap_or_default();
    values.iter().map(|value| (value - middle).abs()).sum()
}

/// Schwarz's criterion (*Estimating the dimension of a model*, Annals of Statistics 6, 1978), for distances from what fits
/// as Laplace has them: more parameters always fit better.
fn badness(distances: f64, nights: usize, parameters: usize) -> f64 {
    let count = nights as f64;
    2.0 * count * (distances / count).ln() + parameters as f64 * count.ln()
}
