//! The figures in LaTeX: each as a float that `\input` takes into a paper, and all of them as a document of two columns. The
//! main functions are [`float`] and [`document`].

use super::Figure;
use crate::present::render::prose;

/// What every document of figures has.
const PREAMBLE: &str = "\\usepackage[T1]{fontenc}\n\\usepackage[utf8]{inputenc}\n\
    \\IfFileExists{lmodern.sty}{\\usepackage{lmodern}}{}\n\\usepackage{graphicx}\n";
/// LaTeX lets only so many floats wait for their place.
const WAITING: usize = 12;

/// A figure as a float, of one column unless it is drawn for all of them, which needs the package `graphicx` and `\graphicspath` to know the figures' folder.
#[must_use]
pub fn float(figure: &Figure) -> String {
    let stem = figure.stem();
    let (float, width) = match figure.layout.is_over_all_columns() {
        true => ("figure*", "\\textwidth"),
        false => ("figure", "\\columnwidth"),
    };
    format!(
        "\\begin{{{float}}}[tbp]\n\\centering\n\\includegraphics[width={width}]{{{stem}.pdf}}\n\\caption{{{}}}\n\
         \\label{{fig:{stem}}}\n\\end{{{float}}}\n",
        prose(&figure.caption)
    )
}

/// A document of all figures, which compiles by itself beside the folder `folder` that they are in.
#[must_use]
pub fn document(figures: &[Figure], folder: &str) -> String {
    let layout = figures.first().map(|figure| figure.layout).unwrap_or_default();
    let mut text = format!(
        "% The figures of a report. Compiles by itself; each is in the folder {folder}, too, for \\input.\n\
         {}{PREAMBLE}\\graphicspath{{{{{folder}/}}}}\n\\begin{{document}}\n",
        layout.document()
    );
    if figures.is_empty() {
        text.push_str("No window has data: nothing is drawn.\n");
    }
    for figures in figures.chunks(WAITING) {
        for figure in figures {
            text.push_str(&format!("\\input{{{folder}/{}}}\n", figure.stem()));
        }
        text.push_str("\\clearpage\n");
    }
    text.push_str("\\end{document}\n");
    text
}
