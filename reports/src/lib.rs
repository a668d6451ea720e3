//! Run directory -> samples -> comparisons -> tables and figures.
//!
//! ```text
//! load(path) -> Run           reads the run directory; the only reading there is
//! analyse(&Run, settings) -> Report     pure
//! Report::markdown, json      pure
//! write(&Run, &Report)        the run directory's `report/`, and nothing else of it
//! write_messages(path)        the captures' messages, into `report/messages/`
//! ```

pub mod comparison;
pub mod figure;
pub mod health;
pub mod ks;
pub mod messages;
pub mod packets;
mod render;
pub mod report;
pub mod run;
pub mod run_directory;
pub mod sample;
pub mod settings;
pub mod table;
mod writing;

pub use report::{Report, analyse};
pub use run::{Run, load};
pub use run_directory::ReadError;
pub use writing::{WriteError, write};
