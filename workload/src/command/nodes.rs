//! One window of nodes: programs on the hosts of an emulated network, started one after the other as each is ready, until those that
//! are not in the background have ended. The main type is [`NodesCall`].

use std::{path::Path, time::Duration};

use record::{
    experiment::{CommandExperiment, NodeSettings, Ready, Values, WindowValues},
    topology::address,
    virtual_host::VirtualHost,
    window::NodeRecord,
};

use super::{
    call::{Bounds, GRACE, Outcome, is_a_crash},
    emulation::Emulation,
    program::{self, End, Printed, Program, Running, Usage, any_ends_within},
};
use crate::{
    command_error::CommandError, descendants::Descendants, experiment::ExperimentError, virtual_hosts,
};

/// How often it is looked whether a node is ready.
const LOOK: Duration = Duration::from_millis(50);
/// ROS keeps its logs there, below the folder for the work.
const ROS_HOME: &str = "ros";

/// The nodes of a window to be called.
pub struct NodesCall<'a> {
    pub experiment: &'a CommandExperiment,
    pub emulation: &'a Emulation,
    /// In which they run.
    pub folder: &'a Path,
    /// The folder for all commands of the environment.
    pub work: &'a Path,
    pub window: WindowValues<'a>,
    pub bounds: Bounds<'a>,
}

/// What came of them.
#[derive(Debug, Default)]
pub struct NodesEnded {
    /// How each ended, in the order of the matrix file.
    pub nodes: Vec<NodeRecord>,
    /// What each printed, also those that were not started.
    pub printed: Vec<Printed>,
    /// What all used together; of the memory, what the largest had.
    pub usage: Usage,
    /// Processes that they left behind, which are ended.
    pub left_behind: u64,
    /// Why the window ended before it was to, if so.
    pub cut: Option<Cut>,
}

/// Why a window of nodes ended before it was to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Cut {
    /// It went too far, while it waited for that, if it waited for a node to be ready.
    Exceeded {
        outcome: Outcome,
        waited_for: Option<String>,
    },
    /// A node ended: its position.
    Node(usize),
}

impl NodesEnded {
    /// How the window ended, as that of a single command would have: with 0 if all went well.
    #[must_use]
    pub fn outcome(&self) -> Outcome {
        match &self.cut {
            None => Outcome::Exited(0),
            Some(Cut::Exceeded { outcome, .. }) => *outcome,
            // Which node that was is one of the reasons, and an exit code of 0 is no good one here.
            Some(Cut::Node(_)) => Outcome::NodeEnded,
        }
    }

    /// Why the window does not count, if so.
    ///
    /// # Errors
    /// When something killed a node.
    pub fn reasons(&self, window: u32, timeout: Duration) -> Result<Vec<String>, CommandError> {
        let mut reasons = Vec::new();
        match &self.cut {
            None => {}
            Some(Cut::Exceeded { outcome, waited_for }) => {
                reasons.push(format!("the window {}", outcome.in_words(timeout)));
                reasons.extend(waited_for.as_ref().map(|node| format!("it waited for {node}")));
            }
            Some(Cut::Node(position)) => {
                let (Some(node), Some(printed)) = (self.nodes.get(*position), self.printed.get(*position))
                else {
                    return Ok(reasons);
                };
                reasons.push(match node.signal {
                    Some(signal) if is_a_crash(signal) => {
                        format!("node `{}` crashed with signal {signal}", node.name)
                    }
                    Some(signal) => {
                        return Err(CommandError::Killed {
                            who: format!("node `{}`", node.name),
                            window,
                            signal,
                            last_words: printed.last_words(),
                        });
                    }
                    None => {
                        let code = node.exit_code.unwrap_or_default();
                        let early = match (code, node.ready_after_ns) {
                            (0, None) => " before it was ready",
                            (0, Some(_)) => " before the window was over",
                            _ => "",
                        };
                        format!("node `{}` ended with exit code {code}{early}", node.name)
                    }
                });
                reasons.extend(printed.said_last());
            }
        }
        Ok(reasons)
    }
}

