//! A control chart for nights: after each night, whether the level has changed since some night, whatever the level was, however
//! much nights differ, and however much a night resembles the one before it. The main type is [`Chart`].
//!
//! It is the change-point chart of Hawkins, Qiu and Kang (*The changepoint model for statistical process control*, Journal of
//! Quality Technology 35, 2003): the mean since a night is compared with the mean before it, for each night that the change may
//! have begun with, and the largest comparison is held against a limit. It needs no learning phase, since mean and scale are
//! estimated anew each night. Five things are different from theirs:
//!
//! - **Outliers**: nights further than [`CLIP`] robust standard deviations from the median count as if they were there (Huber's
//!   winsorising), so that a single night moves no mean by more.
//! - **Dependence**: nights are taken for a first-order autoregression. The comparison is that of generalised least squares, and
//!   its coefficient φ is estimated from the nights around their own two means, with the correction for that (Marriott and Pope,
//!   *Bias in the estimation of autocorrelations*, Biometrika 41, 1954). Few nights do not show φ: it begins at [`YOUNG_PHI`], and
//!   [`CAUTION`] keeps it above its estimate, the more the larger it is, since a φ that is too small is what raises false alarms.
//! - **The limit** depends on how much the nights say of a change: in units of independent nights, I = b·m/(b + m) for b nights
//!   before and m since. It is that of a CUSUM for changes of one standard deviation, h·(√(I/I₀) + √(I₀/I))/2, and at most
//!   [`CAP`] as large where few nights speak, so that large changes are found as soon as by a chart for these.
//! - **Nights without a spread**: where all nights before are equal, and so are all since, no spread says how clear the change is. The
//!   probability is then that of the order: one in as many as there are choices of the nights since.
//! - **A new level does not make it blind**: after [`Chart::restart`], how much nights differ, and φ, come from all nights, each
//!   around the level of its own time.
//!
//! The limit was chosen by simulation (`reports/examples/referee/drift.rs`; docs/drift.md has its tables): with probability
//! [`CALIBRATED`] a night, no kind of nights there, of independent ones with normal or heavy tails up to autoregressions with
//! φ = 0.7, has more false alarms. For smaller
//! probabilities it goes as P ∝ exp(−h²/2.5), more slowly than the tail of a normal distribution.

use crate::effect::median;

/// Robust standard deviations from the median at which a night is clipped, in long histories.
const CLIP: f64 = 2.75;
/// By how many nights' share the clip is wider in short ones, whose standard deviation is not known well.
const CLIP_NIGHTS: f64 = 4.0;
/// φ before nights show it, and the nights at which half of it is left.
const YOUNG_PHI: (f64, f64) = (0.8, 20.0);
/// φ is taken to be φ̂ + this · φ̂^1.5 / √n.
const CAUTION: f64 = 3.0;
/// The largest φ: beyond, no night says anything of a level.
const LARGEST_PHI: f64 = 0.9;
/// The independent nights at which the limit is lowest.
const LOWEST_AT: f64 = 14.0;
/// The most that the limit is above its lowest, where few nights speak and where many do.
const CAP: (f64, f64) = (1.13, 1.25);
/// Up to so many nights the limit is lower by a share, which then fades: a short history has fewer nights for a change to begin with.
const SHORT: (f64, f64) = (60.0, 0.05);
/// The lowest limit, and the probability of a false alarm a night that it was chosen for: of one of nine series that together have
/// 0.01, less what [`crate::watch`] spends otherwise.
const CALIBRATED: (f64, f64) = (3.74, 0.01 / 9.0);
/// How much slower the probability falls with the square of the limit than that of a normal quantile, beyond [`CALIBRATED`]: φ and the
/// scale are estimated.
const TAIL: f64 = 1.25;
/// The fewest nights for which there is a comparison, and the fewest before a change if none were before on another level.
pub const FEWEST: usize = 6;
const FEWEST_BEFORE: usize = 4;

/// What the chart shows after a night.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// The first night of the change that is the most likely.
    pub at: usize,
    /// The probability of such a reading in a night without a change.
    pub probability: f64,
}

