//! An experiment of the user's own: the `experiment:` section of a matrix file. It is a command that is run for each window; what it
//! writes is the window's sample. docs/your-experiment.md is the user's description. The main type is [`CommandExperiment`].

mod argument;
mod metric;
mod node;
mod values;

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

pub use self::{
    argument::{Argument, Placeholder, Values, WindowValues},
    metric::{Compare, Metric},
    node::{NodeSettings, Ready, RosMasterSettings},
    values::{MOST_VALUES, ValueError, read_values},
};
use crate::{layout, name::name, quantity::TimeSpan, settings::SettingsProblem, topology::Topology};

/// A command, what it needs, and what it measures.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct CommandExperiment {
    /// Its name, in reports and in files.
    #[serde(deserialize_with = "name")]
    pub name: String,
    /// Files and folders of the command, relative to the folder of the matrix file. They are copied into each environment, where the
    /// commands are run beside them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub files: Vec<String>,
    /// A command that is run once in each environment, before its windows: a program and its arguments, without a shell.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub prepare: Vec<Argument>,
    /// A command that is run once in each environment, after its windows, whatever became of them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub restore: Vec<Argument>,
    /// How often `matrix` measures the missing windows of an errored scenario again, each time in a new environment. A window that was
    /// measured is never measured again.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub retries: u32,
    /// Whether the first window that does not count ends its scenario, which then has failed.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub fail_fast: bool,
    /// The command that is run for each window: a program and its arguments, without a shell. Exit code 0 makes a window.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub run: Vec<Argument>,
    /// Programs that are started in each window on hosts of an emulated network, in place of `run`. The window ends with the last of
    /// those that are not in the background.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub nodes: Vec<NodeSettings>,
    /// A ROS master for the nodes, started anew in each window. Left out, there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ros_master: Option<RosMasterSettings>,
    /// What a window is.
    #[serde(default)]
    pub window: CommandWindow,
    /// Values for `{parameters.NAME}`. Each can be an axis, as `parameters.NAME`.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    #[cfg_attr(feature = "schema", schemars(with = "BTreeMap<String, argument::Scalar>"))]
    pub parameters: BTreeMap<String, String>,
    /// What is measured, at least one.
    pub metrics: Vec<Metric>,
}

/// A window of a command: one call, or a stretch of one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct CommandWindow {
    /// How long the command may take. One that takes longer is ended with all that it started, and its window does not count.
    pub timeout: TimeSpan,
    /// Whether one call lasts for all windows of an environment. A window then has the rows that were added to the metrics' files in
    /// its time, and the call is asked to end after the last.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub continuous: bool,
    /// How long a window of a continuous command is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub length: Option<TimeSpan>,
}

impl CommandWindow {
    /// How long a window takes at most.
    #[must_use]
    pub fn longest(&self) -> TimeSpan {
        self.length.unwrap_or(self.timeout)
    }
}

impl Default for CommandWindow {
    fn default() -> Self {
        Self {
            timeout: TimeSpan::from_secs(600),
            continuous: false,
            length: None,
        }
    }
}

/// The path of each setting that a problem may be about.
const PREFIX: &str = "experiment";

impl CommandExperiment {
    /// The name of the section in a matrix file, and of the setting.
    pub const SECTION: &str = PREFIX;
    /// It is handed to the workload as an argument of a program, which the kernel bounds by 128 KiB.
    const LONGEST: usize = 48 << 10;
    /// A file that a metric is read from is no longer, in bytes.
    pub const LONGEST_FILE: u64 = 1 << 30;
    /// A line of a file with values is no longer, in bytes.
    pub const LONGEST_LINE: u64 = 1 << 20;
    /// More retries hide a machine that does not work.
    const MOST_RETRIES: u32 = 10;
    /// A window is cut by a process that sleeps: some milliseconds are no window.
    const SHORTEST: TimeSpan = TimeSpan::from_millis(100);
    /// More files, arguments, parameters or metrics no experiment has.
    pub const MOST: usize = 100;

    /// How long a command may take if nothing is said.
    #[must_use]
    pub fn default_timeout() -> TimeSpan {
        CommandWindow::default().timeout
    }

