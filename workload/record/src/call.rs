//! How the program `workload` is called, as the types that it parses its command line into. Whoever calls it makes the command
//! line of the same types, so that no option is written in two places. The main types are [`Run`], [`Check`] and [`Detached`].

use std::{ffi::OsString, path::PathBuf};

use clap::{Args, Subcommand, builder::PossibleValuesParser};

use crate::{progress::Part, quantity::TimeSpan, settings::Settings, virtual_host::VirtualHost};

/// The words by which a workload is found in the list of processes.
pub mod word {
    /// The command [`Run`](super::Run).
    pub const RUN: &str = "run";
    /// The commands [`Detached`](super::Detached).
    pub const DETACHED: &str = "detached";
    /// Of them, [`Supervise`](super::Detached::Supervise).
    pub const SUPERVISE: &str = "supervise";
    /// Of them, [`Lease`](super::Detached::Lease).
    pub const LEASE: &str = "lease";
    /// The option for the name of an environment.
    pub const ENVIRONMENT: &str = "environment";
    /// The option for the folder of the data.
    pub const DATA: &str = "data";
    /// The option for the folder of environments.
    pub const ROOT: &str = "root";
    /// The option for the file of a lease.
    pub const PATH: &str = "path";
}

const CHECK: &str = "check";
const SHELL: &str = "shell";
const REHEARSE: &str = "rehearse";
const WITHOUT: &str = "without";
const SETTINGS: &str = "settings";
const WINDOWS: &str = "windows";
const ENDS_WITH_INPUT: &str = "ends-with-input";
const WORK: &str = "work";
const FROM: &str = "from";
const GRACE: &str = "grace";
const BEAT: &str = "beat";
const JOB: &str = "job";
const NODE: &str = "node";
const HARDWARE: &str = "hardware";
const OS: &str = "os";
const LEASE: &str = "lease";

/// `workload run`: measures windows.
#[derive(Debug, Clone, PartialEq, Eq, Args)]
pub struct Run {
    /// Name of the environment, kept with each window.
    #[arg(long = word::ENVIRONMENT)]
    pub environment: String,
    /// The settings, as JSON; what is left out is as its `dynamics` has it.
    #[arg(long = SETTINGS, default_value = "{}")]
    pub settings: String,
    /// Folder for the data; made if it is not there.
    #[arg(long = word::DATA)]
    pub data: PathBuf,
    /// Folder in which a command runs and writes; its files are in `files`.
    #[arg(long = WORK)]
    pub work: Option<PathBuf>,
    /// Numbers of the windows to measure.
    #[arg(long = WINDOWS, value_delimiter = ',', required = true, value_parser = clap::value_parser!(u32).range(1..))]
    pub windows: Vec<u32>,
    /// End in order when standard input ends: whoever holds it open is not there any more.
    #[arg(long = ENDS_WITH_INPUT)]
    pub ends_with_input: bool,
}

/// `workload check`: reports whether the experiment can run there. It prints a [`CheckRecord`](crate::check::CheckRecord).
#[derive(Debug, Clone, PartialEq, Eq, Args)]
pub struct Check {
    /// The settings, as JSON; what is left out is as its `dynamics` has it.
    #[arg(long = SETTINGS, default_value = "{}")]
    pub settings: String,
}

/// `workload rehearse`: runs network, ROS master and nodes and measures nothing.
#[derive(Debug, Clone, PartialEq, Eq, Args)]
pub struct Rehearse {
    /// The settings, as JSON; what is left out is as its `dynamics` has it.
    #[arg(long = SETTINGS, default_value = "{}")]
    pub settings: String,
    /// A node that is not to run, since you run yours: `plant` or `controller`; twice for both.
    #[arg(long = WITHOUT, value_parser = PossibleValuesParser::new(Part::ALL.map(Part::name)))]
    pub without: Vec<String>,
}

/// `workload shell`: rehearses the experiment and runs a program in a host of its network, which ends with the program.
#[derive(Debug, Clone, PartialEq, Eq, Args)]
pub struct Shell {
    /// The host, such as `h1`.
    pub host: VirtualHost,
    /// The settings, as JSON; what is left out is as its `dynamics` has it.
    #[arg(long = SETTINGS, default_value = "{}")]
    pub settings: String,
    /// The program, `/bin/sh` if none is named, and its arguments.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    pub program: Vec<OsString>,
}