/// How nights depend on those before.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lag {
    /// The correlation of successive nights, estimated.
    pub correlation: f64,
    /// What the chart takes it for.
    pub cautious: f64,
    /// Nights that it was estimated from.
    pub nights: f64,
}

/// The state after some nights. Nights are named by their place, from 0.
#[derive(Debug, Clone, Default)]
pub struct Chart {
    values: Vec<f64>,
    /// The first night of the present level.
    begins: usize,
    /// The values since, in order of size.
    sorted: Vec<f64>,
    earlier: Earlier,
}

/// What nights on earlier levels say of how nights differ.
#[derive(Debug, Clone, Default)]
struct Earlier {
    nights: f64,
    /// The square of their robust standard deviation.
    scale2: f64,
    sums: Sums,
    /// How many nights each level had.
    lengths: Vec<f64>,
}

/// Sums of squares, and of products of successive nights, around the nights' own level.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    squares: f64,
    products: f64,
}

/// Prefix sums of clipped values.
#[derive(Debug, Clone, Copy, Default)]
struct Prefix {
    nights: f64,
    sum: f64,
    squares: f64,
    products: f64,
}

impl Prefix {
    /// Around their mean, of nights that begin and end with these values.
    fn around_mean(self, first: f64, last: f64) -> Sums {
        let mean = self.sum / self.nights;
        Sums {
            squares: self.squares - self.nights * mean * mean,
            products: self.products - mean * (2.0 * self.sum - first - last)
                + (self.nights - 1.0) * mean * mean,
        }
    }
}

/// n times the variance of the mean of n nights, in units of the variance of one: 1 for one night, and (1 + φ)/(1 − φ) for many
/// (nearly, for those between).
pub(crate) fn inflation(phi: f64, nights: f64) -> f64 {
    let many = (1.0 + phi) / (1.0 - phi);
    many * nights / (nights + many - 1.0)
}

/// The sum of squares of nights around their levels, in units of the variance of one.
fn freedom(phi: f64, lengths: impl Iterator<Item = f64>) -> f64 {
    lengths.map(|nights| nights - inflation(phi, nights)).sum()
}

/// The lowest limit for a probability of a false alarm a night.
fn limit(probability: f64) -> f64 {
    let (limit, calibrated) = CALIBRATED;
    let rarer = (calibrated / probability).ln();
    let slope = if rarer > 0.0 { TAIL } else { 1.0 };
    (limit * limit + 2.0 * slope * rarer).max(1.0).sqrt()
}

/// The probability of a false alarm a night with that limit.
fn probability(reached: f64) -> f64 {
    let (limit, calibrated) = CALIBRATED;
    let beyond = (reached * reached - limit * limit) / 2.0;
    let slope = if beyond > 0.0 { TAIL } else { 1.0 };
    (calibrated * (-beyond / slope).exp()).min(1.0)
}

impl Chart {
    /// How many nights there are.
    #[must_use]
    pub const fn nights(&self) -> usize {
        self.values.len()
    }

    /// The first night of the present level.
    #[must_use]
    pub const fn begins(&self) -> usize {
        self.begins
    }

    /// One night more.
    pub fn push(&mut self, value: f64) {
        self.values.push(value);
        let place = self.sorted.partition_point(|other| *other < value);
        self.sorted.insert(place, value);
    }

    /// Whether the newest night alarms where a false alarm has that probability a night, and of what change. It costs as many steps as the
    /// present level has nights.
    #[must_use]
    pub fn alarm(&self, level: f64) -> Option<Reading> {
        let limit = limit(level);
        let (at, ratio) = self.most_striking()?;
        (ratio > limit).then(|| Reading {
            at,
            probability: probability(ratio),
        })
    }