    /// What does not fit together, on that network.
    #[must_use]
    pub fn problems(&self, topology: &Topology) -> Vec<SettingsProblem> {
        let mut found = self.problems_of_size();
        found.extend(self.problems_of_commands(topology));
        found.extend(self.problems_of_nodes(topology));
        found.extend(self.problems_of_windows());
        let problem = |path: String, (message, hint): (String, &str)| SettingsProblem {
            path: format!("{PREFIX}.{path}").into(),
            message,
            hint: hint.to_owned(),
        };
        for (at, metric) in self.metrics.iter().enumerate() {
            let before = self.metrics.get(..at).unwrap_or_default();
            if before.iter().any(|other| other.name == metric.name) {
                let message = format!("two metrics are called `{}`", metric.name);
                let hint = "give each metric a name of its own";
                found.push(problem(format!("metrics.{at}.name"), (message, hint)));
            }
            if let Some((field, message, hint)) = metric.problem() {
                found.push(problem(format!("metrics.{at}.{field}"), (message, hint)));
            }
        }
        for (at, file) in self.files.iter().enumerate().filter(|(_, file)| !is_below(file)) {
            let message = format!("`{file}` is not below the matrix file's folder");
            let hint = "copy it into the folder of the matrix file";
            found.push(problem(format!("files.{at}"), (message, hint)));
        }
        for (name, value) in &self.parameters {
            if !argument::is_parameter(name) {
                let message = format!("`{name}` cannot be a parameter's name");
                let hint = "use letters, digits, `_` and `-`, a letter first";
                found.push(problem("parameters".to_owned(), (message, hint)));
            }
            if value.contains('\0') || value.len() > argument::LONGEST {
                let message = format!("the value of `{name}` cannot be an argument of a command");
                let hint = "write a shorter text without control characters";
                found.push(problem(format!("parameters.{name}"), (message, hint)));
            }
        }
        if self.retries > Self::MOST_RETRIES {
            let message = format!("{} retries are more than {}", self.retries, Self::MOST_RETRIES);
            let hint = "find out why environments break: `matrix status RUN` lists what broke";
            found.push(problem("retries".to_owned(), (message, hint)));
        }
        found
    }

    /// Windows that are none.
    fn problems_of_windows(&self) -> Vec<SettingsProblem> {
        let mut found = Vec::new();
        let window = &self.window;
        if window.timeout.duration().is_zero() {
            let hint = "write a longer time, such as `10min`";
            found.push((
                "window.timeout".to_owned(),
                "a command cannot end in no time".to_owned(),
                hint,
            ));
        }
        if let Some(length) = window.length.filter(|length| *length < Self::SHORTEST) {
            let message = format!("a window of {length} is shorter than {}", Self::SHORTEST);
            found.push((
                "window.length".to_owned(),
                message,
                "write a longer time, such as `10s`",
            ));
        }
        match (window.continuous, window.length) {
            (true, None) => {
                let message = "the windows of a continuous command have no length".to_owned();
                found.push((
                    "window.continuous".to_owned(),
                    message,
                    "write it, such as `length: 10s`",
                ));
            }
            (false, Some(_)) => {
                let message = "a window that is a call is as long as the call".to_owned();
                let hint =
                    "take `length` out, or write `continuous: true` for one call that lasts for all windows";
                found.push(("window.length".to_owned(), message, hint));
            }
            _ => {}
        }
        if window.continuous && !self.nodes.is_empty() {
            let message = "nodes are started anew in each window".to_owned();
            let hint = "take `continuous` out, or write the command as `run`";
            found.push(("window.continuous".to_owned(), message, hint));
        }
        let metrics = self.metrics.iter().enumerate();
        for (at, metric) in metrics.filter(|(_, it)| window.continuous && it.compare == Compare::Identical) {
            let message = format!(
                "`{}` compares whole files, and those of a continuous command grow",
                metric.name
            );
            let hint = "write `compare: ks`, or take `continuous` out";
            found.push((format!("metrics.{at}.compare"), message, hint));
        }
        let problem = |(path, message, hint): (String, String, &str)| SettingsProblem {
            path: format!("{PREFIX}.{path}").into(),
            message,
            hint: hint.to_owned(),
        };
        found.into_iter().map(problem).collect()
    }

