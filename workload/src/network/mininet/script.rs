//! The Python program that holds Mininet's network, and what is spoken with it: a line of JSON each way. The main type
//! is [`Script`].

use std::{
    io::{BufRead, BufReader, Write},
    os::unix::process::CommandExt,
    process::{Child, ChildStdin, Command, Stdio},
    sync::{
        Mutex, PoisonError,
        mpsc::{Receiver, RecvTimeoutError, TryRecvError, channel},
    },
    thread,
    time::Duration,
};

use nix::{
    sys::signal::{Signal, killpg},
    unistd::Pid,
};
use record::{
    settings::Offloads,
    topology::{Link, Topology, TopologyHost, address, mac},
    virtual_host::VirtualHost,
};
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use super::super::{error::NetworkError, kernel::tc_time, mininet::error::MininetError, namespace::errno};

const PROGRAM: &str = include_str!("network.py");

/// The first line that it reads is the program itself, so that there is no file.
const LOADER: &str =
    "import json, sys; exec(compile(json.loads(sys.stdin.readline()), 'network.py', 'exec'))";

/// That of a detached workload is empty.
const PATH: &str = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin";

/// How long taking the network down may take; 4 s were seen on an emulated processor.
const END_TIMEOUT: Duration = Duration::from_secs(60);

/// What is asked of the program.
#[derive(Debug, Serialize)]
#[serde(tag = "do", rename_all = "lowercase")]
pub enum Request {
    /// Whether all is installed: [`Done`].
    Survey,
    /// Build the network, links unimpaired: [`Up`].
    Up {
        /// What all names begin with.
        name: String,
        hosts: Vec<Host>,
        switches: Vec<Switch>,
        datapath: Datapath,
        offloads: Offloads,
    },
    /// Impair the links, given in the order in which they were made: [`Done`].
    Impair { links: Vec<Impair> },
    /// All that was run, and how the network stands: [`Transcript`].
    Inspect,
}

/// What of Open vSwitch forwards the packets, in Mininet's words.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Datapath {
    /// The module `openvswitch`.
    Kernel,
    /// The daemon itself.
    User,
}

/// A host as Mininet is told of it.
#[derive(Debug, Serialize)]
pub struct Host {
    name: VirtualHost,
    /// With the length of the network's prefix.
    ip: String,
    mac: String,
    /// The position of its switch.
    switch: usize,
}

/// A switch as Mininet is told of it.
#[derive(Debug, Serialize)]
pub struct Switch {
    /// The bridge's.
    name: String,
    /// The position of the switch that it is connected to.
    uplink: Option<usize>,
}

/// The parameters of Mininet's `TCIntf.config` (`mininet/link.py`).
#[derive(Debug, Serialize)]
pub struct Impair {
    bandwidth_mbit: f64,
    delay: String,
    jitter: String,
    loss_percent: f64,
    limit_packets: u32,
}

/// The network is there.
#[derive(Debug, Deserialize)]
pub struct Up {
    /// The hosts' shells, in the topology's order.
    pub pids: Vec<u32>,
    /// The interfaces of both ends of each link, the lower one first, in the topology's order.
    pub links: Vec<[String; 2]>,
}

/// What was run, as in a shell, each command followed by what it printed.
#[derive(Debug, Deserialize)]
pub struct Transcript {
    pub transcript: String,
}

/// It is done, and there is nothing to say.
#[derive(Debug, Deserialize)]
pub struct Done {}

/// An answer of any request.
#[derive(Debug, Deserialize)]
#[serde(untagged)]
enum Answer<T> {
    Missing { missing: String },
    Refused { refused: String },
    Error { error: String },
    Wanted(T),
}

impl Request {
    /// Such a network, all names on the machine beginning with `name`.
    #[must_use]
    pub fn up(name: &str, datapath: Datapath, topology: &Topology, offloads: Offloads) -> Self {
        let hosts = topology.hosts.iter().enumerate();
        let switches = topology.switches.iter().enumerate();
        Self::Up {
            name: name.to_owned(),
            hosts: hosts.map(|(position, host)| Host::at(position, host)).collect(),
            switches: switches
                .map(|(position, switch)| Switch {
                    name: bridge(name, position),
                    uplink: switch.uplink.map(|(upper, _)| upper),
                })
                .collect(),
            datapath,
            offloads,
        }
    }

    /// Each link as the topology has it.
    #[must_use]
    pub fn impair(topology: &Topology) -> Self {
        Self::Impair {
            links: topology.links().map(|(_, link)| Impair::from(&link)).collect(),
        }
    }
}

/// The name of the bridge of the switch in that position.
#[must_use]
pub fn bridge(name: &str, position: usize) -> String {
    format!("{name}{position:x}")
}

impl Host {
    fn at(position: usize, host: &TopologyHost) -> Self {
        Self {
            name: host.name,
            ip: format!("{}/8", address(position)),
            mac: mac(position).map(|byte| format!("{byte:02x}")).join(":"),
            switch: host.switch,
        }
    }
}

