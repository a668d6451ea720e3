//! An experiment of the user's own: the `experiment:` section of a matrix file. It is a command that is run for each window; what it
//! writes is the window's sample. docs/your-experiment.md is the user's description. The main type is [`CommandExperiment`].

mod argument;
mod metric;
mod values;

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

pub use self::{
    argument::{Argument, Placeholder, WindowValues},
    metric::{Compare, Metric},
    values::{MOST_VALUES, ValueError, read_values},
};
use crate::{layout, name::name, quantity::TimeSpan, settings::SettingsProblem};

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
    pub run: Vec<Argument>,
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

/// A window of a command: one call.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default)]
pub struct CommandWindow {
    /// How long the command may take. One that takes longer is ended with all that it started, and its window does not count.
    pub timeout: TimeSpan,
}

impl Default for CommandWindow {
    fn default() -> Self {
        Self {
            timeout: TimeSpan::from_secs(600),
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
    /// More retries hide a machine that does not work.
    const MOST_RETRIES: u32 = 10;
    /// More files, arguments, parameters or metrics no experiment has.
    pub const MOST: usize = 100;

    /// What does not fit together.
    #[must_use]
    pub fn problems(&self) -> Vec<SettingsProblem> {
        let mut found = self.problems_of_size();
        found.extend(self.problems_of_commands());
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
        if self.window.timeout.duration().is_zero() {
            let message = "a command cannot end in no time".to_owned();
            let hint = "write a longer time, such as `10min`";
            found.push(problem("window.timeout".to_owned(), (message, hint)));
        }
        found
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
        if self.run.is_empty() {
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
    fn problems_of_commands(&self) -> Vec<SettingsProblem> {
        let mut found = Vec::new();
        let commands = [
            (layout::PREPARE, &self.prepare),
            (layout::RESTORE, &self.restore),
            ("run", &self.run),
        ];
        for (name, command) in commands {
            for (at, argument) in command.iter().enumerate() {
                let refused = argument
                    .placeholders()
                    .filter_map(|placeholder| self.refusal(name, placeholder));
                found.extend(refused.map(|(message, hint)| SettingsProblem {
                    path: format!("{PREFIX}.{name}.{at}").into(),
                    message,
                    hint,
                }));
            }
        }
        found
    }

    /// The names of the files that its metrics are read from, each once.
    #[must_use]
    pub fn measured_files(&self) -> BTreeSet<&str> {
        self.metrics.iter().map(|metric| metric.from.as_str()).collect()
    }

    /// Why a placeholder has no value, and what to write.
    fn refusal(&self, command: &str, placeholder: &Placeholder) -> Option<(String, String)> {
        match placeholder {
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
            of_window if command != "run" => Some((
                format!("`{of_window}` has no value in `{command}`, which runs once for all windows"),
                "write it in `run`, or leave it out".to_owned(),
            )),
            _ => None,
        }
    }
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
        let found = experiment.problems().into_iter();
        found
            .map(|problem| (problem.path.into_owned(), problem.message))
            .collect()
    }

    #[test]
    fn an_experiment_is_written_as_it_was_read() {
        let experiment: CommandExperiment = serde_json::from_value(reach()).unwrap();
        assert_eq!(experiment.problems(), []);
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
    #[case::no_time(
        |it: &mut Value| it["window"] = json!({"timeout": "0s"}), "experiment.window.timeout", "a command cannot end in no time"
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

    #[test]
    fn a_window_has_the_same_seed_everywhere_and_no_other_window_has_it() {
        assert_eq!(seed_of(1), seed_of(1));
        let seeds: BTreeSet<u32> = (1..=10_000).map(seed_of).collect();
        assert_eq!(seeds.len(), 10_000);
        assert!(seeds.iter().all(|seed| *seed < 1 << 31));
    }
}
