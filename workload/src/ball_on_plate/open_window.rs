//! A window under way: what belongs to it is gathered until it can be sealed. The main type is [`OpenWindow`].

use std::io;

use record::{
    causes::with_causes,
    control_log::ControlRow,
    plant_log::PlantRow,
    progress::Progress,
    settings::{
        LateTicks, ValiditySettings,
        validity::{self, Expectation},
    },
    window::{CaptureRecord, LoopRecord, LoopsRecord, NoticesRecord, OfExperiment, Verdict, WindowRecord},
};

use super::log_file::{ControlFile, PlantFile, RowCounts, Steps};
use crate::capture::CapturedWindow;
use crate::experiment::{ExperimentError, Reporter, snapshot::Snapshot, window_folder::WindowFolder};
use crate::virtual_hosts::News;

/// What does not change from one window to the next.
#[derive(Debug, Clone, PartialEq)]
pub struct WindowShape {
    /// The environment's name.
    pub environment: String,
    /// Control steps of a window.
    pub steps: u64,
    /// Control steps of a period.
    pub steps_per_period: u64,
    /// Length of a step.
    pub step_ns: i64,
    /// How long before the controller's step the plant's comes.
    pub phase_ns: i64,
    /// What becomes of ticks that fall due while an earlier one has not ended.
    pub late_ticks: LateTicks,
    /// How many captures each has.
    pub captures: usize,
    /// The network's seed.
    pub network_seed: Option<u64>,
    /// What it may suffer.
    pub limits: ValiditySettings,
}

/// A window whose steps are being done, or whose captures are being completed.
#[derive(Debug)]
pub struct OpenWindow {
    shape: WindowShape,
    number: u32,
    /// Position in the run, from 0.
    position: u64,
    folder: WindowFolder,
    control: ControlFile,
    plant: PlantFile,
    captures: Vec<CaptureRecord>,
    captures_to_come: usize,
    failures: Vec<String>,
    notices: NoticesRecord,
    began: Snapshot,
}

/// A window whose logs and captures are whole on disk.
#[derive(Debug)]
pub struct ClosedWindow {
    /// Where.
    pub folder: WindowFolder,
    /// All but its `files`.
    pub record: WindowRecord,
}

impl OpenWindow {
    /// Opens the log of the window at that position of the run.
    ///
    /// # Errors
    /// If the log cannot be created.
    pub fn begin(
        shape: &WindowShape,
        (number, position): (u32, u64),
        folder: WindowFolder,
        last_row: Option<ControlRow>,
        began: Snapshot,
    ) -> Result<Self, ExperimentError> {
        let steps = |first_ns| Steps {
            first_ns,
            step_ns: shape.step_ns,
        };
        let first = position * shape.steps;
        let counts = RowCounts::after(last_row, first, shape.steps, steps(0));
        let control =
            ControlFile::create(folder.path(), counts).map_err(write_error(&folder, ControlFile::NAME))?;
        let plant = PlantFile::create(folder.path(), first, shape.steps, steps(-shape.phase_ns))
            .map_err(write_error(&folder, PlantFile::NAME))?;
        Ok(Self {
            number,
            position,
            control,
            plant,
            captures: Vec::new(),
            captures_to_come: shape.captures,
            failures: Vec::new(),
            notices: NoticesRecord::default(),
            began,
            folder,
            shape: shape.clone(),
        })
    }

    /// Its number.
    #[must_use]
    pub fn number(&self) -> u32 {
        self.number
    }

    /// What is counted on its control steps.
    #[must_use]
    pub fn counts(&self) -> &RowCounts {
        self.control.counts()
    }

    /// Whether a step of the run belongs to it.
    #[must_use]
    pub fn contains(&self, step: u64) -> bool {
        step / self.shape.steps.max(1) == self.position
    }

