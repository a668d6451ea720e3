//! The watch over one series of nights: what changed, since when, and in which night it was told. The main function is [`watch`].
//!
//! It goes through the nights in their order, as they came, and holds to what it told:
//!
//! ```text
//! night -> Prediction   is it, by itself, further off than any before? then it is told in its night; it is withdrawn, in words, if
//!                       the nights after it are nearer to the level before
//!       -> Chart        has the level changed since any night? then the change is told from now on, the nights since are the new
//!                       level, and the watch goes on from there
//! ```
//!
//! What is told in a night depends on that night and those before it alone, and so stays told. Only its place is looked for again
//! ([`place`], exact least squares) while the first [`SETTLED`] nights after it come in. Changes that go up or down one after the
//! other, where a line fits better than they do, are one [`Kind::Slope`].
//!
//! Of the probability of a false alarm that a night has, [`BY_ITSELF`] is for the night by itself, and the chart was calibrated to
//! have the rest (see there).

mod slopes;

use statrs::distribution::{ContinuousCDF, Normal};

use crate::{
    chart::{Chart, Lag, Reading, inflation, place},
    effect::median,
    prediction::Prediction,
};
use slopes::{join_known_slopes, known_slopes, with_slopes};

/// The share of the level for the newest night by itself, from so many nights on; before, it is smaller, since few nights do not show
/// how heavy their tails are.
const BY_ITSELF: (f64, f64) = (0.2, 60.0);
/// Nights after which one that was told by itself is a level of its own, if those after it are nearer to it than to the level before.
const CONFIRMED: usize = 5;
/// How far off the place of a change may have been named, in nights.
const MISPLACED: usize = 10;
/// A change that was told is the one that is known to begin so many nights from it.
const KNOWN_NEAR: usize = 2;
/// Nights further apart from the level before than so many standard deviations of their mean are on a level of their own.
const OWN_LEVEL: f64 = 3.0;
/// Nights after it was told that the place of a change is looked for with.
const SETTLED: usize = 40;
/// The effects of the days of the week are estimated anew after so many nights, from no fewer on one level.
const WEEKS: usize = 28;
/// Effects are shrunk by 1 − this / F, and are none where F is not above it: the 99 % quantile of F(6, 60) is 3.1.
const WEEKLY: f64 = 3.1;

/// One night of a series.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Night {
    /// What was measured.
    pub value: f64,
    /// The probability of a false alarm that this series has in this night.
    pub level: f64,
    /// The day of the week, from 0 to 6, if it is known.
    pub weekday: Option<usize>,
    /// Whether a change is known to begin with this night.
    pub is_known_change: bool,
}

/// What was found of a series.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Watched {
    /// What changed, by place.
    pub changes: Vec<Change>,
    /// The jump that the newest night would have shown by itself with [`crate::power::POWER`]; none where nothing is known of how the
    /// nights before it differ.
    pub detectable: Option<f64>,
    /// How much a night resembles the one before it.
    pub lag: Option<Lag>,
    /// The difference between the highest and the lowest day of the week, as far as it was taken out.
    pub weekly: f64,
}

/// How a change shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// From one night to the next.
    Jump,
    /// Little by little.
    Slope,
}

/// A change. Nights are named by their place in the series.
#[derive(Debug, Clone, PartialEq)]
pub struct Change {
    /// How it shows.
    pub kind: Kind,
    /// The first night of what is before it.
    pub begins: usize,
    /// The first night with it.
    pub at: usize,
    /// The night after the last with it.
    pub ends: usize,
    /// The night in which it was told.
    pub told: usize,
    /// The probability, in the night in which it was told, that a series without a change is told of.
    pub probability: f64,
    /// The nights with which this change is known to begin.
    pub known: Vec<usize>,
    /// The night in which it was withdrawn: those after its only night are as those before it.
    pub withdrawn: Option<usize>,
}

impl Change {
    fn new(at: usize, told: usize, probability: f64) -> Self {
        Self {
            kind: Kind::Jump,
            begins: 0,
            at,
            ends: 0,
            told,
            probability,
            known: Vec::new(),
            withdrawn: None,
        }
    }
}

/// Watches a series, from its first night on.
#[must_use]
pub fn watch(nights: &[Night]) -> Watched {
    let mut nights = nights.to_vec();
    let alone = take_known_alone(&mut nights);
    let mut watched = watched(&nights);
    for change in watched.changes.iter_mut().filter(|it| it.withdrawn.is_some()) {
        change.known.extend(alone.iter().filter(|at| **at == change.at));
    }
    let slopes = known_slopes(&nights);
    join_known_slopes(&mut watched.changes, &slopes, &nights);
    watched
}

