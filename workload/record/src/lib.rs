//! What the programs agree on, as types: the workload writes it, `matrix` and its reports read it, and the `fake` provider
//! writes it too.
//!
//! - what a matrix file asks of the workload: [`settings`], [`quantity`], [`virtual_host`];
//! - what the workload leaves behind, one module for each file or stream, with its format and units: [`window`],
//!   [`control_log`], [`plant_log`], [`platform`], [`progress`], [`check`]; its exit codes are in [`exit`];
//! - names: of files and folders in [`layout`], of axes in [`axis`], those that are safe in files in [`name`]; errors in words in
//!   [`causes`];
//! - what `workload detached` is asked and answers: [`detached`];
//! - with the feature `run-directory`, the run directory and how its results are compared: `run_directory`,
//!   `report_settings`, `family`.
//!
//! A change of meaning of what the workload writes needs a new [`FORMAT`].

pub mod axis;
pub mod causes;
pub mod check;
pub mod control_log;
pub mod detached;
pub mod exit;
#[cfg(feature = "run-directory")]
pub mod family;
pub mod layout;
pub mod name;
pub mod plant_log;
pub mod platform;
pub mod progress;
pub mod quantity;
#[cfg(feature = "run-directory")]
pub mod report_settings;
#[cfg(feature = "run-directory")]
pub mod run_directory;
pub mod settings;
pub mod virtual_host;
pub mod window;

/// Version of the files that the workload writes.
pub const FORMAT: u32 = 1;
