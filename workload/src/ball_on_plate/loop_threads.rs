//! The thread of one loop: started early, so that what it is granted is known before anything is measured, and then told
//! when to begin. The main type is [`LoopThread`].

use std::{
    sync::mpsc::{Receiver, Sender, channel},
    thread::{self, JoinHandle},
};

use record::{
    control_log::ControlRow,
    plant_log::PlantRow,
    platform::RealtimeGrant,
    settings::{RealtimeSettings, Settings, Waiting},
};
use rtrb::{Consumer, RingBuffer};
use simulation::{controller::Controller, plant::Plant, reference::Reference, schedule::Schedule};

use super::{
    connection::{ControllerEnds, PlantEnds},
    loops::{ControllerLoop, PlantLoop, Shared},
    schedule::Pace,
};
use crate::experiment::ExperimentError;
use crate::{realtime::enter_realtime, ros::Publisher};

/// How many seconds of rows the queues hold: a disk may hang that long.
const QUEUE_SECONDS: f64 = 60.0;

/// One loop, waiting for its schedule.
pub struct LoopThread {
    name: &'static str,
    begins: Sender<(Schedule, Shared)>,
    /// Its publisher, if it has one, unless it was never begun.
    thread: JoinHandle<Option<Publisher>>,
}

impl LoopThread {
    /// The plant's, with the queue of its rows and what it was granted.
    ///
    /// # Errors
    /// If its thread cannot be started.
    pub fn plant(
        settings: &Settings,
        ends: PlantEnds,
    ) -> Result<(Self, Consumer<PlantRow>, RealtimeGrant), ExperimentError> {
        let (queue, rows) = RingBuffer::new(queue_capacity(settings));
        let plant = PlantLoop {
            plant: Plant::new(&settings.plant, settings.rate.step()),
            output: ends.output,
            commands: ends.commands,
            rows: queue,
        };
        let pace = Pace {
            late_ticks: settings.loops.late_ticks,
            waiting: Waiting::Sleep,
        };
        let run = move |schedule: &Schedule, shared: &Shared| plant.run(schedule, pace, shared);
        let (thread, grant) = Self::start("plant", &settings.realtime, run)?;
        Ok((thread, rows, grant))
    }

    /// The controller's, with the queue of its rows and what it was granted.
    ///
    /// # Errors
    /// If its thread cannot be started.
    pub fn controller(
        settings: &Settings,
        ends: ControllerEnds,
    ) -> Result<(Self, Consumer<ControlRow>, RealtimeGrant), ExperimentError> {
        let (queue, rows) = RingBuffer::new(queue_capacity(settings));
        let controller = ControllerLoop {
            reference: Reference::new(settings),
            controller: Controller::new(settings),
            publisher: ends.publisher,
            messages: settings.ros.messages,
            states: ends.states,
            rows: queue,
        };
        let pace = Pace {
            late_ticks: settings.loops.late_ticks,
            waiting: settings.loops.controller_waits,
        };
        let run = move |schedule: &Schedule, shared: &Shared| controller.run(schedule, pace, shared);
        let (thread, grant) = Self::start("controller", &settings.realtime, run)?;
        Ok((thread, rows, grant))
    }

    fn start(
        name: &'static str,
        wishes: &RealtimeSettings,
        run: impl FnOnce(&Schedule, &Shared) -> Option<Publisher> + Send + 'static,
    ) -> Result<(Self, RealtimeGrant), ExperimentError> {
        let (begins, to_begin): (_, Receiver<(Schedule, Shared)>) = channel();
        let (grants, granted) = channel();
        let wishes = wishes.clone();
        let thread = thread::Builder::new().name(name.into()).spawn(move || {
            let _ = grants.send(enter_realtime(&wishes));
            let (schedule, shared) = to_begin.recv().ok()?;
            run(&schedule, &shared)
        });
        let thread = thread.map_err(|source| ExperimentError::Thread {
            name: name.into(),
            source,
        })?;
        let grant = granted
            .recv()
            .map_err(|_| ExperimentError::ThreadEnded { name: name.into() })?;
        Ok((Self { name, begins, thread }, grant))
    }

    /// Tells it when to begin.
    ///
    /// # Errors
    /// If it has ended.
    pub fn begin(&self, schedule: Schedule, shared: &Shared) -> Result<(), ExperimentError> {
        let ended = ExperimentError::ThreadEnded {
            name: self.name.into(),
        };
        self.begins.send((schedule, shared.clone())).map_err(|_| ended)
    }

    /// Waits until it has ended, and gives its publisher back: dropping it closes the connections. One that was never begun
    /// ends at once.
    ///
    /// # Errors
    /// If it ended in a panic.
    pub fn join(self) -> Result<Option<Publisher>, ExperimentError> {
        drop(self.begins);
        self.thread.join().map_err(|_| ExperimentError::ThreadEnded {
            name: self.name.into(),
        })
    }
}

/// How many rows a queue holds.
#[must_use]
pub fn queue_capacity(settings: &Settings) -> usize {
    ((settings.rate.hz() * QUEUE_SECONDS) as usize).max(1024)
}
