//! Settings of the workload under their dotted paths, such as `network.loss`: what an axis can sweep. The main type is
//! [`Role`].
//!
//! The paths come from the settings' own JSON Schema, so that a new setting can be swept without a word here.

use std::{borrow::Cow, sync::LazyLock};

use record::{
    axis::{HARDWARE, OS, VIRTUALIZATION},
    experiment::CommandExperiment,
    settings::Settings,
    topology::LinkSettings,
};
use serde_json::Value;

use super::spelling::{list, propose};

/// What an axis is for, by its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// Which machine: its hardware.
    Hardware,
    /// Which machine: its operating system.
    Os,
    /// What the environment is made with.
    Virtualization,
    /// A setting of the workload, or a parameter of a user's experiment.
    Sweep,
    /// A name for something that the file does not decide.
    Label,
}

/// Why a name is no axis.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NoAxis {
    /// What is wrong with it.
    pub message: String,
    /// What to write.
    pub help: String,
}

impl Role {
    /// The role of an axis of that name.
    ///
    /// # Errors
    /// A name that looks like the path of a setting and is none.
    pub fn of(name: &str) -> Result<Self, NoAxis> {
        let paths = setting_paths();
        match name {
            HARDWARE => return Ok(Self::Hardware),
            OS => return Ok(Self::Os),
            VIRTUALIZATION => return Ok(Self::Virtualization),
            _ if name.starts_with(PARAMETERS) || LinkSettings::is_path(name) => return Ok(Self::Sweep),
            _ if paths.iter().any(|path| path == name) => return Ok(Self::Sweep),
            _ => {}
        }
        let section = name.split('.').next().unwrap_or_default();
        let within: Vec<&str> = paths
            .iter()
            .map(String::as_str)
            .filter(|path| path.split_once('.').is_some_and(|(first, _)| first == section))
            .collect();
        if !within.is_empty() {
            let (message, help) = if name == section {
                (
                    format!("`{name}` is a section of settings, not a setting"),
                    format!("write one of {}", list(within)),
                )
            } else {
                (format!("there is no setting `{name}`"), propose(name, within))
            };
            return Err(NoAxis { message, help });
        }
        if let Some(path) = name.strip_prefix("workload.") {
            return Err(NoAxis {
                message: format!("`{name}` is written with its section"),
                help: format!("settings are swept by their path within `workload:`: write `{path}`"),
            });
        }
        Ok(Self::Label)
    }
}

/// The axes `parameters.NAME` of a user's experiment.
pub const PARAMETERS: &str = "parameters.";

/// The dotted path, within the settings of the workload, of what an axis of that name sweeps.
pub fn path_of(axis: &str) -> Cow<'_, str> {
    match axis.starts_with(PARAMETERS) {
        true => format!("{}.{axis}", CommandExperiment::SECTION).into(),
        false => axis.into(),
    }
}

/// Names that do something as an axis, for a proposal.
pub fn known_axes() -> impl Iterator<Item = &'static str> + Clone {
    [HARDWARE, OS, VIRTUALIZATION]
        .into_iter()
        .chain(setting_paths().iter().map(String::as_str))
}

/// The dotted path of every setting of the workload.
pub fn setting_paths() -> &'static [String] {
    static PATHS: LazyLock<Vec<String>> = LazyLock::new(|| {
        let schema = schemars::schema_for!(Settings).to_value();
        let mut paths = Vec::new();
        collect(&schema, &schema, "", &mut paths);
        paths
    });
    &PATHS
}

fn collect(root: &Value, schema: &Value, prefix: &str, paths: &mut Vec<String>) {
    for (name, property) in schema
        .get("properties")
        .and_then(Value::as_object)
        .into_iter()
        .flatten()
    {
        // A section that may be left out altogether is this or nothing.
        let target = property
            .get("$ref")
            .or_else(|| property.pointer("/anyOf/0/$ref"))
            .and_then(Value::as_str)
            .and_then(|reference| root.pointer(reference.strip_prefix('#')?))
            .unwrap_or(property);
        let path = format!("{prefix}{name}");
        if target.get("properties").is_some() {
            collect(root, target, &format!("{path}."), paths);
        } else {
            paths.push(path);
        }
    }
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    #[test]
    fn every_setting_has_a_path_even_one_that_is_left_out_by_default() {
        let paths = setting_paths();
        for path in [
            "window",
            "network.loss",
            "network.seed",
            "control.angle.kp",
            "ros.tcp_nodelay",
        ] {
            assert!(paths.iter().any(|known| known == path), "{path} of {paths:?}");
        }
        assert!(!paths.iter().any(|path| path == "network"));
    }

    #[rstest]
    #[case("hardware", Role::Hardware)]
    #[case("network.loss", Role::Sweep)]
    #[case("period", Role::Sweep)]
    #[case("network.hosts.robot.delay", Role::Sweep)]
    #[case("fruit", Role::Label)]
    #[case("fruit.colour", Role::Label)]
    fn an_axis_is_what_its_name_says(#[case] name: &str, #[case] role: Role) {
        assert_eq!(Role::of(name), Ok(role));
    }

    #[rstest]
    #[case("network.los", "did you mean `network.loss`?")]
    #[case("ros", "write one of `ros.master`, `ros.tcp_nodelay`, `ros.messages`")]
    #[case(
        "workload.network.loss",
        "settings are swept by their path within `workload:`: write `network.loss`"
    )]
    fn a_name_that_is_nearly_a_path_is_no_label(#[case] name: &str, #[case] help: &str) {
        assert_eq!(Role::of(name).unwrap_err().help, help);
    }
}