/// The known changes that were one night alone: none begins a level of its own, and the way back from it would be told as the next
/// change. A watch that does not know of such a night withdraws it in the next few nights, and one that knows tells of the way back, now or
/// later. They are no longer known changes of the nights, nor is the way back if somebody acknowledged that, too.
fn take_known_alone(nights: &mut [Night]) -> Vec<usize> {
    let mut alone = Vec::new();
    for at in 0..nights.len() {
        if !nights.get(at).is_some_and(|it| it.is_known_change) {
            continue;
        }
        let soon = at + 1..=at + CONFIRMED;
        let tells_of_the_way_back = |change: &Change| soon.contains(&change.at) && change.known.is_empty();
        if !watched(nights).changes.iter().any(tells_of_the_way_back) {
            continue;
        }
        let mut unaware = nights
            .get(..nights.len().min(at + 1 + CONFIRMED))
            .unwrap_or_default()
            .to_vec();
        unaware
            .iter_mut()
            .skip(at)
            .for_each(|night| night.is_known_change = false);
        let found = watched(&unaware).changes;
        if !found.iter().any(|it| it.at == at && it.withdrawn.is_some()) {
            continue;
        }
        alone.push(at);
        let begins_a_level = |night: usize| found.iter().any(|it| it.at == night && it.withdrawn.is_none());
        for (place, night) in nights.iter_mut().enumerate().skip(at).take(1 + KNOWN_NEAR) {
            night.is_known_change &= begins_a_level(place);
        }
    }
    alone
}

fn watched(nights: &[Night]) -> Watched {
    let mut state = State::default();
    let mut detectable = None;
    if let Some((newest, before)) = nights.split_last() {
        for night in before {
            state.step(night);
        }
        // What the newest itself is, is no part of what it was held against.
        let level = newest.level * by_itself(nights.len());
        detectable = state.prediction().map(|it| it.detectable(level));
        state.step(newest);
    }
    let lag = state.chart.lag();
    Watched {
        detectable,
        weekly: state.weekly.range(),
        changes: state.into_changes(nights.last().map_or(1.0, |newest| newest.level)),
        lag,
    }
}

/// The share of the level that so many nights, the newest among them, have for that one.
fn by_itself(nights: usize) -> f64 {
    let (share, full) = BY_ITSELF;
    share * (nights as f64 / full).min(1.0)
}

#[derive(Clone, Default)]
struct State {
    chart: Chart,
    /// As measured, less the effect of the day of the week.
    values: Vec<f64>,
    weekdays: Vec<Option<usize>>,
    weekly: Weekly,
    /// How far nights of earlier levels were from these.
    aside: Vec<f64>,
    changes: Vec<Change>,
    /// A night that was told by itself, while it is open whether it is a new level.
    open: Option<Change>,
}

impl State {
    fn step(&mut self, night: &Night) {
        let newest = self.values.len();
        if night.is_known_change && newest > 0 {
            self.known(newest);
        }
        let value = night.value - self.weekly.effect(night.weekday);
        let by_itself = self
            .by_itself(value)
            .filter(|p| *p < night.level * by_itself(newest + 1))
            .map(|p| Change::new(newest, newest, p));
        let was_open = self.open.is_some();
        self.values.push(value);
        self.weekdays.push(night.weekday);
        self.chart.push(value);
        if !was_open {
            self.open.clone_from(&by_itself);
        }
        match self.chart.alarm(night.level) {
            Some(reading) => self.changed(reading, newest),
            None => self.settle_open(newest),
        }
        // The night that shows another to have been alone may itself be far off, on the other side.
        let withdraws = self
            .changes
            .last()
            .is_some_and(|last| last.withdrawn == Some(newest));
        if was_open && withdraws && self.open.is_none() {
            self.open = by_itself;
        }
        if self.open.is_none() && self.values.len().is_multiple_of(WEEKS) {
            self.learn_weekdays();
        }
    }

    /// The probability of one more night as far off as that, if it is further off than all before.
    fn by_itself(&self, value: f64) -> Option<f64> {
        let usual = self.usual();
        let within = |beyond: &mut dyn Iterator<Item = &f64>| beyond.next().is_some();
        let is_beyond = !within(&mut usual.iter().filter(|other| **other >= value))
            || !within(&mut usual.iter().filter(|other| **other <= value));
        is_beyond.then(|| self.predicted(&usual)?.p(value)).flatten()
    }

    fn prediction(&self) -> Option<Prediction> {
        self.predicted(&self.usual())
    }

    fn predicted(&self, usual: &[f64]) -> Option<Prediction> {
        // With all of the chart's caution a young history would see nothing. With half of it, simulated false alarms keep to α.
        let phi = self
            .chart
            .lag()
            .map_or(0.0, |lag| lag.correlation.max(lag.cautious / 2.0));
        Prediction::of_dependent(usual, phi)
    }