    /// One control step.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn add_row(&mut self, row: &ControlRow) -> Result<(), ExperimentError> {
        self.control
            .write(row)
            .map_err(write_error(&self.folder, ControlFile::NAME))
    }

    /// Whether that step is its last one, or comes after it.
    #[must_use]
    pub fn ends_with(&self, step: u64) -> bool {
        step + 1 >= (self.position + 1) * self.shape.steps
    }

    /// Whether the plant has done its last step of the window.
    #[must_use]
    pub fn plant_is_done(&self) -> bool {
        self.ends_with(self.plant.next_step().saturating_sub(1))
    }

    /// One tick of the plant.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn add_plant_row(&mut self, row: &PlantRow) -> Result<(), ExperimentError> {
        self.plant
            .write(row)
            .map_err(write_error(&self.folder, PlantFile::NAME))
    }

    /// One of its captures is complete, if it is one of its own.
    pub fn add_capture(&mut self, captured: &CapturedWindow) {
        if captured.file.parent() == Some(self.folder.path()) {
            self.captures_to_come = self.captures_to_come.saturating_sub(1);
            match &captured.outcome {
                Ok(record) => self.captures.push(record.clone()),
                Err(error) => self
                    .failures
                    .push(format!("A capture failed: {}.", with_causes(error))),
            }
        }
    }

    /// What has happened between nodes and peers.
    pub fn add_news(&mut self, news: News) {
        news.add_to(&mut self.notices);
    }

    /// Something went wrong that its numbers do not show: a reason, a sentence.
    pub fn fail(&mut self, reason: String) {
        self.failures.push(reason);
    }

    /// Whether captures are still to come.
    #[must_use]
    pub fn waits_for_captures(&self) -> bool {
        self.captures_to_come > 0
    }

    /// Closes it: complete if all steps were to be done by `ended`, else cut there.
    ///
    /// # Errors
    /// If what is gathered cannot be written.
    pub fn close(
        self,
        ended: &Snapshot,
        span: &WindowSpan,
        log_dropped: u64,
    ) -> Result<ClosedWindow, ExperimentError> {
        let missing_rows = self.control.counts().missing();
        let counts = self
            .control
            .finish()
            .map_err(write_error(&self.folder, ControlFile::NAME))?;
        let (plant, missing_ticks) = self
            .plant
            .finish()
            .map_err(write_error(&self.folder, PlantFile::NAME))?;
        let shape = &self.shape;
        let lost = |done: u64, missing: u64| match shape.late_ticks {
            LateTicks::Lost if span.complete => shape.steps.saturating_sub(done + missing),
            _ => 0,
        };
        let controller = LoopRecord {
            lost_ticks: lost(counts.lateness.steps(), missing_rows),
            ..counts.lateness.into_record(shape.step_ns)
        };
        let plant = LoopRecord {
            lost_ticks: lost(plant.steps(), missing_ticks),
            ..plant.into_record(shape.step_ns)
        };
        let mut captures = self.captures;
        captures.sort_by_key(|capture| capture.host);
        let mut record = WindowRecord {
            format: record::FORMAT,
            window: self.number,
            environment: shape.environment.clone(),
            starts_run: self.position == 0,
            complete: span.complete,
            started_unix_ns: self.began.unix_ns(span.zero_ns + span.started_ns),
            ended_unix_ns: ended.unix_ns(span.zero_ns + span.ended_ns),
            started_ns: span.started_ns,
            ended_ns: span.ended_ns,
            of: OfExperiment::Loops(LoopsRecord {
                steps_expected: shape.steps,
                steps_done: controller.steps,
                stale_steps: counts.stale_steps,
                longest_gap_ns: counts.longest_gap_ns,
                controller,
                plant,
                log_dropped,
            }),
            clock_jump_ns: ended.unix_offset_ns - self.began.unix_offset_ns,
            cpu_share: ended.cpu_share_since(&self.began),
            conditions: ended.conditions_since(&self.began),
            captures,
            network_seed: shape.network_seed,
            links: ended.links_since(&self.began),
            notices: self.notices,
            releases: ended.releases_since(&self.began),
            files: Vec::new(),
            verdict: Verdict::Valid,
            reasons: Vec::new(),
        };
        let expected = Expectation {
            step_ns: shape.step_ns,
            steps_per_period: shape.steps_per_period,
            captures: shape.captures,
            limits: &shape.limits,
        };
        (record.verdict, record.reasons) = validity::judge(&record, &expected);
        record.reasons.extend(self.failures);
        Ok(ClosedWindow {
            folder: self.folder,
            record,
        })
    }
}

impl ClosedWindow {
    /// Completes it on the disk, and tells of it if all its steps were done.
    ///
    /// # Errors
    /// If something cannot be written.
    pub fn seal(self, reporter: &Reporter) -> Result<(), ExperimentError> {
        let Self { folder, record } = self;
        let (window, verdict, complete) = (record.window, record.verdict, record.complete);
        let reason = record.invalid_for();
        folder.seal(record)?;
        if complete {
            reporter.say(&Progress::WindowComplete {
                window,
                verdict,
                reason,
            });
        }
        Ok(())
    }
}

/// From when to when a window was.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct WindowSpan {
    /// The experiment's zero, on the monotonic clock.
    pub zero_ns: i64,
    /// Its start, on the experiment's clock.
    pub started_ns: i64,
    /// Its end, on the experiment's clock.
    pub ended_ns: i64,
    /// Whether that is the end it was to have.
    pub complete: bool,
}

fn write_error(folder: &WindowFolder, name: &str) -> impl Fn(io::Error) -> ExperimentError {
    let path = folder.path().join(name);
    move |source| ExperimentError::Write {
        path: path.clone(),
        source,
    }
}
