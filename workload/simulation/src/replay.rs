//! A recorded run once more: its times are put through the loop, and what comes of them is held against what was recorded. The error
//! of a window is a function of when each tick began and which message it used; so a window that was recorded rightly replays.
//! The main type is [`Replay`].
//!
//! Taken from the logs: when ticks began, which state a control step used, and which command was in force at a tick of the plant.
//! Computed: the path, the controller's voltages, the messages' digits, the plant. A step must come after what it used, so
//! that rows of both logs are given in the order in which ticks began.
//!
//! Where the plant answers commands, no log says which of its ticks an answer was about: it is the newest one that began before the
//! command was in force, or, if the answer was written while that tick began, the one before it: of the two the one that is more like
//! what was recorded.

use std::collections::VecDeque;

use record::{
    control_log::ControlRow,
    plant_log::PlantRow,
    settings::{Messages, PlantSends, Settings},
};

use crate::{
    controller::Controller,
    message::{CommandEncoder, CommandMessage, StateEncoder, StateMessage},
    plant::{AxisState, Plant},
    reference::Reference,
};

/// Messages that may still be used: those of the last minutes, at any rate that the loop has.
const KEPT: usize = 1 << 16;

/// A run under replay, from its first tick on.
#[derive(Debug)]
pub struct Replay {
    messages: Messages,
    plant_sends: PlantSends,
    reference: Reference,
    controller: Controller,
    plant: Plant,
    states: StateEncoder,
    commands: CommandEncoder,
    /// Commands as the plant read them, in order of their stamps.
    sent: VecDeque<CommandMessage>,
    /// Ticks of the plant, in order.
    ticks: VecDeque<Tick>,
}

/// A tick of the plant.
#[derive(Debug, Clone, Copy)]
struct Tick {
    /// Counts from 1.
    number: u64,
    /// As the controller read it.
    stamp_ns: i64,
    /// The stamp of the command that was in force, as the plant read it; none before the first.
    command_stamp_ns: Option<i64>,
    /// As the controller read them.
    axes: [AxisState; 2],
}

/// Why a row cannot be replayed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum ReplayError {
    /// A control step used a state that no tick of the plant had.
    #[error("control step {step} used a state that no tick of the plant had")]
    NoState {
        /// The step.
        step: u64,
    },
    /// A tick of the plant used a command that no control step had sent.
    #[error("tick {step} of the plant used a command that no control step had sent")]
    NoCommand {
        /// The tick.
        step: u64,
    },
}

impl Replay {
    /// The run of these settings, before its first tick.
    #[must_use]
    pub fn new(settings: &Settings) -> Self {
        let messages = settings.ros.messages;
        Self {
            messages,
            plant_sends: settings.plant.sends,
            reference: Reference::new(settings),
            controller: Controller::new(settings),
            plant: Plant::new(&settings.plant, settings.rate.step()),
            states: StateEncoder::new(messages),
            commands: CommandEncoder::new(messages),
            sent: VecDeque::new(),
            ticks: VecDeque::new(),
        }
    }

    /// A tick of the plant as it was recorded; as it is replayed.
    ///
    /// # Errors
    /// When its command is not there. The row before is then the last that was replayed.
    pub fn tick(&mut self, recorded: &PlantRow) -> Result<PlantRow, ReplayError> {
        let is_first =
            recorded.command_stamp_ns == 0 && recorded.command_x_v == 0.0 && recorded.command_y_v == 0.0;
        let command = self.command_of(recorded);
        let (voltage_v, command_stamp_ns) = match command {
            Some(command) => (command.voltage_v, Some(command.stamp_ns)),
            // Before the first command the plant has none.
            None if is_first => ([0.0; 2], None),
            None => return Err(ReplayError::NoCommand { step: recorded.step }),
        };
        let axes = self.plant.tick(voltage_v);
        let state = StateMessage {
            seq: recorded.step.wrapping_add(1),
            stamp_ns: recorded.actual_ns,
            axes,
        };
        let received = StateMessage::decode(self.messages, self.states.encode(&state)).unwrap_or(state);
        keep(
            &mut self.ticks,
            Tick {
                number: state.seq,
                stamp_ns: received.stamp_ns,
                command_stamp_ns,
                axes: received.axes,
            },
        );
        let [x, y] = axes;
        Ok(PlantRow {
            x_m: x.position_m,
            y_m: y.position_m,
            angle_x_rad: x.angle_rad,
            angle_y_rad: y.angle_rad,
            command_x_v: voltage_v[0],
            command_y_v: voltage_v[1],
            ..*recorded
        })
    }

