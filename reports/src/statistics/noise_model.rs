//! Made-up windows that are alike, with the dependence that real ones have: what a method says of them is its false
//! positives. The main type is [`Noise`].

use std::f64::consts::TAU;

use oorandom::Rand64;

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