    /// More of something than any experiment has, or nothing.
    fn problems_of_size(&self) -> Vec<SettingsProblem> {
        let mut found = Vec::new();
        let mut problem = |path: &str, message: String, hint: &str| {
            let path = [PREFIX, path].join(".").trim_end_matches('.').to_owned();
            found.push(SettingsProblem {
                path: path.into(),
                message,
                hint: hint.to_owned(),
            });
        };
        if self.run.is_empty() && self.nodes.is_empty() {
            let hint = "write a program and its arguments as a list, such as `run: [python3, sim/reach.py]`";
            problem("run", "there is no command to run".to_owned(), hint);
        }
        if self.metrics.is_empty() {
            let hint = "write what a window measures, such as `- {name: error, unit: mm, from: errors.csv, column: error}`";
            problem("metrics", "nothing is measured".to_owned(), hint);
        }
        let counts = [
            ("files", self.files.len()),
            (layout::PREPARE, self.prepare.len()),
            (layout::RESTORE, self.restore.len()),
            ("run", self.run.len()),
            ("nodes", self.nodes.len()),
            ("parameters", self.parameters.len()),
            ("metrics", self.metrics.len()),
        ];
        for (path, count) in counts.into_iter().filter(|(_, count)| *count > Self::MOST) {
            let message = format!("{count} are more than {}", Self::MOST);
            problem(
                path,
                message,
                "put some of them into a file that the command reads",
            );
        }
        let bytes = serde_json::to_string(self).map_or(0, |text| text.len());
        if bytes > Self::LONGEST {
            let message = format!(
                "the experiment is {bytes} bytes long, more than {}",
                Self::LONGEST
            );
            problem("", message, "put long texts into files that the command reads");
        }
        found
    }

    /// Placeholders without a value.
    fn problems_of_commands(&self, topology: &Topology) -> Vec<SettingsProblem> {
        let mut found = Vec::new();
        let hooks = [(layout::PREPARE, &self.prepare), (layout::RESTORE, &self.restore)];
        let hooks = hooks
            .into_iter()
            .map(|(name, command)| (name.to_owned(), command, Runs::Once(name)));
        let runs = if self.window.continuous {
            Runs::Throughout
        } else {
            Runs::InWindows
        };
        let run = ("run".to_owned(), &self.run, runs);
        let nodes = self.nodes.iter().enumerate();
        let nodes = nodes.map(|(at, node)| (format!("nodes.{at}.run"), &node.run, Runs::OnHosts(topology)));
        for (path, command, runs) in hooks.chain([run]).chain(nodes) {
            for (at, argument) in command.iter().enumerate() {
                let refused = argument
                    .placeholders()
                    .filter_map(|placeholder| self.refusal(runs, placeholder));
                found.extend(refused.map(|(message, hint)| SettingsProblem {
                    path: format!("{PREFIX}.{path}.{at}").into(),
                    message,
                    hint,
                }));
            }
        }
        found
    }

    /// Nodes that do not fit together, or do not fit the rest.
    fn problems_of_nodes(&self, topology: &Topology) -> Vec<SettingsProblem> {
        let mut found = Vec::new();
        if !self.nodes.is_empty() && !self.run.is_empty() {
            let message = "an experiment has a command for each window or nodes, not both".to_owned();
            let hint = "take `run` out, or make it one of the nodes".to_owned();
            found.push(("run".to_owned(), message, hint));
        }
        if self.nodes.is_empty() && self.ros_master.is_some() {
            let message = "there are no nodes that a ROS master could be for".to_owned();
            let hint = "take `ros_master` out, or write `nodes:`".to_owned();
            found.push(("ros_master".to_owned(), message, hint));
        }
        if !self.nodes.is_empty() {
            found.extend(node::problems(&self.nodes, self.ros_master.as_ref(), topology));
            let captures: Vec<String> = topology.names().map(|host| layout::capture(&host)).collect();
            for (at, metric) in self
                .metrics
                .iter()
                .enumerate()
                .filter(|(_, it)| captures.contains(&it.from))
            {
                let message = format!("`{}` is a file that `matrix` writes", metric.from);
                let hint = "let the node write to a file of another name".to_owned();
                found.push((format!("metrics.{at}.from"), message, hint));
            }
        }
        let problem = |(path, message, hint)| SettingsProblem {
            path: format!("{PREFIX}.{path}").into(),
            message,
            hint,
        };
        found.into_iter().map(problem).collect()
    }

