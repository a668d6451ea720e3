//! Statistics of numbers: tests, effects, adjustments, charts of nights and predictions, what a design would detect, and data made up
//! for calibration. They know no run, scenario or sample.
//!
//! They are a crate of their own since they are what a report computes for long: every profile optimises this crate, and not
//! the tables and figures beside it, which polars makes slow to compile.

pub mod anderson_darling;
pub mod block_permutation;
pub mod chart;
pub mod coverage;
pub mod dependence;
pub mod effect;
pub mod energy;
pub mod explained_part;
pub mod ks;
pub mod mean_shift;
pub mod multiplicity;
pub mod nights;
pub mod noise_model;
pub mod permutation;
pub mod pooled_ranks;
pub mod power;
pub mod prediction;
pub mod public_series;
pub mod relabelling;
pub mod replicate_model;
pub mod replicates;
pub mod serial;
pub mod shape;
pub mod stationarity;
pub mod swaps;
pub mod trend;
pub mod variance_components;
pub mod watch;