    /// From that night on nights are on another level; those before go on to say how much nights differ.
    pub fn restart(&mut self, at: usize) {
        let length = at.saturating_sub(self.begins).min(self.sorted.len());
        if length == 0 {
            return;
        }
        if let Some((clipped, scale2)) = self.clipped(self.begins, at) {
            let sums = sums_around_mean(&clipped);
            let (before, now) = (self.earlier.nights, length as f64);
            self.earlier.scale2 = (before * self.earlier.scale2 + now * scale2) / (before + now);
            self.earlier.nights += now;
            self.earlier.sums.squares += sums.squares;
            self.earlier.sums.products += sums.products;
            self.earlier.lengths.push(now);
        }
        self.begins = at;
        self.sorted = self.values.get(at..).unwrap_or_default().to_vec();
        self.sorted.sort_by(f64::total_cmp);
    }

    /// Takes other values for the nights of the present level, such as without what belongs to the day of the week.
    pub fn revise(&mut self, values: &[f64]) {
        self.values.truncate(self.begins);
        self.values.extend_from_slice(values);
        self.sorted = values.to_vec();
        self.sorted.sort_by(f64::total_cmp);
    }

    /// How much a night resembles the one before it, of all nights around their levels.
    #[must_use]
    pub fn lag(&self) -> Option<Lag> {
        let (clipped, _) = self.clipped(self.begins, self.values.len())?;
        let mut sums = sums_around_mean(&clipped);
        sums.squares += self.earlier.sums.squares;
        sums.products += self.earlier.sums.products;
        let nights = self.earlier.nights + clipped.len() as f64;
        (sums.squares > 0.0).then(|| {
            let correlation = unbiased(sums, nights, 1.0 + self.earlier.lengths.len() as f64);
            Lag {
                correlation,
                cautious: cautious(correlation, nights),
                nights,
            }
        })
    }

    /// The standard deviation of a night around its level, and the share of it that is known: see [`freedom`].
    #[must_use]
    pub fn spread(&self) -> Option<(f64, f64)> {
        let lag = self.lag()?;
        let (clipped, _) = self.clipped(self.begins, self.values.len())?;
        let squares = sums_around_mean(&clipped).squares + self.earlier.sums.squares;
        let lengths = self.earlier.lengths.iter().copied().chain([clipped.len() as f64]);
        let free = freedom(lag.cautious, lengths);
        (free > 0.0).then(|| ((squares / free).sqrt(), free))
    }

    /// The clipped values of nights of the present level around their median, and the square of their own robust standard
    /// deviation; none where all nights so far are equal.
    fn clipped(&self, from: usize, to: usize) -> Option<(Vec<f64>, f64)> {
        let values = self.values.get(from..to)?;
        let is_all = from == self.begins && to == self.values.len();
        let mut own = Vec::new();
        let sorted = if is_all {
            &self.sorted
        } else {
            own.extend_from_slice(values);
            own.sort_by(f64::total_cmp);
            &own
        };
        let middle = middle(sorted)?;
        let mut scale = 1.4826 * median_distance(sorted, middle);
        // More than half of them are equal.
        if scale <= middle.abs() * 1e-12 {
            let distances: f64 = sorted.iter().map(|value| (value - middle).abs()).sum();
            scale = 1.2533 * distances / sorted.len() as f64;
        }
        let (before, now) = (self.earlier.nights, values.len() as f64);
        let pooled = ((before * self.earlier.scale2 + now * scale * scale) / (before + now)).sqrt();
        // Sums of equal numbers differ by rounding.
        if pooled <= middle.abs() * 1e-12 {
            return None;
        }
        let clip = CLIP * (1.0 + CLIP_NIGHTS / (before + now)) * pooled;
        let clipped = values.iter().map(|value| (value - middle).clamp(-clip, clip));
        Some((clipped.collect(), scale * scale))
    }

