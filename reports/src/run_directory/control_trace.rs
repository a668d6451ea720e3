//! `control.csv` of one window, read once from start to end: the errors of each period, how old the states were, and
//! the path of the last period. Nothing else of the log is kept, since a campaign has gigabytes of it.
//!
//! The error is e = reference − received position: what the controller itself saw, as in the paper. The main type is
//! [`ControlTrace`]; what can be wrong with a log is [`Fault`].

use std::{fs::File, io, path::Path};

use sha2::{Digest, Sha256};
use workload::record::window::FileRecord;

use super::{
    lines::{Fields, Lines},
    number::Number,
};

/// One window's log, digested.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ControlTrace {
    /// The errors of each period, in order.
    pub periods: Vec<PeriodError>,
    /// Mean age of the state at the moment it was used, in seconds: what the network adds to the loop. None if no
    /// state ever arrived.
    pub mean_state_age_s: Option<f64>,
    /// Mean |e_x| + |e_y| of each [`SLICES`]th of a period, in metres; empty where a period has no whole number of steps in
    /// each.
    pub slices_m: Vec<f64>,
    /// The last period, in which the transient is over.
    pub last_period: PeriodPath,
}

/// Slices of a period, for what is shorter than one: a transient.
pub const SLICES: usize = 10;

/// The tracking errors of one period.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct PeriodError {
    /// Mean |e_x|, in metres.
    pub mean_abs_x_m: f64,
    /// Mean |e_y|, in metres.
    pub mean_abs_y_m: f64,
    /// Mean of √(e_x² + e_y²), in metres.
    pub mean_distance_m: f64,
    /// Mean of e_x² + e_y², in square metres.
    pub mean_square_m2: f64,
}

impl PeriodError {
    /// That of a period's control steps, of which there is one or more: errors `[x, y]` in metres.
    #[must_use]
    pub fn mean(errors_m: impl Iterator<Item = [f64; 2]>) -> Self {
        let mut sums = Self::default();
        let steps = errors_m.map(|error_m| sums.add(error_m)).count();
        sums.over(steps as f64)
    }

    fn add(&mut self, [error_x, error_y]: [f64; 2]) {
        self.mean_abs_x_m += error_x.abs();
        self.mean_abs_y_m += error_y.abs();
        let square = error_x * error_x + error_y * error_y;
        // Not `hypot`: the squares of what is nearer than `FAR_M` are finite.
        self.mean_distance_m += square.sqrt();
        self.mean_square_m2 += square;
    }

    fn over(self, steps: f64) -> Self {
        Self {
            mean_abs_x_m: self.mean_abs_x_m / steps,
            mean_abs_y_m: self.mean_abs_y_m / steps,
            mean_distance_m: self.mean_distance_m / steps,
            mean_square_m2: self.mean_square_m2 / steps,
        }
    }
}

/// Target and actual position, one point a control step.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PeriodPath {
    /// Wanted positions (x, y), in metres.
    pub reference_m: Vec<(f64, f64)>,
    /// Received positions (x, y), in metres.
    pub received_m: Vec<(f64, f64)>,
}

/// What a log must be.
#[derive(Debug, Clone, Copy)]
pub struct Expected<'a> {
    /// Control steps of its window.
    pub steps: u64,
    /// Of these, those that were lost and are not in it.
    pub lost: u64,
    /// The window's first step, in it or not; as the log has it, if it is not known.
    pub first_step: Option<u64>,
    /// Control steps in a period; not 0.
    pub steps_per_period: u64,
    /// Its length and checksum.
    pub file: &'a FileRecord,
}

/// A log that cannot be used.
#[derive(Debug, thiserror::Error)]
#[error("{fault}")]
pub struct ControlLogError {
    /// What is wrong with it.
    pub fault: Fault,
    /// Whether it differs from the file that `window.json` describes.
    pub changed: bool,
}

impl ControlLogError {
    /// What to do about it.
    #[must_use]
    pub fn hint(&self) -> String {
        let how = if self.changed {
            "the file was changed after it was measured, since its SHA-256 is not that of window.json: restore it \
             from a copy"
        } else {
            "the file is as the workload wrote it, so the measurement itself is at fault"
        };
        format!("{how}; or move the window's folder away, and the report counts the window as missing")
    }
}