    /// The nights of the present level, and those of earlier ones moved to it: further apart, by as much as it is not known from its
    /// own nights.
    fn usual(&self) -> Vec<f64> {
        let own = self.values.get(self.chart.begins()..).unwrap_or_default();
        let Some(level) = median(own.to_vec()) else {
            return Vec::new();
        };
        let wider = (1.0 + 1.0 / own.len() as f64).sqrt();
        let moved = self.aside.iter().map(|aside| level + aside * wider);
        moved.chain(own.iter().copied()).collect()
    }

    fn restart(&mut self, at: usize) {
        let ended = self.values.get(self.chart.begins()..at).unwrap_or_default();
        if let Some(level) = median(ended.to_vec()) {
            self.aside.extend(ended.iter().map(|value| value - level));
        }
        self.chart.restart(at);
    }

    /// A change that is known begins with the next night.
    fn known(&mut self, next: usize) {
        if let Some(open) = self.open.take() {
            self.restart(open.at);
            self.changes.push(open);
        }
        let told = self.changes.last_mut().filter(|last| {
            last.withdrawn.is_none() && next.abs_diff(last.at) <= KNOWN_NEAR && !last.known.contains(&next)
        });
        if let Some(same) = told {
            same.known.push(next);
            return;
        }
        self.restart(next);
        let mut change = Change::new(next, next, 1.0);
        change.known.push(next);
        self.changes.push(change);
    }

    /// The chart alarms.
    fn changed(&mut self, reading: Reading, newest: usize) {
        let mut change = Change::new(reading.at, newest, reading.probability);
        if let Some(open) = self.open.take() {
            if reading.at + MISPLACED >= open.at {
                change.told = open.told;
                change.probability = open.probability.min(reading.probability);
            } else {
                self.open = Some(open);
            }
        }
        self.restart(reading.at);
        let is_misplaced = self.is_misplaced(reading.at);
        match self.changes.last_mut().filter(|_| is_misplaced) {
            Some(last) => {
                last.at = reading.at;
                last.told = last.told.max(reading.at);
                last.probability = last.probability.min(reading.probability);
            }
            None => self.changes.push(change),
        }
    }

    /// Whether the last change began with that night and not with the one that was named: the nights between are on the level before.
    fn is_misplaced(&self, at: usize) -> bool {
        let Some(last) = self.changes.last().filter(|last| last.withdrawn.is_none()) else {
            return false;
        };
        let begins = self
            .changes
            .iter()
            .rev()
            .skip(1)
            .find(|it| it.withdrawn.is_none())
            .map_or(0, |it| it.at);
        let level = |from: usize, to: usize| median(self.values.get(from..to)?.to_vec());
        if at <= last.at || at - last.at > MISPLACED {
            return false;
        }
        match (
            level(begins, last.at),
            level(last.at, at),
            level(at, self.values.len()),
            self.chart.spread(),
        ) {
            (Some(before), Some(between), Some(since), Some((spread, _))) => {
                let apart = (between - before).abs() * ((at - last.at) as f64).sqrt();
                apart <= OWN_LEVEL * spread && (between - before).abs() < (between - since).abs()
            }
            _ => false,
        }
    }

    /// Whether the night that was told by itself is a new level, or was alone.
    fn settle_open(&mut self, newest: usize) {
        let Some(open) = self.open.take() else {
            return;
        };
        let after = self.values.get(open.at + 1..).unwrap_or_default().to_vec();
        let before = self
            .values
            .get(self.chart.begins()..open.at)
            .unwrap_or_default()
            .to_vec();
        let own = self.values.get(open.at).copied();
        self.open = match (median(before), own, median(after)) {
            (Some(before), Some(own), Some(after)) if (after - before).abs() < (after - own).abs() => {
                self.changes.push(Change {
                    withdrawn: Some(newest),
                    ..open
                });
                None
            }
            _ if newest + 1 - open.at >= CONFIRMED => {
                self.restart(open.at);
                self.changes.push(open);
                None
            }
            _ => Some(open),
        };
    }

    fn learn_weekdays(&mut self) {
        let from = self.chart.begins();
        if self.values.len() - from < WEEKS {
            return;
        }
        let days = self.weekdays.get(from..).unwrap_or_default();
        let values = self.values.get(from..).unwrap_or_default();
        let measured: Vec<f64> = values
            .iter()
            .zip(days)
            .map(|(value, day)| value + self.weekly.effect(*day))
            .collect();
        let learnt = Weekly::of(&measured, days);
        if learnt == self.weekly {
            return;
        }
        let without: Vec<f64> = measured
            .iter()
            .zip(days)
            .map(|(value, day)| value - learnt.effect(*day))
            .collect();
        self.values.truncate(from);
        self.values.extend_from_slice(&without);
        self.chart.revise(&without);
        self.weekly = learnt;
    }