    /// A control step as it was recorded; as it is replayed.
    ///
    /// # Errors
    /// When its state is not there. The row before is then the last that was replayed.
    pub fn step(&mut self, recorded: &ControlRow) -> Result<ControlRow, ReplayError> {
        let newest = match recorded.state_seq {
            0 => None,
            _ => Some(
                self.used(recorded)
                    .ok_or(ReplayError::NoState { step: recorded.step })?,
            ),
        };
        let first = self.controller.sends_first();
        let reference_m = self.reference.at(recorded.step, recorded.actual_ns);
        let action = self.controller.step(reference_m, newest);
        let command = CommandMessage {
            seq: recorded.step.wrapping_add(1),
            stamp_ns: recorded.actual_ns,
            voltage_v: first.unwrap_or(action.computed_v),
        };
        let read = CommandMessage::decode(self.messages, self.commands.encode(&command));
        if let Some(read) = read {
            keep(&mut self.sent, read);
        }
        Ok(ControlRow {
            step: recorded.step,
            scheduled_ns: recorded.scheduled_ns,
            actual_ns: recorded.actual_ns,
            done_ns: recorded.done_ns,
            state_seq: recorded.state_seq,
            state_stamp_ns: recorded.state_stamp_ns,
            state_received_ns: recorded.state_received_ns,
            ..action.row(reference_m)
        })
    }

    /// The command that was in force at a tick of the plant. Steps that are caught up begin at one time: of theirs it is the one that is
    /// most like what was recorded.
    fn command_of(&self, recorded: &PlantRow) -> Option<CommandMessage> {
        let from_newest = self.sent.iter().rev();
        let of_the_stamp = from_newest
            .skip_while(|sent| sent.stamp_ns > recorded.command_stamp_ns)
            .take_while(|sent| sent.stamp_ns == recorded.command_stamp_ns);
        let distance = |sent: &&CommandMessage| {
            let [x_v, y_v] = sent.voltage_v;
            (x_v - recorded.command_x_v).abs() + (y_v - recorded.command_y_v).abs()
        };
        of_the_stamp
            .min_by(|a, b| distance(a).total_cmp(&distance(b)))
            .copied()
    }

    /// The state that a control step used.
    fn used(&self, recorded: &ControlRow) -> Option<[AxisState; 2]> {
        let stamp_ns = recorded.state_stamp_ns;
        let mut ticks = self.ticks.iter().rev();
        match self.plant_sends {
            PlantSends::OnTick => {
                // A text does not carry the tick's number.
                let is_it = |tick: &&Tick| match self.messages {
                    Messages::Text => tick.stamp_ns == stamp_ns,
                    Messages::Positions | Messages::Rates => tick.number == recorded.state_seq,
                };
                ticks.find(is_it).map(|tick| tick.axes)
            }
            PlantSends::OnCommand => {
                let is_after =
                    |tick: &&Tick| tick.command_stamp_ns.is_some_and(|of_tick| of_tick >= stamp_ns);
                let axes = ticks.skip_while(is_after).map(|tick| tick.axes);
                // A command that came before the first tick was answered with the plant at rest.
                let axes = axes.chain([<[AxisState; 2]>::default()]).take(2);
                axes.min_by(|a, b| distance(a, recorded).total_cmp(&distance(b, recorded)))
            }
        }
    }
}

/// How unlike the state of a control step a state of the plant is.
fn distance([x, y]: &[AxisState; 2], recorded: &ControlRow) -> f64 {
    let of_positions = (x.position_m - recorded.x_m).abs() + (y.position_m - recorded.y_m).abs();
    let of_angles = (x.angle_rad - recorded.angle_x_rad).abs() + (y.angle_rad - recorded.angle_y_rad).abs();
    of_positions + of_angles
}

