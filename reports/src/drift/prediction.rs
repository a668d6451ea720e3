//! What the newest nights are expected to be, from those before them, whatever the tails of nights are like. The main type
//! is [`Prediction`].
//!
//! Four nights or a year do not say whether nights are normal. A test that takes them for normal alarms twenty times as often
//! as it says where they have the tails of Student's t with 3 degrees of freedom. So, for one and for two nights, the chance
//! of nights so far off is the mean of what several kinds of tails say, each weighted by how well it explains the nights
//! before (Bayesian model averaging; Hoeting, Madigan, Raftery and Volinsky, Statistical Science 14, 1999):
//!
//! ```text
//! p = 2 Σ w_ν S_ν(T_ν)^k,   T_ν = |x − μ_ν| / (σ_ν √(1 + 1/n)),   w_ν ∝ prior_ν · likelihood of the n nights before
//! ```
//!
//! x is the one of the k nights that is least far off. ν is infinite for normal nights, where μ and σ are mean and standard
//! deviation and S is that of t with n − 1 degrees of freedom (Hahn, *Factors for calculating two-sided prediction intervals for samples from a normal
//! distribution*, JASA 64, 1969); else μ and σ fit t with
//! ν degrees of freedom best (by the iteration of Lange, Little and Taylor, *Robust statistical modeling using the t
//! distribution*, JASA 84, 1989).
//!
//! For three and more nights little is taken of tails: if nights come in any order, that the newest k are all above or all
//! below the n before has the chance 2 / C(n + k, k), exactly. Nine tenths of the level are spent on that, and one on tails, with
//! the chance that two nights are so far off, which that of more does not exceed: of ten nights before no order says enough.

use statrs::{
    distribution::{Continuous, ContinuousCDF, StudentsT},
    function::factorial::binomial,
};

use crate::{analysis::power, statistics::effect::median};

/// The fewest nights that say how much nights differ.
pub const FEWEST_NIGHTS: usize = 4;

/// Degrees of freedom of tails that nights may have, heavy to light, each of [`HEAVY`] before any night is seen.
const TAILS: [f64; 3] = [2.5, 4.0, 8.0];
/// What is held of each of the [`TAILS`] beforehand; the rest is held of normal nights. Chosen by simulation, for few false
/// alarms of both (docs/drift.md).
const HEAVY: f64 = 0.1;
/// The most nights whose tails are multiplied.
const BY_TAILS: usize = 2;
/// Of the level of more nights, what is spent on their order.
const BY_ORDER: f64 = 0.9;
/// Rounds of the fit; it moves by less than a percent of σ after ten.
const ROUNDS: usize = 25;

/// What the nights before say of the next.
#[derive(Debug, Clone, PartialEq)]
pub struct Prediction {
    nights: usize,
    least: f64,
    most: f64,
    kinds: Vec<Kind>,
}

/// Nights with one kind of tails.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Kind {
    weight: f64,
    middle: f64,
    /// Of one more night.
    scale: f64,
    freedom: f64,
}

impl Prediction {
    /// From the levels of nights; none of fewer than [`FEWEST_NIGHTS`], or of equal ones.
    #[must_use]
    pub fn of(levels: &[f64]) -> Option<Self> {
        if levels.len() < FEWEST_NIGHTS {
            return None;
        }
        let count = levels.len() as f64;
        let mean = levels.iter().sum::<f64>() / count;
        let spread = (levels.iter().map(|level| (level - mean).powi(2)).sum::<f64>() / count).sqrt();
        // Sums of equal numbers differ by rounding.
        if spread <= mean.abs() * 1e-12 {
            return None;
        }
        let (unbiased, one_more) = ((count / (count - 1.0)).sqrt(), (1.0 + 1.0 / count).sqrt());
        let mut found = vec![(
            (1.0 - HEAVY * TAILS.len() as f64).ln() + normal_likelihood(count, spread),
            Kind {
                weight: 0.0,
                middle: mean,
                scale: spread * unbiased * one_more,
                freedom: count - 1.0,
            },
        )];
        for freedom in TAILS {
            let (middle, scale) = fitted(levels, freedom, spread * unbiased);
            let student = StudentsT::new(middle, scale, freedom).ok()?;
            let likelihood: f64 = levels.iter().map(|level| student.ln_pdf(*level)).sum();
            found.push((
                HEAVY.ln() + likelihood,
                Kind {
                    weight: 0.0,
                    middle,
                    scale: scale * unbiased * one_more,
                    freedom: freedom.min(count - 1.0),
                },
            ));
        }
        let largest = found
            .iter()
            .map(|(weight, _)| *weight)
            .fold(f64::NEG_INFINITY, f64::max);
        let sum: f64 = found.iter().map(|(weight, _)| (weight - largest).exp()).sum();
        Some(Self {
            nights: levels.len(),
            least: levels.iter().copied().fold(f64::INFINITY, f64::min),
            most: levels.iter().copied().fold(f64::NEG_INFINITY, f64::max),
            kinds: found
                .into_iter()
                .map(|(weight, kind)| Kind {
                    weight: (weight - largest).exp() / sum,
                    ..kind
                })
                .collect(),
        })
    }