impl From<&Link> for Impair {
    fn from(link: &Link) -> Self {
        Self {
            bandwidth_mbit: link.bandwidth.bits_per_second() as f64 / 1e6,
            delay: tc_time(link.delay),
            jitter: tc_time(link.jitter),
            loss_percent: link.loss.probability() * 100.0,
            limit_packets: link.limit_packets,
        }
    }
}

/// The running program. Dropping it ends it, and the network with it.
#[derive(Debug)]
pub struct Script {
    child: Child,
    // Its end is the network's.
    input: Option<ChildStdin>,
    /// Closed when the program has ended. Never contended: the mutex only makes it shareable.
    answers: Mutex<Receiver<String>>,
    ended: bool,
}

impl Script {
    /// Starts the program; it has made nothing yet.
    ///
    /// # Errors
    /// If there is no Python, or it cannot be started.
    pub fn start() -> Result<Self, NetworkError> {
        let mut python = Command::new("python3");
        python.args(["-I", "-c", LOADER]);
        let mut script = Self::of(&mut python)?;
        // Plain text can always be written as JSON.
        script.say(&serde_json::to_string(PROGRAM).unwrap_or_default())?;
        Ok(script)
    }

    /// Starts any program that answers lines.
    fn of(command: &mut Command) -> Result<Self, NetworkError> {
        command
            .env_clear()
            .env("PATH", PATH)
            // Mininet reads what tools print.
            .env("LC_ALL", "C")
            .env("TERM", "dumb")
            .current_dir("/")
            // A Ctrl-C is for the workload.
            .process_group(0)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped());
        let mut child = command.spawn().map_err(|error| match error.kind() {
            std::io::ErrorKind::NotFound => MininetError::Missing {
                what: command.get_program().to_string_lossy().into_owned(),
            }
            .into(),
            _ => NetworkError::Start {
                program: "python3",
                source: errno(&error),
            },
        })?;
        let input = child.stdin.take();
        let (lines, answers) = channel();
        let output = child.stdout.take();
        let script = Self {
            child,
            input,
            answers: Mutex::new(answers),
            ended: false,
        };
        thread::Builder::new()
            .name("mininet".into())
            .spawn(move || {
                let output = output
                    .into_iter()
                    .flat_map(|output| BufReader::new(output).lines());
                for line in output.map_while(Result::ok) {
                    if lines.send(line).is_err() {
                        break;
                    }
                }
            })
            .map_err(|error| NetworkError::Thread {
                source: errno(&error),
            })?;
        Ok(script)
    }

    /// Asks and waits for the answer.
    ///
    /// # Errors
    /// If the answer is that it cannot be done, or there is none.
    pub fn ask<T: DeserializeOwned>(
        &mut self,
        request: &Request,
        timeout: Duration,
    ) -> Result<T, NetworkError> {
        // Plain data can always be written as JSON.
        self.say(&serde_json::to_string(request).unwrap_or_default())?;
        let answers = self.answers.lock().unwrap_or_else(PoisonError::into_inner);
        let answer = answers.recv_timeout(timeout).map_err(|error| match error {
            RecvTimeoutError::Timeout => MininetError::Silent { after: timeout },
            RecvTimeoutError::Disconnected => MininetError::Ended,
        })?;
        match serde_json::from_str(&answer) {
            Ok(Answer::Wanted(wanted)) => Ok(wanted),
            Ok(Answer::Missing { missing: what }) => Err(MininetError::Missing { what }.into()),
            Ok(Answer::Refused { refused: said }) => Err(MininetError::Refused { said }.into()),
            Ok(Answer::Error { error: said }) => Err(MininetError::Failed { said }.into()),
            Err(_) => Err(MininetError::Puzzling { answer }.into()),
        }
    }

    /// Whether the program has ended, which it does not before it is told to.
    pub fn has_ended(&mut self) -> bool {
        let answers = self.answers.get_mut().unwrap_or_else(PoisonError::into_inner);
        self.ended |= answers.try_recv() == Err(TryRecvError::Disconnected);
        self.ended
    }

    /// Has it take the network down, and waits until it has.
    pub fn end(&mut self) {
        drop(self.input.take());
        let answers = self.answers.get_mut().unwrap_or_else(PoisonError::into_inner);
        while let Ok(_late) = answers.recv_timeout(END_TIMEOUT) {}
        // Both fail where it has ended in order.
        if let Ok(group) = i32::try_from(self.child.id()) {
            let _ = killpg(Pid::from_raw(group), Signal::SIGKILL);
        }
        let _ = self.child.wait();
    }

    fn say(&mut self, line: &str) -> Result<(), NetworkError> {
        let written = self
            .input
            .as_mut()
            .map(|input| input.write_all(format!("{line}\n").as_bytes()));
        match written {
            Some(Ok(())) => Ok(()),
            Some(Err(_)) | None => Err(MininetError::Ended.into()),
        }
    }
}

impl Drop for Script {
    fn drop(&mut self) {
        if self.input.is_some() {
            self.end();
        }
    }
}

#[cfg(test)]
mod tests;
