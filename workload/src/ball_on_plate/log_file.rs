//! The two logs of the window under way, and what is counted on their rows as they pass. The main types are
//! [`ControlFile`] and [`PlantFile`].

use std::{
    fs::File,
    io::{self, BufWriter, Write},
    path::Path,
};

use record::{control_log::ControlRow, layout, plant_log::PlantRow};

use crate::ball_on_plate::lateness::Lateness;

/// How much is gathered before the disk is asked: some seven seconds of rows.
const CHUNK_BYTES: usize = 128 * 1024;

/// Creates a log with its first line. It must not exist.
fn create(folder: &Path, name: &str, header: &str) -> io::Result<BufWriter<File>> {
    let file = File::create_new(folder.join(name))?;
    let mut out = BufWriter::with_capacity(CHUNK_BYTES, file);
    writeln!(out, "{header}")?;
    Ok(out)
}

/// When the steps of a window are due.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Steps {
    /// When step 0 of the run is due, on the experiment's clock.
    pub first_ns: i64,
    /// From one step to the next.
    pub step_ns: i64,
}

impl Steps {
    /// The step that is due then.
    fn at(self, scheduled_ns: i64) -> u64 {
        u64::try_from((scheduled_ns - self.first_ns) / self.step_ns.max(1)).unwrap_or(0)
    }
}

/// The steps of one window's log, one after the other.
#[derive(Debug, Default)]
pub struct Sequence {
    steps: Steps,
    /// The step that is to follow.
    next: u64,
    /// Rows that should have been there: nobody says that their ticks were lost.
    missing: u64,
}

impl Sequence {
    /// Of a window that begins with step `first`.
    fn from(first: u64, steps: Steps) -> Self {
        Self {
            steps,
            next: first,
            missing: 0,
        }
    }

    /// A row says by when it was due which ticks before it were lost: those from then to its own. What is between that and
    /// the row before it is missing.
    fn add(&mut self, step: u64, scheduled_ns: i64) {
        self.missing += self.steps.at(scheduled_ns).saturating_sub(self.next);
        self.next = step + 1;
    }
}

/// The controller's log of one window, written in large chunks.
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
    sequence: Sequence,
}

impl RowCounts {
    /// For a window that begins with step `first` and follows on `before`, the last row of the window before it.
    #[must_use]
    pub fn after(before: Option<ControlRow>, first: u64, capacity: u64, steps: Steps) -> Self {
        Self {
            lateness: Lateness::with_capacity(capacity),
            last: before,
            sequence: Sequence::from(first, steps),
            ..Self::default()
        }
    }

    /// Counts one more row.
    pub fn add(&mut self, row: &ControlRow) {
        self.lateness
            .add(row.actual_ns - row.scheduled_ns, self.sequence.steps.step_ns);
        self.sequence.add(row.step, row.scheduled_ns);
        if let Some(before) = &self.last {
            self.stale_steps += u64::from(row.state_seq == before.state_seq);
            self.longest_gap_ns = self.longest_gap_ns.max(row.actual_ns - before.actual_ns);
        }
        self.last = Some(*row);
    }

    /// Rows that should have been there.
    #[must_use]
    pub const fn missing(&self) -> u64 {
        self.sequence.missing
    }
}

impl ControlFile {
    /// The name of the file.
    pub const NAME: &'static str = layout::CONTROL_LOG;

    /// Creates the file with its first line. It must not exist.
    ///
    /// # Errors
    /// What the file system says.
    pub fn create(folder: &Path, counts: RowCounts) -> io::Result<Self> {
        Ok(Self {
            out: create(folder, Self::NAME, ControlRow::HEADER)?,
            counts,
        })
    }

