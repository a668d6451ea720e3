//! The threads of the two loops: started early, so that what they are granted is known before anything is measured,
//! and then told when to begin. The main type is [`LoopThreads`].

use std::{
    sync::mpsc::{Receiver, Sender, channel},
    thread::{self, JoinHandle},
};

use rtrb::{Consumer, RingBuffer};

use super::{
    connection::{ControllerEnds, PlantEnds},
    error::ExperimentError,
    loops::{ControllerLoop, PlantLoop, Shared},
    schedule::{Schedule, Tick},
};
use crate::{
    controller::Controller,
    plant::PlantModel,
    realtime::enter_realtime,
    record::{control_log::ControlRow, platform::RealtimeGrant},
    reference::Reference,
    ros::Publisher,
    settings::{RealtimeSettings, Settings},
};

/// How many seconds of rows the queues hold: a disk may hang that long.
const QUEUE_SECONDS: f64 = 60.0;

/// Both loops, waiting for their schedule.
pub struct LoopThreads {
    controller: LoopThread,
    plant: LoopThread,
}

/// What the recorder reads.
pub struct Queues {
    /// The controller's rows.
    pub rows: Consumer<ControlRow>,
    /// The plant's ticks.
    pub ticks: Consumer<Tick>,
}

impl LoopThreads {
    /// Starts both threads and says what they were granted; where they differ, the refusal counts.
    ///
    /// # Errors
    /// If a thread cannot be started.
    pub fn start(
        settings: &Settings,
        plant: PlantEnds,
        controller: ControllerEnds,
    ) -> Result<(Self, Queues, RealtimeGrant), ExperimentError> {
        let (plant, ticks, plant_grant) = LoopThread::plant(settings, plant)?;
        let (controller, rows, grant) = LoopThread::controller(settings, controller)?;
        let grant = if plant_grant.priority_refusal.is_some() {
            plant_grant
        } else {
            grant
        };
        Ok((Self { controller, plant }, Queues { rows, ticks }, grant))
    }

    /// Tells both when to begin.
    ///
    /// # Errors
    /// If one has ended.
    pub fn begin(
        &self,
        plant: Schedule,
        controller: Schedule,
        shared: &Shared,
    ) -> Result<(), ExperimentError> {
        self.plant.begin(plant, shared)?;
        self.controller.begin(controller, shared)
    }

    /// Waits until both have ended. Loops that were never begun end at once.
    ///
    /// # Errors
    /// If one ended in a panic.
    pub fn join(self) -> Result<(), ExperimentError> {
        let plant = self.plant.end();
        let controller = self.controller.end();
        // Only now the connections close: neither loop has lost its peer.
        controller.and(plant).map(drop)
    }
}

/// One loop, waiting for its schedule.
pub struct LoopThread {
    name: &'static str,
    begins: Sender<(Schedule, Shared)>,
    /// Its publisher, unless it was never begun.
    thread: JoinHandle<Option<Publisher>>,
}

impl LoopThread {
    /// The plant's, with the queue of its ticks and what it was granted.
    ///
    /// # Errors
    /// If its thread cannot be started.
    pub fn plant(
        settings: &Settings,
        (publisher, commands): PlantEnds,
    ) -> Result<(Self, Consumer<Tick>, RealtimeGrant), ExperimentError> {
        let (queue, ticks) = RingBuffer::new(queue_capacity(settings));
        let plant = PlantLoop {
            model: PlantModel::new(&settings.plant, settings.rate.step()),
            publisher,
            commands,
            ticks: queue,
        };
        let run = move |schedule: &Schedule, shared: &Shared| plant.run(schedule, shared);
        let (thread, grant) = Self::start("plant", &settings.realtime, run)?;
        Ok((thread, ticks, grant))
    }

    /// The controller's, with the queue of its rows and what it was granted.
    ///
    /// # Errors
    /// If its thread cannot be started.
    pub fn controller(
        settings: &Settings,
        (publisher, states): ControllerEnds,
    ) -> Result<(Self, Consumer<ControlRow>, RealtimeGrant), ExperimentError> {
        let (queue, rows) = RingBuffer::new(queue_capacity(settings));
        let controller = ControllerLoop {
            reference: Reference::new(settings),
            controller: Controller::new(&settings.control),
            publisher,
            states,
            rows: queue,
        };
        let run = move |schedule: &Schedule, shared: &Shared| controller.run(schedule, shared);
        let (thread, grant) = Self::start("controller", &settings.realtime, run)?;
        Ok((thread, rows, grant))
    }

    fn start(
        name: &'static str,
        wishes: &RealtimeSettings,
        run: impl FnOnce(&Schedule, &Shared) -> Publisher + Send + 'static,
    ) -> Result<(Self, RealtimeGrant), ExperimentError> {
        let (begins, to_begin): (_, Receiver<(Schedule, Shared)>) = channel();
        let (grants, granted) = channel();
        let wishes = wishes.clone();
        let thread = thread::Builder::new().name(name.into()).spawn(move || {
            let _ = grants.send(enter_realtime(&wishes));
            let (schedule, shared) = to_begin.recv().ok()?;
            Some(run(&schedule, &shared))
        });
        let thread = thread.map_err(|source| ExperimentError::Thread { name, source })?;
        let grant = granted
            .recv()
            .map_err(|_| ExperimentError::ThreadEnded { name })?;
        Ok((Self { name, begins, thread }, grant))
    }

    /// Tells it when to begin.
    ///
    /// # Errors
    /// If it has ended.
    pub fn begin(&self, schedule: Schedule, shared: &Shared) -> Result<(), ExperimentError> {
        let ended = ExperimentError::ThreadEnded { name: self.name };
        self.begins.send((schedule, shared.clone())).map_err(|_| ended)
    }

    /// Waits until it has ended. One that was never begun ends at once.
    ///
    /// # Errors
    /// If it ended in a panic.
    pub fn join(self) -> Result<(), ExperimentError> {
        self.end().map(drop)
    }

    fn end(self) -> Result<Option<Publisher>, ExperimentError> {
        drop(self.begins);
        self.thread
            .join()
            .map_err(|_| ExperimentError::ThreadEnded { name: self.name })
    }
}

fn queue_capacity(settings: &Settings) -> usize {
    ((settings.rate.hz() * QUEUE_SECONDS) as usize).max(1024)
}
