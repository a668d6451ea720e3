//! The ball on the plate in virtual time: all that a real run leaves, computed. The main type is [`Simulated`].
//!
//! No clock is read, no network is made and no right is needed: what the platform does is in the settings. The windows are closed,
//! judged and sealed by the code of real ones. The wall clock of a simulated run begins at [`EPOCH`], so that the same seed gives the
//! same bytes.

mod captures;

use std::{
    collections::VecDeque,
    io,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use oorandom::Rand64;
use record::{
    control_log::ControlRow,
    plant_log::PlantRow,
    platform::RealtimeGrant,
    progress::Progress,
    settings::{Settings, SimulationSettings},
    virtual_host::VirtualHost,
};
use simulation::closed_loop::{Platform, SimulatedStep, Simulation};

use self::captures::Captures;
use super::{
    nanoseconds,
    open_window::{OpenWindow, WindowShape, WindowSpan},
};
use crate::{
    capabilities::drop_unneeded,
    experiment::{
        Ending, Experiment, ExperimentError, KnownPlatform, Reporter, Request, snapshot::Snapshot,
        window_folder::WindowFolder,
    },
};

/// 2000-01-01 00:00:00 UTC, since 1970.
const EPOCH: Duration = Duration::from_secs(946_684_800);
/// How often the real clock is looked at, in control steps: some milliseconds.
const LOOK_EVERY: u64 = 4096;
/// How often health is reported.
const HEALTH_EVERY: Duration = Duration::from_secs(1);

/// The ball on the plate, computed.
pub struct Simulated;

impl Experiment for Simulated {
    fn begin(&self, _: &Settings) -> Result<(), ExperimentError> {
        Ok(())
    }

    fn run(
        &self,
        request: &Request,
        reporter: &Reporter,
        stop: &Arc<AtomicBool>,
    ) -> Result<Ending, ExperimentError> {
        drop_unneeded();
        let known = KnownPlatform::look(&request.data, RealtimeGrant::default(), Arc::new(|| None))?;
        reporter.say(&Progress::Connected);
        let ending = Run::begin(request, reporter)?.finish(stop)?;
        // The machine that computes is no part of what is computed: that it changed meanwhile is on record and worth no remark.
        known.finish()?;
        Ok(ending)
    }
}

/// A run under way.
struct Run<'a> {
    request: &'a Request,
    reporter: &'a Reporter,
    shape: WindowShape,
    simulation: Simulation,
    captures: Option<Captures>,
    numbers: VecDeque<u32>,
    /// Windows in which a loop has steps to do, in order.
    open: VecDeque<Open>,
    /// Of the next window to be opened, in the run.
    next_position: u64,
    last_row: Option<ControlRow>,
    health: Instant,
}

struct Open {
    window: OpenWindow,
    position: u64,
    /// What had passed the links once its control steps were done.
    ended: Option<Snapshot>,
    /// Whether a later tick of the plant has been done.
    plant_is_past: bool,
}

impl<'a> Run<'a> {
    fn begin(request: &'a Request, reporter: &'a Reporter) -> Result<Self, ExperimentError> {
        let settings = &request.settings;
        let captures = settings.capture.enabled.then(|| Captures::new(&settings.capture));
        let shape = WindowShape {
            environment: request.environment.clone(),
            steps: settings.steps_per_window(),
            steps_per_period: settings.steps_per_period(),
            step_ns: nanoseconds(settings.rate.step()),
            phase_ns: nanoseconds(settings.control.phase.duration()),
            late_ticks: settings.loops.late_ticks,
            captures: captures.as_ref().map_or(0, |_| VirtualHost::OF_THE_BALL.len()),
            network_seed: None,
            limits: settings.validity.clone(),
        };
        let first = request.windows.first().copied().unwrap_or(1);
        let seed = seed(settings.simulation.as_ref(), first);
        let mut simulation = Simulation::new(settings, &Platform::of(settings), seed).with_plant_rows();
        if captures.is_some() {
            simulation = simulation.with_captures();
        }
        let mut run = Self {
            request,
            reporter,
            shape,
            simulation,
            captures,
            numbers: request.windows.iter().copied().collect(),
            open: VecDeque::new(),
            next_position: 0,
            last_row: None,
            health: Instant::now(),
        };
        run.open_next(run.snapshot(0))?;
        reporter.say(&Progress::Measuring { window: first });
        Ok(run)
    }

    fn finish(mut self, stop: &AtomicBool) -> Result<Ending, ExperimentError> {
        let mut steps: u64 = 0;
        while !self.open.is_empty() {
            let Some(SimulatedStep { row, .. }) = self.simulation.next() else {
                break;
            };
            self.add(&row)?;
            if let Some(captures) = &mut self.captures {
                let unix_offset_ns = nanoseconds(EPOCH) - self.shape.phase_ns;
                captures
                    .take(&mut self.simulation, unix_offset_ns)
                    .map_err(captured)?;
            }
            while let Some(row) = self.simulation.take_plant_row() {
                self.add_of_plant(&row)?;
            }
            self.close_those_done(row.actual_ns)?;
            steps += 1;
            if steps % LOOK_EVERY == 0 {
                if stop.load(Ordering::Relaxed) {
                    return self.cut(row.actual_ns);
                }
                self.tell_health();
            }
        }
        Ok(Ending::Finished)
    }

