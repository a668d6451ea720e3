//! What a pair of windows would detect: the smallest disturbance of a platform that the report's KS test finds with a
//! power of [`POWER`], from the closed loop in virtual time ([`simulation::closed_loop`]). The main function is
//! [`Design::sensitivity`].
//!
//! A pair is an undisturbed window and one that is disturbed throughout; all are simulated independently. A disturbance
//! is doubled from a 256th of the largest one that is looked at until it is detected, and then bisected, so that of
//! several sizes at which the power goes through [`POWER`] the smallest is found. A size is given up as soon as more pairs
//! are missed than the power allows. What is found is tried once more on pairs that had no part in finding it, since the search stops
//! where luck was good.

use std::time::Duration;

use rayon::prelude::*;
use record::{
    platform_model::Quantiles,
    report_settings::{ErrorOf, ReportSettings},
    settings::Settings,
};
use simulation::closed_loop::Platform;
use statistics::ks::Procedure;

use crate::analysis::{calibration::Rate, simulated_errors::period_errors_m};

/// The share of pairs that are to be told apart.
pub const POWER: f64 = 0.9;

/// How often the smallest size that is tried is doubled up to the largest.
const DOUBLINGS: u32 = 8;
/// How often what lies between detected and not is halved, on a logarithmic scale: to 9 %.
const HALVINGS: u32 = 3;
/// Pairs of a size that are simulated at a time: with more, more is simulated in vain.
const AT_ONCE: usize = 4;

/// What a platform may do to a window.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Disturbance {
    /// Every packet takes longer, each way; in milliseconds.
    Delay,
    /// More packets are lost at each end of a link; in percentage points.
    Loss,
    /// So many percent of both loops' ticks begin late by this time.
    Stalls(Duration),
}

impl Disturbance {
    /// Those that are looked for: stalls of half a step at 50 Hz and of five.
    pub const ALL: [Self; 4] = [
        Self::Delay,
        Self::Loss,
        Self::Stalls(Duration::from_millis(10)),
        Self::Stalls(Duration::from_millis(100)),
    ];

    /// The largest size that is tried.
    #[must_use]
    pub const fn largest(self) -> f64 {
        match self {
            Self::Delay => 20.0,
            Self::Loss => 5.0,
            Self::Stalls(_) => 25.0,
        }
    }

    /// Puts it on a platform.
    fn disturb(self, size: f64, platform: &mut Platform) {
        match self {
            // Two ends each way.
            Self::Delay => platform.network.impairment.delay_ns += (size * 1e6 / 2.0) as u64,
            Self::Loss => platform.network.impairment.loss += size / 100.0,
            Self::Stalls(length) => {
                let late = Quantiles::sometimes(size / 100.0, length.into());
                platform.controller.late = late.clone();
                platform.plant.late = late;
            }
        }
    }
}

/// What pairs are made of.
#[derive(Debug, Clone, Copy)]
pub struct Design<'a> {
    /// What a window is.
    pub settings: &'a Settings,
    /// How two are compared.
    pub report: &'a ReportSettings,
    /// How many pairs a power is the share of.
    pub pairs: usize,
    /// The same gives the same result.
    pub seed: u64,
}

/// What a pair of windows would detect.
#[derive(Debug, Clone, PartialEq)]
pub struct Sensitivity {
    /// How often two undisturbed windows differ.
    pub alike: Rate,
    /// Of each of [`Disturbance::ALL`].
    pub detected: Vec<Detected>,
}

/// The smallest size of a disturbance that is detected.
#[derive(Debug, Clone, PartialEq)]
pub struct Detected {
    /// Of which.
    pub disturbance: Disturbance,
    /// In its unit; none where the largest is not detected.
    pub size: Option<f64>,
    /// How often it was, on new pairs: at that size, or at the largest.
    pub power: Rate,
}

/// Windows of their own for finding a size and for trying it.
#[derive(Debug, Clone, Copy)]
enum Role {
    Finding,
    Trying,
}

/// Undisturbed windows.
struct Alike {
    finding: Vec<Vec<f64>>,
    trying: Vec<Vec<f64>>,
}

