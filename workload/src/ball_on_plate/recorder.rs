//! Takes what the loops say and turns it into windows on disk, while they are already in the next one. The main type is
//! [`Recorder`].
//!
//! It looks at the queues at a steady rate rather than being woken: waking is a system call that the loops need not
//! make. Hashing and syncing are left to a thread of their own behind all others.

use std::{
    collections::VecDeque,
    path::Path,
    sync::{
        atomic::Ordering,
        mpsc::{Receiver, Sender, channel},
    },
    thread,
};

use nix::unistd::Pid;
use record::{
    causes::with_causes, control_log::ControlRow, plant_log::PlantRow, progress::Progress,
    virtual_host::VirtualHost,
};
use rtrb::Consumer;

use super::{
    loops::Shared,
    open_window::{ClosedWindow, OpenWindow, WindowShape, WindowSpan},
};
use crate::experiment::{
    Ending, ExperimentError, Reporter,
    snapshot::{Snapshot, unix_offset_ns},
    window_folder::WindowFolder,
};
use crate::{
    capture::Capture,
    network::Network,
    realtime::{monotonic_ns, priority::step_back, sleep_until, unix_ns},
    virtual_hosts::NoticeQueue,
};

const MILLISECOND_NS: i64 = 1_000_000;
/// How often the queues are emptied; they hold far more.
const DRAIN_EVERY_NS: i64 = 50 * MILLISECOND_NS;
/// How often health is reported.
const HEALTH_EVERY_NS: i64 = 1000 * MILLISECOND_NS;
/// How long before it begins the captures are told of a window.
const ANNOUNCE_AHEAD_NS: i64 = 1000 * MILLISECOND_NS;
/// How long after its end a window waits for its captures and the plant's last steps.
const CAPTURE_TIMEOUT_NS: i64 = 30_000 * MILLISECOND_NS;

/// Where a recorder gets everything from.
pub struct Sources<'a> {
    /// The controller's rows.
    pub rows: Consumer<ControlRow>,
    /// The plant's rows.
    pub plant_rows: Consumer<PlantRow>,
    /// The running captures.
    pub captures: Vec<(VirtualHost, Capture)>,
    /// The links.
    pub network: &'a dyn Network,
    /// What master and nodes have to say.
    pub board: NoticeQueue,
    /// What is shared with the loops.
    pub shared: Shared,
    /// The processes of the nodes, beside this one.
    pub processes: Vec<Pid>,
}

/// Records a run, window after window.
pub struct Recorder<'a> {
    sources: Sources<'a>,
    shape: WindowShape,
    data: &'a Path,
    reporter: &'a Reporter,
    current: Option<OpenWindow>,
    /// The position in the run of the next window, and its folder once the captures know of it.
    next_position: u64,
    next_folder: Option<WindowFolder>,
    numbers: VecDeque<u32>,
    closing: VecDeque<Closing>,
    last_row: Option<ControlRow>,
    log_dropped_before: u64,
    health: Health,
}

/// A window whose control steps are over.
struct Closing {
    window: OpenWindow,
    ended: Snapshot,
    span: WindowSpan,
    log_dropped: u64,
}

#[derive(Default)]
struct Health {
    due_ns: i64,
    worst_lateness_ns: i64,
    measuring: bool,
}

impl<'a> Recorder<'a> {
    /// Opens the first window; the captures begin it at once.
    ///
    /// # Errors
    /// If its folder or a file cannot be created.
    pub fn begin(
        sources: Sources<'a>,
        shape: WindowShape,
        numbers: &[u32],
        data: &'a Path,
        reporter: &'a Reporter,
    ) -> Result<Self, ExperimentError> {
        let mut recorder = Self {
            health: Health {
                due_ns: sources.shared.zero_ns + HEALTH_EVERY_NS,
                ..Health::default()
            },
            sources,
            shape,
            data,
            reporter,
            current: None,
            next_position: 0,
            next_folder: None,
            numbers: numbers.iter().copied().collect(),
            closing: VecDeque::new(),
            last_row: None,
            log_dropped_before: 0,
        };
        recorder.announce_next()?;
        let began = Snapshot::take(Some(recorder.sources.network), &recorder.sources.processes);
        recorder.open_next(began)?;
        Ok(recorder)
    }

