//! What the programs agree on, as types: the workload writes it, `matrix` and its reports read it, and the `fake` provider
//! writes it too.
//!
//! - what a matrix file asks of the workload: [`settings`], [`experiment`], [`quantity`], [`virtual_host`],
//!   [`topology`];
//! - what the workload leaves behind, one module for each file or stream, with its format and units: [`window`],
//!   [`control_log`], [`plant_log`], [`platform`], [`progress`], [`check`]; its exit codes are in [`exit`];
//! - names: of files and folders in [`layout`], of axes in [`axis`], those that are safe in files in [`name`]; what a host is said
//!   to be in [`identity`]; errors in words in [`causes`];
//! - how the workload is called: [`call`]; what `workload detached` reads and answers: [`detached`], and how it sends the data:
//!   [`transfer`];
//! - what a program needs of the kernel before it begins: [`limits`];
//! - with the feature `run-directory`, the run directory, how its hosts were reached, how its results are compared, and how its
//!   text is shown: `run_directory`, `connection`, `report_settings`, `family`, `escaping`.
//!
//! A change of meaning of what the workload writes needs a new [`FORMAT`].

pub mod axis;
pub mod call;
pub mod causes;
pub mod check;
#[cfg(feature = "run-directory")]
pub mod connection;
pub mod control_log;
pub mod detached;
#[cfg(feature = "run-directory")]
pub mod escaping;
pub mod exit;
pub mod experiment;
#[cfg(feature = "run-directory")]
pub mod family;
pub mod identity;
pub mod layout;
pub mod limits;
pub mod name;
pub mod plant_log;
pub mod platform;
pub mod platform_model;
pub mod progress;
pub mod quantity;
pub mod reason;
#[cfg(feature = "run-directory")]
pub mod report_settings;
#[cfg(feature = "run-directory")]
pub mod run_directory;
pub mod settings;
pub mod topology;
pub mod transfer;
pub mod virtual_host;
pub mod window;

/// Version of the files that the workload writes.
pub const FORMAT: u32 = 1;

/// The name of a field of a record, as it is in a file. The compiler finds that there is no such field; of one that serde renames it
/// would not find it.
#[macro_export]
macro_rules! field {
    ($record:ty, $name:ident) => {{
        const _: fn(&$record) = |record| {
            let _ = &record.$name;
        };
        stringify!($name)
    }};
}
