//! The figures, as SVG and as PDF: how large the differences are and what they come from, the control loop, the network, an example
//! of the test, one period of target and actual position, and of pairs of windows the histograms and the distribution functions. The
//! main type is [`Figure`]; [`draw`] makes all of a report's.
//!
//! ```text
//! pairs -> which windows        layout -> how wide      canvas -> letters, axes
//! forest, control_loop, topology, trajectory, histogram, distributions -> Figure -> pdf, latex
//! ```
//!
//! The drawings are as wide as the place where they are to stand ([`Layout`]) and have no captions: those are text ([`Figure::caption`]), which LaTeX
//! and the page set.

mod canvas;
mod control_loop;
mod distributions;
mod forest;
mod histogram;
mod latex;
mod layout;
mod pairs;
mod pdf;
mod schematic;
mod sweep;
mod topology;
mod trajectory;

#[cfg(test)]
mod tests;

pub use canvas::FigureError;
pub use pdf::{PdfError, of as pdf};

pub(crate) use self::pairs::chosen;
pub use self::{
    latex::{document as latex_document, float as latex_float},
    layout::Layout,
};
use crate::{analysis::report::Report, input::run::Run};

/// One drawn figure.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Figure {
    /// What it shows.
    pub kind: Kind,
    /// Its file's name, such as `cdf-b-d.svg`.
    pub name: String,
    /// What is to be seen, in sentences.
    pub caption: String,
    /// What it is drawn for.
    pub layout: Layout,
    /// The drawing.
    pub svg: String,
}

impl Figure {
    /// The file's name without its ending, such as `cdf-b-d`.
    #[must_use]
    pub fn stem(&self) -> &str {
        self.name.strip_suffix(".svg").unwrap_or(&self.name)
    }
}

/// What a figure shows: the effects, and then what the paper's figures show in their order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// The shifts of all pairs with their intervals.
    Forest,
    /// The metric against a swept setting.
    Sweep,
    /// What the difference of a pair comes from.
    Causes,
    /// The control loop with the network's delays.
    ControlLoop,
    /// The hosts, the switch and the links between them.
    Topology,
    /// An example of the Kolmogorov-Smirnov test.
    KsTest,
    /// One period of target and actual position.
    Trajectory,
    /// The histograms of two windows.
    Histogram,
    /// The distribution functions of two windows.
    Distributions,
}

impl Kind {
    /// All of them.
    pub const ALL: [Self; 9] = [
        Self::Forest,
        Self::Sweep,
        Self::Causes,
        Self::ControlLoop,
        Self::Topology,
        Self::KsTest,
        Self::Trajectory,
        Self::Histogram,
        Self::Distributions,
    ];

    /// What the names of its files begin with.
    #[must_use]
    pub const fn prefix(self) -> &'static str {
        match self {
            Self::Forest => "forest",
            Self::Sweep => "sweep",
            Self::Causes => "causes",
            Self::ControlLoop => "control-loop",
            Self::Topology => "topology",
            Self::KsTest => "ks-test",
            Self::Trajectory => "trajectory",
            Self::Histogram => "histogram",
            Self::Distributions => "cdf",
        }
    }
}

/// Draws the figures of a report.
///
/// # Errors
/// When the drawing library fails.
pub fn draw(run: &Run, report: &Report, layout: Layout) -> Result<Vec<Figure>, FigureError> {
    let mut figures = Vec::from_iter(forest::draw(report, layout)?);
    figures.extend(sweep::draw(report, layout)?);
    for pair in &report.causes {
        figures.extend(forest::parts(report, pair, layout)?);
    }
    figures.extend(control_loop::draw(run, layout)?);
    figures.extend(topology::draw(run, layout)?);
    figures.extend(distributions::example(report, layout)?);
    for scenario in &run.scenarios {
        figures.extend(trajectory::draw(report, scenario, run.error, layout)?);
    }
    for pair in chosen(report).pairs {
        figures.push(histogram::draw(report, &pair, layout)?);
        figures.push(distributions::draw(report, &pair, layout)?);
    }
    Ok(figures)
}
