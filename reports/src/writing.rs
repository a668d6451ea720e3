//! Writing a report into its run directory: the folder `report/` is ours and is brought to what the report is, each file
//! in one step; nothing else of the run directory is touched. The main function is [`write`].

use std::{
    collections::BTreeSet,
    fs, io,
    path::{Path, PathBuf},
};

use polars::error::PolarsError;
use rayon::prelude::*;

use crate::{
    figure::{self, FigureError, PdfError},
    render::columns,
    report::Report,
    run::Run,
};

/// The folder of the figures, in `report/`.
const FIGURES: &str = "figures";
/// The folder of the LaTeX tables, in `report/`.
const TABLES: &str = "tables";
/// The first line of each of these, by which an old one is known.
const TABLE_OF_OURS: &str = "% A table of a report of matrix, for \\input.";

/// A report could not be written. What was there before of the file at fault is still there.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// The operating system refused.
    #[error("{} cannot be written", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A table of numbers could not be encoded.
    #[error("the table {name} cannot be encoded")]
    Columns {
        /// The table.
        name: &'static str,
        /// Why.
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

/// Writes the report into the run directory's `report/`. Figures and LaTeX tables of an earlier report that this one does
/// not have are removed.
///
/// # Errors
/// When something cannot be encoded, which is before anything is written, and when a file cannot be written.
pub fn write(run: &Run, report: &Report) -> Result<(), WriteError> {
    let folder = run.directory.report();
    let figures = figure::draw(run, report)?;
    let mut files: Vec<(PathBuf, Vec<u8>)> = vec![
        ("tables.md".into(), report.markdown().into_bytes()),
        ("tables.tex".into(), report.latex().into_bytes()),
        ("report.html".into(), report.html(&figures).into_bytes()),
        (
            "report.json".into(),
            format!("{:#}\n", report.json()).into_bytes(),
        ),
    ];
    files.extend(column_files(report)?);
    // Each takes a while, and they have nothing to do with each other.
    let pdfs: Vec<Vec<u8>> = figures
        .par_iter()
        .map(figure::pdf)
        .collect::<Result<_, PdfError>>()?;
    let drawings = Path::new(FIGURES);
    for (figure, pdf) in figures.into_iter().zip(pdfs) {
        let name = drawings.join(figure.name);
        files.push((name.with_extension("pdf"), pdf));
        files.push((name, figure.svg.into_bytes()));
    }
    let tables = Path::new(TABLES);
    for table in report.latex_tables() {
        let text = format!("{TABLE_OF_OURS}\n{}", table.text);
        files.push((tables.join(table.name).with_extension("tex"), text.into_bytes()));
    }
    let written: BTreeSet<PathBuf> = files.iter().map(|(name, _)| folder.join(name)).collect();

    for inner in [drawings, tables] {
        let inner = folder.join(inner);
        fs::create_dir_all(&inner).map_err(at(&inner))?;
    }
    for (name, bytes) in files {
        replace(&folder.join(name), &bytes)?;
    }
    remove_others(&folder.join(drawings), &written, is_figure_of_ours)?;
    remove_others(&folder.join(tables), &written, is_table_of_ours)
}

/// Each table of numbers as CSV and as Parquet.
fn column_files(report: &Report) -> Result<Vec<(PathBuf, Vec<u8>)>, WriteError> {
    let tables = [
        ("comparisons", columns::comparisons(report)),
        ("contrasts", columns::contrasts(report)),
        ("samples", columns::samples(report)),
        ("packets", columns::packets(report)),
    ];
    let mut files = Vec::new();
    for (name, table) in tables {
        let fail = |source| WriteError::Columns { name, source };
        let mut table = table.map_err(fail)?;
        files.push((
            format!("{name}.csv").into(),
            columns::csv(&mut table).map_err(fail)?,
        ));
        files.push((
            format!("{name}.parquet").into(),
            columns::parquet(&mut table).map_err(fail)?,
        ));
    }
    Ok(files)
}

/// A reader sees the old file or the new one, never a part.
fn replace(path: &Path, bytes: &[u8]) -> Result<(), WriteError> {
    let mut beside = path.as_os_str().to_owned();
    beside.push(".new");
    let beside = PathBuf::from(beside);
    fs::write(&beside, bytes).map_err(at(&beside))?;
    fs::rename(&beside, path).map_err(at(path))
}

/// Removes what an earlier report has written there and this one has not.
fn remove_others(
    folder: &Path,
    written: &BTreeSet<PathBuf>,
    is_ours: impl Fn(&Path, &str) -> bool,
) -> Result<(), WriteError> {
    for entry in fs::read_dir(folder).map_err(at(folder))? {
        let path = entry.map_err(at(folder))?.path();
        let name = path
            .file_name()
            .and_then(|name| name.to_str())
            .unwrap_or_default();
        if !written.contains(&path) && is_ours(&path, name) {
            fs::remove_file(&path).map_err(at(&path))?;
        }
    }
    Ok(())
}

fn is_figure_of_ours(_: &Path, name: &str) -> bool {
    let name = name.strip_suffix(".new").unwrap_or(name);
    (name.starts_with("cdf-") || name.starts_with("trajectory-"))
        && (name.ends_with(".svg") || name.ends_with(".pdf"))
}

fn is_table_of_ours(path: &Path, name: &str) -> bool {
    let is_table = name.strip_suffix(".new").unwrap_or(name).ends_with(".tex");
    is_table && fs::read(path).is_ok_and(|bytes| bytes.starts_with(TABLE_OF_OURS.as_bytes()))
}

fn at(path: &Path) -> impl FnOnce(io::Error) -> WriteError {
    let path = path.to_owned();
    |source| WriteError::Io { path, source }
}