    /// The chance of nights that are all above those before, or all below, by as much as these or more; none where they are
    /// not.
    #[must_use]
    pub fn p(&self, newest: &[f64]) -> Option<f64> {
        let nearest = if newest.iter().all(|level| *level > self.most) {
            newest.iter().copied().reduce(f64::min)?
        } else if newest.iter().all(|level| *level < self.least) {
            newest.iter().copied().reduce(f64::max)?
        } else {
            return None;
        };
        let nights = newest.len().min(BY_TAILS) as i32;
        let tail = |kind: &Kind| kind.tail((nearest - kind.middle).abs()).powi(nights);
        let by_tails = 2.0
            * self
                .kinds
                .iter()
                .map(|kind| kind.weight * tail(kind))
                .sum::<f64>();
        let p = if newest.len() <= BY_TAILS {
            by_tails
        } else {
            let by_order = 2.0 / binomial((self.nights + newest.len()) as u64, newest.len() as u64);
            (by_order / BY_ORDER).min(by_tails / (1.0 - BY_ORDER))
        };
        Some(p.min(1.0))
    }

    /// The jump of one night that a test at that level finds with [`power::POWER`].
    #[must_use]
    pub fn detectable(&self, level: f64) -> f64 {
        self.reach(level / 2.0) + self.reach(1.0 - power::POWER)
    }

    /// How far one more night is off on one side with that chance.
    fn reach(&self, chance: f64) -> f64 {
        let tail = |distance: f64| {
            self.kinds
                .iter()
                .map(|kind| kind.weight * kind.tail(distance))
                .sum::<f64>()
        };
        let mut beyond = self.kinds.iter().map(|kind| kind.scale).fold(0.0, f64::max);
        while tail(beyond) > chance {
            beyond *= 2.0;
            if !beyond.is_finite() {
                return f64::INFINITY;
            }
        }
        let mut within = 0.0;
        for _ in 0..60 {
            let between = f64::midpoint(within, beyond);
            match tail(between) > chance {
                true => within = between,
                false => beyond = between,
            }
        }
        beyond
    }
}

impl Kind {
    /// The chance of a night further off on one side.
    fn tail(&self, distance: f64) -> f64 {
        StudentsT::new(0.0, self.scale, self.freedom).map_or(1.0, |student| student.sf(distance))
    }
}

/// The logarithm of the likelihood of so many normal values at its greatest.
fn normal_likelihood(count: f64, spread: f64) -> f64 {
    -0.5 * count * ((2.0 * std::f64::consts::PI * spread * spread).ln() + 1.0)
}