/// What is wrong with a log. Lines count from 1, the header being the first.
#[derive(Debug, thiserror::Error)]
pub enum Fault {
    /// A column that is needed is not in the header.
    #[error("column `{column}` is missing in the first line")]
    MissingColumn {
        /// Which.
        column: &'static str,
    },
    /// A line that ends too early, or has no end.
    #[error("line {line} is cut short")]
    Cut {
        /// Which.
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

impl ControlTrace {
    /// Reads a log.
    ///
    /// # Errors
    /// When it cannot be read, is not as long as expected, or has a field that is wrong.
    pub fn read(path: &Path, expected: Expected<'_>) -> Result<Self, ControlLogError> {
        let unreadable = |source: io::Error| ControlLogError {
            fault: Fault::Csv(source.into()),
            changed: false,
        };
        let mut file = Hashing::new(File::open(path).map_err(unreadable)?);
        let parsed = parse(&mut file, expected);
        // To the end in any case: whether the file is the one that was measured decides what is to be done.
        io::copy(&mut file, &mut io::sink()).map_err(unreadable)?;
        let ends_well = file.last == b'\n';
        let difference = file.difference(expected.file);
        let changed = difference.is_some();
        let cut = |lines| Err(Fault::Cut { line: lines });
        let checked = match parsed {
            Ok((_, lines)) if !ends_well => cut(lines),
            Ok((trace, _)) => difference.map_or(Ok(trace), Err),
            Err(fault) => Err(fault),
        };
        checked.map_err(|fault| ControlLogError { fault, changed })
    }
}

/// The trace, and how many lines the log has.
fn parse(file: &mut Hashing<File>, expected: Expected<'_>) -> Result<(ControlTrace, u64), Fault> {
    let unreadable = |error: io::Error| Fault::Csv(error.into());
    let mut lines = Lines::of(file);
    let header = lines.next().map_err(unreadable)?.unwrap_or_default();
    let columns = Columns::of(header)?;
    let mut digest = Digesting::new(expected);
    let mut next_step = expected.first_step;
    let mut lost = expected.lost;
    let mut line = 1;
    while let Some(record) = lines.next().map_err(unreadable)? {
        line += 1;
        let row = columns.row(record, line)?;
        let due = next_step.unwrap_or(row.step);
        let skipped = row.step.checked_sub(due);
        let Some(left) = skipped.and_then(|skipped| lost.checked_sub(skipped)) else {
            return Err(Fault::NotContiguous {
                line,
                expected: due,
                found: row.step,
            });
        };
        let lost_before = lost - left;
        lost = left;
        next_step = row.step.checked_add(1);
        digest.skip(lost_before)?;
        digest.take(&row);
    }
    // What was lost at the end of a window shows in no row of it.
    digest.skip(lost)?;
    if digest.steps != expected.steps {
        return Err(Fault::WrongLength {
            expected: expected.steps.saturating_sub(expected.lost),
            found: digest.rows,
        });
    }
    Ok((digest.finish(), line))
}

/// No ball is ever this far away, in metres.
const FAR_M: f64 = 1e100;

/// What is needed of one row.
struct Row {
    step: u64,
    actual_ns: i64,
    state_seq: u64,
    state_stamp_ns: i64,
    reference_m: (f64, f64),
    received_m: (f64, f64),
}

/// Where the needed columns are; they may stand in any order.
struct Columns {
    names: Vec<Vec<u8>>,
    step: usize,
    actual_ns: usize,
    state_seq: usize,
    state_stamp_ns: usize,
    reference_x_m: usize,
    reference_y_m: usize,
    x_m: usize,
    y_m: usize,
}

impl Columns {
    fn of(header: Fields<'_>) -> Result<Self, Fault> {
        let find = |column: &'static str| {
            let at = header
                .iter()
                .position(|name| name.trim_ascii() == column.as_bytes());
            at.ok_or(Fault::MissingColumn { column })
        };
        Ok(Self {
            step: find("step")?,
            actual_ns: find("actual_ns")?,
            state_seq: find("state_seq")?,
            state_stamp_ns: find("state_stamp_ns")?,
            reference_x_m: find("reference_x_m")?,
            reference_y_m: find("reference_y_m")?,
            x_m: find("x_m")?,
            y_m: find("y_m")?,
            names: header.iter().map(<[u8]>::to_vec).collect(),
        })
    }

    fn row(&self, record: Fields<'_>, line: u64) -> Result<Row, Fault> {
        match self.plain_row(record) {
            Some(row) => Ok(row),
            None => self.odd_row(record, line),
        }
    }

    /// A row with nothing odd about it, such as all are that the workload writes; told apart from others in as little time as
    /// can be. It is one that [`Self::odd_row`] reads alike.
    fn plain_row(&self, record: Fields<'_>) -> Option<Row> {
        if record.len() != self.names.len() || record.may_have_names() {
            return None;
        }
        let position = |x: usize, y: usize| {
            let position = (f64::read(record.get(x))?, f64::read(record.get(y))?);
            (position.0.abs() < FAR_M && position.1.abs() < FAR_M).then_some(position)
        };
        Some(Row {
            step: Number::read(record.get(self.step))?,
            actual_ns: Number::read(record.get(self.actual_ns))?,
            state_seq: Number::read(record.get(self.state_seq))?,
            state_stamp_ns: Number::read(record.get(self.state_stamp_ns))?,
            reference_m: position(self.reference_x_m, self.reference_y_m)?,
            received_m: position(self.x_m, self.y_m)?,
        })
    }

    #[cold]
    fn odd_row(&self, record: Fields<'_>, line: u64) -> Result<Row, Fault> {
        if record.len() != self.names.len() {
            return Err(Fault::Cut { line });
        }
        // NaN and inf are the only numbers with an n or an i in them: that checks the columns too that are not read.
        let is_of_a_name = |byte: &u8| matches!(byte | 0x20, b'n' | b'i');
        if record.line().iter().any(is_of_a_name) {
            return Err(self.not_finite(record, line));
        }
        Ok(Row {
            step: self.number(record, line, self.step)?,
            actual_ns: self.number(record, line, self.actual_ns)?,
            state_seq: self.number(record, line, self.state_seq)?,
            state_stamp_ns: self.number(record, line, self.state_stamp_ns)?,
            reference_m: self.position(record, line, self.reference_x_m, self.reference_y_m)?,
            received_m: self.position(record, line, self.x_m, self.y_m)?,
        })
    }

    fn position(&self, record: Fields<'_>, line: u64, x: usize, y: usize) -> Result<(f64, f64), Fault> {
        let position: (f64, f64) = (self.number(record, line, x)?, self.number(record, line, y)?);
        // 1e999 is spelt without letters of its own; and the squares of what is nearly infinite must be finite too.
        match position {
            (x, y) if x.abs() < FAR_M && y.abs() < FAR_M => Ok(position),
            _ => Err(self.not_finite(record, line)),
        }
    }

    fn number<T: Number>(&self, record: Fields<'_>, line: u64, at: usize) -> Result<T, Fault> {
        let field = record.get(at);
        T::read(field)
            .or_else(|| T::read(field.trim_ascii()))
            .ok_or_else(|| Fault::NotANumber {
                line,
                column: self.name(at),
                text: shown(field),
            })
    }

    fn not_finite(&self, record: Fields<'_>, line: u64) -> Fault {
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
        shown(self.names.get(at).map(Vec::as_slice).unwrap_or_default())
    }
}

/// A field as it can stand in a message.
fn shown(field: &[u8]) -> String {
    field.escape_ascii().to_string().chars().take(40).collect()
}

/// The sums of the period under way, and what is finished.
struct Digesting {
    steps_per_period: u64,
    /// Steps so far, lost ones too, and rows, which are those that were done.
    steps: u64,
    rows: u64,
    /// Rows of the period under way, and of the slice.
    period_rows: u64,
    slice_rows: u64,
    /// Steps after which the period under way ends, and the slice; there are no slices if it never does.
    period_ends: u64,
    slice_ends: Option<u64>,
    keep_path_from: u64,
    steps_per_slice: u64,
    slice_m: f64,
    sums: PeriodError,
    ages_ns: f64,
    states: u64,
    trace: ControlTrace,
}

impl Digesting {
    fn new(expected: Expected<'_>) -> Self {
        let periods = expected.steps / expected.steps_per_period;
        let steps_per_slice = expected.steps_per_period / SLICES as u64;
        let has_slices = steps_per_slice > 0 && expected.steps_per_period.is_multiple_of(SLICES as u64);
        Self {
            steps_per_period: expected.steps_per_period,
            steps: 0,
            rows: 0,
            period_rows: 0,
            slice_rows: 0,
            period_ends: expected.steps_per_period,
            slice_ends: has_slices.then_some(steps_per_slice),
            keep_path_from: periods.saturating_sub(1) * expected.steps_per_period,
            steps_per_slice,
            slice_m: 0.0,
            sums: PeriodError::default(),
            ages_ns: 0.0,
            states: 0,
            trace: ControlTrace::default(),
        }
    }

