//! Run directory -> samples -> comparisons -> tables and figures.
//!
//! ```text
//! load(path) -> Run                                   reads the run directory
//! input::traffic::read(&Run) -> Traffic               reads its captures
//! analysis::combination::combine(Vec<Run>) -> Run     pure: machines that were measured apart
//! analyse(&Run, Traffic, settings) -> Report          pure, data alone
//! Report::present() -> Presentation                   pure: remarks and tables; markdown, latex, html, json
//! write(&Run, &Report, Layout)                        the run directory's `report/`, and nothing else of it
//! drift::history::judge(&[Night], settings) -> Drift  pure: many runs, and whether they change
//! messages::write_messages                            the captures' messages, into `report/messages/`
//! explain::explain([(&Source, a), (&Source, b)], ..)  why the errors of two scenarios differ
//! fit::fit(&RunDirectory, &[u32]) -> Vec<FittedPlatform>  the platforms of a run, for simulated scenarios
//! replay::replay(&RunDirectory) -> ReplayDocument     the logs against what their times give
//! ```

pub mod analysis;
pub mod drift;
pub mod explain;
pub mod fit;
pub mod input;
pub mod messages;
pub mod present;
pub mod redaction;
pub mod replay;

pub use analysis::report::{Report, analyse};
pub use input::run::{Run, load, load_from};
pub use present::render::{LatexTable, ReportDocument};
pub use present::{
    figure::Layout,
    writing::{WriteError, is_report_folder, write},
};
