//! A log of a window: CSV with a header, whose length and checksum `window.json` has. [`read_log`] reads one; what can be wrong
//! with it is [`Fault`].

use std::{
    fs::File,
    io::{self, Read as _, Take},
};

use sha2::{Digest, Sha256};

use super::{Place, lines::Fields, number::Number};
use crate::window::FileRecord;

/// A log that cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("{fault}")]
pub struct LogError {
    /// What is wrong with it.
    pub fault: Fault,
    /// Whether it differs from the file that `window.json` describes.
    pub changed: bool,
}

impl LogError {
    /// Whether the system could not read it: nobody knows what is in it then.
    #[must_use]
    pub fn is_of_the_system(&self) -> bool {
        matches!(&self.fault, Fault::Csv(error) if error.is_io_error()) && !self.changed
    }

    /// Whose fault it is.
    #[must_use]
    pub const fn cause(&self) -> &'static str {
        match self.changed {
            true => {
                "the file was changed after it was measured, since its SHA-256 is not that of window.json"
            }
            false => "its SHA-256 is that of window.json, so it is as it was measured",
        }
    }

    /// What to do about it.
    #[must_use]
    pub fn hint(&self) -> String {
        let restored = if self.changed {
            ": restore it from a copy"
        } else {
            ""
        };
        format!(
            "{}{restored}; or move the window's folder away, and the report counts the window as missing",
            self.cause()
        )
    }
}

/// What is wrong with a log. Lines count from 1, the header being the first.
#[derive(Debug, thiserror::Error)]
pub enum Fault {
    /// A column that is needed is not in the header.
    #[error("column `{column}` is missing in the first line")]
    MissingColumn {
        /// The column's heading.
        column: &'static str,
    },
    /// A line that ends too early, or has no end.
    #[error("line {line} is cut short")]
    Cut {
        /// The line, from 1 on.
        line: u64,
    },
    /// A field that is not a number of its column's kind.
    #[error("line {line} has `{text}` in column `{column}`, which is not a number of its kind")]
    NotANumber {
        /// Where.
        line: u64,
        /// Which column.
        column: String,
        /// What it says.
        text: String,
    },
    /// NaN or an infinity.
    #[error("line {line} has `{text}` in column `{column}`: the loop diverged, or its arithmetic is broken")]
    NotFinite {
        /// Where.
        line: u64,
        /// Which column.
        column: String,
        /// What it says.
        text: String,
    },
    /// A step that does not follow the one before.
    #[error("line {line} is step {found}, and step {expected} was to follow")]
    NotContiguous {
        /// Where.
        line: u64,
        /// The step that was due.
        expected: u64,
        /// The step that is there.
        found: u64,
    },
    /// The plant has not moved.
    #[error("there is no tick of the plant in it")]
    NoTick,
    /// A period of which there is no step, and so no mean error.
    #[error("period {period} has no control step, so there is no error to average")]
    EmptyPeriod {
        /// From 1, in the window.
        period: usize,
    },
    /// More or fewer steps than the window has.
    #[error("it has {found} control steps, and its window has {expected}")]
    WrongLength {
        /// Steps of the window.
        expected: u64,
        /// Steps in the log.
        found: u64,
    },
    /// It reads well, but is not the file that was measured.
    #[error("it is not the file that was measured: its {what} is {found}, and window.json says {expected}")]
    Changed {
        /// Length or checksum.
        what: &'static str,
        /// As window.json has it.
        expected: String,
        /// As it is.
        found: String,
    },
    /// Not CSV, or unreadable.
    #[error(transparent)]
    Csv(csv::Error),
}

impl Fault {
    pub(super) fn unreadable(error: io::Error) -> Self {
        Self::Csv(error.into())
    }
}

/// Reads a log by what parses it, which says how many lines it has.
///
/// # Errors
/// When it cannot be read or parsed, or is not the file of its record.
pub(super) fn read_log<T>(
    place: &Place,
    record: &FileRecord,
    parse: impl FnOnce(&mut Hashing<Take<File>>) -> Result<(T, u64), Fault>,
) -> Result<T, LogError> {
    let unreadable = |source: io::Error| LogError {
        // One that does not take the room that it says it has is none that was measured.
        changed: source.kind() == io::ErrorKind::FileTooLarge,
        fault: Fault::unreadable(source),
    };
    let file = place.open().map_err(unreadable)?;
    let bytes = file.metadata().map_err(unreadable)?.len();
    // What is behind is not of the file that was measured, and may have no end.
    let mut file = Hashing::new(file.take(record.bytes));
    let parsed = parse(&mut file);
    // To the end in any case: whether the file is the one that was measured decides what is to be done.
    io::copy(&mut file, &mut io::sink()).map_err(unreadable)?;
    let ends_well = file.last == b'\n';
    let difference = file.difference(record, bytes);
    let changed = difference.is_some();
    let cut = |lines| Err(Fault::Cut { line: lines });
    let checked = match parsed {
        Ok((_, lines)) if !ends_well => cut(lines),
        Ok((trace, _)) => difference.map_or(Ok(trace), Err),
        Err(fault) => Err(fault),
    };
    checked.map_err(|fault| LogError { fault, changed })
}

