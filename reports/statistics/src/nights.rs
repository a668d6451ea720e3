//! Histories of nights that are made up, with changes that are known, and what [`watch`] makes of them: how often it tells of a
//! change where there is none, and after how many nights of one that is there. The main type is [`Nights`].
//!
//! Each function is of one seed, so that a caller spreads many over the processors and small numbers fit a test.
//! `reports/examples/referee/drift.rs` prints the tables of docs/drift.md.

use crate::{
    noise_model::Noise,
    watch::{self, Watched, watch},
};

/// What nights are like without a change: of standard deviation 1 around 100, but for what comes on top.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Nights {
    /// Independent and normal.
    Normal,
    /// Independent, of Student's t with 3 degrees of freedom.
    HeavyTails,
    /// A first-order autoregression with that coefficient.
    Autoregression(f64),
    /// Normal, and two nights of seven higher by so much.
    Weekends(f64),
    /// Normal, and a sine over the year of that height.
    Sine(f64),
    /// Normal, and a random walk of that standard deviation a night.
    RandomWalk(f64),
}

/// What changes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Change {
    /// By so much from one night to the next.
    Jump(f64),
    /// By so much more each night.
    Slope(f64),
}

/// The days of a year.
pub const YEAR: usize = 365;

impl Nights {
    /// Its name in tables.
    #[must_use]
    pub fn name(self) -> String {
        match self {
            Self::Normal => "normal".to_owned(),
            Self::HeavyTails => "heavy tails (t with 3 degrees of freedom)".to_owned(),
            Self::Autoregression(phi) => format!("AR(1), φ = {phi}"),
            Self::Weekends(height) => format!("weekends {height} sd higher"),
            Self::Sine(height) => format!("a sine of {height} sd over the year"),
            Self::RandomWalk(step) => format!("a random walk of {step} sd a night"),
        }
    }

    /// So many of them.
    #[must_use]
    pub fn values(self, count: usize, seed: u64) -> Vec<f64> {
        let mut noise = Noise::new(seed);
        let mut walk = 0.0;
        let mut autoregression = noise.normal();
        let first_day = seed as usize % 7;
        let mut value = |night: usize| {
            let normal = noise.normal();
            match self {
                Self::Normal => normal,
                Self::HeavyTails => {
                    let squares: f64 = (0..3).map(|_| noise.normal().powi(2)).sum();
                    // The variance of t with 3 degrees of freedom is 3.
                    normal / squares.sqrt()
                }
                Self::Autoregression(phi) => {
                    autoregression = phi * autoregression + (1.0 - phi * phi).sqrt() * normal;
                    autoregression
                }
                Self::Weekends(height) => {
                    let is_weekend = (night + first_day) % 7 < 2;
                    normal + if is_weekend { height } else { 0.0 }
                }
                Self::Sine(height) => {
                    normal + height * (std::f64::consts::TAU * night as f64 / YEAR as f64).sin()
                }
                Self::RandomWalk(step) => {
                    walk += step * noise.normal();
                    normal + walk
                }
            }
        };
        (0..count).map(|night| 100.0 + value(night)).collect()
    }
}

/// Values as a series has them whose probability of a false alarm is `level` in each night.
#[must_use]
pub fn observed(values: &[f64], level: f64, seed: u64) -> Vec<watch::Night> {
    let night = |(at, value): (usize, &f64)| watch::Night {
        value: *value,
        level,
        weekday: Some((at + seed as usize) % 7),
        is_known_change: false,
    };
    values.iter().enumerate().map(night).collect()
}

/// The nights, by place, in which a year of nights without a change is told of, from its first night on; each change begins a new
/// level.
#[must_use]
pub fn false_changes(nights: Nights, level: f64, seed: u64) -> Vec<usize> {
    let values = nights.values(YEAR, seed);
    let watched = watch(&observed(&values, level, seed));
    watched.changes.iter().map(|change| change.told).collect()
}

