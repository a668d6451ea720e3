//! The exit codes of both programs.

pub mod matrix;
pub mod workload;
