//! Both logs of the ball on the plate, row by row. The main type is [`LoopLogs`].

use std::{fs::File, iter::Peekable};

use rayon::prelude::*;
use record::{
    causes::with_causes,
    control_log::ControlRow,
    layout,
    plant_log::PlantRow,
    run_directory::{
        NotWhole, Place, PlannedScenario, ReadError, RunDirectory, RunRecords, ScenarioState,
        ensure_file_is_whole, read_whole_record,
    },
    window::WindowRecord,
};
use serde::de::DeserializeOwned;

use super::short_lines::ShortLines;

/// Looks at each scenario of the ball on the plate, side by side; what came of them, in letter order.
///
/// # Errors
/// Of those that fail always the first.
pub fn of_the_ball<T: Send, E: Send>(
    records: &RunRecords,
    look: impl Fn(&PlannedScenario, &ScenarioState) -> Result<T, E> + Sync,
) -> Result<Vec<T>, E> {
    let is_it = |planned: &&PlannedScenario| planned.settings.experiment.is_none();
    let planned: Vec<&PlannedScenario> = records.plan.scenarios.iter().filter(is_it).collect();
    let looked: Vec<Result<T, E>> = planned
        .into_par_iter()
        .map(|planned| look(planned, &records.state.scenario(&planned.slug)))
        .collect();
    looked.into_iter().collect()
}

/// A window's folder, and what it says of itself.
pub type LoggedWindow = (Place, WindowRecord);

/// The windows of a scenario that have a record and are of the ball on the plate, in order, whatever they are worth.
///
/// # Errors
/// When the system does not let one be read.
pub fn logged_windows(
    directory: &RunDirectory,
    planned: &PlannedScenario,
    known: &ScenarioState,
) -> Result<Vec<LoggedWindow>, ReadError> {
    let mut windows = Vec::new();
    for number in 1..=planned.settings.all_windows() {
        let folder = directory.window(&planned.slug, number);
        match read_whole_record(&folder, number, known.window_sha256(number)) {
            Ok(record) if record.loops().is_some() => windows.push((folder, record)),
            // The report says so.
            Ok(_) | Err(NotWhole::Broken(_)) => {}
            Err(NotWhole::Replaced(error) | NotWhole::Unreadable(error)) => return Err(error),
        }
    }
    Ok(windows)
}

/// The same by runs of the loop: windows that follow each other in one environment. The first of a run begins it, unless that window is
/// missing.
pub fn runs_of_the_loop(windows: &[LoggedWindow]) -> impl Iterator<Item = &[LoggedWindow]> {
    windows.chunk_by(|(_, a), (_, b)| {
        b.environment == a.environment && b.window == a.window + 1 && !b.starts_run
    })
}

/// A row of either log.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Row {
    /// A tick of the plant.
    Plant(PlantRow),
    /// A control step, with its window's place among the windows.
    Control {
        /// The window's place.
        window: usize,
        /// The row.
        row: ControlRow,
    },
}

/// The rows of both logs of contiguous windows, in the order in which their ticks began. The plant comes first at one time. An error is
/// why there are no more.
pub struct LoopLogs<'a> {
    control: Peekable<Rows<'a, ControlRow>>,
    plant: Peekable<Rows<'a, PlantRow>>,
}

impl<'a> LoopLogs<'a> {
    /// Of these windows. Files are looked at as they are reached.
    #[must_use]
    pub fn of(windows: &'a [LoggedWindow]) -> Self {
        Self {
            control: Rows::of(layout::CONTROL_LOG, windows).peekable(),
            plant: Rows::of(layout::PLANT_LOG, windows).peekable(),
        }
    }
}

impl Iterator for LoopLogs<'_> {
    type Item = Result<Row, String>;

    fn next(&mut self) -> Option<Self::Item> {
        let is_plants = match (self.plant.peek(), self.control.peek()) {
            (None, None) => return None,
            (Some(Ok((_, plant))), Some(Ok((_, control)))) => plant.actual_ns <= control.actual_ns,
            (Some(Err(_)), _) | (Some(_), None) => true,
            (_, Some(_)) => false,
        };
        match is_plants {
            true => Some(self.plant.next()?.map(|(_, row)| Row::Plant(row))),
            false => {
                let row = self.control.next()?;
                Some(row.map(|(window, row)| Row::Control { window, row }))
            }
        }
    }
}

/// The rows of one log of several windows, each with its window's place among them.
struct Rows<'a, T> {
    log: &'static str,
    windows: std::iter::Enumerate<std::slice::Iter<'a, (Place, WindowRecord)>>,
    open: Option<(usize, csv::DeserializeRecordsIntoIter<ShortLines<File>, T>)>,
}

impl<'a, T: DeserializeOwned> Rows<'a, T> {
    fn of(log: &'static str, windows: &'a [(Place, WindowRecord)]) -> Self {
        Self {
            log,
            windows: windows.iter().enumerate(),
            open: None,
        }
    }

    fn open(&self, folder: &Place, record: &WindowRecord) -> Result<File, String> {
        let log = self.log;
        let file = record.files.iter().find(|file| file.name == log);
        let file = file.ok_or_else(|| format!("window.json does not name {log}"))?;
        ensure_file_is_whole(folder, file).map_err(|not_whole| match not_whole {
            NotWhole::Broken(reason) => reason,
            NotWhole::Replaced(error) | NotWhole::Unreadable(error) => with_causes(&error),
        })?;
        folder
            .join(log)
            .open_within(file.bytes)
            .map_err(|error| format!("{log}: {error}"))
    }
}

impl<T: DeserializeOwned> Iterator for Rows<'_, T> {
    type Item = Result<(usize, T), String>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some((window, rows)) = &mut self.open {
                match rows.next() {
                    Some(row) => {
                        let window = *window;
                        let row = row.map_err(|error| format!("{}: {error}", self.log));
                        return Some(row.map(|row| (window, row)));
                    }
                    None => self.open = None,
                }
            }
            let (window, (folder, record)) = self.windows.next()?;
            match self.open(folder, record) {
                Ok(file) => {
                    let rows = csv::Reader::from_reader(ShortLines::new(file)).into_deserialize();
                    self.open = Some((window, rows));
                }
                Err(reason) => return Some(Err(reason)),
            }
        }
    }
}