/// No ball is ever this far away, in metres.
pub(super) const FAR_M: f64 = 1e100;

/// The names of a log's columns.
pub(super) struct Header(Vec<Vec<u8>>);

impl Header {
    pub(super) fn of(names: Fields<'_>) -> Self {
        Self(names.iter().map(<[u8]>::to_vec).collect())
    }

    /// Where a column is; they may stand in any order.
    pub(super) fn find(&self, column: &'static str) -> Result<usize, Fault> {
        let at = self
            .0
            .iter()
            .position(|name| name.trim_ascii() == column.as_bytes());
        at.ok_or(Fault::MissingColumn { column })
    }

    pub(super) fn len(&self) -> usize {
        self.0.len()
    }

    pub(super) fn position(
        &self,
        record: Fields<'_>,
        line: u64,
        x: usize,
        y: usize,
    ) -> Result<(f64, f64), Fault> {
        let position: (f64, f64) = (self.number(record, line, x)?, self.number(record, line, y)?);
        // 1e999 is spelt without letters of its own; and the squares of what is nearly infinite must be finite too.
        match position {
            (x, y) if x.abs() < FAR_M && y.abs() < FAR_M => Ok(position),
            _ => Err(self.not_finite(record, line)),
        }
    }

    pub(super) fn number<T: Number>(&self, record: Fields<'_>, line: u64, at: usize) -> Result<T, Fault> {
        let field = record.get(at);
        T::read(field)
            .or_else(|| T::read(field.trim_ascii()))
            .ok_or_else(|| Fault::NotANumber {
                line,
                column: self.name(at),
                text: shown(field),
            })
    }

    pub(super) fn not_finite(&self, record: Fields<'_>, line: u64) -> Fault {
        let finite = |field: &[u8]| {
            let number = std::str::from_utf8(field)
                .ok()
                .and_then(|text| text.trim().parse::<f64>().ok());
            number.map(|number| number.abs() < FAR_M)
        };
        let at = record
            .iter()
            .position(|field| finite(field) != Some(true))
            .unwrap_or_default();
        let field = record.get(at);
        let (column, text) = (self.name(at), shown(field));
        match finite(field) {
            Some(_) => Fault::NotFinite { line, column, text },
            None => Fault::NotANumber { line, column, text },
        }
    }

    fn name(&self, at: usize) -> String {
        shown(self.0.get(at).map(Vec::as_slice).unwrap_or_default())
    }
}

/// A field as it can stand in a message.
fn shown(field: &[u8]) -> String {
    field.escape_ascii().to_string().chars().take(40).collect()
}

/// A reader that hashes what passes through it.
pub(super) struct Hashing<R> {
    inner: R,
    hasher: Sha256,
    last: u8,
}

impl<R> Hashing<R> {
    fn new(inner: R) -> Self {
        Self {
            inner,
            hasher: Sha256::new(),
            last: 0,
        }
    }

    fn difference(self, record: &FileRecord, bytes: u64) -> Option<Fault> {
        let difference = |what, expected: String, found: String| {
            Some(Fault::Changed {
                what,
                expected,
                found,
            })
        };
        if bytes != record.bytes {
            return difference("length", record.bytes.to_string(), bytes.to_string());
        }
        let sha256 = format!("{:x}", self.hasher.finalize());
        if sha256.eq_ignore_ascii_case(&record.sha256) {
            return None;
        }
        difference("SHA-256", record.sha256.clone(), sha256)
    }
}

impl<R: io::Read> io::Read for Hashing<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let read = self.inner.read(buffer)?;
        let bytes = buffer.get(..read).unwrap_or_default();
        self.hasher.update(bytes);
        self.last = bytes.last().copied().unwrap_or(self.last);
        Ok(read)
    }
}