    /// Records until the loops have ended and all windows are sealed.
    ///
    /// # Errors
    /// If a window cannot be written or the network stops; the loops are told to stop then.
    pub fn run(mut self) -> Result<Ending, ExperimentError> {
        let reporter = self.reporter;
        let name = "sealer";
        let outcome = thread::scope(|scope| {
            let (closed, to_seal) = channel();
            let sealer = thread::Builder::new()
                .name(name.into())
                .spawn_scoped(scope, move || {
                    step_back();
                    seal_all(&to_seal, reporter)
                });
            let sealer = sealer.map_err(|source| ExperimentError::Thread {
                name: name.into(),
                source,
            })?;
            let recorded = self.record(&closed);
            if let Err(failure) = &recorded {
                self.cut(failure, &closed);
            }
            drop(closed);
            // What kept the sealer from sealing is the cause of what kept the recorder from handing over.
            sealer
                .join()
                .unwrap_or(Err(ExperimentError::ThreadEnded { name: name.into() }))?;
            recorded
        });
        if outcome.is_err() {
            self.sources.shared.stop.store(true, Ordering::Relaxed);
        }
        outcome
    }

    fn record(&mut self, closed: &Sender<ClosedWindow>) -> Result<Ending, ExperimentError> {
        // The first look comes right after the first control step, whose announcement others wait for.
        let mut look_ns = self.sources.shared.zero_ns + 2 * MILLISECOND_NS;
        loop {
            sleep_until(look_ns);
            look_ns = monotonic_ns() + DRAIN_EVERY_NS;
            let loops_ended = self.sources.rows.is_abandoned() && self.sources.plant_rows.is_abandoned();
            self.drain()?;
            self.look_after()?;
            if loops_ended {
                break;
            }
            self.hand_over(closed, false)?;
        }
        let ending = self.end()?;
        self.hand_over_rest(closed)?;
        Ok(ending)
    }

    /// Empties both queues. A row of the plant of a window that is not open yet stays in its queue.
    fn drain(&mut self) -> Result<(), ExperimentError> {
        while let Ok(row) = self.sources.rows.pop() {
            // Rows may have been lost at the end of the window before.
            if self
                .current
                .as_ref()
                .is_some_and(|window| !window.contains(row.step))
            {
                self.rotate()?;
            }
            self.health.worst_lateness_ns = self
                .health
                .worst_lateness_ns
                .max(row.actual_ns - row.scheduled_ns);
            let Some(window) = self.current.as_mut() else {
                continue;
            };
            window.add_row(&row)?;
            let done = window.ends_with(row.step);
            if !self.health.measuring {
                self.health.measuring = true;
                self.reporter.say(&Progress::Measuring {
                    window: window.number(),
                });
            }
            self.last_row = Some(row);
            if done {
                self.rotate()?;
            }
        }
        let Self {
            sources,
            current,
            closing,
            ..
        } = self;
        while let Ok(row) = sources.plant_rows.peek().copied() {
            let closing = closing.iter_mut().map(|closing| &mut closing.window);
            let Some(window) = closing
                .chain(current.as_mut())
                .find(|window| window.contains(row.step))
            else {
                break;
            };
            window.add_plant_row(&row)?;
            let _ = sources.plant_rows.pop();
        }
        for (_, capture) in &sources.captures {
            for captured in capture.completed().try_iter() {
                let closing = closing.iter_mut().map(|closing| &mut closing.window);
                closing
                    .chain(current.as_mut())
                    .for_each(|window| window.add_capture(&captured));
            }
        }
        Ok(())
    }

