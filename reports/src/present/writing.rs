//! Writing a report into its folder, a run directory's `report/` or one of its own: it is ours and is brought to what the
//! report is, each file in one step; nothing else of the run directory is touched. The main function is [`write`].

use std::{
    collections::BTreeSet,
    fs::File,
    io::{self, BufWriter, Read as _, Write},
    path::{Path, PathBuf},
};

use polars::error::PolarsError;
use rayon::prelude::*;
use record::run_directory::{Kind as Entry, Place};

use crate::{
    analysis::report::Report,
    input::run::Run,
    present::{
        Presentation,
        figure::{self, FigureError, Kind, Layout, PdfError},
        render::columns::{self, Pieces},
    },
};

/// The folder of the figures, in `report/`.
const FIGURES: &str = "figures";
/// The folder of the LaTeX tables, in `report/`.
const TABLES: &str = "tables";
/// The first line of each of these, by which an old one is known.
const TABLE_OF_OURS: &str = "% A table of a report of matrix, for \\input.";

/// How `report.json` begins.
const REPORT_OF_OURS: &[u8; 9] = b"{\n  \"run\"";

/// A report could not be written. What was there before of the file at fault is still there.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// The operating system refused.
    #[error("{} cannot be written", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// A table of numbers could not be encoded.
    #[error("the table {name} cannot be encoded")]
    Columns {
        /// The table.
        name: &'static str,
        /// Polars' error.
        source: PolarsError,
    },
    /// A figure could not be drawn.
    #[error(transparent)]
    Figure(#[from] FigureError),
    /// A figure could not be made into PDF.
    #[error(transparent)]
    Pdf(#[from] PdfError),
}

impl WriteError {
    /// What to do about it.
    #[must_use]
    pub const fn hint(&self) -> &'static str {
        match self {
            Self::Io { .. } => "see that the disk has room and that you may write to the run directory",
            Self::Columns { .. } | Self::Figure(_) | Self::Pdf(_) => {
                "this is a fault of matrix: please report it with the run directory's report/report.json"
            }
        }
    }
}

/// What writes a file's content.
type Content<'a> = Box<dyn FnOnce(&mut BufWriter<File>) -> Result<(), Failure> + 'a>;

/// Why a content could not be written.
enum Failure {
    Io(io::Error),
    Columns(&'static str, PolarsError),
}

/// Writes the report into the run's folder for it, and those of its other metrics into folders in it. Figures and LaTeX tables of an
/// earlier report that this one does not have are removed.
///
/// # Errors
/// When a figure cannot be drawn, which is before anything of its metric is written, and when a file cannot be encoded or written.
pub fn write(run: &Run, report: &Report, layout: Layout) -> Result<(), WriteError> {
    write_into(&run.report_folder, run, report, layout)?;
    for other in &report.others {
        let folder = run.report_folder.join(other_folder(&other.quantity.name));
        folder.make_folder().map_err(at(&folder))?;
        write_into(&folder, run, other, layout)?;
    }
    Ok(())
}

/// Where the report of another metric is, below the report's own folder.
pub(crate) fn other_folder(metric: &str) -> PathBuf {
    Path::new("metrics").join(metric)
}

fn write_into(folder: &Place, run: &Run, report: &Report, layout: Layout) -> Result<(), WriteError> {
    let page = report.present();
    let figures = figure::draw(run, report, layout)?;
    // Each takes a while, and they have nothing to do with each other.
    let pdfs: Vec<Vec<u8>> = figures
        .par_iter()
        .map(figure::pdf)
        .collect::<Result<_, PdfError>>()?;
    let mut files: Vec<(PathBuf, Content<'_>)> = vec![
        ("tables.md".into(), whole(page.markdown())),
        ("tables.tex".into(), whole(page.latex())),
        (
            "figures.tex".into(),
            whole(figure::latex_document(&figures, FIGURES)),
        ),
        ("report.html".into(), whole(page.html(&figures))),
        ("report.json".into(), json(&page)),
    ];
    files.extend(column_files(report));
    let drawings = Path::new(FIGURES);
    for (figure, pdf) in figures.into_iter().zip(pdfs) {
        let name = drawings.join(&figure.name);
        files.push((name.with_extension("pdf"), whole(pdf)));
        files.push((name.with_extension("tex"), whole(figure::latex_float(&figure))));
        files.push((name, whole(figure.svg)));
    }
    let tables = Path::new(TABLES);
    for table in page.latex_tables() {
        let text = format!("{TABLE_OF_OURS}\n{}", table.file());
        files.push((tables.join(format!("{}.tex", table.name)), whole(text)));
    }
    let written: BTreeSet<Place> = files.iter().map(|(name, _)| folder.join(name)).collect();

    for inner in [drawings, tables] {
        let inner = folder.join(inner);
        inner.make_folder().map_err(at(&inner))?;
    }
    for (name, content) in files {
        replace(&folder.join(name), content)?;
    }
    remove_others(&folder.join(drawings), &written, is_figure_of_ours)?;
    remove_others(&folder.join(tables), &written, is_table_of_ours)
}

/// Whether a folder has a report in it.
#[must_use]
pub fn is_report_folder(folder: &Place) -> bool {
    let mut first = [0; REPORT_OF_OURS.len()];
    let opened = folder.join("report.json").open();
    opened.and_then(|mut file| file.read_exact(&mut first)).is_ok() && first == *REPORT_OF_OURS
}

/// A content that is there already.
fn whole<'a>(content: impl AsRef<[u8]> + 'a) -> Content<'a> {
    Box::new(move |out| out.write_all(content.as_ref()).map_err(Failure::Io))
}

