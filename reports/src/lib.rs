//! Run directory -> samples -> comparisons -> tables and figures.

pub mod ks;
pub mod run_directory;
pub mod settings;