    fn take(&mut self, row: &Row) {
        let error_x = row.reference_m.0 - row.received_m.0;
        let error_y = row.reference_m.1 - row.received_m.1;
        self.slice_m += error_x.abs() + error_y.abs();
        self.sums.add([error_x, error_y]);
        if row.state_seq > 0 {
            self.ages_ns += (row.actual_ns as f64) - (row.state_stamp_ns as f64);
            self.states += 1;
        }
        if self.steps >= self.keep_path_from {
            self.trace.last_period.reference_m.push(row.reference_m);
            self.trace.last_period.received_m.push(row.received_m);
        }
        self.rows += 1;
        self.period_rows += 1;
        self.slice_rows += 1;
        // A period that has this row has a mean.
        let _ = self.advance();
    }

    /// Goes over steps that were lost.
    fn skip(&mut self, lost: u64) -> Result<(), Fault> {
        (0..lost).try_for_each(|_| self.advance())
    }

    /// To the next step: slices and periods end where they end, whatever was lost of them.
    fn advance(&mut self) -> Result<(), Fault> {
        self.steps += 1;
        if self.slice_ends == Some(self.steps) {
            self.end_slice();
        }
        if self.steps == self.period_ends {
            self.period_ends += self.steps_per_period;
            self.end_period()?;
        }
        Ok(())
    }