/// A node that was started.
struct Started<'a> {
    node: &'a NodeSettings,
    running: Running,
    ready_after: Option<Duration>,
}

impl NodesCall<'_> {
    /// Starts the master and the nodes, tells `watch` about once a second for how long they have been running, and ends all of them.
    ///
    /// # Errors
    /// When one cannot be started, or something that they left behind does not end.
    pub fn run(&self, mut watch: impl FnMut(Duration)) -> Result<NodesEnded, ExperimentError> {
        let master = self.master_place();
        let uri = master.map(|(_, position)| virtual_hosts::uri(address(position)));
        let program = self.experiment.ros_master.map(|master| master.program);
        let master_runs = match (program, master) {
            (Some(program), Some(place)) => Some(self.emulation.start_master(program, place)?),
            _ => None,
        };
        // The network's own processes and the master were there before.
        let descendants = Descendants::begin()?;
        let mut started = Vec::new();
        let mut told = Duration::ZERO;
        let mut watch = |elapsed: Duration| {
            if elapsed.saturating_sub(told) >= super::call::LOOK {
                told = elapsed;
                watch(elapsed);
            }
        };
        let cut = self.until_end(uri.as_deref(), &mut started, &descendants, &mut watch);
        let ended = self.end(started, &descendants);
        // Whatever became of the nodes.
        let stopped = master_runs.map_or(Ok(()), virtual_hosts::RunningMaster::stop);
        let (cut, mut ended) = (cut?, ended?);
        stopped?;
        ended.cut = cut;
        Ok(ended)
    }

    fn master_place(&self) -> Option<(VirtualHost, usize)> {
        let topology = self.emulation.topology();
        let position = self.experiment.ros_master?.position(topology)?;
        Some((topology.hosts.get(position)?.name, position))
    }

    /// Starts the nodes and waits until the window is over; why, if that is before it was to be.
    fn until_end<'n>(
        &'n self,
        uri: Option<&str>,
        started: &mut Vec<Started<'n>>,
        descendants: &Descendants,
        watch: &mut impl FnMut(Duration),
    ) -> Result<Option<Cut>, ExperimentError> {
        for node in &self.experiment.nodes {
            let running = self.emulation.start(node.host, self.program(node, uri))?;
            started.push(Started {
                node,
                running,
                ready_after: None,
            });
            while !self.is_ready(node, started, uri)? {
                any_ends_within(&still_running(started)?, LOOK)?;
                watch(self.bounds.began.elapsed());
                if let Some(cut) = self.cut(started, Some(node))? {
                    return Ok(Some(cut));
                }
            }
            if let Some(last) = started.last_mut() {
                last.ready_after = Some(self.bounds.began.elapsed());
            }
        }
        loop {
            if let Some(cut) = self.cut(started, None)? {
                return Ok(Some(cut));
            }
            let running = still_running(started)?;
            // The others are there: one of them that had ended would have cut the window.
            if running.len() == started.iter().filter(|it| it.node.background).count() {
                return Ok(None);
            }
            any_ends_within(&running, self.bounds.until_next_look())?;
            descendants.reap(started.iter().map(|it| it.running.pid()));
            watch(self.bounds.began.elapsed());
        }
    }

    /// Why the window is not to go on, if so.
    fn cut(
        &self,
        started: &[Started<'_>],
        waits_for: Option<&NodeSettings>,
    ) -> Result<Option<Cut>, ExperimentError> {
        self.emulation.look()?;
        for (position, it) in started.iter().enumerate() {
            let is_awaited = waits_for.is_some_and(|node| node.name == it.node.name);
            let may_end = !it.node.background && !is_awaited;
            match it.running.ended()? {
                None => {}
                Some(End::Exited(0)) if may_end => {}
                Some(_) => return Ok(Some(Cut::Node(position))),
            }
        }
        let waited_for = || waits_for.map(|node| format!("node `{}` {}", node.name, sign(node)));
        Ok(self.bounds.exceeded().map(|outcome| Cut::Exceeded {
            outcome,
            waited_for: waited_for(),
        }))
    }

    fn is_ready(
        &self,
        node: &NodeSettings,
        started: &[Started<'_>],
        uri: Option<&str>,
    ) -> Result<bool, ExperimentError> {
        match &node.ready {
            None => Ok(true),
            Some(Ready::Port(port)) => self.emulation.listens(node.host, *port),
            Some(Ready::Line(_)) => Ok(started.last().is_some_and(|it| it.running.has_said())),
            Some(Ready::Topic(topic)) => match (self.master_place(), uri) {
                (Some((host, _)), Some(uri)) => self.emulation.has_publisher(host, uri, topic),
                // Settings without problems have a master.
                _ => Ok(true),
            },
        }
    }

    fn program(&self, node: &NodeSettings, uri: Option<&str>) -> Program {
        let topology = self.emulation.topology();
        let values = Values {
            parameters: &self.experiment.parameters,
            topology: Some(topology),
            window: Some(self.window),
        };
        let mut environment = Vec::new();
        if let (Some(uri), Some(position)) = (uri, topology.position(node.host)) {
            environment.push(("ROS_MASTER_URI", uri.to_owned()));
            environment.push(("ROS_IP", address(position).to_string()));
            environment.push(("ROS_HOME", self.work.join(ROS_HOME).display().to_string()));
        }
        Program {
            arguments: node.run.iter().map(|it| it.filled(values)).collect(),
            folder: self.folder.to_owned(),
            work: self.work.to_owned(),
            environment,
            sought: match &node.ready {
                Some(Ready::Line(text)) => Some(text.clone()),
                _ => None,
            },
        }
    }

    /// Asks those that still run to end, the last one first, ends them, and says how each ended.
    fn end(
        &self,
        started: Vec<Started<'_>>,
        descendants: &Descendants,
    ) -> Result<NodesEnded, ExperimentError> {
        let running: Vec<_> = started.iter().map(|it| &it.running).collect();
        // What has ended by itself is not left behind.
        descendants.reap(running.iter().map(|it| it.pid()));
        let ends = program::end(&running, GRACE)?;
        let mut ended = NodesEnded {
            left_behind: descendants.end_all()?,
            ..NodesEnded::default()
        };
        for (it, (end, usage)) in started.iter().zip(ends) {
            let printed = it.running.printed();
            ended.usage.cpu_ns += usage.cpu_ns;
            ended.usage.peak_memory_bytes = ended.usage.peak_memory_bytes.max(usage.peak_memory_bytes);
            ended.nodes.push(NodeRecord {
                name: it.node.name,
                host: it.node.host,
                exit_code: match end {
                    End::Exited(code) => Some(code),
                    End::Signal(_) => None,
                },
                signal: match end {
                    End::Exited(_) => None,
                    End::Signal(signal) => Some(signal),
                },
                ready_after_ns: it
                    .ready_after
                    .map(|after| u64::try_from(after.as_nanos()).unwrap_or(u64::MAX)),
                cpu_ns: usage.cpu_ns,
                peak_memory_bytes: usage.peak_memory_bytes,
                stdout_bytes: printed.stdout.bytes,
                stderr_bytes: printed.stderr.bytes,
            });
            ended.printed.push(printed);
        }
        ended
            .printed
            .resize_with(self.experiment.nodes.len(), Printed::default);
        Ok(ended)
    }
}

fn still_running<'a>(started: &'a [Started<'_>]) -> Result<Vec<&'a Running>, ExperimentError> {
    let mut running = Vec::new();
    for it in started {
        if it.running.ended()?.is_none() {
            running.push(&it.running);
        }
    }
    Ok(running)
}

/// What shows that the node is ready, in words after it.
fn sign(node: &NodeSettings) -> String {
    match &node.ready {
        None => "to start".to_owned(),
        Some(Ready::Port(port)) => format!("to listen on port {port}"),
        Some(Ready::Topic(topic)) => format!("to publish `{topic}`"),
        Some(Ready::Line(text)) => format!("to print `{text}`"),
    }
}
