//! Run directory -> samples -> comparisons -> tables and figures.
//!
//! ```text
//! load(path) -> Run                                   reads the run directory
//! input::traffic::read(&Run) -> Traffic               reads its captures
//! analysis::combination::combine(Vec<Run>) -> Run     pure: machines that were measured apart
//! analyse(&Run, Traffic, settings) -> Report          pure, data alone
//! Report::present() -> Presentation                   pure: remarks and tables; markdown, latex, html, json
//! write(&Run, &Report)                                the run directory's `report/`, and nothing else of it
//! drift::history::judge(&[Night], settings) -> Drift  pure: many runs, and whether they change
//! messages::write_messages                            the captures' messages, into `report/messages/`
//! ```

pub mod analysis;
pub mod drift;
pub mod input;
pub mod messages;
pub mod present;
pub mod redaction;

pub use analysis::report::{Report, analyse};
pub use input::run::{Run, load, load_by};
pub use present::render::{LatexTable, ReportDocument};
pub use present::writing::{WriteError, is_report_folder, write};