    /// What is to be done now and then: the next window's announcement, health, the network's.
    fn look_after(&mut self) -> Result<(), ExperimentError> {
        if let Some(error) = self.sources.network.failure() {
            return Err(error.into());
        }
        let reporter = self.reporter;
        if let Some(window) = &mut self.current {
            window.add_news(self.sources.board.look(|progress| reporter.say(progress)));
        }
        let now_ns = monotonic_ns();
        if self.next_folder.is_none()
            && !self.numbers.is_empty()
            && now_ns >= self.boundary_ns(self.next_position) - ANNOUNCE_AHEAD_NS
        {
            self.announce_next()?;
        }
        if now_ns >= self.health.due_ns {
            self.health.due_ns += HEALTH_EVERY_NS;
            if let Some(window) = &self.current {
                let lateness = &window.counts().lateness;
                self.reporter.say(&Progress::Health {
                    window: window.number(),
                    steps_done: lateness.steps(),
                    steps_expected: self.shape.steps,
                    missed_deadlines: lateness.missed(),
                    worst_lateness_ns: std::mem::take(&mut self.health.worst_lateness_ns),
                });
            }
        }
        Ok(())
    }

    /// When the window at that position begins, on the monotonic clock.
    fn boundary_ns(&self, position: u64) -> i64 {
        self.sources.shared.zero_ns + self.starts_ns(position)
    }

    /// The same on the experiment's clock.
    fn starts_ns(&self, position: u64) -> i64 {
        let steps = i64::try_from(position * self.shape.steps).unwrap_or(i64::MAX);
        steps.saturating_mul(self.shape.step_ns)
    }

    /// Makes the next window's folder and tells the captures.
    fn announce_next(&mut self) -> Result<(), ExperimentError> {
        let Some(number) = self.numbers.front() else {
            return Ok(());
        };
        let folder = WindowFolder::create(self.data, *number)?;
        // The plant's first state is sent before the first control step: the first window's captures have it too.
        let starts_unix_ns = match self.next_position {
            0 => unix_ns(),
            position => self.boundary_ns(position) + unix_offset_ns(),
        };
        for (host, capture) in &self.sources.captures {
            capture.begin_window(folder.capture(*host), starts_unix_ns)?;
        }
        self.next_folder = Some(folder);
        Ok(())
    }

    /// Opens the next window, if there is to be one.
    fn open_next(&mut self, began: Snapshot) -> Result<(), ExperimentError> {
        if self.next_folder.is_none() {
            self.announce_next()?;
        }
        let (Some(folder), Some(number)) = (self.next_folder.take(), self.numbers.pop_front()) else {
            return Ok(());
        };
        let place = (number, self.next_position);
        let window = OpenWindow::begin(&self.shape, place, folder, self.last_row, began)?;
        self.current = Some(window);
        self.next_position += 1;
        Ok(())
    }

    /// The current window's control steps are over at the time they were to be; on to the next.
    fn rotate(&mut self) -> Result<(), ExperimentError> {
        let ended_ns = self.starts_ns(self.next_position);
        let ended = self.close_current(ended_ns, true);
        if self.numbers.is_empty() {
            self.end_captures(ended_ns, &ended)
        } else {
            self.open_next(ended)
        }
    }

    fn close_current(&mut self, ended_ns: i64, complete: bool) -> Snapshot {
        let ended = Snapshot::take(Some(self.sources.network), &self.sources.processes);
        let log_dropped = self.sources.shared.log_dropped.load(Ordering::Relaxed);
        if let Some(window) = self.current.take() {
            self.closing.push_back(Closing {
                window,
                ended: ended.clone(),
                span: WindowSpan {
                    zero_ns: self.sources.shared.zero_ns,
                    started_ns: self.starts_ns(self.next_position.saturating_sub(1)),
                    ended_ns,
                    complete,
                },
                log_dropped: log_dropped - self.log_dropped_before,
            });
        }
        self.log_dropped_before = log_dropped;
        ended
    }

    fn end_captures(&self, ended_ns: i64, ended: &Snapshot) -> Result<(), ExperimentError> {
        let at_unix_ns = ended.unix_ns(self.sources.shared.zero_ns + ended_ns);
        for (_, capture) in &self.sources.captures {
            capture.end(at_unix_ns)?;
        }
        Ok(())
    }

