//! Matrix file -> plan -> run -> run directory.

pub mod provider;
