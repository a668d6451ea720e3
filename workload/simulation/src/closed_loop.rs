//! The closed loop in virtual time: the experiment's plant, controller, schedules and messages on the network of
//! [`crate::virtual_time`], and on a platform of which every property is given ([`Platform`]). The main type is
//! [`Simulation`], an iterator over control steps.
//!
//! # Order of things
//!
//! The plant ticks at `k·h` and the controller at `k·h + phase`; stalls let some ticks begin late. What each does at a
//! tick, when it publishes and what becomes of late ticks is as the settings have it, by the code of the real loops as far
//! as that has no thread in it. At one instant the network comes first, so that a message that arrives exactly at a tick is
//! in time for it, then the plant, then the controller. Messages do not overtake each other, as on a TCP connection.
//!
//! # What the error is made of
//!
//! In the dynamics `robust` and at the default settings the loop is linear except for its first second, and the *received* error `r(t) − x(t−d)`
//! is nearly free of the delay: at these low frequencies `a ≈ 0`, so that `Kp·e = −Kd·ẋ` and mean |e_x| is `Kd/|Kp|`
//! times the mean speed, 0.1204 m. The *true* error `r(t) − x(t)` lacks the way that the ball went during `d`:
//! 0.1179 m with 20 ms. This is the known value of 0.118 of an independent simulation, and it holds for each reading of
//! the rates (measured or differenced) and of the angle's limit (no limit is met).
//!
//! With 40 ms each way the loop is past its stability limit (about 70 ms from state to command applied) and goes into
//! a limit cycle between the plate's stops, so that the error depends on what the plate does there. The independent
//! simulation's 0.144 needs a limit on the motor's voltage and on where exactly the command arrives, neither of which
//! the paper gives (24 V and one step more of delay come to 0.1434); with the stops of [`crate::plant`] and no voltage limit it is
//! 0.117 true and 0.122 received.
//!
//! # Why the controller ticks half a step after the plant
//!
//! With 20 ms each way and h = 20 ms, a phase of zero puts every arrival on the edge of a tick: an exact 20 ms makes a
//! loop delay of two steps, one microsecond more makes four, which is unstable. Real delays are always a little more
//! than nominal. Any phase within the step gives three steps (60 ms, stable), and half a step leaves the most room on both
//! ways: 10 ms, nine times the standard deviation of the jitter. The received error is 0.1204 m as before.

mod programs;
mod ticks;

use std::{collections::VecDeque, time::Duration};

use oorandom::Rand64;
use record::{
    control_log::ControlRow,
    plant_log::PlantRow,
    platform_model::{StallModel, TickLateness},
    settings::Settings,
    virtual_host::VirtualHost,
    window::LinkRecord,
};

use self::{
    programs::{ControllerProgram, Message, PlantProgram},
    ticks::Ticks,
};
use crate::{
    controller::Controller,
    message::{CommandEncoder, CommandMessage, StateEncoder, StateMessage},
    plant::Plant,
    reference::Reference,
    schedule::Schedule,
    stalls::Stalls,
    virtual_time::{
        exchange::{Conditions, Exchange, Heard, Peer},
        path::NOTHING_PASSED,
        programs::run,
    },
};

/// What is under the loop.
#[derive(Debug, Clone, PartialEq)]
pub struct Platform {
    /// What messages go through.
    pub network: Conditions,
    /// How late the controller's ticks begin.
    pub controller: TickLateness,
    /// How late the plant's ticks begin.
    pub plant: TickLateness,
    /// When all of it stands still.
    pub stalls: StallModel,
}

impl Platform {
    /// The links and TCP of the settings, on hosts that take no time.
    #[must_use]
    pub fn ideal(settings: &Settings) -> Self {
        Self::on(Conditions {
            nagle: !settings.ros.tcp_nodelay,
            ..Conditions::of(&settings.network)
        })
    }

    /// The links and TCP of the settings, on the platform that they model, if they do.
    #[must_use]
    pub fn of(settings: &Settings) -> Self {
        let ideal = Self::ideal(settings);
        let Some(simulation) = &settings.simulation else {
            return ideal;
        };
        let model = &simulation.platform;
        Self {
            network: Conditions {
                stack_ns: nanoseconds(model.stack.duration()),
                reading: model.reading.clone(),
                ..ideal.network
            },
            controller: model.controller.clone(),
            plant: model.plant.clone(),
            stalls: model.stalls.clone(),
        }
    }

    /// Every message takes that long, each way: nothing is left to chance.
    #[must_use]
    pub fn fixed(one_way: Duration) -> Self {
        Self::on(Conditions::fixed(one_way))
    }

    fn on(network: Conditions) -> Self {
        Self {
            network,
            controller: TickLateness::default(),
            plant: TickLateness::default(),
            stalls: StallModel::default(),
        }
    }
}

