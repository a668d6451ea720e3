//! `control.csv` of one window, read once from start to end: the errors of each period, how old the states were, and
//! the path of the last period. Nothing else of the log is kept, since a campaign has gigabytes of it.
//!
//! The error is e = reference − position, where the position is what the controller received, as in the paper, or where the
//! ball truly was ([`PlantTrace`]). The main type is [`ControlTrace`].

use std::io::Read;

use super::{
    Place,
    lines::{Fields, Lines},
    log::{FAR_M, Fault, Header, LogError, read_log},
    number::Number,
    plant_trace::PlantTrace,
};
use crate::window::FileRecord;

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
    /// Positions (x, y), in metres: those that the error is of.
    pub position_m: Vec<(f64, f64)>,
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

impl ControlTrace {
    /// Reads a log. The error is of the positions that the controller received, or of the true ones where these are given.
    ///
    /// # Errors
    /// When it cannot be read, is not as long as expected, or has a field that is wrong.
    pub fn read(place: &Place, expected: Expected<'_>, truth: Option<&PlantTrace>) -> Result<Self, LogError> {
        read_log(place, expected.file, |file| parse(file, expected, truth))
    }
}

/// The trace, and how many lines the log has.
fn parse(
    log: impl Read,
    expected: Expected<'_>,
    truth: Option<&PlantTrace>,
) -> Result<(ControlTrace, u64), Fault> {
    let mut lines = Lines::of(log);
    let header = lines.next().map_err(Fault::unreadable)?.unwrap_or_default();
    let columns = Columns::of(header)?;
    let mut truth = truth.map(PlantTrace::in_time);
    let mut digest = Digesting::new(expected);
    let mut next_step = expected.first_step;
    let mut lost = expected.lost;
    let mut line = 1;
    while let Some(record) = lines.next().map_err(Fault::unreadable)? {
        line += 1;
        let mut row = columns.row(record, line)?;
        if let Some(truth) = &mut truth {
            row.position_m = truth.at(row.actual_ns);
        }
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

/// What is needed of one row.
struct Row {
    step: u64,
    actual_ns: i64,
    state_seq: u64,
    state_stamp_ns: i64,
    reference_m: (f64, f64),
    position_m: (f64, f64),
}

/// Where the needed columns are; they may stand in any order.
struct Columns {
    header: Header,
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
        let header = Header::of(header);
        let find = |column: &'static str| header.find(column);
        Ok(Self {
            step: find("step")?,
            actual_ns: find("actual_ns")?,
            state_seq: find("state_seq")?,
            state_stamp_ns: find("state_stamp_ns")?,
            reference_x_m: find("reference_x_m")?,
            reference_y_m: find("reference_y_m")?,
            x_m: find("x_m")?,
            y_m: find("y_m")?,
            header,
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
        if record.len() != self.header.len() || record.may_have_names() {
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
            position_m: position(self.x_m, self.y_m)?,
        })
    }

    #[cold]
    fn odd_row(&self, record: Fields<'_>, line: u64) -> Result<Row, Fault> {
        if record.len() != self.header.len() {
            return Err(Fault::Cut { line });
        }
        // NaN and inf are the only numbers with an n or an i in them: that checks the columns too that are not read.
        let is_of_a_name = |byte: &u8| matches!(byte | 0x20, b'n' | b'i');
        if record.line().iter().any(is_of_a_name) {
            return Err(self.header.not_finite(record, line));
        }
        Ok(Row {
            step: self.header.number(record, line, self.step)?,
            actual_ns: self.header.number(record, line, self.actual_ns)?,
            state_seq: self.header.number(record, line, self.state_seq)?,
            state_stamp_ns: self.header.number(record, line, self.state_stamp_ns)?,
            reference_m: self
                .header
                .position(record, line, self.reference_x_m, self.reference_y_m)?,
            position_m: self.header.position(record, line, self.x_m, self.y_m)?,
        })
    }
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
        let error_x = row.reference_m.0 - row.position_m.0;
        let error_y = row.reference_m.1 - row.position_m.1;
        self.slice_m += error_x.abs() + error_y.abs();
        self.sums.add([error_x, error_y]);
        if row.state_seq > 0 {
            self.ages_ns += (row.actual_ns as f64) - (row.state_stamp_ns as f64);
            self.states += 1;
        }
        if self.steps >= self.keep_path_from {
            self.trace.last_period.reference_m.push(row.reference_m);
            self.trace.last_period.position_m.push(row.position_m);
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
