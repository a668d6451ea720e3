//! All windows of a command that lasts for them: one call, which is asked to end after the last.

use std::{iter::Peekable, time::Instant};

use record::{
    progress::Progress,
    window::{CommandRecord, NoticesRecord},
};

use super::{
    Measured, Runs,
    call::{Bounds, Ended, Outcome},
    collection::{OUTPUT, check, keep_output, write_error},
    cuts::{Cuts, UpTo},
    program::Running,
};
use crate::experiment::{Ending, ExperimentError, snapshot::Snapshot, window_folder::WindowFolder};

/// A call that lasts for several windows.
struct OneCall {
    running: Running,
    began: Instant,
    /// How many windows it has had.
    windows: u32,
    cuts: Cuts,
    /// What it had used of the processors at the last cut.
    cpu_ns: u64,
    /// The last cut.
    at: Snapshot,
}

impl Runs<'_> {
    /// All windows of a command that lasts for them. One that ends before them is started again for the next.
    pub(super) fn all_of_one_call(&self) -> Result<Ending, ExperimentError> {
        let mut windows = self.request.windows.iter().copied().peekable();
        while let Some(first) = windows.peek().copied() {
            self.place.empty()?;
            let program = self.call(&self.experiment.run, Some(first), self.stop).program;
            let call = OneCall {
                running: program.start()?,
                began: Instant::now(),
                windows: 0,
                cuts: Cuts::begin(self.experiment, &self.place.output),
                cpu_ns: 0,
                at: Snapshot::take(None, &[]),
            };
            let ending = self.windows_of_one_call(call, &mut windows);
            // It is still there if something went wrong.
            self.descendants.end_all()?;
            if let Some(ending) = ending? {
                return Ok(ending);
            }
        }
        Ok(Ending::Finished)
    }

    /// The windows until that call ends. How the run ends with them, if so.
    fn windows_of_one_call(
        &self,
        mut call: OneCall,
        windows: &mut Peekable<impl Iterator<Item = u32>>,
    ) -> Result<Option<Ending>, ExperimentError> {
        let length = self.experiment.window.longest().duration();
        while let Some(number) = windows.next() {
            let folder = WindowFolder::create(&self.request.data, number)?;
            let starts_run = self.request.windows.first() == Some(&number);
            if starts_run {
                self.reporter.say(&Progress::Measuring { window: number });
            }
            call.windows += 1;
            let ends = call.began + length * call.windows;
            let cut = self.until(&call.running, number, ends)?;
            let after = Snapshot::take(None, &[]);
            let mut measured = Measured {
                outcome: cut.unwrap_or(Outcome::Exited(0)),
                reasons: Vec::new(),
                command: CommandRecord {
                    cpu_ns: call.running.cpu_ns().unwrap_or(call.cpu_ns),
                    peak_memory_bytes: call.running.peak_memory_bytes().unwrap_or_default(),
                    ..CommandRecord::default()
                },
                captures: Vec::new(),
                notices: NoticesRecord::default(),
            };
            if cut.is_none() {
                measured.reasons = self.cut(&mut call.cuts, &folder, UpTo::LastLine)?;
            }
            if cut.is_some() || windows.peek().is_none() {
                let ended = Ended::of(&call.running, cut, self.descendants)?;
                keep_output(folder.path(), &OUTPUT, &ended.printed)?;
                measured.command = ended.record();
                if cut.is_some() {
                    ended.check_not_killed(number)?;
                    measured.reasons = self.early(&ended);
                    measured
                        .reasons
                        .extend(self.cut(&mut call.cuts, &folder, UpTo::End)?);
                } else {
                    // It is how it took being asked to end, and says nothing of the window.
                    measured.command.exit_code = None;
                }
            }
            // Of the call, which all its windows share.
            let total_ns = measured.command.cpu_ns;
            measured.command.cpu_ns = total_ns.saturating_sub(call.cpu_ns);
            call.cpu_ns = total_ns;
            let reasons = std::mem::take(&mut measured.reasons);
            let record = self.record(number, starts_run, (&call.at, &after), measured, reasons);
            call.at = after;
            if let Some(ending) = self.seal(&folder, record)? {
                return Ok(Some(ending));
            }
            if cut.is_some() {
                return Ok(None);
            }
        }
        Ok(None)
    }

    /// Waits for the end of a window; how the command ended, or why it is not to go on, if that comes first.
    fn until(
        &self,
        running: &Running,
        number: u32,
        ends: Instant,
    ) -> Result<Option<Outcome>, ExperimentError> {
        let bounds = self.bounds();
        let window = Bounds {
            timeout: ends.saturating_duration_since(bounds.began),
            ..bounds
        };
        match window.wait(running, self.descendants, |elapsed| {
            self.say_running(number, elapsed)
        })? {
            None => Ok(running.ended()?.map(Outcome::from)),
            // The window is over, and the command goes on.
            Some(Outcome::TimedOut) => Ok(None),
            cut => Ok(cut),
        }
    }

    /// Why a window does not count in which the call ended.
    fn early(&self, ended: &Ended) -> Vec<String> {
        let how = ended
            .outcome
            .in_words(self.experiment.window.longest().duration());
        // Of any other exit code the verdict says so.
        let is_told = ended.outcome.exit_code().is_some_and(|code| code != 0);
        let why = (!is_told).then(|| format!("the command {how} before its windows were over"));
        why.into_iter().chain(ended.printed.said_last()).collect()
    }

    /// Takes the window's part of the files, and says what is wrong with it.
    fn cut(
        &self,
        cuts: &mut Cuts,
        folder: &WindowFolder,
        up_to: UpTo,
    ) -> Result<Vec<String>, ExperimentError> {
        let window = folder.path();
        let mut wrong = cuts.cut(window, up_to).map_err(write_error(window))?;
        for name in self.experiment.measured_files() {
            if window.join(name).exists() {
                wrong.extend(check(self.experiment, name, window)?);
            }
        }
        Ok(wrong)
    }
}