/// One control step and what only a simulation knows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SimulatedStep {
    /// As the controller would log it. A step takes no time.
    pub row: ControlRow,
    /// Where the ball was from the plant's newest tick on, `[x, y]`, in metres.
    pub true_position_m: [f64; 2],
    /// Whether the plate was at a stop, on either axis.
    pub at_angle_limit: bool,
}

/// The closed loop, step by step, for ever. Its values are a function of settings, platform and seed alone.
#[derive(Debug)]
pub struct Simulation {
    exchange: Exchange<Message>,
    plant: PlantProgram,
    controller: ControllerProgram,
}

impl Simulation {
    /// The loop at rest in the middle of the plate, before its first step.
    #[must_use]
    pub fn new(settings: &Settings, platform: &Platform, seed: u64) -> Self {
        let step = settings.rate.step();
        let zero_ns = nanoseconds(settings.control.phase.duration());
        let messages = settings.ros.messages;
        let mut seeds = Rand64::new(u128::from(seed));
        let network_seed = seeds.rand_u64();
        let stalls = Stalls::new(&platform.stalls, !network_seed);
        let mut ticks = |first_ns, lateness| {
            let schedule = Schedule {
                first_ns,
                step_ns: nanoseconds(step),
                steps: u64::MAX,
            };
            let chance = Rand64::new(u128::from(seeds.rand_u64()));
            Ticks::new(
                schedule,
                settings.loops.late_ticks,
                lateness,
                chance,
                stalls.clone(),
            )
        };
        Self {
            exchange: Exchange::on(&platform.network, network_seed, &stalls),
            plant: PlantProgram {
                ticks: ticks(0, &platform.plant),
                plant: Plant::new(&settings.plant, step),
                sends: settings.plant.sends,
                messages,
                encoder: StateEncoder::new(messages),
                zero_ns,
                command: CommandMessage::default(),
                newest: StateMessage::default(),
                rows: None,
                written: None,
            },
            controller: ControllerProgram {
                ticks: ticks(zero_ns, &platform.controller),
                reference: Reference::new(settings),
                controller: Controller::new(settings),
                messages,
                encoder: CommandEncoder::new(messages),
                zero_ns,
                received: None,
                states_received: 0,
                rows: VecDeque::new(),
                written: None,
            },
        }
    }
}

impl Simulation {
    /// Keeps what the plant does, too, for [`Self::take_plant_row`].
    #[must_use]
    pub fn with_plant_rows(mut self) -> Self {
        self.plant.rows = Some(VecDeque::new());
        self
    }

    /// The next tick of the plant of those that were done by the newest control step.
    pub fn take_plant_row(&mut self) -> Option<PlantRow> {
        self.plant.rows.as_mut()?.pop_front()
    }

    /// Keeps each packet that leaves a host or comes to one, and each byte that is written, for [`Self::take_heard`] and
    /// [`Self::take_written`].
    #[must_use]
    pub fn with_captures(mut self) -> Self {
        self.exchange.listen();
        self.plant.written = Some(Vec::new());
        self.controller.written = Some(Vec::new());
        self
    }

    /// The next packet of those that were under way by the newest control step, at a time after the plant's first tick.
    pub fn take_heard(&mut self) -> Option<Heard> {
        self.exchange.take_heard()
    }

    /// The bytes that a peer has written on its connection since this was asked last.
    pub fn take_written(&mut self, by: Peer) -> Vec<u8> {
        let written = match by {
            Peer::Controller => &mut self.controller.written,
            Peer::Plant => &mut self.plant.written,
        };
        written.as_mut().map(std::mem::take).unwrap_or_default()
    }

    /// What went through the links so far, in [`VirtualHost::OF_THE_BALL`]'s order. The master's carries nothing.
    #[must_use]
    pub fn links(&self) -> [LinkRecord; 3] {
        let [commands, states] = self.exchange.passes();
        let [h1, sta1, sta2] = VirtualHost::OF_THE_BALL;
        let link = |host, up, down| LinkRecord { host, up, down };
        [
            link(h1, NOTHING_PASSED, NOTHING_PASSED),
            link(sta1, commands.up, states.down),
            link(sta2, states.up, commands.down),
        ]
    }
}

impl Iterator for Simulation {
    type Item = SimulatedStep;

    fn next(&mut self) -> Option<SimulatedStep> {
        while self.controller.rows.is_empty() {
            let until_ns = self.controller.ticks.next_ns();
            run(
                &mut self.exchange,
                &mut self.controller,
                &mut self.plant,
                until_ns,
            );
        }
        let row = self.controller.rows.pop_front()?;
        let axes = self.plant.newest.axes;
        Some(SimulatedStep {
            row,
            true_position_m: axes.map(|axis| axis.position_m),
            at_angle_limit: self.plant.plant.is_at_angle_limit(&axes),
        })
    }
}

fn nanoseconds(duration: Duration) -> i64 {
    i64::try_from(duration.as_nanos()).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests;
