//! Tables, figures and remarks of a report, and their media: Markdown, LaTeX, HTML, JSON, CSV, Parquet, SVG, PDF. The
//! main type is [`Presentation`], made by [`Report::present`].

mod axes;
pub(crate) mod colours;
pub mod figure;
mod finding;
pub(crate) mod forest;
pub(crate) mod frames;
pub(crate) mod listing;
mod method;
mod remarks;
pub(crate) mod render;
mod sweep;
pub mod table;
pub(crate) mod writing;

use self::table::Table;
use crate::analysis::report::{Report, or_fault};

/// A report with the words and tables that all of its media have.
#[derive(Debug, Clone, PartialEq)]
pub struct Presentation<'a> {
    /// What is presented.
    pub report: &'a Report,
    /// What a reader must know before believing the tables.
    pub remarks: Vec<String>,
    /// The paper's tables, and those beside them: how well each platform held its schedule, among others.
    pub tables: Vec<Table>,
}

impl Report {
    /// The report for readers. Pure.
    #[must_use]
    pub fn present(&self) -> Presentation<'_> {
        let mut faults = self.faults.clone();
        // Whether what must be the same is, and how large differences are, before any count of rejections.
        let mut tables = table::agreements(self);
        tables.extend(table::shifts(self));
        tables.extend(or_fault(table::of_the_paper(self), &mut faults));
        tables.extend(table::beside(self));
        let mut remarks = remarks::remarks(self);
        remarks.extend(faults);
        Presentation {
            report: self,
            remarks,
            tables: tables.into_iter().map(Table::shortened).collect(),
        }
    }
}