    /// The files of a window beside its record that `matrix` writes, on that network.
    #[must_use]
    pub fn files_of_matrix(&self, topology: &Topology) -> BTreeSet<String> {
        if self.nodes.is_empty() {
            return [layout::STDOUT, layout::STDERR].map(str::to_owned).into();
        }
        let printed = self.nodes.iter().flat_map(|node| layout::printed_by(&node.name));
        printed
            .chain(topology.names().map(|host| layout::capture(&host)))
            .collect()
    }

    /// The names of the files that its metrics are read from, each once.
    #[must_use]
    pub fn measured_files(&self) -> BTreeSet<&str> {
        self.metrics.iter().map(|metric| metric.from.as_str()).collect()
    }

    /// Why a placeholder has no value, and what to write.
    fn refusal(&self, runs: Runs<'_>, placeholder: &Placeholder) -> Option<(String, String)> {
        match placeholder {
            Placeholder::HostAddress(host) => match runs {
                Runs::OnHosts(topology) if topology.position(*host).is_some() => None,
                Runs::OnHosts(topology) => {
                    let hosts: Vec<String> = topology.names().map(|name| name.to_string()).collect();
                    let hint = format!(
                        "write one of {}, or add it to `workload.network.hosts`",
                        hosts.join(", ")
                    );
                    Some((format!("the network has no host `{host}`"), hint))
                }
                _ => Some((
                    format!("`{placeholder}` has no value where there is no network"),
                    "write it in a command of `nodes:`".to_owned(),
                )),
            },
            Placeholder::Parameter(name) if !self.parameters.contains_key(name) => {
                let known: Vec<&str> = self.parameters.keys().map(String::as_str).collect();
                let hint = match known.as_slice() {
                    [] => format!("write it under `parameters:`, such as `parameters: {{{name}: 1}}`"),
                    known => format!(
                        "write it under `parameters:`; these are there: {}",
                        known.join(", ")
                    ),
                };
                Some((format!("there is no parameter `{name}`"), hint))
            }
            Placeholder::Parameter(_) => None,
            of_window => match runs {
                Runs::Once(command) => Some((
                    format!("`{of_window}` has no value in `{command}`, which runs once for all windows"),
                    "write it in `run`, or leave it out".to_owned(),
                )),
                Runs::Throughout if *of_window == Placeholder::WindowNumber => Some((
                    format!("`{of_window}` has no value in a command that lasts for all windows"),
                    "leave it out: `matrix` cuts the windows".to_owned(),
                )),
                _ => None,
            },
        }
    }
}

