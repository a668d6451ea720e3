//! What of an experiment does not fit together.

use super::{CommandExperiment, Compare, PREFIX, Placeholder, argument, node};
use crate::{layout, settings::SettingsProblem, topology::Topology};

impl CommandExperiment {
    /// What does not fit together, on that network.
    #[must_use]
    pub fn problems(&self, topology: &Topology) -> Vec<SettingsProblem> {
        let mut found = self.problems_of_size();
        found.extend(self.problems_of_commands(topology));
        found.extend(self.problems_of_nodes(topology));
        found.extend(self.problems_of_windows());
        for (at, metric) in self.metrics.iter().enumerate() {
            let before = self.metrics.get(..at).unwrap_or_default();
            if before.iter().any(|other| other.name == metric.name) {
                let message = format!("two metrics are called `{}`", metric.name);
                let hint = "give each metric a name of its own";
                found.push(of_experiment(format!("metrics.{at}.name"), message, hint));
            }
            if let Some((field, message, hint)) = metric.problem() {
                found.push(of_experiment(format!("metrics.{at}.{field}"), message, hint));
            }
        }
        for (at, file) in self.files.iter().enumerate().filter(|(_, file)| !is_below(file)) {
            let message = format!("`{file}` is not below the matrix file's folder");
            let hint = "copy it into the folder of the matrix file";
            found.push(of_experiment(format!("files.{at}"), message, hint));
        }
        for (name, value) in &self.parameters {
            if !argument::is_parameter(name) {
                let message = format!("`{name}` cannot be a parameter's name");
                let hint = "use letters, digits, `_` and `-`, a letter first";
                found.push(of_experiment("parameters", message, hint));
            }
            if value.contains('\0') || value.len() > argument::LONGEST {
                let message = format!("the value of `{name}` cannot be an argument of a command");
                let hint = "write a shorter text without control characters";
                found.push(of_experiment(format!("parameters.{name}"), message, hint));
            }
        }
        if self.retries > Self::MOST_RETRIES {
            let message = format!("{} retries are more than {}", self.retries, Self::MOST_RETRIES);
            let hint = "find out why environments break: `matrix status RUN` lists what broke";
            found.push(of_experiment("retries", message, hint));
        }
        found
    }

    /// Windows that are none.
    fn problems_of_windows(&self) -> Vec<SettingsProblem> {
        let mut found = Vec::new();
        let mut problem = |path: &str, message: &str, hint| found.push(of_experiment(path, message, hint));
        let window = &self.window;
        if window.timeout.duration().is_zero() {
            let hint = "write a longer time, such as `10min`";
            problem("window.timeout", "a command cannot end in no time", hint);
        }
        if let Some(length) = window.length.filter(|length| *length < Self::SHORTEST) {
            let message = format!("a window of {length} is shorter than {}", Self::SHORTEST);
            problem("window.length", &message, "write a longer time, such as `10s`");
        }
        match (window.continuous, window.length) {
            (true, None) => {
                let message = "the windows of a continuous command have no length";
                problem("window.continuous", message, "write it, such as `length: 10s`");
            }
            (false, Some(_)) => {
                let message = "a window that is a call is as long as the call";
                let hint =
                    "take `length` out, or write `continuous: true` for one call that lasts for all windows";
                problem("window.length", message, hint);
            }
            _ => {}
        }
        if window.continuous && !self.nodes.is_empty() {
            let message = "nodes are started anew in each window";
            let hint = "take `continuous` out, or write the command as `run`";
            problem("window.continuous", message, hint);
        }
        let metrics = self.metrics.iter().enumerate();
        for (at, metric) in metrics.filter(|(_, it)| window.continuous && it.compare == Compare::Identical) {
            let message = format!(
                "`{}` compares whole files, and those of a continuous command grow",
                metric.name
            );
            let hint = "write `compare: ks`, or take `continuous` out";
            problem(&format!("metrics.{at}.compare"), &message, hint);
        }
        found
    }

    /// More of something than any experiment has, or nothing.
    fn problems_of_size(&self) -> Vec<SettingsProblem> {
        let mut found = Vec::new();
        let mut problem = |path: &str, message: &str, hint| found.push(of_experiment(path, message, hint));
        if self.run.is_empty() && self.nodes.is_empty() {
            let hint = "write a program and its arguments as a list, such as `run: [python3, sim/reach.py]`";
            problem("run", "there is no command to run", hint);
        }
        if self.metrics.is_empty() {
            let hint = "write what a window measures, such as `- {name: error, unit: mm, from: errors.csv, column: error}`";
            problem("metrics", "nothing is measured", hint);
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
                &message,
                "put some of them into a file that the command reads",
            );
        }
        let bytes = serde_json::to_string(self).map_or(0, |text| text.len());
        if bytes > Self::LONGEST {
            let message = format!(
                "the experiment is {bytes} bytes long, more than {}",
                Self::LONGEST
            );
            let hint = "put long texts into files that the command reads";
            found.push(SettingsProblem::of(PREFIX, message, hint));
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
                found.extend(
                    refused.map(|(message, hint)| of_experiment(format!("{path}.{at}"), message, hint)),
                );
            }
        }
        found
    }

    /// Nodes that do not fit together, or do not fit the rest.
    fn problems_of_nodes(&self, topology: &Topology) -> Vec<SettingsProblem> {
        let mut found = Vec::new();
        if !self.nodes.is_empty() && !self.run.is_empty() {
            let message = "an experiment has a command for each window or nodes, not both";
            let hint = "take `run` out, or make it one of the nodes";
            found.push(of_experiment("run", message, hint));
        }
        if self.nodes.is_empty() && self.ros_master.is_some() {
            let message = "there are no nodes that a ROS master could be for";
            let hint = "take `ros_master` out, or write `nodes:`";
            found.push(of_experiment("ros_master", message, hint));
        }
        if !self.nodes.is_empty() {
            let of_nodes = node::problems(&self.nodes, self.ros_master.as_ref(), topology);
            found.extend(
                of_nodes
                    .into_iter()
                    .map(|(path, message, hint)| of_experiment(path, message, hint)),
            );
            let captures: Vec<String> = topology.names().map(|host| layout::capture(&host)).collect();
            for (at, metric) in self
                .metrics
                .iter()
                .enumerate()
                .filter(|(_, it)| captures.contains(&it.from))
            {
                let message = format!("`{}` is a file that `matrix` writes", metric.from);
                let hint = "let the node write to a file of another name";
                found.push(of_experiment(format!("metrics.{at}.from"), message, hint));
            }
        }
        found
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

/// A problem of that setting of the experiment.
fn of_experiment(
    path: impl std::fmt::Display,
    message: impl Into<String>,
    hint: impl Into<String>,
) -> SettingsProblem {
    SettingsProblem::of(format!("{PREFIX}.{path}"), message, hint)
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