/// `workload detached`: a workload that outlives the call that started it. [`crate::detached`] has what each command reads and
/// answers.
#[derive(Debug, Clone, PartialEq, Eq, Subcommand)]
pub enum Detached {
    /// Make an environment and start its workload, which outlives this call. Standard input has its owner and settings, and
    /// the experiment's files.
    Start(Which),
    /// The workload's supervisor, as `start` starts it. Standard input has the settings.
    #[command(hide = true, name = word::SUPERVISE)]
    Supervise(Which),
    /// Make an environment for a job of a batch system, and start nothing. Standard input is that of `start`.
    Prepare(Which),
    /// Run the workload of a prepared environment, as the one process of its job, until it has ended. SIGTERM and SIGUSR1 end
    /// it in order.
    Job(Job),
    /// Print the workload's lines until it has ended.
    Follow(Follow),
    /// Report what there is by now of an environment whose workload may run on another machine, and print the lines that are new.
    Look(Follow),
    /// Report whether the workload runs, how it ended and what it printed last.
    Ended(Which),
    /// Ask the workload to end in order.
    Stop(Which),
    /// End the workload and remove the environment.
    Remove(Remove),
    /// List the environments, and the bridges that killed workloads left in Open vSwitch.
    List(Root),
    /// Remove such a bridge.
    RemoveBridge {
        /// Its name, as `list` prints it.
        name: String,
    },
    /// Send the data folder as LZ4 of tar. Standard input has how much of each file is already there.
    Collect(Which),
    /// Hold a lease until standard input ends. Its first line says who asks.
    #[command(name = word::LEASE)]
    Lease(Lease),
    /// Report what the host is, how much room its disk has and what time it is.
    Platform(Root),
}

/// Where environments are.
#[derive(Debug, Clone, PartialEq, Eq, Args)]
pub struct Root {
    /// The folder that has a folder for each environment.
    #[arg(long = word::ROOT)]
    pub root: PathBuf,
}

/// Which environment.
#[derive(Debug, Clone, PartialEq, Eq, Args)]
pub struct Which {
    /// Where it is.
    #[command(flatten)]
    pub root: Root,
    /// The environment's name, which is that of its folder.
    #[arg(long = word::ENVIRONMENT)]
    pub environment: String,
}

/// From where on lines are printed.
#[derive(Debug, Clone, PartialEq, Eq, Args)]
pub struct Follow {
    /// Of which environment.
    #[command(flatten)]
    pub which: Which,
    /// How many bytes of them are known already.
    #[arg(long = FROM, default_value_t = 0)]
    pub from: u64,
}

/// Which job.
#[derive(Debug, Clone, PartialEq, Eq, Args)]
pub struct Job {
    /// Of which environment.
    #[command(flatten)]
    pub which: Which,
    /// Its number, as the batch system has it.
    #[arg(long = JOB)]
    pub job: String,
    /// The node that it runs on, as the batch system calls it.
    #[arg(long = NODE)]
    pub node: String,
    /// The hardware that the node is said to have.
    #[arg(long = HARDWARE)]
    pub hardware: String,
    /// The operating system that it is said to have.
    #[arg(long = OS)]
    pub os: String,
    /// The file on the node whose lock says that somebody measures there.
    #[arg(long = LEASE)]
    pub lease: PathBuf,
}

/// What is removed, and how.
#[derive(Debug, Clone, PartialEq, Eq, Args)]
pub struct Remove {
    /// Which environment.
    #[command(flatten)]
    pub which: Which,
    /// How long the workload may take to end in order before it is ended by force.
    #[arg(long = GRACE, default_value = "10s")]
    pub grace: TimeSpan,
}

/// Which lease.
#[derive(Debug, Clone, PartialEq, Eq, Args)]
pub struct Lease {
    /// The file whose lock it is; made if it is not there.
    #[arg(long = word::PATH)]
    pub path: PathBuf,
    /// End when nothing, not even an empty line, has come on standard input for that long.
    #[arg(long = BEAT, default_value = "5min")]
    pub beat: TimeSpan,
}

/// The folders of an environment.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Folders {
    /// For the data.
    pub data: PathBuf,
    /// For a command's work, where the experiment is one.
    pub work: PathBuf,
}

