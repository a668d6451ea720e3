//! ROS master, plant and controller on their virtual hosts, as threads of this process or as processes of their own
//! ([`Processes`]): brought up, connected, their loops begun and ended. The main types are [`Nodes`] and [`Loops`].

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64},
    },
    thread,
    time::Instant,
};

use nix::unistd::Pid;
use record::{
    control_log::ControlRow,
    plant_log::PlantRow,
    platform::RealtimeGrant,
    settings::{Processes, RosMaster, Settings},
    virtual_host::VirtualHost,
};
use rtrb::{Consumer, RingBuffer};
use simulation::schedule::Schedule;

use super::{
    connection::{ControllerEnds, PlantEnds, Side, TIMEOUT, Tenancy},
    loop_threads::{LoopThread, queue_capacity},
    loops::Shared,
    node_messages::{MASTER, Program},
    node_process::{Given, NodeProcess, Rows},
};
use crate::{
    experiment::ExperimentError,
    network::Network,
    virtual_hosts::{self, NoticeQueue, RunningMaster, begin_on_host, on_host, outcome_of},
};

/// Master and nodes, connected by their topics both ways.
pub struct Nodes {
    master: Box<dyn RunningMaster>,
    pair: Pair,
}

enum Pair {
    Threads {
        plant: Side<PlantEnds>,
        controller: Side<ControllerEnds>,
    },
    Processes {
        plant: NodeProcess,
        controller: NodeProcess,
        queues: Queues,
    },
}

/// What the recorder reads.
pub struct Queues {
    /// The controller's rows.
    pub rows: Consumer<ControlRow>,
    /// The plant's rows.
    pub plant_rows: Consumer<PlantRow>,
}

/// What the nodes need of the run.
pub struct Setting<'a> {
    /// The virtual hosts.
    pub network: &'a dyn Network,
    pub settings: &'a Settings,
    /// Where notices go.
    pub board: &'a NoticeQueue,
    /// Set when the run is to end.
    pub stop: &'a Arc<AtomicBool>,
    /// Counts rows for which there was no room.
    pub log_dropped: &'a Arc<AtomicU64>,
}

impl Nodes {
    /// Starts everything, the two nodes at the same time, and waits for the topics. `None` if it was told to stop.
    ///
    /// # Errors
    /// If something cannot be started or the nodes do not find each other.
    pub fn connect(setting: &Setting<'_>) -> Result<Option<Self>, ExperimentError> {
        let deadline = Instant::now() + TIMEOUT;
        match setting.settings.loops.processes {
            Processes::Threads => Self::connect_threads(setting, deadline),
            Processes::Separate => Self::connect_processes(setting, deadline),
        }
    }

    fn connect_threads(setting: &Setting<'_>, deadline: Instant) -> Result<Option<Self>, ExperimentError> {
        let Setting {
            network,
            settings,
            board,
            stop,
            ..
        } = *setting;
        let [h1, sta1, sta2] = VirtualHost::OF_THE_BALL.map(|host| board.of(host));
        let program = settings.ros.master;
        let master = on_host(network, VirtualHost::H1, move || {
            virtual_hosts::start_master(program, MASTER, h1)
        })?;
        let uri = virtual_hosts::uri(MASTER.1);
        let (of_plant, uri_of_plant) = (settings.clone(), uri.clone());
        let plant = begin_on_host(network, VirtualHost::STA2, move || {
            Ok(Side::open_plant(&of_plant, &uri_of_plant, sta2)?)
        })?;
        let of_controller = settings.clone();
        let controller = on_host(network, VirtualHost::STA1, move || {
            Ok(Side::open_controller(&of_controller, &uri, sta1)?)
        });
        // Waited for in any case.
        let plant = outcome_of(plant, VirtualHost::STA2);
        let (controller, plant) = (controller?, plant?);
        let connected = plant.wait(deadline, stop)? && controller.wait(deadline, stop)?;
        if connected {
            let pair = Pair::Threads { plant, controller };
            return Ok(Some(Self { master, pair }));
        }
        let ((plant, plant_ends), (controller, controller_ends)) =
            (plant.into_parts(), controller.into_parts());
        drop((plant_ends, controller_ends));
        end_both([controller, plant]);
        master.stop()?;
        Ok(None)
    }

    fn connect_processes(setting: &Setting<'_>, deadline: Instant) -> Result<Option<Self>, ExperimentError> {
        let settings = setting.settings;
        let Some(master) = start_master(setting, deadline)? else {
            return Ok(None);
        };
        let (rows_in, rows) = RingBuffer::new(queue_capacity(settings));
        let (plant_rows_in, plant_rows) = RingBuffer::new(queue_capacity(settings));
        let plant = start(setting, Program::Plant, Rows::Plant(plant_rows_in))?;
        let controller = start(setting, Program::Controller, Rows::Control(rows_in))?;
        let connected = plant.wait_until_connected(deadline, setting.stop)?
            && controller.wait_until_connected(deadline, setting.stop)?;
        if connected {
            let pair = Pair::Processes {
                plant,
                controller,
                queues: Queues { rows, plant_rows },
            };
            return Ok(Some(Self { master, pair }));
        }
        close_both([controller, plant])?;
        master.stop()?;
        Ok(None)
    }

