//! Matrix file -> plan -> run -> run directory.

pub mod exit;
pub mod journal;
pub mod lease;
pub mod matrix_file;
pub mod observer;
pub mod plan;
pub mod provider;
pub mod run;
pub mod state_directory;
pub mod workload_binary;
