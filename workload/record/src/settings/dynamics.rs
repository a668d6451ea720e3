//! Which rules plant, controller and their messages follow: a whole set of settings under one name. The main type is
//! [`Dynamics`]; docs/paper.md says where each rule comes from.

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::{
    ControlSettings, ImpairedFrom, Limit, Limits, LoopSettings, NetworkSettings, PlantSettings,
    RealtimeSettings, ReferenceSettings, RosSettings, Settings, ValiditySettings,
};
use crate::quantity::TimeSpan;

/// A whole set of rules. Each of them is a setting of its own, which can be written beside it and then counts instead.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum Dynamics {
    /// The author's public code as it runs, its mistakes included: text messages without rates, an answering plant,
    /// lost ticks, ordinary scheduling. A platform's timing reaches the error.
    #[default]
    Author,
    /// The paper's equations solved exactly, rates as differences of what was received, each program at its tick.
    Equations,
    /// Rates in the messages, late steps caught up, real-time priority: an error that hardly feels its platform.
    Robust,
}

impl Dynamics {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Author, Self::Equations, Self::Robust];

    /// As a matrix file names it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Author => "author",
            Self::Equations => "equations",
            Self::Robust => "robust",
        }
    }

    /// The one of that name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|dynamics| dynamics.name() == name)
    }
}

/// What the plant publishes, and how both topics are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum Messages {
    /// `std_msgs/String` on `control_action` and `plant_state`: positions and shaft angles with four decimals, and the
    /// time stamp of the command that the state answers. From the author's code.
    Text,
    /// `std_msgs/Float64MultiArray` on `command` and `state`: positions and shaft angles in full precision.
    Positions,
    /// The same, with the rates of both.
    Rates,
}

/// Where the controller's rates come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum Rates {
    /// Backward differences of the states that the controller used, over one step. A state that is used twice has a
    /// rate of zero, and one after a lost state has twice the rate.
    Differenced,
    /// As the plant sent them.
    Sent,
}

/// How motor and ball go from one step to the next.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Discretization {
    /// The difference equations of the author's code, in which the motor is an undamped oscillator and not the
    /// paper's `1/(s(b1 s + b0))`.
    Author,
    /// The exact solution of the paper's equations with the voltage held over the step.
    ZeroOrderHold,
}

/// When the plant publishes its state.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum PlantSends {
    /// When a command arrives: the state of the tick before.
    OnCommand,
    /// At each of its ticks.
    OnTick,
}

/// The sign with which the inner loop takes the shaft's rate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum Feedback {
    /// `+ Kd·θ̇`, as in the author's code.
    Positive,
    /// `− Kd·θ̇`, which damps.
    Negative,
}

/// What comes first in a control step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum StepOrder {
    /// The action that the step before computed is sent; then the newest state is taken and the next action computed.
    SendFirst,
    /// The newest state is taken, and the action computed of it is sent.
    TakeFirst,
}

/// What the reference is evaluated at.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum ReferenceBy {
    /// The clock when the step begins, so that a late step has a later reference.
    Clock,
    /// The step's number, so that all periods have the same values.
    Step,
}

/// What becomes of ticks that fall due while an earlier one has not ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum LateTicks {
    /// All but one are lost, as those of an interval timer (setitimer(2)).
    Lost,
    /// Each is done, one right after the other.
    CaughtUp,
}

/// How the controller's thread waits for its next tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum Waiting {
    /// It looks at the clock again and again, and takes a processor for itself.
    Spin,
    /// It sleeps.
    Sleep,
}

/// Where ROS master, controller and plant run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "lowercase")]
pub enum Processes {
    /// Each is a process.
    Separate,
    /// They are threads of the workload's process.
    Threads,
}

impl Settings {
    /// What is meant by a set of rules when nothing else is written.
    #[must_use]
    pub fn of(dynamics: Dynamics) -> Self {
        match dynamics {
            Dynamics::Author => Self::of_author(),
            Dynamics::Equations => Self::of_equations(),
            Dynamics::Robust => Self::of_robust(),
        }
    }

    fn of_author() -> Self {
        let equations = Self::of_equations();
        Self {
            dynamics: Dynamics::Author,
            plant: PlantSettings {
                discretization: Discretization::Author,
                sends: PlantSends::OnCommand,
                // The shaft's ±52°, which the gear makes the plate's.
                angle_limit_deg: 52.0 / 16.0,
                ..equations.plant
            },
            control: ControlSettings {
                order: StepOrder::SendFirst,
                angle_rate_feedback: Feedback::Positive,
                wanted_limit_deg: Limit::Above(52.0),
                ..equations.control
            },
            ros: RosSettings {
                messages: Messages::Text,
                ..equations.ros
            },
            loops: LoopSettings {
                controller_waits: Waiting::Spin,
                ..equations.loops
            },
            ..equations
        }
    }

    fn of_equations() -> Self {
        let robust = Self::of_robust();
        Self {
            dynamics: Dynamics::Equations,
            reference: ReferenceSettings {
                by: ReferenceBy::Clock,
                ..robust.reference
            },
            control: ControlSettings {
                rates: Rates::Differenced,
                ..robust.control
            },
            network: NetworkSettings {
                impaired_from: ImpairedFrom::Start,
                ..robust.network
            },
            ros: RosSettings {
                messages: Messages::Positions,
                tcp_nodelay: false,
                ..robust.ros
            },
            realtime: RealtimeSettings {
                priority: 0,
                lock_memory: false,
            },
            loops: LoopSettings {
                late_ticks: LateTicks::Lost,
                processes: Processes::Separate,
                ..robust.loops
            },
            // A late step is what is measured here, and no fault of the window. The network emulator shares the processors
            // with it, scheduled as it is.
            validity: ValiditySettings {
                missed_deadlines: Limits::NEVER,
                lateness: Limits::NEVER,
                gap_steps: Limits::NEVER,
                release_lateness: Limits::both(TimeSpan::from_millis(5), TimeSpan::from_millis(10)),
                ..robust.validity
            },
            ..robust
        }
    }