    /// Has the loops wait for their schedules, and says what they were granted; where they differ, the refusal counts.
    ///
    /// # Errors
    /// If a loop cannot be started.
    pub fn start_loops(self, settings: &Settings) -> Result<(Loops, Queues, RealtimeGrant), ExperimentError> {
        let (running, queues, grants) = match self.pair {
            Pair::Threads { plant, controller } => {
                let (plant_node, plant_ends) = plant.into_parts();
                let (controller_node, controller_ends) = controller.into_parts();
                let (plant, plant_rows, plant_grant) = LoopThread::plant(settings, plant_ends)?;
                let (controller, rows, grant) = LoopThread::controller(settings, controller_ends)?;
                let running = Running::Threads {
                    plant,
                    controller,
                    nodes: [controller_node, plant_node],
                };
                (running, Queues { rows, plant_rows }, [plant_grant, grant])
            }
            Pair::Processes {
                plant,
                controller,
                queues,
            } => {
                let grants = [plant.wait_until_ready()?, controller.wait_until_ready()?];
                (Running::Processes { plant, controller }, queues, grants)
            }
        };
        let [plant, controller] = grants;
        let refused =
            |grant: &RealtimeGrant| grant.priority_refusal.is_some() || grant.lock_refusal.is_some();
        let grant = if refused(&plant) { plant } else { controller };
        let loops = Loops {
            master: self.master,
            running,
            begun: false,
        };
        Ok((loops, queues, grant))
    }
}

/// The master, in a process of its own. `None` if it was told to stop.
fn start_master(
    setting: &Setting<'_>,
    deadline: Instant,
) -> Result<Option<Box<dyn RunningMaster>>, ExperimentError> {
    match setting.settings.ros.master {
        RosMaster::Embedded => {
            let master = start(setting, Program::Master, Rows::None)?;
            if master.wait_until_connected(deadline, setting.stop)? {
                return Ok(Some(Box::new(master)));
            }
            master.close()?;
            Ok(None)
        }
        RosMaster::Rosmaster => {
            let notices = setting.board.of(VirtualHost::H1);
            on_host(setting.network, VirtualHost::H1, move || {
                virtual_hosts::start_master(RosMaster::Rosmaster, MASTER, notices)
            })
            .map(Some)
        }
    }
}

fn start(setting: &Setting<'_>, program: Program, rows: Rows) -> Result<NodeProcess, ExperimentError> {
    let host = program.host();
    let given = Given {
        rows,
        notices: setting.board.of(host),
        stop: Arc::clone(setting.stop),
        log_dropped: Arc::clone(setting.log_dropped),
    };
    let settings = setting.settings.clone();
    on_host(setting.network, host, move || {
        NodeProcess::start(program, &settings, given)
    })
}

/// Both loops, waiting for their schedules or running, and what they need.
pub struct Loops {
    master: Box<dyn RunningMaster>,
    running: Running,
    begun: bool,
}

enum Running {
    Threads {
        plant: LoopThread,
        controller: LoopThread,
        nodes: [Tenancy; 2],
    },
    Processes {
        plant: NodeProcess,
        controller: NodeProcess,
    },
}

impl Loops {
    /// Tells both when to begin.
    ///
    /// # Errors
    /// If one has ended.
    pub fn begin(
        &mut self,
        plant_schedule: Schedule,
        controller_schedule: Schedule,
        shared: &Shared,
    ) -> Result<(), ExperimentError> {
        self.begun = true;
        match &self.running {
            Running::Threads {
                plant, controller, ..
            } => {
                plant.begin(plant_schedule, shared)?;
                controller.begin(controller_schedule, shared)
            }
            Running::Processes { plant, controller } => {
                plant.begin(plant_schedule, shared.zero_ns)?;
                controller.begin(controller_schedule, shared.zero_ns)
            }
        }
    }

    /// The processes that they run in, beside this one.
    #[must_use]
    pub fn processes(&self) -> Vec<Pid> {
        match &self.running {
            Running::Threads { .. } => Vec::new(),
            Running::Processes { plant, controller } => vec![plant.pid(), controller.pid()],
        }
    }

    /// Waits until both have ended, then closes the connections and ends master and nodes, within some seconds. Loops that
    /// were never begun end at once.
    ///
    /// # Errors
    /// If one ended in a failure.
    pub fn end(self) -> Result<(), ExperimentError> {
        let ended = match self.running {
            Running::Threads {
                plant,
                controller,
                nodes,
            } => {
                // Only when both have ended do the connections close: neither loop has lost its peer.
                let (plant, controller) = (plant.join(), controller.join());
                let ended = controller.and(plant).map(drop);
                end_both(nodes);
                ended
            }
            Running::Processes { plant, controller } => {
                let ended = if self.begun {
                    let (plant, controller) = (plant.wait_until_ended(), controller.wait_until_ended());
                    controller.and(plant)
                } else {
                    Ok(())
                };
                ended.and(close_both([controller, plant]))
            }
        };
        ended.and(self.master.stop())
    }
}

fn end_both([one, other]: [Tenancy; 2]) {
    thread::scope(|scope| {
        scope.spawn(|| one.end());
        other.end();
    });
}

fn close_both([one, other]: [NodeProcess; 2]) -> Result<(), ExperimentError> {
    one.hang_up();
    other.hang_up();
    let (one, other) = (one.close(), other.close());
    one.and(other)
}