/// When and where a command runs, which decides what its placeholders may be.
#[derive(Clone, Copy)]
enum Runs<'a> {
    /// Once, as the hook of that name.
    Once(&'static str),
    /// In each window.
    InWindows,
    /// Once, for all windows.
    Throughout,
    /// In each window, on hosts of that network.
    OnHosts(&'a Topology),
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
const fn is_zero(retries: &u32) -> bool {
    *retries == 0
}

/// The seed of a window, for `{window.seed}`: from 0 to 2³¹ − 1, the same for windows of the same number in every scenario, so that
/// what they compute can be compared byte for byte.
#[must_use]
pub const fn seed_of(window: u32) -> u32 {
    // SplitMix64's finalizer (Steele, Lea and Flood, 2014): neighbouring windows have seeds that have nothing in common.
    let mut z = (window as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    ((z ^ (z >> 31)) >> 33) as u32
}

/// Whether a path is relative and leaves its folder nowhere on its way.
fn is_below(path: &str) -> bool {
    let mut parts = std::path::Path::new(path).components();
    !path.is_empty()
        && parts.all(|part| {
            matches!(
                part,
                std::path::Component::Normal(_) | std::path::Component::CurDir
            )
        })
}

#[cfg(test)]
mod tests {
    use rstest::rstest;
    use serde_json::{Value, json};

    use super::*;
    use crate::settings::NetworkSettings;

    fn reach() -> Value {
        json!({
            "name": "arm-reach",
            "files": ["sim/"],
            "prepare": ["./setup.sh", "{parameters.solver}"],
            "run": ["python3", "sim/reach.py", "--steps", "{parameters.steps}", "--seed={window.seed}", "{window.folder}"],
            "parameters": {"steps": "5000", "solver": "newton"},
            "metrics": [
                {"name": "reach_error", "unit": "mm", "from": "errors.csv", "column": "error"},
                {"name": "final_state", "from": "state.txt", "compare": "identical"},
            ],
        })
    }

    fn with(edit: impl FnOnce(&mut Value)) -> Vec<(String, String)> {
        let mut experiment = reach();
        edit(&mut experiment);
        let experiment: CommandExperiment = serde_json::from_value(experiment).unwrap();
        let found = experiment
            .problems(&NetworkSettings::default().topology())
            .into_iter();
        found
            .map(|problem| (problem.path.into_owned(), problem.message))
            .collect()
    }

    #[test]
    fn an_experiment_is_written_as_it_was_read() {
        let experiment: CommandExperiment = serde_json::from_value(reach()).unwrap();
        assert_eq!(experiment.problems(&NetworkSettings::default().topology()), []);
        assert_eq!(experiment.window.timeout, TimeSpan::from_secs(600));
        let written = serde_json::to_value(&experiment).unwrap();
        assert_eq!(written["run"], reach()["run"]);
        assert_eq!(
            serde_json::from_value::<CommandExperiment>(written).unwrap(),
            experiment
        );
    }

    #[rstest]
    #[case::no_command(|it: &mut Value| it["run"] = json!([]), "experiment.run", "there is no command to run")]
    #[case::no_metric(|it: &mut Value| it["metrics"] = json!([]), "experiment.metrics", "nothing is measured")]
    #[case::no_such_parameter(
        |it: &mut Value| it["run"] = json!(["a", "{parameters.seed}"]), "experiment.run.1", "there is no parameter `seed`"
    )]
    #[case::before_the_windows(
        |it: &mut Value| it["prepare"] = json!(["a", "{window.seed}"]),
        "experiment.prepare.1", "`{window.seed}` has no value in `prepare`, which runs once for all windows"
    )]
    #[case::twice(
        |it: &mut Value| it["metrics"][1]["name"] = json!("reach_error"),
        "experiment.metrics.1.name", "two metrics are called `reach_error`"
    )]
    #[case::outside(
        |it: &mut Value| it["files"] = json!(["../secret"]), "experiment.files.0", "`../secret` is not below the matrix file's folder"
    )]
    #[case::root(|it: &mut Value| it["files"] = json!(["/etc"]), "experiment.files.0", "`/etc` is not below the matrix file's folder")]
    #[case::name_of_a_parameter(
        |it: &mut Value| it["parameters"]["a b"] = json!("1"), "experiment.parameters", "`a b` cannot be a parameter's name"
    )]
    #[case::no_length(
        |it: &mut Value| { it["window"] = json!({"continuous": true}); it["metrics"].as_array_mut().unwrap().pop(); },
        "experiment.window.continuous", "the windows of a continuous command have no length"
    )]
    #[case::length_of_a_call(
        |it: &mut Value| it["window"] = json!({"length": "10s"}), "experiment.window.length", "a window that is a call is as long as the call"
    )]
    #[case::short(
        |it: &mut Value| { it["window"] = json!({"continuous": true, "length": "1ms"}); it["metrics"].as_array_mut().unwrap().pop(); },
        "experiment.window.length", "a window of 1ms is shorter than 100ms"
    )]
    #[case::grows(
        |it: &mut Value| it["window"] = json!({"continuous": true, "length": "10s"}), "experiment.metrics.1.compare",
        "`final_state` compares whole files, and those of a continuous command grow"
    )]
    #[case::number_of_all(
        |it: &mut Value| {
            it["window"] = json!({"continuous": true, "length": "10s"});
            it["metrics"].as_array_mut().unwrap().pop();
            it["run"] = json!(["a", "{window.number}"]);
        },
        "experiment.run.1", "`{window.number}` has no value in a command that lasts for all windows"
    )]
    #[case::no_time(
        |it: &mut Value| it["window"] = json!({"timeout": "0s"}), "experiment.window.timeout", "a command cannot end in no time"
    )]
    #[case::no_network(
        |it: &mut Value| it["run"] = json!(["a", "{hosts.h1.address}"]),
        "experiment.run.1", "`{hosts.h1.address}` has no value where there is no network"
    )]
    #[case::both(|it: &mut Value| it["nodes"] = json!([nodes()[1]]), "experiment.run", "an experiment has a command for each window or nodes, not both")]
    #[case::master_of_nobody(
        |it: &mut Value| it["ros_master"] = json!({}), "experiment.ros_master", "there are no nodes that a ROS master could be for"
    )]
    #[case::many(
        |it: &mut Value| it["files"] = json!(vec!["a"; 101]), "experiment.files", "101 are more than 100"
    )]
    fn what_does_not_fit_together_is_found(
        #[case] edit: fn(&mut Value),
        #[case] path: &str,
        #[case] message: &str,
    ) {
        assert_eq!(with(edit), [(path.to_owned(), message.to_owned())]);
    }

    fn nodes() -> Value {
        json!([
            {"name": "plant", "host": "sta2", "run": ["./plant"], "ready": {"topic": "/state"}, "background": true},
            {"name": "controller", "host": "sta1", "run": ["./controller", "{hosts.sta2.address}", "{window.seed}"]},
        ])
    }

    fn with_nodes(edit: impl FnOnce(&mut Value)) -> Vec<(String, String)> {
        with(|it| {
            it["run"] = json!([]);
            it["nodes"] = nodes();
            it["ros_master"] = json!({"program": "rosmaster"});
            edit(it);
        })
    }

    #[test]
    fn nodes_are_an_experiment() {
        assert_eq!(with_nodes(|_| ()), []);
    }

    #[rstest]
    #[case::host(|it: &mut Value| it["nodes"][0]["host"] = json!("sta3"), "experiment.nodes.0.host", "the network has no host `sta3`")]
    #[case::address(
        |it: &mut Value| it["nodes"][1]["run"][1] = json!("{hosts.base.address}"), "experiment.nodes.1.run.1",
        "the network has no host `base`"
    )]
    #[case::twice(|it: &mut Value| it["nodes"][1]["name"] = json!("plant"), "experiment.nodes.1.name", "two nodes are called `plant`")]
    #[case::nothing(|it: &mut Value| it["nodes"][0]["run"] = json!([]), "experiment.nodes.0.run", "there is no program to start")]
    #[case::endless(
        |it: &mut Value| it["nodes"][1]["background"] = json!(true), "experiment.nodes",
        "all nodes are in the background, and nothing ends the window"
    )]
    #[case::no_master(
        |it: &mut Value| { it.as_object_mut().unwrap().remove("ros_master"); }, "experiment.nodes.0.ready",
        "there is no ROS master that could know a topic"
    )]
    #[case::topic(
        |it: &mut Value| it["nodes"][0]["ready"] = json!({"topic": "state"}), "experiment.nodes.0.ready", "that is no topic of ROS"
    )]
    #[case::port(|it: &mut Value| it["nodes"][0]["ready"] = json!({"port": 0}), "experiment.nodes.0.ready", "that is no port")]
    #[case::line(
        |it: &mut Value| it["nodes"][0]["ready"] = json!({"line": " "}), "experiment.nodes.0.ready", "no line is known by that text"
    )]
    #[case::master(
        |it: &mut Value| it["ros_master"] = json!({"host": "h2"}), "experiment.ros_master.host", "the network has no host `h2`"
    )]
    #[case::capture(
        |it: &mut Value| it["metrics"][0]["from"] = json!("sta1.pcap"), "experiment.metrics.0.from",
        "`sta1.pcap` is a file that `matrix` writes"
    )]
    #[case::printed(
        |it: &mut Value| it["metrics"][0]["from"] = json!("plant.stdout.txt"), "experiment.metrics.0.from",
        "`plant.stdout.txt` is a file that `matrix` writes"
    )]
    fn what_nodes_cannot_be_is_found(
        #[case] edit: fn(&mut Value),
        #[case] path: &str,
        #[case] message: &str,
    ) {
        assert_eq!(with_nodes(edit), [(path.to_owned(), message.to_owned())]);
    }

    #[test]
    fn a_window_has_the_same_seed_everywhere_and_no_other_window_has_it() {
        assert_eq!(seed_of(1), seed_of(1));
        let seeds: BTreeSet<u32> = (1..=10_000).map(seed_of).collect();
        assert_eq!(seeds.len(), 10_000);
        assert!(seeds.iter().all(|seed| *seed < 1 << 31));
    }
}