impl Run {
    /// Measures these windows with these settings, in folders of its own.
    #[must_use]
    pub fn of(environment: &str, settings: &Settings, folders: Folders, windows: &[u32]) -> Self {
        Self {
            environment: environment.to_owned(),
            settings: json(settings),
            data: folders.data,
            work: settings.experiment.is_some().then_some(folders.work),
            windows: windows.to_vec(),
            ends_with_input: false,
        }
    }

    /// The arguments of the program.
    #[must_use]
    pub fn arguments(&self) -> Vec<OsString> {
        let windows: Vec<String> = self.windows.iter().map(u32::to_string).collect();
        let arguments = Arguments::of(word::RUN)
            .option(word::ENVIRONMENT, &self.environment)
            .option(SETTINGS, &self.settings)
            .option(word::DATA, &self.data)
            .option(WINDOWS, windows.join(","));
        let arguments = match &self.work {
            Some(work) => arguments.option(WORK, work),
            None => arguments,
        };
        match self.ends_with_input {
            true => arguments.value(&format!("--{ENDS_WITH_INPUT}")).0,
            false => arguments.0,
        }
    }
}

impl Check {
    /// Checks these settings.
    #[must_use]
    pub fn of(settings: &Settings) -> Self {
        Self {
            settings: json(settings),
        }
    }

    /// The arguments of the program.
    #[must_use]
    pub fn arguments(&self) -> [String; 3] {
        [CHECK.to_owned(), format!("--{SETTINGS}"), self.settings.clone()]
    }
}

impl Rehearse {
    /// With all nodes of these settings.
    #[must_use]
    pub fn of(settings: &Settings) -> Self {
        Self {
            settings: json(settings),
            without: Vec::new(),
        }
    }

    /// The arguments of the program.
    #[must_use]
    pub fn arguments(&self) -> Vec<OsString> {
        let begun = Arguments::of(REHEARSE).option(SETTINGS, &self.settings);
        let without = self.without.iter();
        without.fold(begun, |so_far, node| so_far.option(WITHOUT, node)).0
    }
}

impl Shell {
    /// In that host, with these settings.
    #[must_use]
    pub fn of(host: VirtualHost, settings: &Settings) -> Self {
        Self {
            host,
            settings: json(settings),
            program: Vec::new(),
        }
    }

    /// The arguments of the program. Those that come after them are the program to run there, and its arguments.
    #[must_use]
    pub fn arguments(&self) -> Vec<OsString> {
        let begun = Arguments::of(SHELL)
            .option(SETTINGS, &self.settings)
            .value(self.host.name());
        begun.0.into_iter().chain(self.program.iter().cloned()).collect()
    }
}

impl Detached {
    /// The command's name.
    #[must_use]
    pub const fn name(&self) -> &'static str {
        match self {
            Self::Start(_) => "start",
            Self::Supervise(_) => word::SUPERVISE,
            Self::Prepare(_) => "prepare",
            Self::Job(_) => JOB,
            Self::Follow(_) => "follow",
            Self::Look(_) => "look",
            Self::Ended(_) => "ended",
            Self::Stop(_) => "stop",
            Self::Remove(_) => "remove",
            Self::List(_) => "list",
            Self::RemoveBridge { .. } => "remove-bridge",
            Self::Collect(_) => "collect",
            Self::Lease(_) => word::LEASE,
            Self::Platform(_) => "platform",
        }
    }

    /// The arguments of the program.
    #[must_use]
    pub fn arguments(&self) -> Vec<OsString> {
        let begun = Arguments::of(word::DETACHED).value(self.name());
        match self {
            Self::Start(which)
            | Self::Prepare(which)
            | Self::Supervise(which)
            | Self::Ended(which)
            | Self::Stop(which)
            | Self::Collect(which) => begun.which(which),
            Self::Job(call) => begun
                .which(&call.which)
                .option(JOB, &call.job)
                .option(NODE, &call.node)
                .option(HARDWARE, &call.hardware)
                .option(OS, &call.os)
                .option(LEASE, &call.lease),
            Self::Follow(call) | Self::Look(call) => {
                begun.which(&call.which).option(FROM, call.from.to_string())
            }
            Self::Remove(call) => begun.which(&call.which).option(GRACE, call.grace.to_string()),
            Self::List(root) | Self::Platform(root) => begun.option(word::ROOT, &root.root),
            Self::RemoveBridge { name } => begun.value(name),
            Self::Lease(call) => begun
                .option(word::PATH, &call.path)
                .option(BEAT, call.beat.to_string()),
        }
        .0
    }
}