    /// The clocks and counters at a time of the experiment.
    fn snapshot(&self, now_ns: i64) -> Snapshot {
        Snapshot::in_virtual_time(now_ns, nanoseconds(EPOCH), self.simulation.links().to_vec())
    }

    fn starts_ns(&self, position: u64) -> i64 {
        let steps = i64::try_from(position * self.shape.steps).unwrap_or(i64::MAX);
        steps.saturating_mul(self.shape.step_ns)
    }

    fn open_next(&mut self, began: Snapshot) -> Result<(), ExperimentError> {
        let Some(number) = self.numbers.pop_front() else {
            return Ok(());
        };
        let folder = WindowFolder::create(&self.request.data, number)?;
        let position = self.next_position;
        let ends_ns = self.starts_ns(position + 1) + self.shape.phase_ns;
        if let Some(captures) = &mut self.captures {
            captures.begin_window(&folder, ends_ns)?;
        }
        let window = OpenWindow::begin(&self.shape, (number, position), folder, self.last_row, began)?;
        self.open.push_back(Open {
            window,
            position,
            ended: None,
            plant_is_past: false,
        });
        self.next_position += 1;
        Ok(())
    }

    /// A control step, and the end of its window with it if it is the last. Those after the last window are not part of it.
    fn add(&mut self, row: &ControlRow) -> Result<(), ExperimentError> {
        while let Some(at) = self.open.iter().position(|open| open.ended.is_none()) {
            let Some(open) = self.open.get_mut(at) else {
                return Ok(());
            };
            let is_in = open.window.contains(row.step);
            if is_in {
                open.window.add_row(row)?;
                self.last_row = Some(*row);
            }
            if !open.window.ends_with(row.step) {
                return Ok(());
            }
            let ended = self.snapshot(self.starts_ns(self.next_position));
            if let Some(open) = self.open.get_mut(at) {
                open.ended = Some(ended.clone());
            }
            self.open_next(ended)?;
            if is_in {
                return Ok(());
            }
        }
        Ok(())
    }

    fn add_of_plant(&mut self, row: &PlantRow) -> Result<(), ExperimentError> {
        for open in &mut self.open {
            if open.window.contains(row.step) {
                open.window.add_plant_row(row)?;
            }
            open.plant_is_past |= open.window.ends_with(row.step);
        }
        Ok(())
    }

    /// A window is done once both loops and all packets are beyond it.
    fn close_those_done(&mut self, now_ns: i64) -> Result<(), ExperimentError> {
        loop {
            let is_done = self.open.front().is_some_and(|open| {
                open.ended.is_some() && open.plant_is_past && now_ns >= self.starts_ns(open.position + 1)
            });
            if !is_done {
                return Ok(());
            }
            let Some(Open {
                mut window,
                position,
                ended: Some(ended),
                ..
            }) = self.open.pop_front()
            else {
                return Ok(());
            };
            self.end_captures(&mut window);
            let span = self.span(position, self.starts_ns(position + 1), true);
            window.close(&ended, &span, 0)?.seal(self.reporter)?;
        }
    }

    fn end_captures(&mut self, window: &mut OpenWindow) {
        let captured = self.captures.as_mut().map(Captures::end_window);
        captured
            .iter()
            .flatten()
            .for_each(|captured| window.add_capture(captured));
    }

    fn span(&self, position: u64, ended_ns: i64, complete: bool) -> WindowSpan {
        WindowSpan {
            zero_ns: 0,
            started_ns: self.starts_ns(position),
            ended_ns,
            complete,
        }
    }

    /// It is to stop: the window under way ends here.
    fn cut(mut self, now_ns: i64) -> Result<Ending, ExperimentError> {
        let ended = self.snapshot(now_ns);
        let mut under_way = None;
        for mut open in std::mem::take(&mut self.open) {
            self.end_captures(&mut open.window);
            under_way.get_or_insert(open.window.number());
            let until_ns = now_ns.max(self.starts_ns(open.position));
            let span = self.span(open.position, until_ns, false);
            open.window.close(&ended, &span, 0)?.seal(self.reporter)?;
        }
        Ok(under_way.map_or(Ending::Finished, |window| Ending::Stopped { window }))
    }

    fn tell_health(&mut self) {
        if self.health.elapsed() < HEALTH_EVERY {
            return;
        }
        self.health = Instant::now();
        if let Some(open) = self.open.back() {
            let lateness = &open.window.counts().lateness;
            self.reporter.say(&Progress::Health {
                window: open.window.number(),
                steps_done: lateness.steps(),
                steps_expected: self.shape.steps,
                missed_deadlines: lateness.missed(),
                worst_lateness_ns: 0,
            });
        }
    }
}

fn captured(source: io::Error) -> ExperimentError {
    ExperimentError::Write {
        path: "a captured packet".into(),
        source,
    }
}

/// Of one environment, which is known by its first window: every environment of a scenario draws anew.
fn seed(simulation: Option<&SimulationSettings>, first_window: u32) -> u64 {
    let seed = simulation.map_or(0, |simulation| simulation.seed);
    Rand64::new((u128::from(seed) << 32) | u128::from(first_window)).rand_u64()
}
