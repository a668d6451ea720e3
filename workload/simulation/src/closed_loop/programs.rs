//! Plant and controller as programs on virtual hosts: the steps of `workload/src/experiment/loops.rs` without their threads. The
//! main types are [`PlantProgram`] and [`ControllerProgram`].

use std::collections::VecDeque;

use record::{
    control_log::ControlRow,
    plant_log::PlantRow,
    settings::{Messages, PlantSends},
};

use super::ticks::Ticks;
use crate::{
    controller::Controller,
    message::{CommandEncoder, CommandMessage, StateEncoder, StateMessage},
    plant::Plant,
    reference::Reference,
    virtual_time::{
        exchange::Delivery,
        programs::{Program, Publication},
    },
};

/// The length before a message on a connection.
const LENGTH_BYTES: u64 = 4;

/// A message as its receiver reads it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Message {
    State(StateMessage),
    Command(CommandMessage),
    /// It is passed over: it has a value that is no number.
    Unreadable,
}

fn publication(
    encoded: &[u8],
    message: Option<Message>,
    written: &mut Option<Vec<u8>>,
) -> Publication<Message> {
    if let Some(written) = written {
        written.extend(u32::try_from(encoded.len()).unwrap_or(u32::MAX).to_le_bytes());
        written.extend(encoded);
    }
    Publication {
        message: message.unwrap_or(Message::Unreadable),
        bytes: LENGTH_BYTES + encoded.len() as u64,
    }
}

#[derive(Debug)]
pub(super) struct PlantProgram {
    pub ticks: Ticks,
    pub plant: Plant,
    pub sends: PlantSends,
    pub messages: Messages,
    pub encoder: StateEncoder,
    /// When the experiment's clock shows zero.
    pub zero_ns: i64,
    pub command: CommandMessage,
    /// What its newest tick says of it.
    pub newest: StateMessage,
    /// What it did and nobody has taken yet, if anybody is to.
    pub rows: Option<VecDeque<PlantRow>>,
    /// What it wrote on its connection and nobody has taken yet, if anybody is to.
    pub written: Option<Vec<u8>>,
}

impl PlantProgram {
    fn publish(&mut self, state: &StateMessage, published: &mut Vec<Publication<Message>>) {
        let encoded = self.encoder.encode(state);
        let received = StateMessage::decode(self.messages, encoded).map(Message::State);
        published.push(publication(encoded, received, &mut self.written));
    }
}

impl Program<Message> for PlantProgram {
    fn next_ns(&self) -> Option<i64> {
        Some(self.ticks.next_ns())
    }

    fn tick(&mut self, _: i64, published: &mut Vec<Publication<Message>>) {
        let tick = self.ticks.take();
        let state = StateMessage {
            seq: tick.step + 1,
            stamp_ns: tick.began_ns - self.zero_ns,
            axes: self.plant.tick(self.command.voltage_v),
        };
        self.newest = state;
        if let Some(rows) = &mut self.rows {
            rows.push_back(state.row(&tick, self.zero_ns, &self.command));
        }
        if self.sends == PlantSends::OnTick {
            self.publish(&state, published);
        }
    }

    fn read(&mut self, delivery: Delivery<Message>, published: &mut Vec<Publication<Message>>) {
        let Message::Command(command) = delivery.message else {
            return;
        };
        self.command = command;
        if self.sends == PlantSends::OnCommand {
            let answer = StateMessage {
                stamp_ns: command.stamp_ns,
                ..self.newest
            };
            self.publish(&answer, published);
        }
    }
}

#[derive(Debug)]
pub(super) struct ControllerProgram {
    pub ticks: Ticks,
    pub reference: Reference,
    pub controller: Controller,
    pub messages: Messages,
    pub encoder: CommandEncoder,
    /// When the experiment's clock shows zero.
    pub zero_ns: i64,
    /// The newest state and when it was read, on the experiment's clock; none until one has come.
    pub received: Option<(StateMessage, i64)>,
    pub states_received: u64,
    /// What it did and nobody has taken yet.
    pub rows: VecDeque<ControlRow>,
    /// What it wrote on its connection and nobody has taken yet, if anybody is to.
    pub written: Option<Vec<u8>>,
}

impl Program<Message> for ControllerProgram {
    fn next_ns(&self) -> Option<i64> {
        Some(self.ticks.next_ns())
    }

    fn tick(&mut self, _: i64, published: &mut Vec<Publication<Message>>) {
        let tick = self.ticks.take();
        let began_ns = tick.began_ns - self.zero_ns;
        let first = self.controller.sends_first();
        let reference_m = self.reference.at(tick.step, began_ns);
        let newest = self.received.map(|(state, _)| state.axes);
        let action = self.controller.step(reference_m, newest);
        let encoded = self.encoder.encode(&CommandMessage {
            seq: tick.step + 1,
            stamp_ns: began_ns,
            voltage_v: first.unwrap_or(action.computed_v),
        });
        let received = CommandMessage::decode(self.messages, encoded).map(Message::Command);
        published.push(publication(encoded, received, &mut self.written));
        let (state, received_ns) = self.received.unwrap_or_default();
        self.rows.push_back(ControlRow {
            step: tick.step,
            scheduled_ns: tick.due_ns - self.zero_ns,
            actual_ns: began_ns,
            done_ns: began_ns,
            state_seq: state.seq,
            state_stamp_ns: state.stamp_ns,
            state_received_ns: received_ns,
            ..action.row(reference_m)
        });
    }

    fn read(&mut self, delivery: Delivery<Message>, _: &mut Vec<Publication<Message>>) {
        let Message::State(mut state) = delivery.message else {
            return;
        };
        self.states_received += 1;
        if self.messages == Messages::Text {
            state.seq = self.states_received;
        }
        self.received = Some((state, delivery.at_ns - self.zero_ns));
    }
}
