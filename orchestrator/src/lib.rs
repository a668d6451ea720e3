//! Matrix file -> plan -> run -> run directory.
//!
//! ```text
//! matrix_file   text -> MatrixFile                              pure
//! host          a machine: programs and sockets on it, here or over SSH
//! survey        what the hosts can do
//! plan          MatrixFile, what hosts can do -> Plan           pure
//! run           Plan -> events -> run directory, by providers
//! observer      events -> journal, progress bars, plain lines
//! command       what a user asks for, made of these
//! ```

pub mod arguments;
pub mod command;
pub mod exit;
#[doc(hidden)]
pub mod fuzzing;
pub mod host;
pub mod journal;
pub mod lease;
pub mod matrix_file;
pub mod observer;
pub mod plan;
pub mod provider;
pub mod room;
pub mod run;
pub mod state_directory;
pub mod survey;
pub mod terminal;
pub mod workload_binary;