    /// The night since which the comparison is the clearest, and how large the largest is in units of its limit, where the lowest
    /// limit is one.
    fn most_striking(&self) -> Option<(usize, f64)> {
        let earlier = &self.earlier;
        let total = earlier.nights + self.sorted.len() as f64;
        if total < FEWEST as f64 || self.sorted.len() < 2 {
            return None;
        }
        let (clipped, _) = self.clipped(self.begins, self.values.len())?;
        let prefixes = prefixes(&clipped);
        let all = prefixes.last()?;
        let fewest_before = if earlier.nights >= FEWEST_BEFORE as f64 {
            1
        } else {
            FEWEST_BEFORE
        };
        let short = 1.0 - SHORT.1 * (SHORT.0 / total).min(1.0);
        let (first, last) = (*clipped.first()?, *clipped.last()?);
        let mut place = None;
        let (mut clearest, mut largest) = (0.0, 0.0_f64);
        // The newest night by itself is no level.
        for at in fewest_before..clipped.len() - 1 {
            let (before, value, previous) = (prefixes[at], clipped[at], clipped[at - 1]);
            let since = Prefix {
                nights: all.nights - before.nights,
                sum: all.sum - before.sum,
                squares: all.squares - before.squares,
                products: all.products - before.products - value * previous,
            };
            let (a, b) = (
                before.around_mean(first, previous),
                since.around_mean(value, last),
            );
            let sums = Sums {
                squares: earlier.sums.squares + a.squares + b.squares,
                products: earlier.sums.products + a.products + b.products,
            };
            if sums.squares <= all.squares * 1e-12 {
                // The nights before are all equal, and so are those since.
                return Some((
                    self.begins + at,
                    limit(of_equal_nights(before.nights, since.nights)),
                ));
            }
            let means = 2.0 - 1.0 / before.nights.min(since.nights) + earlier.lengths.len() as f64;
            let phi = cautious(unbiased(sums, total, means), total);
            let ends = [before.nights, since.nights];
            let free = freedom(phi, earlier.lengths.iter().copied().chain(ends));
            if free <= 0.5 {
                continue;
            }
            let step = Step::of(&clipped, at, all.sum, since.sum, phi);
            let variance = sums.squares / free * (1.0 - phi * phi);
            let t2 = step.score.powi(2) / (variance * step.information);
            let nights = step.information / (1.0 - phi * phi);
            let aside = (nights / LOWEST_AT).sqrt();
            let cap = if nights < LOWEST_AT { CAP.0 } else { CAP.1 };
            let above = (0.5 * (aside + 1.0 / aside)).min(cap) * short;
            let above2 = above * above;
            if t2 > clearest {
                clearest = t2;
                place = Some(self.begins + at);
            }
            // A normal quantile is below that of Student's distribution.
            if t2 > largest * above2 {
                let freedom = (free * (1.0 - phi * phi) / (1.0 + phi * phi)).max(0.5);
                let ratio2 = normal_square(t2, freedom) / above2;
                largest = largest.max(ratio2);
            }
        }
        place.map(|at| (at, largest.sqrt()))
    }
}

/// The least-squares comparison of nights since one with those before, of an autoregression: score and information of the step.
struct Step {
    score: f64,
    information: f64,
}

impl Step {
    fn of(values: &[f64], at: usize, sum: f64, sum_since: f64, phi: f64) -> Self {
        let (count, since) = (values.len() as f64, (values.len() - at) as f64);
        let (first, last, value, previous) =
            (values[0], values[values.len() - 1], values[at], values[at - 1]);
        let own = 1.0 - phi;
        let level = (1.0 - phi * phi) + (count - 1.0) * own * own;
        let both = own * (1.0 + (since - 1.0) * own);
        let step = 1.0 + (since - 1.0) * own * own;
        let of_level = (1.0 - phi * phi) * first + own * ((sum - first) - phi * (sum - last));
        let of_step = (value - phi * previous) + own * ((sum_since - value) - phi * (sum_since - last));
        Self {
            score: of_step - of_level * both / level,
            information: (step - both * both / level).max(1e-9),
        }
    }
}