    fn into_changes(mut self, level: f64) -> Vec<Change> {
        self.changes.extend(self.open.take());
        let phi = self.chart.lag().map_or(0.0, |lag| lag.correlation.max(0.0));
        let cautious = self.chart.lag().map_or(0.0, |lag| lag.cautious);
        let spread = self.chart.spread().map(|(spread, _)| spread);
        let mut changes = self.changes;
        let values = self.values;
        bound(&mut changes, values.len());
        for change in &mut changes {
            if change.withdrawn.is_some() || !change.known.is_empty() {
                continue;
            }
            let ends = change.ends.min(change.told + SETTLED);
            let stretch = values.get(change.begins..ends).unwrap_or_default();
            let from = change.at.saturating_sub(change.begins + MISPLACED);
            if let Some(at) = place(stretch, phi, from, change.told - change.begins) {
                change.at = change.begins + at;
            }
        }
        bound(&mut changes, values.len());
        for change in &mut changes {
            if !change.known.is_empty() {
                let level = |from: usize, to: usize| {
                    let stretch = values.get(from..to).unwrap_or_default();
                    let nights = stretch.len() as f64;
                    Some((median(stretch.to_vec())?, inflation(cautious, nights) / nights))
                };
                let ends = change.ends.min(change.at + SETTLED);
                let known = level(change.begins, change.at).zip(level(change.at, ends));
                if let Some(((before, variance), (since, variance_since))) = known {
                    let apart = (since - before).abs();
                    let spread = spread.unwrap_or(0.0) * (variance + variance_since).sqrt();
                    let p = match spread > 0.0 {
                        true => 2.0 * Normal::standard().sf(apart / spread),
                        false => f64::from(u8::from(apart <= 0.0)),
                    };
                    change.probability = change.probability.min(p);
                }
            }
        }
        changes.retain(|change| change.known.is_empty() || change.probability < level);
        bound(&mut changes, values.len());
        let mut changes = with_slopes(changes, &values);
        changes.sort_by_key(|change| change.at);
        changes
    }
}

/// Where each begins and ends that was not withdrawn: at the others'.
fn bound(changes: &mut [Change], nights: usize) {
    changes.sort_by_key(|change| change.at);
    let places: Vec<usize> = changes
        .iter()
        .filter(|change| change.withdrawn.is_none())
        .map(|change| change.at)
        .collect();
    for change in changes {
        change.begins = places
            .iter()
            .rev()
            .copied()
            .find(|at| *at < change.at)
            .unwrap_or(0);
        change.ends = match change.withdrawn {
            Some(_) => change.at + 1,
            None => places
                .iter()
                .copied()
                .find(|at| *at > change.at)
                .unwrap_or(nights),
        };
    }
}

/// What belongs to the day of the week.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Weekly([f64; 7]);

impl Weekly {
    /// From nights of one level: the days' means of clipped values, shrunk by how little they differ beyond chance.
    fn of(values: &[f64], days: &[Option<usize>]) -> Self {
        let Some(middle) = median(values.to_vec()) else {
            return Self::default();
        };
        let spread =
            1.4826 * median(values.iter().map(|value| (value - middle).abs()).collect()).unwrap_or_default();
        let mut sums = [(0.0_f64, 0.0_f64); 7];
        let mut squares = 0.0;
        let mut total = (0.0, 0.0);
        for (value, day) in values.iter().zip(days) {
            let Some(sum) = day.and_then(|day| sums.get_mut(day)) else {
                continue;
            };
            let clipped = (value - middle).clamp(-3.0 * spread, 3.0 * spread);
            *sum = (sum.0 + 1.0, sum.1 + clipped);
            total = (total.0 + 1.0, total.1 + clipped);
            squares += clipped * clipped;
        }
        if sums.iter().any(|(nights, _)| *nights < 3.0) {
            return Self::default();
        }
        let mean = total.1 / total.0;
        let between: f64 = sums
            .iter()
            .map(|(nights, sum)| nights * (sum / nights - mean).powi(2))
            .sum();
        let within = squares - total.0 * mean * mean - between;
        let ratio = (between / 6.0) / (within / (total.0 - 7.0));
        let share = (1.0 - WEEKLY / ratio).max(0.0);
        if !(share > 0.0 && share <= 1.0) {
            return Self::default();
        }
        Self(sums.map(|(nights, sum)| share * (sum / nights - mean)))
    }

    fn effect(&self, day: Option<usize>) -> f64 {
        day.and_then(|day| self.0.get(day)).copied().unwrap_or(0.0)
    }

    fn range(&self) -> f64 {
        let highest = self.0.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        highest - self.0.iter().copied().fold(f64::INFINITY, f64::min)
    }
}