/// Comparison by comparison: of half a million it is 190 MB.
fn json<'a>(page: &'a Presentation<'_>) -> Content<'a> {
    Box::new(|out| {
        serde_json::to_writer_pretty(&mut *out, &page.json()).map_err(|error| Failure::Io(error.into()))?;
        out.write_all(b"\n").map_err(Failure::Io)
    })
}

/// Each table of numbers as CSV and as Parquet.
fn column_files(report: &Report) -> Vec<(PathBuf, Content<'_>)> {
    type Columns = fn(&Report) -> Pieces<'_>;
    let tables: [(_, Columns); 5] = [
        ("scenarios", columns::scenarios),
        ("comparisons", columns::comparisons),
        ("contrasts", columns::contrasts),
        ("samples", columns::samples),
        ("packets", columns::packets),
    ];
    let mut files: Vec<(PathBuf, Content<'_>)> = Vec::new();
    for (name, table) in tables {
        let fail = move |source| Failure::Columns(name, source);
        files.push((
            format!("{name}.csv").into(),
            Box::new(move |out| columns::csv(table(report), out).map_err(fail)),
        ));
        files.push((
            format!("{name}.parquet").into(),
            Box::new(move |out| columns::parquet(table(report), out).map_err(fail)),
        ));
    }
    files
}

/// A reader sees the old file or the new one, never a part.
fn replace(place: &Place, content: Content<'_>) -> Result<(), WriteError> {
    let (unfinished, mut out) = place.begin().map_err(at(place))?;
    content(&mut out)
        .and_then(|()| out.flush().map_err(Failure::Io))
        .map_err(|failure| failure.at(place))?;
    unfinished.finish().map(drop).map_err(at(place))
}

impl Failure {
    fn at(self, place: &Place) -> WriteError {
        match self {
            Self::Io(source) => at(place)(source),
            // The disk is full, and polars was the one to find out.
            Self::Columns(_, PolarsError::IO { error, .. }) => at(place)(io::Error::new(error.kind(), error)),
            Self::Columns(name, source) => WriteError::Columns { name, source },
        }
    }
}

/// Removes what an earlier report has written there and this one has not.
fn remove_others(
    folder: &Place,
    written: &BTreeSet<Place>,
    is_ours: impl Fn(&Place) -> bool,
) -> Result<(), WriteError> {
    for (place, kind) in folder.entries().map_err(at(folder))? {
        if kind == Entry::File && !written.contains(&place) && is_ours(&place) {
            place.remove_file().map_err(at(&place))?;
        }
    }
    Ok(())
}

fn is_figure_of_ours(place: &Place) -> bool {
    let name = place.name();
    let name = name.strip_suffix(".new").unwrap_or(name);
    let is_kind = |kind: &Kind| {
        let rest = name.strip_prefix(kind.prefix());
        rest.is_some_and(|rest| rest.starts_with(['-', '.']))
    };
    Kind::ALL.iter().any(is_kind) && [".svg", ".pdf", ".tex"].iter().any(|end| name.ends_with(end))
}

fn is_table_of_ours(place: &Place) -> bool {
    let name = place.name();
    let is_table = name.strip_suffix(".new").unwrap_or(name).ends_with(".tex");
    let begins = || {
        let mut first = vec![0; TABLE_OF_OURS.len()];
        let read = place.open().and_then(|mut file| file.read_exact(&mut first));
        read.is_ok() && first == TABLE_OF_OURS.as_bytes()
    };
    is_table && begins()
}

fn at(place: &Place) -> impl FnOnce(io::Error) -> WriteError {
    let path = place.path();
    |source| WriteError::Io { path, source }
}