    /// Reads settings that need not be complete. What is left out is as its `dynamics` has it, and where that is left
    /// out too, as `otherwise` has it.
    ///
    /// # Errors
    /// A key or value that is none.
    pub fn from_json(given: Value, otherwise: Dynamics) -> Result<Self, serde_json::Error> {
        let dynamics = match given.get("dynamics") {
            Some(named) => Dynamics::deserialize(named)?,
            None => otherwise,
        };
        let mut whole = serde_json::to_value(Self::of(dynamics))?;
        lay_over(&mut whole, given);
        Self::deserialize(whole)
    }

    /// The settings that are not as their dynamics has them, as dotted paths, in order; those alone that a dynamics
    /// decides.
    #[must_use]
    pub fn overridden(&self) -> Vec<String> {
        let (mine, preset) = (leaves(self), leaves(&Self::of(self.dynamics)));
        let decided: Vec<_> = Dynamics::ALL.map(|dynamics| leaves(&Self::of(dynamics))).into();
        let differs = |path: &String, value: &Value| {
            let by_dynamics = decided.iter().any(|other| other.get(path) != preset.get(path));
            by_dynamics && preset.get(path) != Some(value)
        };
        mine.iter()
            .filter(|(path, value)| differs(path, value))
            .map(|(path, _)| path.clone())
            .collect()
    }
}

/// Settings as a record has them: those without a `dynamics` were written before there was a choice, and are `robust`.
///
/// # Errors
/// What is no setting.
pub fn recorded<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<Settings, D::Error> {
    let given = Value::deserialize(deserializer)?;
    Settings::from_json(given, Dynamics::Robust).map_err(serde::de::Error::custom)
}

/// Settings as somebody asks for them: what is left out is as their `dynamics` has it.
///
/// # Errors
/// What is no setting.
pub fn asked_for<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<Settings, D::Error> {
    let given = Value::deserialize(deserializer)?;
    Settings::from_json(given, Dynamics::default()).map_err(serde::de::Error::custom)
}

/// Lays objects over objects, and replaces everything else.
fn lay_over(base: &mut Value, over: Value) {
    match (base, over) {
        (Value::Object(base), Value::Object(over)) => {
            for (key, value) in over {
                lay_over(base.entry(key).or_insert(Value::Null), value);
            }
        }
        (base, over) => *base = over,
    }
}

/// Every setting that is no section, by its dotted path.
fn leaves(settings: &Settings) -> std::collections::BTreeMap<String, Value> {
    fn collect(prefix: &str, value: Value, found: &mut std::collections::BTreeMap<String, Value>) {
        match value {
            Value::Object(entries) => {
                for (key, value) in entries {
                    let path = if prefix.is_empty() {
                        key
                    } else {
                        format!("{prefix}.{key}")
                    };
                    collect(&path, value, found);
                }
            }
            leaf => drop(found.insert(prefix.to_owned(), leaf)),
        }
    }
    let mut found = std::collections::BTreeMap::new();
    // Plain data can always be written as JSON.
    collect("", serde_json::to_value(settings).unwrap_or_default(), &mut found);
    found.remove("dynamics");
    found
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[rstest::rstest]
    #[case::author(Dynamics::Author)]
    #[case::equations(Dynamics::Equations)]
    #[case::robust(Dynamics::Robust)]
    fn every_dynamics_fits_together_and_overrides_nothing(#[case] dynamics: Dynamics) {
        let settings = Settings::of(dynamics);
        assert_eq!(settings.problems(), Vec::new());
        assert_eq!(settings.overridden(), Vec::<String>::new());
        assert_eq!(Dynamics::named(dynamics.name()), Some(dynamics));
    }

    #[test]
    fn what_is_left_out_is_as_the_named_dynamics_has_it() {
        let given = json!({"dynamics": "robust", "control": {"rates": "differenced"}});
        let settings = Settings::from_json(given, Dynamics::Author).unwrap();
        let mut wanted = Settings::of(Dynamics::Robust);
        wanted.control.rates = Rates::Differenced;
        assert_eq!(settings, wanted);
        assert_eq!(settings.overridden(), ["control.rates"]);
    }

    #[test]
    fn what_every_dynamics_has_alike_is_no_override() {
        let settings = Settings::from_json(json!({"window": "200s"}), Dynamics::Author).unwrap();
        assert_eq!(settings.overridden(), Vec::<String>::new());
    }

    #[test]
    fn a_record_of_before_there_was_a_choice_is_robust() {
        let mut old = serde_json::to_value(Settings::of(Dynamics::Robust)).unwrap();
        let sections = old.as_object_mut().unwrap();
        sections.remove("dynamics");
        sections.remove("loops");
        for (section, new) in [
            ("plant", "discretization"),
            ("plant", "sends"),
            ("control", "rates"),
            ("control", "order"),
            ("control", "angle_rate_feedback"),
            ("control", "wanted_limit_deg"),
            ("reference", "by"),
            ("ros", "messages"),
        ] {
            sections[section].as_object_mut().unwrap().remove(new).unwrap();
        }
        assert_eq!(recorded(old).unwrap(), Settings::of(Dynamics::Robust));
    }

    #[test]
    fn a_dynamics_that_does_not_exist_is_an_error_that_names_those_that_do() {
        let error = Settings::from_json(json!({"dynamics": "autor"}), Dynamics::Author).unwrap_err();
        assert!(
            error.to_string().contains("`author`, `equations`, `robust`"),
            "{error}"
        );
    }
}