/// The night with which a single step of level begins in some values, by least squares with that φ, between two places; the
/// search is exact.
#[must_use]
pub fn place(values: &[f64], phi: f64, from: usize, to: usize) -> Option<usize> {
    let middle = median(values.to_vec())?;
    let spread = 1.4826 * median(values.iter().map(|value| (value - middle).abs()).collect())?;
    // A step widens the spread of all by itself: clipped are outliers alone.
    let clip = if spread > 0.0 {
        2.0 * CLIP * spread
    } else {
        f64::INFINITY
    };
    let clipped: Vec<f64> = values
        .iter()
        .map(|value| (value - middle).clamp(-clip, clip))
        .collect();
    let sum: f64 = clipped.iter().sum();
    let mut since: f64 = clipped.get(from.max(1)..)?.iter().sum();
    let mut best = None;
    let mut largest = 0.0;
    for at in from.max(1)..=to.min(values.len().checked_sub(1)?) {
        let step = Step::of(&clipped, at, sum, since, phi);
        let gain = step.score.powi(2) / step.information;
        if gain > largest {
            largest = gain;
            best = Some(at);
        }
        since -= clipped[at];
    }
    best
}

/// The probability that the nights with one of two values come last, whatever the order of the nights: one in as many as there are
/// choices of that many nights.
fn of_equal_nights(before: f64, since: f64) -> f64 {
    let steps = 1..=since.min(1000.0) as usize;
    steps
        .map(|step| step as f64 / (before + step as f64))
        .product::<f64>()
        .max(f64::MIN_POSITIVE)
}

/// The square of the normal quantile that has the probability of Student's t (Wallace, *Bounds on normal approximations to
/// Student's and the chi-square distributions*, Annals of Mathematical Statistics 30, 1959).
fn normal_square(t2: f64, freedom: f64) -> f64 {
    let factor = (8.0 * freedom + 1.0) / (8.0 * freedom + 3.0);
    freedom * (t2 / freedom).ln_1p() * factor * factor
}

/// φ without the bias that comes of so many estimated means.
fn unbiased(sums: Sums, nights: f64, means: f64) -> f64 {
    let plain = sums.products / sums.squares;
    ((plain * nights + means) / (nights - 3.0 * means).max(1.0)).clamp(-0.3, LARGEST_PHI)
}

/// φ as the chart takes it.
fn cautious(phi: f64, nights: f64) -> f64 {
    let young = 1.0 / (1.0 + (nights / YOUNG_PHI.1).powi(2));
    let positive = phi.max(0.0);
    let caution = CAUTION * positive * (positive / nights).sqrt();
    ((1.0 - young) * phi + young * YOUNG_PHI.0 + caution).clamp(0.0, LARGEST_PHI)
}

fn prefixes(values: &[f64]) -> Vec<Prefix> {
    let mut all = Vec::with_capacity(values.len() + 1);
    let mut prefix = Prefix::default();
    let mut previous = 0.0;
    all.push(prefix);
    for value in values {
        prefix.nights += 1.0;
        prefix.sum += value;
        prefix.squares += value * value;
        prefix.products += value * previous;
        previous = *value;
        all.push(prefix);
    }
    all
}

fn sums_around_mean(values: &[f64]) -> Sums {
    match (prefixes(values).last(), values.first(), values.last()) {
        (Some(all), Some(first), Some(last)) => all.around_mean(*first, *last),
        _ => Sums::default(),
    }
}

fn middle(sorted: &[f64]) -> Option<f64> {
    let half = sorted.len() / 2;
    let upper = *sorted.get(half)?;
    Some(match sorted.len() % 2 {
        1 => upper,
        _ => f64::midpoint(upper, *sorted.get(half.checked_sub(1)?)?),
    })
}

/// The median of the distances from a value, of values in order.
fn median_distance(sorted: &[f64], from: f64) -> f64 {
    let mut above = sorted.partition_point(|value| *value < from);
    let mut below = above;
    let (mut current, mut previous) = (0.0, 0.0);
    for _ in 0..=sorted.len() / 2 {
        previous = current;
        let down = below
            .checked_sub(1)
            .and_then(|at| sorted.get(at))
            .map_or(f64::INFINITY, |value| from - value);
        let up = sorted.get(above).map_or(f64::INFINITY, |value| value - from);
        if down < up {
            current = down;
            below -= 1;
        } else {
            current = up;
            above += 1;
        }
    }
    match sorted.len() % 2 {
        1 => current,
        _ => f64::midpoint(current, previous),
    }
}
