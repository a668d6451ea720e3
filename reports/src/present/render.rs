//! A report in each of its media. All of them are pure: report in, text or picture out.

pub(crate) mod columns;
mod document;
mod html;
mod json;
mod latex;
mod markdown;
mod summary;

pub use document::ReportDocument;
pub(crate) use html::head;
pub use latex::LatexTable;
pub(crate) use latex::prose;

use crate::present::{Presentation, figure::Figure};

impl Presentation<'_> {
    /// The conclusion, the scenarios and what a reader must know, for one screen of a terminal.
    #[must_use]
    pub fn summary(&self) -> String {
        summary::render(self)
    }

    /// As Markdown, at most 80 columns wide unless a name is longer: `report/tables.md`.
    #[must_use]
    pub fn markdown(&self) -> String {
        markdown::render(self)
    }

    /// As LaTeX: a document that compiles by itself, of all tables.
    #[must_use]
    pub fn latex(&self) -> String {
        latex::render(self)
    }

    /// The tables as LaTeX, each for itself: what `\input` takes into a paper.
    #[must_use]
    pub fn latex_tables(&self) -> Vec<LatexTable> {
        latex::tables(self)
    }

    /// As one page for a browser, with these figures in it.
    #[must_use]
    pub fn html(&self, figures: &[Figure]) -> String {
        html::render(self, figures)
    }

    /// As JSON, the shape that `matrix report --json` prints. Comparisons are made as they are written.
    #[must_use]
    pub fn json(&self) -> ReportDocument<'_> {
        json::document(self)
    }
}
