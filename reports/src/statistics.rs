//! Statistics of numbers: tests, effects, adjustments, and data made up for calibration. They know no run, scenario or sample.

pub mod anderson_darling;
pub mod block_permutation;
pub mod dependence;
pub mod effect;
pub mod energy;
pub mod ks;
pub mod multiplicity;
pub mod noise_model;
pub mod permutation;
pub mod pooled_ranks;
pub mod relabelling;
pub mod shape;
pub mod stationarity;
