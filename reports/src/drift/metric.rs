//! What is followed from night to night. The main type is [`Metric`].

use record::{
    experiment::{self, Compare},
    name::is_name,
    report_settings::TRACKING_ERROR,
};
use serde::{Deserialize, Serialize};

use crate::analysis::quantity::Quantity;

/// What is followed.
#[derive(Debug, Clone, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub enum Metric {
    /// The mean error of a window's periods, in metres.
    #[default]
    TrackingError,
    /// How old the state was when the controller used it, the mean of a window, in seconds: what network and ROS take.
    StateAge,
    /// How long packets were under way, the mean of a window's in both directions, in seconds: what the network takes.
    PacketDelay,
    /// How late the controller's steps began, 99 % of a window's, in seconds.
    Lateness,
    /// How long it took to make an environment, in seconds.
    Provisioning,
    /// A metric of a user's command: the mean of a window's values.
    OfCommand {
        /// Its name.
        name: String,
        /// The unit of its values; empty for numbers without one.
        unit: String,
    },
    /// A metric of a user's command that is compared byte for byte.
    Content {
        /// Its name.
        name: String,
    },
}

impl Metric {
    /// Those that have a name of ours.
    pub const OURS: [Self; 5] = [
        Self::TrackingError,
        Self::StateAge,
        Self::PacketDelay,
        Self::Lateness,
        Self::Provisioning,
    ];

    /// The one that a report's metric is followed by.
    #[must_use]
    pub fn of(quantity: &Quantity) -> Self {
        let name = || quantity.name.clone();
        match quantity.compare {
            _ if quantity.is_tracking_error => Self::TrackingError,
            Compare::Identical => Self::Content { name: name() },
            Compare::Ks => Self::OfCommand {
                name: name(),
                unit: quantity.unit.clone(),
            },
        }
    }

    /// Its name in reports and in files of acknowledgements.
    #[must_use]
    pub fn name(&self) -> &str {
        match self {
            Self::TrackingError => TRACKING_ERROR,
            Self::StateAge => "state-age",
            Self::PacketDelay => "packet-delay",
            Self::Lateness => "lateness",
            Self::Provisioning => experiment::Metric::PROVISIONING,
            Self::OfCommand { name, .. } | Self::Content { name } => name,
        }
    }

    /// Whether an experiment is about it; the others are followed beside it.
    #[must_use]
    pub const fn is_of_experiment(&self) -> bool {
        matches!(
            self,
            Self::TrackingError | Self::OfCommand { .. } | Self::Content { .. }
        )
    }

    /// A value as text, with its unit.
    #[must_use]
    pub fn text(&self, value: f64) -> String {
        match self {
            Self::TrackingError => format!("{:.3} mm", value * 1e3),
            Self::StateAge | Self::PacketDelay | Self::Lateness => format!("{:.3} ms", value * 1e3),
            Self::Provisioning if value.abs() < 1.0 => format!("{:.1} ms", value * 1e3),
            Self::Provisioning => format!("{value:.3} s"),
            Self::OfCommand { unit, .. } => {
                let digits = match value.abs() {
                    small if small > 0.0 && small < 0.000_5 => format!("{value:.3e}"),
                    large if large >= 99_999.5 => format!("{value:.3e}"),
                    _ => format!("{value:.3}"),
                };
                format!("{digits} {unit}").trim_end().to_owned()
            }
            Self::Content { .. } => value.to_string(),
        }
    }

    /// What its values can be told apart by, in its unit: the journal's stamps are to the millisecond, and one of them ends and one
    /// begins what is provisioned.
    #[must_use]
    pub const fn resolution(&self) -> f64 {
        match self {
            Self::Provisioning => 0.002,
            _ => 0.0,
        }
    }

    /// The unit of its values.
    #[must_use]
    pub fn unit(&self) -> &str {
        match self {
            Self::TrackingError => "m",
            Self::StateAge | Self::PacketDelay | Self::Lateness | Self::Provisioning => "s",
            Self::OfCommand { unit, .. } => unit,
            Self::Content { .. } => "",
        }
    }
}

/// How the name of one ends that is compared byte for byte.
const BYTES: &str = " [bytes]";

/// As files have it: a name of ours, or a command's with its unit in parentheses, also where it has none, or with `[bytes]`.
impl From<Metric> for String {
    fn from(metric: Metric) -> Self {
        match metric {
            Metric::OfCommand { name, unit } => format!("{name} ({unit})"),
            Metric::Content { name } => format!("{name}{BYTES}"),
            ours => ours.name().to_owned(),
        }
    }
}

impl TryFrom<String> for Metric {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        if let Some(ours) = Self::OURS.into_iter().find(|metric| metric.name() == text) {
            return Ok(ours);
        }
        if let Some(name) = text.strip_suffix(BYTES).filter(|name| is_name(name)) {
            return Ok(Self::Content {
                name: name.to_owned(),
            });
        }
        let of_command = text.strip_suffix(')').and_then(|text| text.split_once(" ("));
        match of_command.filter(|(name, _)| is_name(name)) {
            Some((name, unit)) => Ok(Self::OfCommand {
                name: name.to_owned(),
                unit: unit.to_owned(),
            }),
            None => Err(format!("`{}` is no metric", text.escape_debug())),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;

    #[test]
    fn a_metric_is_read_as_it_was_written() {
        let of_command = |name: &str, unit: &str| Metric::OfCommand {
            name: name.to_owned(),
            unit: unit.to_owned(),
        };
        // Also one that is called as one of ours, and one whose unit has parentheses.
        let commands = [
            of_command("error", ""),
            of_command("rate", "1/(s m)"),
            of_command("x", "mm"),
            of_command("x", "[bytes]"),
            Metric::Content { name: "x".to_owned() },
        ];
        let all = Metric::OURS.into_iter().chain(commands);
        let all: BTreeMap<Metric, u32> = all.zip(1..).collect();
        let text = serde_json::to_string(&all).unwrap();
        assert_eq!(serde_json::from_str::<BTreeMap<Metric, u32>>(&text).unwrap(), all);
        assert!(
            text.contains(r#""state-age":2"#) && text.contains(r#""error ()":6"#),
            "{text}"
        );
    }

    #[test]
    fn what_is_no_metric_is_refused() {
        for text in ["errors", "a b (mm)", "../x (mm)", " (mm)", " [bytes]"] {
            assert!(Metric::try_from(text.to_owned()).is_err(), "{text}");
        }
    }
}