    /// Writes and counts one row.
    ///
    /// # Errors
    /// What the file system says.
    pub fn write(&mut self, row: &ControlRow) -> io::Result<()> {
        self.counts.add(row);
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

/// The plant's log of one window.
#[derive(Debug)]
pub struct PlantFile {
    out: BufWriter<File>,
    lateness: Lateness,
    sequence: Sequence,
}

impl PlantFile {
    /// The name of the file.
    pub const NAME: &'static str = layout::PLANT_LOG;

    /// Creates the file with its first line, for a window that begins with step `first`. It must not exist.
    ///
    /// # Errors
    /// What the file system says.
    pub fn create(folder: &Path, first: u64, capacity: u64, steps: Steps) -> io::Result<Self> {
        Ok(Self {
            out: create(folder, Self::NAME, PlantRow::HEADER)?,
            lateness: Lateness::with_capacity(capacity),
            sequence: Sequence::from(first, steps),
        })
    }

    /// Writes and counts one row.
    ///
    /// # Errors
    /// What the file system says.
    pub fn write(&mut self, row: &PlantRow) -> io::Result<()> {
        self.lateness
            .add(row.actual_ns - row.scheduled_ns, self.sequence.steps.step_ns);
        self.sequence.add(row.step, row.scheduled_ns);
        row.write_to(&mut self.out)
    }

    /// The step that is to follow.
    #[must_use]
    pub const fn next_step(&self) -> u64 {
        self.sequence.next
    }

    /// Writes out what is still gathered. How late the ticks were, and how many rows should have been there.
    ///
    /// # Errors
    /// What the file system says.
    pub fn finish(mut self) -> io::Result<(Lateness, u64)> {
        self.out.flush()?;
        Ok((self.lateness, self.sequence.missing))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEPS: Steps = Steps {
        first_ns: 0,
        step_ns: 20,
    };

    fn row(step: u64, due: u64, actual_ns: i64, state_seq: u64) -> ControlRow {
        ControlRow {
            step,
            scheduled_ns: due as i64 * STEPS.step_ns,
            actual_ns,
            state_seq,
            ..ControlRow::default()
        }
    }

    #[test]
    fn a_state_seen_before_is_a_stale_step_across_windows_too() {
        let mut counts = RowCounts::after(Some(row(0, 0, 0, 7)), 1, 3, STEPS);
        [row(1, 1, 20, 7), row(2, 2, 40, 8), row(3, 3, 60, 8)]
            .iter()
            .for_each(|row| counts.add(row));
        assert_eq!(counts.stale_steps, 2);
    }

    #[test]
    fn a_gap_over_the_boundary_belongs_to_the_window_that_begins_late() {
        let mut counts = RowCounts::after(Some(row(0, 0, 0, 1)), 1, 2, STEPS);
        [row(1, 1, 90, 2), row(2, 2, 110, 3)]
            .iter()
            .for_each(|row| counts.add(row));
        assert_eq!(counts.longest_gap_ns, 90);
    }

    #[test]
    fn lost_ticks_are_not_missing_and_rows_that_nobody_lost_are() {
        let mut counts = RowCounts::after(Some(row(0, 0, 0, 1)), 1, 9, STEPS);
        // Ticks 1 to 3 were merged into one.
        counts.add(&row(3, 1, 70, 2));
        assert_eq!(counts.missing(), 0);
        // Of tick 4 nobody says that it was lost.
        counts.add(&row(5, 5, 100, 3));
        assert_eq!(counts.missing(), 1);
    }

    #[test]
    fn the_plants_ticks_are_counted_from_its_own_first_one() {
        let folder = tempfile::tempdir().unwrap();
        let steps = Steps {
            first_ns: -10,
            step_ns: 20,
        };
        let mut file = PlantFile::create(folder.path(), 0, 3, steps).unwrap();
        for (step, scheduled_ns) in [(0, -10), (2, 10), (3, 50)] {
            let row = PlantRow {
                step,
                scheduled_ns,
                actual_ns: scheduled_ns + 5,
                ..PlantRow::default()
            };
            file.write(&row).unwrap();
        }
        assert_eq!(file.next_step(), 4);
        let (lateness, missing) = file.finish().unwrap();
        assert_eq!((lateness.steps(), missing), (3, 0));
        let text = std::fs::read_to_string(folder.path().join(PlantFile::NAME)).unwrap();
        assert_eq!(text.lines().count(), 4);
    }
}
