//! Matrix file -> plan -> run -> run directory.
//!
//! ```text
//! matrix_file   text -> MatrixFile                              pure
//! host          a machine: programs and sockets on it, here or over SSH
//! batch         what a cluster's scheduler is asked
//! survey        what the hosts can do
//! plan          MatrixFile, what hosts can do -> Plan           pure
//! preparation   path of a matrix file -> Plan, by a survey or offline
//! examination   all that a host can do, whatever a matrix needs
//! run           Plan -> events -> run directory, by providers
//! observer      events -> journal, and whoever watches
//! cli           what a user asks for, made of these: all that reads arguments, prints and chooses an exit code
//! ```

pub mod batch;
pub mod cli;
pub mod disk_space;
mod entry;
pub mod escaping;
pub mod examination;
pub mod experiment_files;
pub mod failure;
#[doc(hidden)]
pub mod fuzzing;
pub mod host;
pub mod journal;
pub mod lease;
pub mod matrix_file;
pub mod observer;
pub mod plan;
pub mod preparation;
pub mod provider;
pub mod run;
pub mod state_directory;
pub mod survey;
pub mod workload_binary;

pub use entry::main_with;
