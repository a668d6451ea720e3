//! The two loops: one step of the plant, one step of the controller. The main types are [`PlantLoop`] and
//! [`ControllerLoop`].
//!
//! Within a step nothing is allocated, written to a file, locked or logged: what a step has to say goes into a queue of
//! fixed length that the recorder empties.

use std::sync::{
    Arc,
    atomic::{AtomicBool, AtomicU64, Ordering},
};

use record::{control_log::ControlRow, plant_log::PlantRow, settings::Messages};
use rtrb::Producer;
use simulation::{
    controller::Controller,
    message::{CommandEncoder, CommandMessage, StateEncoder, StateMessage},
    plant::Plant,
    reference::Reference,
    schedule::Schedule,
};

use super::{
    latest_value::{CommandReader, CommandWriter, StateReader, StateWriter},
    schedule::{Pace, follow},
};
use crate::{realtime::monotonic_ns, ros::Publisher};

/// What both loops share with the rest of the process.
#[derive(Debug, Clone)]
pub struct Shared {
    /// When the experiment's clock shows zero, on the monotonic clock: the first control step.
    pub zero_ns: i64,
    /// Set when the loops are to end.
    pub stop: Arc<AtomicBool>,
    /// Rows for which the queues had no room.
    pub log_dropped: Arc<AtomicU64>,
}

/// The plant, on `sta2`.
pub struct PlantLoop {
    /// Its physics.
    pub plant: Plant,
    /// Where its state goes.
    pub output: PlantOutput,
    /// Where commands come from.
    pub commands: CommandReader,
    /// Its log.
    pub rows: Producer<PlantRow>,
}

/// Where the plant's state goes.
pub enum PlantOutput {
    /// To its topic, at each tick.
    Topic {
        /// The topic.
        publisher: Publisher,
        /// In its form.
        encoder: StateEncoder,
    },
    /// To the thread that answers commands ([`answer`]).
    Answers(StateWriter),
}

impl PlantLoop {
    /// Does all steps. Gives the publisher back, if it has it: dropping it closes its connections, which is for when the
    /// other loop has ended, too.
    pub fn run(mut self, schedule: &Schedule, pace: Pace, shared: &Shared) -> Option<Publisher> {
        follow(schedule, pace, &shared.stop, |tick| {
            let command = self.commands.read().unwrap_or_default();
            let axes = self.plant.tick(command.voltage_v);
            let state = StateMessage {
                seq: tick.step + 1,
                stamp_ns: tick.began_ns - shared.zero_ns,
                axes,
            };
            match &mut self.output {
                PlantOutput::Topic { publisher, encoder } => {
                    publisher.publish(encoder.encode(&state));
                }
                PlantOutput::Answers(newest) => newest.keep(&state, tick.began_ns),
            }
            let row = state.row(&tick, shared.zero_ns, &command);
            if self.rows.push(row).is_err() {
                shared.log_dropped.fetch_add(1, Ordering::Relaxed);
            }
        });
        match self.output {
            PlantOutput::Topic { publisher, .. } => Some(publisher),
            PlantOutput::Answers(_) => None,
        }
    }
}

/// Keeps each command, and answers it with the state of the plant's newest tick, stamped as the command is.
pub fn answer(
    messages: Messages,
    mut commands: CommandWriter,
    newest: StateReader,
    mut publisher: Publisher,
) -> impl FnMut(&[u8]) + Send + 'static {
    let mut encoder = StateEncoder::new(messages);
    move |message: &[u8]| {
        if let Some(command) = CommandMessage::decode(messages, message) {
            commands.keep(&command);
            let state = newest.read().map(|(state, _)| state).unwrap_or_default();
            publisher.publish(encoder.encode(&StateMessage {
                stamp_ns: command.stamp_ns,
                ..state
            }));
        }
    }
}

/// The controller of both axes, on `sta1`.
pub struct ControllerLoop {
    /// The path to follow.
    pub reference: Reference,
    /// Its rules and gains.
    pub controller: Controller,
    /// Where its commands go.
    pub publisher: Publisher,
    /// In which form.
    pub messages: Messages,
    /// Where states come from.
    pub states: StateReader,
    /// Its log.
    pub rows: Producer<ControlRow>,
}

impl ControllerLoop {
    /// Does all steps. Gives the publisher back, as the plant does.
    pub fn run(mut self, schedule: &Schedule, pace: Pace, shared: &Shared) -> Option<Publisher> {
        let mut encoder = CommandEncoder::new(self.messages);
        follow(schedule, pace, &shared.stop, |tick| {
            let began_ns = tick.began_ns - shared.zero_ns;
            let mut send = |voltage_v| {
                let command = CommandMessage {
                    seq: tick.step + 1,
                    stamp_ns: began_ns,
                    voltage_v,
                };
                self.publisher.publish(encoder.encode(&command));
            };
            let first = self.controller.sends_first();
            if let Some(voltage_v) = first {
                send(voltage_v);
            }
            let newest = self.states.read();
            let reference_m = self.reference.at(tick.step, began_ns);
            let action = self
                .controller
                .step(reference_m, newest.map(|(state, _)| state.axes));
            if first.is_none() {
                send(action.computed_v);
            }
            let done_ns = monotonic_ns() - shared.zero_ns;
            let (state, received_ns) = newest.map_or_else(Default::default, |(state, received_ns)| {
                (state, received_ns - shared.zero_ns)
            });
            let row = ControlRow {
                step: tick.step,
                scheduled_ns: tick.due_ns - shared.zero_ns,
                actual_ns: began_ns,
                done_ns,
                state_seq: state.seq,
                state_stamp_ns: state.stamp_ns,
                state_received_ns: received_ns,
                ..action.row(reference_m)
            };
            if self.rows.push(row).is_err() {
                shared.log_dropped.fetch_add(1, Ordering::Relaxed);
            }
        });
        Some(self.publisher)
    }
}