impl Design<'_> {
    /// Finds the size of each disturbance. Takes long: a few hundred windows are simulated for each.
    #[must_use]
    pub fn sensitivity(&self) -> Sensitivity {
        let alike = self.alike();
        let pairs = alike.finding.iter().zip(&alike.trying);
        let rejected = pairs.filter(|(a, b)| self.rejects(a, b)).count();
        Sensitivity {
            alike: self.rate("undisturbed windows", rejected),
            detected: Disturbance::ALL
                .into_par_iter()
                .map(|disturbance| self.detected(disturbance, &alike))
                .collect(),
        }
    }

    fn alike(&self) -> Alike {
        let platform = Platform::ideal(self.settings);
        let windows = |role| -> Vec<Vec<f64>> {
            (0..self.pairs)
                .into_par_iter()
                .map(|pair| self.window(&platform, self.seed_of(role, 0, pair)))
                .collect()
        };
        Alike {
            finding: windows(Role::Finding),
            trying: windows(Role::Trying),
        }
    }

    fn detected(&self, disturbance: Disturbance, alike: &Alike) -> Detected {
        let is_detected = |size| self.is_detected(disturbance, size, &alike.finding);
        let mut found = (0..=DOUBLINGS)
            .rev()
            .map(|halvings| disturbance.largest() / f64::from(1_u32 << halvings))
            .find(|size| is_detected(*size));
        if let Some(size) = &mut found {
            let mut factor = 2.0_f64;
            for _ in 0..HALVINGS {
                factor = factor.sqrt();
                if is_detected(*size / factor) {
                    *size /= factor;
                }
            }
        }
        let size = found.unwrap_or(disturbance.largest());
        let rejected = (0..self.pairs)
            .into_par_iter()
            .zip(&alike.trying)
            .filter(|(pair, window)| {
                let disturbed = self.disturbed(disturbance, size, Role::Trying, *pair);
                self.rejects(window, &disturbed)
            })
            .count();
        Detected {
            disturbance,
            size: found,
            power: self.rate("disturbed windows", rejected),
        }
    }

    /// Whether the power is at least [`POWER`].
    fn is_detected(&self, disturbance: Disturbance, size: f64, alike: &[Vec<f64>]) -> bool {
        let allowed = self.pairs - (POWER * self.pairs as f64).ceil() as usize;
        let mut missed = 0;
        for (at, some) in alike.chunks(AT_ONCE).enumerate() {
            missed += some
                .par_iter()
                .enumerate()
                .filter(|(within, window)| {
                    let pair = at * AT_ONCE + within;
                    let disturbed = self.disturbed(disturbance, size, Role::Finding, pair);
                    !self.rejects(window, &disturbed)
                })
                .count();
            if missed > allowed {
                return false;
            }
        }
        true
    }

    /// A disturbed window. Of all sizes a pair has the same chance, so that its luck does not change within a search.
    fn disturbed(&self, disturbance: Disturbance, size: f64, role: Role, pair: usize) -> Vec<f64> {
        let mut platform = Platform::ideal(self.settings);
        disturbance.disturb(size, &mut platform);
        self.window(&platform, self.seed_of(role, 1, pair))
    }

    fn seed_of(&self, role: Role, side: u64, pair: usize) -> u64 {
        (self.seed << 32) ^ ((pair as u64) << 2) ^ ((role as u64) << 1) ^ side
    }

    /// The errors of a window's periods, in metres, after those that the report leaves out.
    fn window(&self, platform: &Platform, seed: u64) -> Vec<f64> {
        let drawn = (self.settings.steps_per_window(), seed);
        period_errors_m(self.settings, self.report, ErrorOf::Received, platform, drawn)
    }

    /// Whether the report's test does. A loop that has left all numbers behind is unlike any.
    fn rejects(&self, a: &[f64], b: &[f64]) -> bool {
        let procedure = Procedure {
            method: self.report.method,
            ..Procedure::default()
        };
        let alike = procedure.test(a, b).is_ok_and(|test| test.p >= self.report.alpha);
        !alike
    }

    fn rate(&self, data: &'static str, rejected: usize) -> Rate {
        Rate {
            method: "KS of two windows".to_owned(),
            data,
            nominal: self.report.alpha,
            rejected,
            trials: self.pairs,
            independent: self.pairs,
        }
    }
}

#[cfg(test)]
mod tests {
    use record::{quantity::TimeSpan, settings::Dynamics};

    use super::*;

    fn settings(dynamics: Dynamics) -> Settings {
        let mut settings = Settings::of(dynamics);
        settings.period = TimeSpan::from_secs(4);
        settings.window = TimeSpan::from_secs(80);
        settings.reference.amplitude_m = 0.03;
        settings
    }

    fn design<'a>(settings: &'a Settings, report: &'a ReportSettings) -> Design<'a> {
        Design {
            settings,
            report,
            pairs: 10,
            seed: 1,
        }
    }

    #[test]
    fn a_window_has_as_many_errors_as_periods_and_a_delay_moves_them() {
        let (settings, report) = (settings(Dynamics::Author), ReportSettings::default());
        let design = design(&settings, &report);
        let platform = Platform::ideal(&settings);
        let window = design.window(&platform, 1);
        assert_eq!(window.len(), 20);
        assert_eq!(window, design.window(&platform, 1));
        assert_ne!(window, design.window(&platform, 2));
        let disturbed = design.disturbed(Disturbance::Delay, 20.0, Role::Finding, 0);
        assert!(design.rejects(&window, &disturbed));
    }

    #[test]
    fn a_delay_is_detected_from_some_size_on_and_undisturbed_windows_are_alike() {
        let (settings, report) = (settings(Dynamics::Robust), ReportSettings::default());
        let design = design(&settings, &report);
        let alike = design.alike();
        let found = design.detected(Disturbance::Delay, &alike);
        let size = found.size.unwrap();
        assert!((1.0..=20.0).contains(&size), "{found:?}");
        // Nine of ten are asked for; those that are counted had no part in finding the size.
        assert!(found.power.rejected >= 5, "{found:?}");
        assert!(!design.is_detected(Disturbance::Delay, 0.1, &alike.finding));
        assert_eq!(found, design.detected(Disturbance::Delay, &alike));
        let pairs = alike.finding.iter().zip(&alike.trying);
        assert!(pairs.filter(|(a, b)| design.rejects(a, b)).count() <= 1);
    }

    #[test]
    fn what_is_not_detected_at_its_largest_has_no_size() {
        let (settings, report) = (settings(Dynamics::Author), ReportSettings::default());
        let design = design(&settings, &report);
        let found = design.detected(Disturbance::Stalls(Duration::from_millis(10)), &design.alike());
        assert_eq!(found.size, None);
        assert!(found.power.rejected < 9, "{found:?}");
    }
}
