//! Made-up windows that are alike, with the dependence that real ones have: what a method says of them is its false
//! positives. The main type is [`Noise`].

use std::f64::consts::TAU;

use oorandom::Rand64;

/// How often levels are far off.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Tails {
    /// As of the normal distribution.
    Normal,
    /// As of Student's t with 3 degrees of freedom: one in 70 is 3 standard deviations off, in place of one in 370.
    Heavy,
}

/// A seeded source of normal noise.
#[derive(Debug, Clone)]
pub struct Noise(Rand64);

impl Noise {
    /// The noise of a seed.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self(Rand64::new(u128::from(seed)))
    }

    /// A standard normal number (Box and Muller 1958).
    pub fn normal(&mut self) -> f64 {
        (-2.0 * (1.0 - self.0.rand_float()).ln()).sqrt() * (TAU * self.0.rand_float()).cos()
    }

    /// A number of standard deviation 1.
    pub fn of(&mut self, tails: Tails) -> f64 {
        match tails {
            Tails::Normal => self.normal(),
            Tails::Heavy => {
                const FREEDOM: usize = 3;
                let scale = self.chi_squared(FREEDOM) / FREEDOM as f64;
                // The variance of Student's t with ν degrees of freedom is ν / (ν − 2).
                self.normal() / (scale * 3.0).sqrt()
            }
        }
    }

    /// A χ² number of so many degrees of freedom, at least 1.
    pub fn chi_squared(&mut self, freedom: usize) -> f64 {
        // Wilson and Hilferty 1931; at 50 degrees of freedom its quantiles are right to 1e-4.
        if freedom > 50 {
            let nu = freedom as f64;
            let part = 2.0 / (9.0 * nu);
            return nu * (1.0 - part + self.normal() * part.sqrt()).powi(3).max(0.0);
        }
        (0..freedom.max(1)).map(|_| self.normal().powi(2)).sum()
    }

    /// AR(1) noise of standard deviation 1 and autocorrelation `phi`, stationary from the start.
    pub fn ar1(&mut self, n: usize, phi: f64) -> Vec<f64> {
        let mut value = self.normal();
        (0..n)
            .map(|_| {
                value = phi * value + (1.0 - phi * phi).sqrt() * self.normal();
                value
            })
            .collect()
    }
}

/// What the windows of a run share though no scenario differs from another. Levels have standard deviation 1 within an
/// environment; each scenario is measured in one environment, window after window, one scenario after the other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Shared {
    /// Nothing: what a permutation test of windows assumes.
    Nothing(Tails),
    /// Each window remembers the one before, of its own scenario or of the one before: AR(1) with this coefficient.
    Memory(f64),
    /// The run drifts in a straight line, by so much from its first window to its last.
    Drift(f64),
    /// Each environment has a level of its own, of this standard deviation.
    Environment(f64),
}

impl Shared {
    /// The window levels of each scenario, in the order in which they are measured.
    pub fn levels(self, scenarios: usize, windows: usize, noise: &mut Noise) -> Vec<Vec<f64>> {
        let last = (scenarios * windows).saturating_sub(1).max(1) as f64;
        let all: Vec<f64> = match self {
            Self::Nothing(tails) => (0..scenarios * windows).map(|_| noise.of(tails)).collect(),
            Self::Memory(phi) => noise.ar1(scenarios * windows, phi),
            Self::Drift(by) => (0..scenarios * windows)
                .map(|at| by * at as f64 / last + noise.normal())
                .collect(),
            Self::Environment(deviation) => (0..scenarios)
                .flat_map(|_| {
                    let environment = deviation * noise.normal();
                    noise
                        .ar1(windows, 0.0)
                        .into_iter()
                        .map(move |level| environment + level)
                })
                .collect(),
        };
        all.chunks(windows.max(1)).map(<[f64]>::to_vec).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{permutation, relabelling::Effort};

    // The figures of a program of its own are .08, .29, .46, .22 and .49, of 200 runs each.
    #[rstest::rstest]
    #[case(Shared::Nothing(Tails::Normal), 0.02..0.08)]
    #[case(Shared::Nothing(Tails::Heavy), 0.02..0.08)]
    #[case(Shared::Memory(0.6), 0.2..0.4)]
    #[case(Shared::Drift(2.0), 0.36..0.56)]
    #[case(Shared::Environment(0.5), 0.14..0.3)]
    #[case(Shared::Environment(1.0), 0.4..0.58)]
    fn what_windows_share_is_taken_for_a_difference_of_their_scenarios(
        #[case] shared: Shared,
        #[case] rejected: std::ops::Range<f64>,
    ) {
        let found = (0..600).filter(|seed| {
            let levels = shared.levels(2, 8, &mut Noise::new(*seed));
            let test = permutation::mean_difference(&levels[0], &levels[1], Effort::of_a_report(1));
            test.unwrap().p < 0.05
        });
        let share = found.count() as f64 / 600.0;
        assert!(rejected.contains(&share), "{share}");
    }

    #[test]
    fn chi_squared_numbers_have_their_mean_and_variance() {
        let mut noise = Noise::new(5);
        for freedom in [1, 9, 80] {
            let drawn: Vec<f64> = (0..20_000).map(|_| noise.chi_squared(freedom)).collect();
            let mean = drawn.iter().sum::<f64>() / drawn.len() as f64;
            let variance = drawn.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / drawn.len() as f64;
            let nu = freedom as f64;
            assert!((mean / nu - 1.0).abs() < 0.04, "{freedom}: {mean}");
            assert!(
                (variance / (2.0 * nu) - 1.0).abs() < 0.08,
                "{freedom}: {variance}"
            );
        }
    }

    #[test]
    fn heavy_tails_have_the_quantiles_of_students_t() {
        let mut noise = Noise::new(6);
        let mut drawn: Vec<f64> = (0..50_000).map(|_| noise.of(Tails::Heavy)).collect();
        drawn.sort_by(f64::total_cmp);
        // R: qt(c(.9, .99), 3) / sqrt(3)
        for (share, quantile) in [(0.9, 0.945_6), (0.99, 2.621_6)] {
            let found = drawn[(share * drawn.len() as f64) as usize];
            assert!((found / quantile - 1.0).abs() < 0.04, "{share}: {found}");
        }
    }
}
