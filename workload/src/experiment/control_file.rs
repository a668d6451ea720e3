//! `control.csv` of the window under way, and what is counted on its rows as they pass. The main type is
//! [`ControlFile`].

use std::{
    fs::File,
    io::{self, BufWriter, Write},
    path::Path,
};

use crate::{experiment::lateness::Lateness, record::control_log::ControlRow};

/// How much is gathered before the disk is asked: some seven seconds of rows.
const CHUNK_BYTES: usize = 128 * 1024;

/// The log of one window, written in large chunks.
#[derive(Debug)]
pub struct ControlFile {
    out: BufWriter<File>,
    counts: RowCounts,
}

/// What is counted on the rows of one window.
#[derive(Debug, Default)]
pub struct RowCounts {
    /// How late they began.
    pub lateness: Lateness,
    /// Rows whose state was that of the row before.
    pub stale_steps: u64,
    /// Longest time from one row to the next, the last one of the window before included.
    pub longest_gap_ns: i64,
    /// The row before.
    pub last: Option<ControlRow>,
}

impl RowCounts {
    /// For a window that follows on `before`, the last row of the window before it.
    #[must_use]
    pub fn after(before: Option<ControlRow>, steps: u64) -> Self {
        Self {
            lateness: Lateness::with_capacity(steps),
            last: before,
            ..Self::default()
        }
    }

    /// Counts one more row.
    pub fn add(&mut self, row: &ControlRow, step_ns: i64) {
        self.lateness.add(row.actual_ns - row.scheduled_ns, step_ns);
        if let Some(before) = &self.last {
            self.stale_steps += u64::from(row.state_seq == before.state_seq);
            self.longest_gap_ns = self.longest_gap_ns.max(row.actual_ns - before.actual_ns);
        }
        self.last = Some(*row);
    }
}

impl ControlFile {
    /// The name of the file.
    pub const NAME: &'static str = "control.csv";

    /// Creates the file with its first line. It must not exist.
    ///
    /// # Errors
    /// What the file system says.
    pub fn create(folder: &Path, counts: RowCounts) -> io::Result<Self> {
        let file = File::create_new(folder.join(Self::NAME))?;
        let mut out = BufWriter::with_capacity(CHUNK_BYTES, file);
        writeln!(out, "{}", ControlRow::HEADER)?;
        Ok(Self { out, counts })
    }

    /// Writes and counts one row.
    ///
    /// # Errors
    /// What the file system says.
    pub fn write(&mut self, row: &ControlRow, step_ns: i64) -> io::Result<()> {
        self.counts.add(row, step_ns);
        row.write_to(&mut self.out)
    }

    /// What was counted so far.
    #[must_use]
    pub fn counts(&self) -> &RowCounts {
        &self.counts
    }

    /// Writes out what is still gathered.
    ///
    /// # Errors
    /// What the file system says.
    pub fn finish(mut self) -> io::Result<RowCounts> {
        self.out.flush()?;
        Ok(self.counts)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(actual_ns: i64, state_seq: u64) -> ControlRow {
        ControlRow {
            actual_ns,
            state_seq,
            ..ControlRow::default()
        }
    }

    #[test]
    fn a_state_seen_before_is_a_stale_step_across_windows_too() {
        let mut counts = RowCounts::after(Some(row(0, 7)), 3);
        [row(20, 7), row(40, 8), row(60, 8)]
            .iter()
            .for_each(|row| counts.add(row, 20));
        assert_eq!(counts.stale_steps, 2);
    }

    #[test]
    fn a_gap_over_the_boundary_belongs_to_the_window_that_begins_late() {
        let mut counts = RowCounts::after(Some(row(0, 1)), 2);
        [row(90, 2), row(110, 3)]
            .iter()
            .for_each(|row| counts.add(row, 20));
        assert_eq!(counts.longest_gap_ns, 90);
    }
}