    /// The loops have ended: after the last step, or cut.
    fn end(&mut self) -> Result<Ending, ExperimentError> {
        let Some(number) = self.current.as_ref().map(OpenWindow::number) else {
            return Ok(Ending::Finished);
        };
        let stopped = self.sources.shared.stop.load(Ordering::Relaxed);
        if stopped {
            self.close_last(self.now_ns(), false)?;
            Ok(Ending::Stopped { window: number })
        } else if self.numbers.is_empty() {
            self.close_last(self.starts_ns(self.next_position), true)?;
            Ok(Ending::Finished)
        } else {
            Err(ExperimentError::ThreadEnded {
                name: "controller".into(),
            })
        }
    }

    /// After a failure: stops the loops, and ends the window under way here, with the failure as a reason. Windows that
    /// were whole by then are handed over; one that still waited for something stays without a record. A second failure
    /// on the way is not told: it is likely a consequence of the first.
    fn cut(&mut self, failure: &ExperimentError, closed: &Sender<ClosedWindow>) {
        self.sources.shared.stop.store(true, Ordering::Relaxed);
        let _ = self.hand_over(closed, false);
        self.closing.clear();
        if let Some(window) = &mut self.current {
            window.fail(format!("The experiment failed: {}.", with_causes(failure)));
            let _ = self
                .close_last(self.now_ns(), false)
                .and_then(|()| self.hand_over_rest(closed));
        }
    }

    /// Now on the experiment's clock, in the window under way.
    fn now_ns(&self) -> i64 {
        let now_ns = monotonic_ns() - self.sources.shared.zero_ns;
        now_ns.min(self.starts_ns(self.next_position))
    }

    /// Closes the last window of the run, and the captures with it.
    fn close_last(&mut self, ended_ns: i64, complete: bool) -> Result<(), ExperimentError> {
        let ended = self.close_current(ended_ns, complete);
        self.end_captures(ended_ns, &ended)?;
        if let Some(folder) = self.next_folder.take() {
            folder.withdraw();
        }
        Ok(())
    }

    /// Hands over what is closed, as it gets ready; the loops have ended or were told to.
    fn hand_over_rest(&mut self, closed: &Sender<ClosedWindow>) -> Result<(), ExperimentError> {
        while !self.closing.is_empty() {
            self.hand_over(closed, true)?;
            sleep_until(monotonic_ns() + DRAIN_EVERY_NS);
        }
        Ok(())
    }

    /// Whether the plant has done its last step of the window, or a later one.
    fn plant_is_done(&self, window: &OpenWindow) -> bool {
        let later = self.sources.plant_rows.peek();
        window.plant_is_done() || later.is_ok_and(|row| window.ends_with(row.step))
    }

    /// Closes and hands over the windows that are ready, in order.
    fn hand_over(&mut self, closed: &Sender<ClosedWindow>, loops_ended: bool) -> Result<(), ExperimentError> {
        self.drain()?;
        while let Some(front) = self.closing.front() {
            let overdue = monotonic_ns() > front.ended.monotonic_ns + CAPTURE_TIMEOUT_NS;
            let plant_done = loops_ended || self.plant_is_done(&front.window);
            if !overdue && (front.window.waits_for_captures() || !plant_done) {
                return Ok(());
            }
            let Some(Closing {
                window,
                ended,
                span,
                log_dropped,
            }) = self.closing.pop_front()
            else {
                return Ok(());
            };
            let window = window.close(&ended, &span, log_dropped)?;
            if closed.send(window).is_err() {
                return Err(ExperimentError::ThreadEnded {
                    name: "sealer".into(),
                });
            }
        }
        Ok(())
    }
}

fn seal_all(to_seal: &Receiver<ClosedWindow>, reporter: &Reporter) -> Result<(), ExperimentError> {
    to_seal.iter().try_for_each(|window| window.seal(reporter))
}

#[cfg(test)]
mod tests;
