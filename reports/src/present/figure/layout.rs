//! What figures are drawn for: how wide they are, how large their letters, and the document of LaTeX that they go into. The type is
//! [`Layout`].

use super::canvas::{COLUMN_PT, LETTERS_PT};

/// Where a figure is to stand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Layout {
    /// A column of the IEEE's two-column papers, and nearly one of the ACM's: 3.5 inches.
    #[default]
    IeeeColumn,
    /// Both columns of such a page.
    IeeePage,
    /// A page of Springer's Lecture Notes in Computer Science: 122 mm.
    LncsPage,
    /// A slide of 10 by 5.6 inches, with letters that the last row can read.
    Slide,
}

impl Layout {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::IeeeColumn, Self::IeeePage, Self::LncsPage, Self::Slide];

    /// Its name on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::IeeeColumn => "ieee-column",
            Self::IeeePage => "ieee-page",
            Self::LncsPage => "lncs-page",
            Self::Slide => "slide",
        }
    }

    /// How wide a figure is, in points.
    #[must_use]
    pub const fn width_pt(self) -> f64 {
        match self {
            Self::IeeeColumn => COLUMN_PT,
            Self::IeeePage => 516.0,
            Self::LncsPage => 347.0,
            Self::Slide => 640.0,
        }
    }

    /// How large its letters are, in points.
    #[must_use]
    pub const fn letters_pt(self) -> f64 {
        match self {
            Self::IeeeColumn | Self::IeeePage | Self::LncsPage => LETTERS_PT,
            Self::Slide => 15.0,
        }
    }

    /// By how much everything on it is larger than on a column.
    pub(super) const fn scale(self) -> f64 {
        self.letters_pt() / LETTERS_PT
    }

    /// Whether a figure takes more than one of the columns that the text has.
    pub(super) const fn is_over_all_columns(self) -> bool {
        matches!(self, Self::IeeePage)
    }

    /// How the text of the document stands.
    pub(super) const fn document(self) -> &'static str {
        match self {
            Self::IeeeColumn | Self::IeeePage => {
                "\\documentclass[twocolumn]{article}\n\\usepackage[a4paper,textwidth=516pt,columnsep=12pt,vmargin=2cm]{geometry}\n"
            }
            Self::LncsPage => {
                "\\documentclass{article}\n\\usepackage[a4paper,textwidth=347pt,vmargin=3cm]{geometry}\n"
            }
            Self::Slide => {
                "\\documentclass{article}\n\\usepackage[a4paper,landscape,textwidth=640pt,vmargin=1cm]{geometry}\n"
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_layout_is_narrower_than_what_is_drawn_and_none_has_letters_that_papers_refuse() {
        for layout in Layout::ALL {
            assert!(layout.width_pt() / layout.scale() >= COLUMN_PT, "{layout:?}");
            assert!(layout.letters_pt() >= 7.0, "{layout:?}");
        }
    }
}