/// Middle and scale of Student's t with so many degrees of freedom, for which the levels are likeliest.
fn fitted(levels: &[f64], freedom: f64, spread: f64) -> (f64, f64) {
    // Of levels that are mostly equal the scale would go to 0.
    let smallest = spread / 100.0;
    let mut middle = median(levels.to_vec()).unwrap_or_default();
    let distances = levels.iter().map(|level| (level - middle).abs()).collect();
    let mut scale = (1.4826 * median(distances).unwrap_or_default()).max(smallest);
    for _ in 0..ROUNDS {
        let weight = |level: f64| (freedom + 1.0) / (freedom + ((level - middle) / scale).powi(2));
        let weights: Vec<f64> = levels.iter().map(|level| weight(*level)).collect();
        let weighted = weights.iter().zip(levels).map(|(weight, level)| weight * level);
        middle = weighted.sum::<f64>() / weights.iter().sum::<f64>();
        let squares = weights
            .iter()
            .zip(levels)
            .map(|(weight, level)| weight * (level - middle).powi(2));
        scale = (squares.sum::<f64>() / levels.len() as f64).sqrt().max(smallest);
    }
    (middle, scale)
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;
    use crate::statistics::noise_model::Noise;

    fn nights(seed: u64, count: usize) -> Vec<f64> {
        let mut noise = Noise::new(seed);
        (0..count).map(|_| noise.normal()).collect()
    }

    #[test]
    fn nothing_is_expected_of_three_nights_or_of_equal_ones() {
        assert_eq!(Prediction::of(&[1.0, 2.0, 3.0]), None);
        assert_eq!(Prediction::of(&[1.0; 9]), None);
    }

    #[test]
    fn one_more_normal_night_is_expected_where_hahns_factor_says() {
        // n = 5, s = 1: the 95 % prediction interval is ±t(0.975, 4)·√(6/5) = ±2.776·1.0954 = ±3.04 (Hahn 1969, table 1).
        let prediction = Prediction::of(&[-1.0, -1.0, 0.0, 1.0, 1.0]).unwrap();
        let p = 2.0 * prediction.kinds[0].tail(3.041);
        assert!((p - 0.05).abs() < 1e-3, "{p}");
    }

    #[test]
    fn a_long_normal_history_expects_nearly_what_students_interval_does() {
        let prediction = Prediction::of(&nights(1, 2000)).unwrap();
        let normal = prediction.kinds[0];
        let (p, normal) = (
            prediction.p(&[4.5]).unwrap(),
            2.0 * normal.tail(4.5 - normal.middle),
        );
        assert!((1.0..1.5).contains(&(p / normal)), "{p} {normal}");
    }

    #[test]
    fn a_stricter_level_finds_only_larger_jumps() {
        let prediction = Prediction::of(&[1.0, 2.0, 3.0, 2.0, 1.0, 3.0]).unwrap();
        assert!(prediction.detectable(0.001) > prediction.detectable(0.01));
    }

    #[test]
    fn one_night_far_off_makes_the_next_one_less_of_a_surprise() {
        let mut levels = nights(2, 60);
        let before = Prediction::of(&levels).unwrap().p(&[9.0]).unwrap();
        levels[30] = -8.0;
        let after = Prediction::of(&levels).unwrap().p(&[9.0]).unwrap();
        assert!(before < 1e-4 && after > 1e-3, "{before} {after}");
    }

    #[test]
    fn tails_are_told_by_the_nights() {
        let mut noise = Noise::new(3);
        let heavy: Vec<f64> = (0..400)
            .map(|_| noise.normal() / ((0..3).map(|_| noise.normal().powi(2)).sum::<f64>() / 3.0).sqrt())
            .collect();
        let normal = |levels: &[f64]| Prediction::of(levels).unwrap().kinds[0].weight;
        assert!(normal(&heavy) < 1e-6, "{}", normal(&heavy));
        assert!(normal(&nights(3, 400)) > 0.9, "{}", normal(&nights(3, 400)));
    }

    #[rstest]
    #[case::three(3, 2.0 / 1771.0)]
    #[case::four(4, 2.0 / 10626.0)]
    fn three_nights_and_more_are_counted_by_their_order(#[case] count: usize, #[case] p: f64) {
        // C(23, 3) = 1771, C(24, 4) = 10626.
        let levels = nights(4, 20);
        let prediction = Prediction::of(&levels).unwrap();
        let most = levels.iter().copied().fold(f64::MIN, f64::max);
        let found = prediction.p(&vec![most + 0.001; count]).unwrap();
        assert!((found / (p / 0.9) - 1.0).abs() < 1e-9, "{found} {p}");
        assert_eq!(prediction.p(&[9.0, 9.0, 0.0]), None, "one that is not beyond");
        assert_eq!(prediction.p(&[-9.0, 9.0]), None, "on both sides");
    }

    #[test]
    fn three_nights_very_far_off_are_told_where_their_order_says_little() {
        let prediction = Prediction::of(&nights(4, 10)).unwrap();
        let (three, two) = (
            prediction.p(&[40.0; 3]).unwrap(),
            prediction.p(&[40.0; 2]).unwrap(),
        );
        assert!(three < 1e-4 && (three / two - 10.0).abs() < 1e-9, "{three} {two}");
    }

    #[test]
    fn a_jump_as_large_as_is_said_is_found_in_four_of_five_histories() {
        let level = 1e-3;
        let mut noise = Noise::new(6);
        let found = (0..400)
            .filter(|seed| {
                let prediction = Prediction::of(&nights(100 + seed, 60)).unwrap();
                let newest = noise.normal() + prediction.detectable(level);
                prediction.p(&[newest]).is_some_and(|p| p < level)
            })
            .count();
        // Nearly: 0.8 of 400, where the middle is estimated too.
        assert!((290..=360).contains(&found), "{found}");
    }
}
