//! The command line: what reads arguments, prints, and chooses an exit code. Everything below it returns typed errors and
//! events. The main function is [`command::execute`].

pub mod arguments;
pub mod command;
pub mod completion;
pub mod plain_log;
pub mod progress_bars;
pub mod run_argument;
mod session;
pub mod terminal;
