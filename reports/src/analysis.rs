//! From a run to what is compared and what came of it: [`report::analyse`]. Pure, and without words for a reader but names.

pub mod agreement;
pub mod calibration;
pub mod calls;
pub mod changed_settings;
pub mod combination;
pub mod comparison;
pub mod conclusion;
pub mod contrast;
pub(crate) mod declaration;
pub(crate) mod fields;
pub mod health;
pub mod measured_experiment;
pub mod other_ways;
pub mod packet_counts;
pub mod packet_explanations;
pub mod pairs;
pub(crate) mod paper;
pub mod quantity;
pub mod replicates;
pub mod report;
pub mod sample;
pub mod scenario;
pub mod sensitivity;
pub mod setup;
pub mod simulated_errors;
pub mod within;
