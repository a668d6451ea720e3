//! Whether windows resemble the windows before and after them: those of a machine that warms up, drifts, or remembers do, and are
//! then not the independent measurements for which every test takes them. The main type is [`SerialDependence`].
//!
//! ```text
//! r = Σ_s n_s r_s / Σ_s n_s,   r_s = Σ (x_t − x̄)(x_{t+1} − x̄) / Σ (x_t − x̄)²
//! ```
//!
//! over the scenarios s, each with its windows in the order of measuring. p is the share of the orders of the windows within
//! scenarios with an r at least as large (Wald and Wolfowitz, *An exact test for randomness in the non-parametric case based on
//! serial correlation*, 1943). Independent windows have r = −1/n on the mean and not 0, and all orders of them are alike. Few
//! windows of each of many scenarios do together what many of one do.

use oorandom::Rand64;

use crate::{effect::level, relabelling::shuffle};

/// How windows depend on their neighbours in time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SerialDependence {
    /// r less what independent windows have on the mean.
    pub lag_one: f64,
    /// The share of orders with an r at least as large.
    pub p: f64,
    /// Windows of the scenarios that have at least three.
    pub windows: usize,
}

/// Orders that are drawn.
const DRAWS: u32 = 9_999;

impl SerialDependence {
    /// That of the window levels of some scenarios, each in the order of measuring; none where no scenario has three windows that
    /// are not all alike.
    #[must_use]
    pub fn of(scenarios: &[&[f64]], seed: u64) -> Option<Self> {
        let mut standardised: Vec<Vec<f64>> = scenarios.iter().filter_map(|levels| unit(levels)).collect();
        let windows: usize = standardised.iter().map(Vec::len).sum();
        if windows == 0 {
            return None;
        }
        let r = |scenarios: &[Vec<f64>]| {
            let of_one =
                |x: &Vec<f64>| x.len() as f64 * x.windows(2).map(|pair| pair[0] * pair[1]).sum::<f64>();
            scenarios.iter().map(of_one).sum::<f64>() / windows as f64
        };
        let observed = r(&standardised);
        let on_the_mean = -(standardised.len() as f64) / windows as f64;
        let mut random = Rand64::new(u128::from(seed));
        let reached = (0..DRAWS).filter(|_| {
            for levels in &mut standardised {
                shuffle(levels, &mut random);
            }
            r(&standardised) >= observed - 1e-9
        });
        let reached = reached.count();
        Some(Self {
            lag_one: observed - on_the_mean,
            p: (reached + 1) as f64 / f64::from(DRAWS + 1),
            windows,
        })
    }
}

/// Levels around their mean, of a sum of squares of 1.
fn unit(levels: &[f64]) -> Option<Vec<f64>> {
    let mean = level(levels).filter(|_| levels.len() >= 3)?;
    let largest = levels.iter().fold(0.0_f64, |most, it| most.max(it.abs()));
    let size = levels.iter().map(|it| (it - mean).powi(2)).sum::<f64>().sqrt();
    // Equal levels differ from their mean by rounding.
    (size > largest * 1e-12).then(|| levels.iter().map(|it| (it - mean) / size).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise_model::Noise;

    fn of(scenarios: &[Vec<f64>]) -> Option<SerialDependence> {
        let scenarios: Vec<&[f64]> = scenarios.iter().map(Vec::as_slice).collect();
        SerialDependence::of(&scenarios, 1)
    }

    // By hand: 1, 2, 3 has r = 0, as 3, 2, 1; the four other orders −0.5.
    #[test]
    fn three_windows_in_a_row_are_two_of_six_orders() {
        let found = of(&[vec![1.0, 2.0, 3.0]]).unwrap();
        assert!((found.p - 2.0 / 6.0).abs() < 0.02, "{found:?}");
        assert!((found.lag_one - 1.0 / 3.0).abs() < 1e-9, "{found:?}");
    }

    #[test]
    fn scenarios_that_all_rise_are_seen_together() {
        let rising = vec![1.0, 2.0, 3.0, 4.0];
        assert!(of(std::slice::from_ref(&rising)).unwrap().p > 0.05);
        assert!(of(&vec![rising; 7]).unwrap().p < 0.001);
    }

    #[test]
    fn independent_windows_are_seldom_seen() {
        let mut random = Noise::new(2);
        let seen = (0..100).filter(|_| {
            let scenarios: Vec<Vec<f64>> = (0..3).map(|_| random.ar1(4, 0.0)).collect();
            of(&scenarios).unwrap().p < 0.05
        });
        assert!(seen.count() <= 12);
    }

    #[test]
    fn too_few_windows_and_equal_ones_have_no_order() {
        assert_eq!(of(&[vec![1.0, 2.0], vec![0.1; 5]]), None);
        assert_eq!(of(&[]), None);
    }
}