    fn end_slice(&mut self) {
        let (sum_m, rows) = (
            std::mem::take(&mut self.slice_m),
            std::mem::take(&mut self.slice_rows),
        );
        if rows == 0 {
            // A slice without a mean: without slices the window can still be told by its periods.
            self.slice_ends = None;
            self.trace.slices_m.clear();
        } else {
            self.slice_ends = Some(self.steps + self.steps_per_slice);
            self.trace.slices_m.push(sum_m / rows as f64);
        }
    }

    fn end_period(&mut self) -> Result<(), Fault> {
        let sums = std::mem::take(&mut self.sums);
        let rows = std::mem::take(&mut self.period_rows);
        if rows == 0 {
            return Err(Fault::EmptyPeriod {
                period: self.trace.periods.len() + 1,
            });
        }
        self.trace.periods.push(sums.over(rows as f64));
        Ok(())
    }

    fn finish(mut self) -> ControlTrace {
        if self.states > 0 {
            self.trace.mean_state_age_s = Some(self.ages_ns / self.states as f64 / 1e9);
        }
        self.trace
    }
}

/// A reader that hashes what passes through it.
struct Hashing<R> {
    inner: R,
    hasher: Sha256,
    bytes: u64,
    last: u8,
}

impl<R> Hashing<R> {
    fn new(inner: R) -> Self {
        Self {
            inner,
            hasher: Sha256::new(),
            bytes: 0,
            last: 0,
        }
    }

    fn difference(self, record: &FileRecord) -> Option<Fault> {
        let difference = |what, expected: String, found: String| {
            Some(Fault::Changed {
                what,
                expected,
                found,
            })
        };
        if self.bytes != record.bytes {
            return difference("length", record.bytes.to_string(), self.bytes.to_string());
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
        self.bytes += read as u64;
        self.last = bytes.last().copied().unwrap_or(self.last);
        Ok(read)
    }
}
