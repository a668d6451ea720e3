//! The two real-time loops: one step of the plant, one step of the controller. The main types are [`PlantLoop`] and
//! [`ControllerLoop`].
//!
//! Within a step nothing is allocated, written to a file, locked or logged: what a step has to say goes into a queue of
//! fixed length that the recorder empties.

use std::sync::{
    Arc,
    atomic::{AtomicBool, AtomicU64, Ordering},
};

use rtrb::Producer;

use super::{
    message::{CommandMessage, StateMessage},
    schedule::{Schedule, Tick},
    slot::{CommandReader, StateReader},
};
use crate::{
    controller::Controller,
    plant::{AxisState, PlantModel},
    realtime::monotonic_ns,
    record::control_log::ControlRow,
    reference::Reference,
    ros::{Publisher, float64_multi_array::Encoder},
};

/// What both loops share with the rest of the process.
#[derive(Debug, Clone)]
pub struct Shared {
    /// When the experiment's clock shows zero, on the monotonic clock: the first control step.
    pub zero_ns: i64,
    /// Set when the loops are to end.
    pub stop: Arc<AtomicBool>,
    /// Rows and ticks for which the queues had no room.
    pub log_dropped: Arc<AtomicU64>,
}

/// The plant, on `sta2`.
pub struct PlantLoop {
    /// Its physics.
    pub model: PlantModel,
    /// Where its state goes.
    pub publisher: Publisher,
    /// Where commands come from.
    pub commands: CommandReader,
    /// When it ticks.
    pub ticks: Producer<Tick>,
}

impl PlantLoop {
    /// Does all steps. Publishes the state first, then applies the newest command until the next step. Gives the
    /// publisher back: dropping it closes its connections, which is for when the other loop has ended, too.
    pub fn run(mut self, schedule: &Schedule, shared: &Shared) -> Publisher {
        let mut encoder = Encoder::new(StateMessage::FIELDS);
        let mut axes = [AxisState::default(); 2];
        schedule.follow(&shared.stop, |tick| {
            let message = StateMessage {
                seq: tick.step + 1,
                stamp_ns: tick.began_ns - shared.zero_ns,
                axes,
            };
            self.publisher.publish(encoder.encode(&message.to_values()));
            let [x, y] = axes;
            let [x_v, y_v] = self.commands.read().map_or([0.0; 2], |command| command.voltage_v);
            axes = [self.model.step(&x, x_v), self.model.step(&y, y_v)];
            if self.ticks.push(tick).is_err() {
                shared.log_dropped.fetch_add(1, Ordering::Relaxed);
            }
        });
        self.publisher
    }
}

/// The controller of both axes, on `sta1`.
pub struct ControllerLoop {
    /// The path to follow.
    pub reference: Reference,
    /// Its gains.
    pub controller: Controller,
    /// Where its commands go.
    pub publisher: Publisher,
    /// Where states come from.
    pub states: StateReader,
    /// Its log.
    pub rows: Producer<ControlRow>,
}

impl ControllerLoop {
    /// Does all steps. Gives the publisher back, as the plant does.
    pub fn run(mut self, schedule: &Schedule, shared: &Shared) -> Publisher {
        let mut encoder = Encoder::new(CommandMessage::FIELDS);
        schedule.follow(&shared.stop, |tick| {
            let reference_m = self.reference.at_step(tick.step);
            let (state, received_ns) = match self.states.read() {
                Some((state, received_ns)) => (state, received_ns - shared.zero_ns),
                None => (StateMessage::default(), 0),
            };
            let [x, y] = state.axes;
            let command = CommandMessage {
                seq: tick.step + 1,
                stamp_ns: tick.began_ns - shared.zero_ns,
                voltage_v: [
                    self.controller.voltage_v(reference_m[0], &x),
                    self.controller.voltage_v(reference_m[1], &y),
                ],
            };
            self.publisher.publish(encoder.encode(&command.to_values()));
            let row = ControlRow {
                step: tick.step,
                scheduled_ns: tick.due_ns - shared.zero_ns,
                actual_ns: command.stamp_ns,
                done_ns: monotonic_ns() - shared.zero_ns,
                state_seq: state.seq,
                state_stamp_ns: state.stamp_ns,
                state_received_ns: received_ns,
                ..ControlRow::of_axes(reference_m, state.axes, command.voltage_v)
            };
            if self.rows.push(row).is_err() {
                shared.log_dropped.fetch_add(1, Ordering::Relaxed);
            }
        });
        self.publisher
    }
}