/// Nights with a change that begins after so many, and lasts for `after` more.
#[must_use]
pub fn with_change(nights: Nights, change: Change, before: usize, after: usize, seed: u64) -> Vec<f64> {
    let mut values = nights.values(before + after, seed);
    for (night, value) in values.iter_mut().skip(before).enumerate() {
        *value += match change {
            Change::Jump(height) => height,
            Change::Slope(step) => step * (night + 1) as f64,
        };
    }
    values
}

/// What is told of them.
#[must_use]
pub fn changed(
    nights: Nights,
    change: Change,
    before: usize,
    after: usize,
    level: f64,
    seed: u64,
) -> Watched {
    watch(&observed(
        &with_change(nights, change, before, after, seed),
        level,
        seed,
    ))
}

/// After how many nights a change is told that begins after so many; 0 in its night, none if not within `after`.
#[must_use]
pub fn delay(
    nights: Nights,
    change: Change,
    before: usize,
    after: usize,
    level: f64,
    seed: u64,
) -> Option<usize> {
    let watched = changed(nights, change, before, after, level, seed);
    first_since(before, watched.changes.iter().map(|change| change.told))
}

/// The chart that the watch is held against: Page's CUSUM (*Continuous inspection schemes*, Biometrika 41, 1954), two-sided, with
/// k = 0.5 standard deviations, mean and standard deviation from the nights that it learns from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cusum {
    /// Its limit h, in standard deviations.
    pub limit: f64,
}

/// An alarm of a CUSUM.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Alarm {
    /// The night in which it was raised.
    pub told: usize,
    /// The first night since its sum was last 0, which is Page's place of the change.
    pub at: usize,
}

impl Cusum {
    /// One for independent normal nights: of nine series it alarms as often as the watch does.
    pub const OF_INDEPENDENT_NIGHTS: Self = Self { limit: 8.5 };
    const K: f64 = 0.5;
    const LEARNS: usize = 60;

    /// How many times it alarms in a year after its 60 nights; after each alarm it begins anew at 0.
    #[must_use]
    pub fn false_changes(self, nights: Nights, seed: u64) -> usize {
        self.alarms(&nights.values(Self::LEARNS + YEAR, seed), Self::LEARNS)
            .len()
    }

    /// As [`delay`].
    #[must_use]
    pub fn delay(
        self,
        nights: Nights,
        change: Change,
        before: usize,
        after: usize,
        seed: u64,
    ) -> Option<usize> {
        let alarms = self.alarms(&with_change(nights, change, before, after, seed), Self::LEARNS);
        first_since(before, alarms.into_iter().map(|alarm| alarm.told))
    }

    /// The alarms after the first `learns` values, from which it has the mean and the standard deviation.
    #[must_use]
    pub fn alarms(self, values: &[f64], learns: usize) -> Vec<Alarm> {
        let (learnt, watched) = values.split_at(learns.min(values.len()));
        let count = learnt.len() as f64;
        let mean = learnt.iter().sum::<f64>() / count;
        let variance = learnt.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0);
        // The sum upwards and the one downwards, each with its first night above 0.
        let mut sums = [(0.0_f64, learns); 2];
        let mut alarms = Vec::new();
        for (night, value) in (learns..).zip(watched) {
            let aside = (value - mean) / variance.sqrt();
            for ((sum, since), aside) in sums.iter_mut().zip([aside, -aside]) {
                *sum = (*sum + aside - Self::K).max(0.0);
                if *sum == 0.0 {
                    *since = night + 1;
                }
            }
            if let Some((_, at)) = sums.iter().copied().find(|(sum, _)| *sum > self.limit) {
                alarms.push(Alarm { told: night, at });
                sums = [(0.0, night + 1); 2];
            }
        }
        alarms
    }
}

/// How many nights after that one the first of these comes that is no earlier.
fn first_since(before: usize, told: impl Iterator<Item = usize>) -> Option<usize> {
    told.filter(|told| *told >= before)
        .min()
        .map(|told| told - before)
}