fn keep<T>(all: &mut VecDeque<T>, newest: T) {
    if all.len() == KEPT {
        all.pop_front();
    }
    all.push_back(newest);
}

#[cfg(test)]
mod tests {
    use record::settings::Dynamics;
    use rstest::rstest;

    use super::*;
    use crate::closed_loop::{Platform, Simulation};

    enum Row {
        Plant(PlantRow),
        Control(ControlRow),
    }

    impl Row {
        const fn key(&self) -> (i64, bool) {
            match self {
                Self::Plant(row) => (row.actual_ns, false),
                Self::Control(row) => (row.actual_ns, true),
            }
        }
    }

    /// The logs of so many control steps, in the order in which ticks began.
    fn logs(settings: &Settings, platform: &Platform, steps: usize) -> Vec<Row> {
        let mut simulation = Simulation::new(settings, platform, 3).with_plant_rows();
        let mut rows = Vec::new();
        for _ in 0..steps {
            rows.extend(simulation.next().map(|step| Row::Control(step.row)));
            while let Some(row) = simulation.take_plant_row() {
                rows.push(Row::Plant(row));
            }
        }
        rows.sort_by_key(Row::key);
        rows
    }

    fn busy(settings: &Settings) -> Platform {
        let mut settings = settings.clone();
        let simulation = r#"{"platform": {
            "controller": {"late": [[0, "1us"], [0.98, "2ms"], [1, "70ms"]], "persistence": "50%"},
            "plant": {"late": [[0, "1us"], [0.98, "2ms"], [1, "70ms"]]},
            "stalls": {"per_hour": 900, "length": [[0, "5ms"], [1, "150ms"]]},
            "stack": "300us", "reading": [[0, "10us"], [1, "3ms"]]
        }}"#;
        settings.simulation = Some(serde_json::from_str(simulation).unwrap());
        Platform::of(&settings)
    }

    #[rstest]
    #[case::author(Dynamics::Author)]
    #[case::robust(Dynamics::Robust)]
    fn a_run_replays_to_the_last_bit(#[case] dynamics: Dynamics, #[values(false, true)] is_busy: bool) {
        let settings = Settings::of(dynamics);
        let platform = match is_busy {
            true => busy(&settings),
            false => Platform::ideal(&settings),
        };
        let mut replay = Replay::new(&settings);
        for row in logs(&settings, &platform, 20_000) {
            match row {
                Row::Plant(row) => assert_eq!(replay.tick(&row).unwrap(), row),
                Row::Control(row) => assert_eq!(replay.step(&row).unwrap(), row),
            }
        }
    }

    /// A state that was used and is said to have been another leads elsewhere from then on.
    #[test]
    fn a_row_that_is_not_as_it_was_does_not_replay() {
        let settings = Settings::of(Dynamics::Robust);
        let mut replay = Replay::new(&settings);
        let mut parted = None;
        for row in logs(&settings, &Platform::ideal(&settings), 1000) {
            match row {
                Row::Plant(row) => {
                    let _ = replay.tick(&row).unwrap();
                }
                Row::Control(mut row) => {
                    if row.step == 500 {
                        row.state_seq -= 1;
                    }
                    let replayed = replay.step(&row).unwrap();
                    if (replayed.x_m - row.x_m).abs() > 1e-9 {
                        parted.get_or_insert(row.step);
                    }
                }
            }
        }
        assert_eq!(parted, Some(500));
    }

    #[test]
    fn rows_whose_messages_were_never_sent_are_told() {
        let settings = Settings::of(Dynamics::Robust);
        let mut replay = Replay::new(&settings);
        let row = ControlRow {
            step: 7,
            state_seq: 3,
            state_stamp_ns: 5,
            ..ControlRow::default()
        };
        assert_eq!(replay.step(&row), Err(ReplayError::NoState { step: 7 }));
        let row = PlantRow {
            step: 9,
            command_stamp_ns: 5,
            ..PlantRow::default()
        };
        assert_eq!(replay.tick(&row), Err(ReplayError::NoCommand { step: 9 }));
    }
}
