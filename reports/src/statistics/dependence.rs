//! How much the values within a window depend on each other: autocorrelation, and how many independent values they are
//! worth. The main type is [`Dependence`].
//!
//! ```text
//! ρ(k) = Σ (x_t − x̄)(x_{t+k} − x̄) / Σ (x_t − x̄)²        over all windows, each around its own mean
//! τ = 1 + 2 Σ ρ(k)                                         n_eff = n / τ
//! ```
//!
//! The sum ends where Geyer's initial positive sequence does (*Practical Markov Chain Monte Carlo*, 1992): ρ(2m) +
//! ρ(2m + 1) is added as long as it is positive. It needs no window width to be chosen, as Sokal's rule does, and with 60
//! values that choice would matter more than the estimate. τ is taken to be at least 1: that negative correlation made
//! values worth more than they are is not believed.

/// The dependence within the windows of one scenario.
#[derive(Debug, Clone, PartialEq)]
pub struct Dependence {
    /// ρ(1), ρ(2), … up to where Geyer's sequence ends, and at least ρ(1).
    pub autocorrelation: Vec<f64>,
    /// Integrated autocorrelation time τ, in periods; at least 1.
    pub time: f64,
    /// Values in all windows.
    pub n: usize,
    /// Independent values they are worth.
    pub effective: f64,
}

impl Dependence {
    /// That of some windows; none where no window has two values that differ.
    #[must_use]
    pub fn of(windows: &[&[f64]]) -> Option<Self> {
        let centred: Vec<Vec<f64>> = windows
            .iter()
            .filter(|window| !window.is_empty())
            .map(|window| {
                let mean = window.iter().sum::<f64>() / window.len() as f64;
                window.iter().map(|value| value - mean).collect()
            })
            .collect();
        let n = centred.iter().map(Vec::len).sum();
        let longest = centred.iter().map(Vec::len).max()?;
        let covariance = |lag: usize| -> f64 {
            centred
                .iter()
                .flat_map(|values| values.iter().zip(values.iter().skip(lag)))
                .map(|(a, b)| a * b)
                .sum()
        };
        let variance = covariance(0);
        let largest = windows
            .iter()
            .flat_map(|w| w.iter())
            .fold(0.0_f64, |most, v| most.max(v.abs()));
        // Equal values differ from their mean by rounding.
        if longest < 2 || variance <= n as f64 * (largest * 1e-12).powi(2) {
            return None;
        }
        let rho = |lag: usize| covariance(lag) / variance;
        let mut autocorrelation = vec![rho(1)];
        // ρ(0) + ρ(1), then ρ(2) + ρ(3), …
        let mut pair = 1.0 + rho(1);
        let mut sum = 0.0;
        let mut lag = 2;
        while pair > 0.0 {
            sum += pair;
            if lag + 1 >= longest {
                break;
            }
            let (even, odd) = (rho(lag), rho(lag + 1));
            pair = even + odd;
            if pair > 0.0 {
                autocorrelation.extend([even, odd]);
            }
            lag += 2;
        }
        let time = (2.0 * sum - 1.0).max(1.0);
        Some(Self {
            autocorrelation,
            time,
            n,
            effective: n as f64 / time,
        })
    }

    /// The block of some windows; one value where nothing is known of them.
    #[must_use]
    pub fn block_of(windows: &[&[f64]]) -> usize {
        Self::of(windows).map_or(1, |found| found.block())
    }

    /// ρ(1).
    #[must_use]
    pub fn lag_one(&self) -> f64 {
        self.autocorrelation.first().copied().unwrap_or(0.0)
    }

    /// Values in a block that is about independent of the next: twice the autocorrelation time, and one where values
    /// are independent.
    #[must_use]
    pub fn block(&self) -> usize {
        if self.time > 1.0 {
            (2.0 * self.time).ceil() as usize
        } else {
            1
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::statistics::noise_model::Noise;

    // Closed form for AR(1): ρ(k) = φ^k and τ = (1 + φ)/(1 − φ).
    #[rstest::rstest]
    #[case(0.0, 1.0)]
    #[case(0.5, 3.0)]
    #[case(0.9, 19.0)]
    fn ar1_noise_has_the_time_of_its_closed_form(#[case] phi: f64, #[case] time: f64) {
        let mut noise = Noise::new(3);
        let windows: Vec<Vec<f64>> = (0..4).map(|_| noise.ar1(20_000, phi)).collect();
        let windows: Vec<&[f64]> = windows.iter().map(Vec::as_slice).collect();
        let found = Dependence::of(&windows).unwrap();
        assert!((found.lag_one() - phi).abs() < 0.02, "{}", found.lag_one());
        assert!((found.time / time - 1.0).abs() < 0.1, "{}", found.time);
    }

    // Expected: statsmodels.tsa.stattools.acf([...], nlags=3); reports/tests/data/window_tests.py.
    #[test]
    fn a_windows_autocorrelation_is_that_of_statsmodels() {
        let found = Dependence::of(&[&[1.0, 2.0, 4.0, 3.0, 5.0, 6.0, 5.0, 7.0]]).unwrap();
        let expected = [0.410_714_285_7, 0.232_683_982_7, 0.102_272_727_3];
        for (found, expected) in found.autocorrelation.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-9, "{found}");
        }
    }

    #[test]
    fn negative_correlation_makes_no_value_worth_more_than_one() {
        let found = Dependence::of(&[&[1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0]]).unwrap();
        assert!(found.lag_one() < -0.8);
        assert_eq!((found.time, found.effective, found.block()), (1.0, 8.0, 1));
    }

    #[test]
    fn windows_at_different_levels_are_no_correlation_within_them() {
        let found = Dependence::of(&[&[1.0, 2.0, 1.0, 2.0, 1.5], &[9.0, 8.0, 9.0, 8.0, 8.5]]).unwrap();
        assert!(found.lag_one() < 0.0);
    }

    #[rstest::rstest]
    #[case(&[])]
    #[case(&[&[][..]])]
    #[case(&[&[1.0][..]])]
    #[case(&[&[0.1, 0.1, 0.1][..]])]
    fn without_two_values_that_differ_there_is_none(#[case] windows: &[&[f64]]) {
        assert_eq!(Dependence::of(windows), None);
    }
}
