//! What the next night is expected to be, from those before it, whatever the tails of nights are like. The main type
//! is [`Prediction`].
//!
//! Four nights or a year do not say whether nights are normal. A test that takes them for normal alarms twenty times as often
//! as it says where they have the tails of Student's t with 3 degrees of freedom. So the chance of a night so far off is the mean
//! of what several kinds of tails say, each weighted by how well it explains the nights before (Bayesian model averaging; Hoeting,
//! Madigan, Raftery and Volinsky, Statistical Science 14, 1999):
//!
//! ```text
//! p = 2 Σ w_ν S_ν(T_ν),   T_ν = |x − μ_ν| / (σ_ν √(1 + 1/n)),   w_ν ∝ prior_ν · likelihood of the n nights before
//! ```
//!
//! ν is infinite for normal nights, where μ and σ are mean and standard
//! deviation and S is that of t with n − 1 degrees of freedom (Hahn, *Factors for calculating two-sided prediction intervals for samples from a normal
//! distribution*, JASA 64, 1969); else μ and σ fit t with
//! ν degrees of freedom best (by the iteration of Lange, Little and Taylor, *Robust statistical modeling using the t
//! distribution*, JASA 84, 1989).
//!
//! Nights that resemble each other show less of how nights differ: [`Prediction::of_dependent`] has a wider scale and fewer
//! degrees of freedom. One night is all that is predicted: two nights share the error of the mean and of the scale, and the product
//! of their chances is no chance of both.

use statrs::distribution::{Continuous, ContinuousCDF, StudentsT};

use crate::{chart::inflation, effect::median, power};

/// The fewest nights that say how much nights differ.
pub const FEWEST_NIGHTS: usize = 4;

/// Degrees of freedom of tails that nights may have, heavy to light, each of [`HEAVY`] before any night is seen.
const TAILS: [f64; 3] = [2.5, 4.0, 8.0];
/// What is held of each of the [`TAILS`] beforehand; the rest is held of normal nights. Chosen by simulation, for few false
/// alarms of both (docs/drift.md).
const HEAVY: f64 = 0.1;
/// Rounds of the fit; it moves by less than a percent of σ after ten.
const ROUNDS: usize = 25;

/// What the nights before say of the next.
#[derive(Debug, Clone, PartialEq)]
pub struct Prediction {
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
        Self::of_dependent(levels, 0.0)
    }

    /// The same, where successive nights are correlated by `phi`, from 0 to below 1, as in a first-order autoregression.
    #[must_use]
    pub fn of_dependent(levels: &[f64], phi: f64) -> Option<Self> {
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
        // Of a mean of n correlated nights, n times its variance.
        let inflation = inflation(phi, count);
        let free = count - inflation;
        let (unbiased, one_more) = ((count / free).sqrt(), (1.0 + inflation / count).sqrt());
        let known = (free * (1.0 - phi * phi) / (1.0 + phi * phi)).max(1.0);
        let mut found = vec![(
            (1.0 - HEAVY * TAILS.len() as f64).ln() + normal_likelihood(count, spread),
            Kind {
                weight: 0.0,
                middle: mean,
                scale: spread * unbiased * one_more,
                freedom: known,
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
                    freedom: freedom.min(known),
                },
            ));
        }
        let largest = found
            .iter()
            .map(|(weight, _)| *weight)
            .fold(f64::NEG_INFINITY, f64::max);
        let sum: f64 = found.iter().map(|(weight, _)| (weight - largest).exp()).sum();
        Some(Self {
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

    /// The chance of a night that is as far above all before as this one, or as far below; none where it is within them.
    #[must_use]
    pub fn p(&self, newest: f64) -> Option<f64> {
        if newest <= self.most && newest >= self.least {
            return None;
        }
        let tail = |kind: &Kind| kind.weight * kind.tail((newest - kind.middle).abs());
        Some((2.0 * self.kinds.iter().map(tail).sum::<f64>()).min(1.0))
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
    use super::*;
    use crate::noise_model::Noise;

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
        let (p, normal) = (prediction.p(4.5).unwrap(), 2.0 * normal.tail(4.5 - normal.middle));
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
        let before = Prediction::of(&levels).unwrap().p(9.0).unwrap();
        levels[30] = -8.0;
        let after = Prediction::of(&levels).unwrap().p(9.0).unwrap();
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

    #[test]
    fn nights_that_resemble_each_other_show_less_of_how_nights_differ() {
        let levels = nights(5, 12);
        let p = |phi: f64| Prediction::of_dependent(&levels, phi).unwrap().p(6.0).unwrap();
        assert!(
            p(0.0) < p(0.3) && p(0.3) < p(0.7),
            "{} {} {}",
            p(0.0),
            p(0.3),
            p(0.7)
        );
        assert_eq!(Prediction::of(&levels), Prediction::of_dependent(&levels, 0.0));
    }

    #[test]
    fn a_jump_as_large_as_is_said_is_found_in_four_of_five_histories() {
        let level = 1e-3;
        let mut noise = Noise::new(6);
        let found = (0..400)
            .filter(|seed| {
                let prediction = Prediction::of(&nights(100 + seed, 60)).unwrap();
                let newest = noise.normal() + prediction.detectable(level);
                prediction.p(newest).is_some_and(|p| p < level)
            })
            .count();
        // Nearly: 0.8 of 400, where the middle is estimated too.
        assert!((290..=360).contains(&found), "{found}");
    }
}
