//! Run directory -> samples -> comparisons -> tables and figures.
//!
//! ```text
//! load(path) -> Run           reads the run directory
//! combination::combine(Vec<Run>) -> Run    pure: machines that were measured apart
//! traffic::read(&Run) -> Traffic        reads its captures
//! analyse(&Run, Traffic, settings) -> Report     pure
//! Report::markdown, html, json      pure
//! write(&Run, &Report)        the run directory's `report/`, and nothing else of it
//! drift::history::judge(&[Night], settings) -> Drift    pure: many runs, and whether they change
//! write_messages(path)        the captures' messages, into `report/messages/`
//! ```

pub mod anderson_darling;
pub mod block_permutation;
pub mod combination;
pub mod comparison;
pub mod conclusion;
pub mod contrast;
mod declaration;
pub mod dependence;
pub mod drift;
pub mod effect;
pub mod energy;
pub mod family;
mod fields;
pub mod figure;
mod frames;
pub mod health;
pub mod ks;
pub mod merged;
pub mod messages;
pub mod multiplicity;
pub mod packets;
mod paper;
pub mod permutation;
pub mod power;
pub mod redaction;
pub mod relabelling;
mod render;
pub mod report;
pub mod run;
pub mod run_directory;
pub mod sample;
pub mod selftest;
pub mod sensitivity;
pub mod settings;
pub mod setup;
pub mod shape;
pub mod simulation;
pub mod steadiness;
pub mod table;
pub mod traffic;
mod verdict;
pub mod verification;
pub mod within;
mod writing;

pub use render::LatexTable;
pub use report::{Report, analyse};
pub use run::{Run, load, load_by};
pub use run_directory::ReadError;
pub use writing::{WriteError, is_report_folder, write};
