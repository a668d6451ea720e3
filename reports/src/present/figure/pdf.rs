//! A figure as PDF, for papers: lines stay lines and texts stay texts. The main function is [`of`].
//!
//! SVG leaves the choice of the font to whoever shows it; PDF brings its font with it. Ours is a part of this program
//! (`font/`), so that a figure is the same on a machine without fonts.

use std::sync::{Arc, LazyLock};

use svg2pdf::{
    ConversionError, ConversionOptions, PageOptions,
    usvg::{self, Options, Tree, fontdb::Database},
};

use super::Figure;

/// Latin, Greek and signs of DejaVu Sans 2.37, cut out of Debian's `fonts-dejavu-core` by fontTools.
const FONT: &[u8] = include_bytes!("font/DejaVuSans.ttf");
const FAMILY: &str = "DejaVu Sans";
/// Of the SVG's pixels, as browsers have it.
const DPI: f32 = 96.0;

static FONTS: LazyLock<Arc<Database>> = LazyLock::new(|| {
    let mut fonts = Database::new();
    fonts.load_font_data(FONT.to_vec());
    fonts.set_sans_serif_family(FAMILY);
    Arc::new(fonts)
});

/// A figure could not be made into PDF.
#[derive(Debug, thiserror::Error)]
pub enum PdfError {
    /// Its SVG could not be read.
    #[error("the figure {name} cannot be read")]
    Read {
        /// The figure.
        name: String,
        /// The error of the SVG reader.
        source: usvg::Error,
    },
    /// It could not be written.
    #[error("the figure {name} cannot be made into PDF: {reason}")]
    Write {
        /// The figure.
        name: String,
        /// The error of the conversion.
        reason: ConversionError,
    },
}

/// The figure on a page of its own size.
///
/// # Errors
/// When the SVG cannot be read or has what the library cannot convert.
pub fn of(figure: &Figure) -> Result<Vec<u8>, PdfError> {
    svg2pdf::to_pdf(
        &tree(figure)?,
        ConversionOptions::default(),
        PageOptions { dpi: DPI },
    )
    .map_err(|reason| PdfError::Write {
        name: figure.name.clone(),
        reason,
    })
}

/// The drawing with its letters laid out.
pub(super) fn tree(figure: &Figure) -> Result<Tree, PdfError> {
    let options = Options {
        fontdb: FONTS.clone(),
        font_family: FAMILY.to_owned(),
        ..Options::default()
    };
    Tree::from_str(&figure.svg, &options).map_err(|source| PdfError::Read {
        name: figure.name.clone(),
        source,
    })
}