/// Arguments as they are put together.
struct Arguments(Vec<OsString>);

impl Arguments {
    fn of(command: &str) -> Self {
        Self(vec![command.into()])
    }

    fn value(mut self, value: &str) -> Self {
        self.0.push(value.into());
        self
    }

    fn option(mut self, name: &str, value: impl Into<OsString>) -> Self {
        self.0.extend([format!("--{name}").into(), value.into()]);
        self
    }

    fn which(self, which: &Which) -> Self {
        self.option(word::ROOT, &which.root.root)
            .option(word::ENVIRONMENT, &which.environment)
    }
}

/// Settings are plain data: they can always be written.
fn json(settings: &Settings) -> String {
    serde_json::to_string(settings).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use rstest::rstest;

    use super::*;
    use crate::settings::Dynamics;

    #[derive(Debug, PartialEq, Parser)]
    struct Call {
        #[command(subcommand)]
        command: Command,
    }

    #[derive(Debug, PartialEq, Subcommand)]
    enum Command {
        Run(Run),
        Check(Check),
        Rehearse(Rehearse),
        Shell(Shell),
        #[command(subcommand)]
        Detached(Detached),
    }

    fn parsed(arguments: impl IntoIterator<Item = impl Into<OsString>>) -> Command {
        let program = OsString::from("workload");
        let all = std::iter::once(program).chain(arguments.into_iter().map(Into::into));
        Call::try_parse_from(all).unwrap().command
    }

    fn root() -> Root {
        Root {
            root: "/some where".into(),
        }
    }

    fn which() -> Which {
        Which {
            root: root(),
            environment: "e-1".into(),
        }
    }

    #[test]
    fn a_run_is_read_as_it_was_called() {
        let folders = Folders {
            data: "/d a".into(),
            work: "/w".into(),
        };
        let settings = Settings::of(Dynamics::default());
        let run = Run::of("e-1", &settings, folders.clone(), &[1, 2, 7]);
        assert_eq!(
            (&run.work, parsed(run.arguments())),
            (&None, Command::Run(run.clone()))
        );
        let experiment =
            serde_json::json!({"name": "e", "run": ["true"], "metrics": [{"name": "m", "from": "m.csv"}]});
        let of_a_command = Settings {
            experiment: Some(serde_json::from_value(experiment).unwrap()),
            ..settings.clone()
        };
        let run = Run {
            ends_with_input: true,
            ..Run::of("e-1", &of_a_command, folders, &[1])
        };
        assert_eq!(run.work.as_deref(), Some(std::path::Path::new("/w")));
        assert_eq!(parsed(run.arguments()), Command::Run(run));
        let check = Check::of(&settings);
        assert_eq!(parsed(check.arguments()), Command::Check(check));
        let rehearsal = Rehearse {
            without: ["plant".into(), "controller".into()].into(),
            ..Rehearse::of(&settings)
        };
        assert_eq!(parsed(rehearsal.arguments()), Command::Rehearse(rehearsal));
        let shell = Shell {
            program: ["bash".into(), "--login".into()].into(),
            ..Shell::of(VirtualHost::STA1, &settings)
        };
        assert_eq!(parsed(shell.arguments()), Command::Shell(shell));
    }

    #[rstest]
    #[case(Detached::Start(which()))]
    #[case(Detached::Supervise(which()))]
    #[case(Detached::Follow(Follow { which: which(), from: 7 }))]
    #[case(Detached::Prepare(which()))]
    #[case(Detached::Job(Job {
        which: which(), job: "17".into(), node: "n1".into(), hardware: "x86_64".into(), os: "rocky-9".into(), lease: "/l".into()
    }))]
    #[case(Detached::Look(Follow { which: which(), from: 7 }))]
    #[case(Detached::Ended(which()))]
    #[case(Detached::Stop(which()))]
    #[case(Detached::Remove(Remove { which: which(), grace: TimeSpan::from_secs(3) }))]
    #[case(Detached::List(root()))]
    #[case(Detached::RemoveBridge { name: "m1-s1".into() })]
    #[case(Detached::Collect(which()))]
    #[case(Detached::Lease(Lease { path: "/l".into(), beat: TimeSpan::from_secs(90) }))]
    #[case(Detached::Platform(root()))]
    fn a_command_is_read_as_it_was_called(#[case] call: Detached) {
        assert_eq!(parsed(call.arguments()), Command::Detached(call));
    }
}
