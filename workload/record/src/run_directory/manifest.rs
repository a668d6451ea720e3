//! `manifest.json`: what was asked. The main type is [`Manifest`].

use std::{fmt, path::PathBuf};

use serde::{Deserialize, Deserializer, Serialize, Serializer};
use serde_json::{Map, Value};

use crate::{connection::Connection, name::name, report_settings::ReportSettings, window::Impossible};

/// What was asked of this run; written once, before anything else happens.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// [`super::FORMAT`] at the time of writing.
    pub format: u32,
    /// The run's name, which is its folder's name at first.
    #[serde(deserialize_with = "name")]
    pub run: String,
    /// When it was asked for, RFC 3339.
    pub created: String,
    /// Version of `matrix`.
    pub matrix_version: String,
    /// The revision of its sources; none where it was built outside of git, and in runs of earlier versions.
    #[serde(default)]
    pub matrix_revision: Option<Revision>,
    /// SHA-256 of the workload binary that was deployed, in hexadecimal.
    pub workload_sha256: String,
    /// The words of the command that asked for it; none in runs of earlier versions and in redacted copies.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub invocation: Vec<String>,
    /// Where the matrix file was.
    pub matrix_file: String,
    /// The matrix file as given.
    pub matrix_text: String,
    /// Its SHA-256, in hexadecimal.
    pub matrix_sha256: String,
    /// The profile that was chosen.
    pub profile: Option<String>,
    /// How the scenarios were put in order: `randomised` or `blocked`. Runs of earlier versions were randomised.
    #[serde(default = "randomised")]
    pub order: String,
    /// Seed of the scenarios' order.
    pub seed: u64,
    /// The settings of each provider by its name, which is a value of the axis `virtualization`. A section is any JSON: only its
    /// provider can read it, which may be one from outside this workspace (`docs/extending.md`).
    pub providers: Map<String, Value>,
    /// The hosts that the matrix file names; none in runs of earlier versions, which were on one machine.
    #[serde(default)]
    pub hosts: Vec<HostRecord>,
    /// Where this machine keeps what is of the run and not in its directory, such as the environments of `native`; none in
    /// runs of earlier versions and in redacted copies.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub state_directory: Option<PathBuf>,
    /// SHA-256 of the packed files of a user's experiment, in hexadecimal; none if it has none, and of the ball on the plate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub experiment_sha256: Option<String>,
    /// How the tables are to be made.
    pub report: ReportSettings,
    /// Whether this is a copy from which names were taken (`reports::redaction`): it can be reported, and not resumed.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub redacted: bool,
}

impl Manifest {
    /// More hosts no matrix file has: one for each scenario.
    pub const MOST_HOSTS: usize = 1000;

    /// Looks whether it is one that `matrix` could have written: it comes from a run directory.
    ///
    /// # Errors
    /// What is not.
    pub fn check(&self) -> Result<(), Impossible> {
        match self.hosts.len() > Self::MOST_HOSTS {
            true => Err(Impossible::count("hosts", self.hosts.len())),
            false => self.report.check(),
        }
    }
}

/// A revision of sources in git.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Revision {
    /// The commit, in hexadecimal.
    pub commit: String,
    /// Whether the program was built of something else than what was committed.
    pub dirty: bool,
}

impl fmt::Display for Revision {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let short: String = self.commit.chars().take(12).collect();
        let changes = if self.dirty {
            " with uncommitted changes"
        } else {
            ""
        };
        write!(f, "{short}{changes}")
    }
}

fn randomised() -> String {
    "randomised".to_owned()
}

/// A host as it was when the run was planned.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct HostRecord {
    /// Its name in the matrix file.
    #[serde(deserialize_with = "name")]
    pub name: String,
    /// How it is reached.
    pub connect: RecordedConnection,
    /// What it is, as `uname -m` says it; empty where it could not be asked.
    pub hardware: String,
    /// `ID` and `VERSION_ID` of its os-release.
    pub os: String,
    /// Its kernel, as `uname -r` says it.
    pub kernel: String,
}

/// How a host was reached, as a manifest has it. Writing it gives what was read.
#[derive(Debug, Clone, PartialEq)]
pub enum RecordedConnection {
    /// As the matrix file said it.
    Known(Connection),
    /// Not said: `null`, in a redacted copy.
    Redacted,
    /// In a way that this version does not know. It is JSON, since nothing but a later version can read it.
    Unknown(Value),
}

impl RecordedConnection {
    /// The connection, if it is there and this version knows it.
    #[must_use]
    pub const fn known(&self) -> Option<&Connection> {
        match self {
            Self::Known(connection) => Some(connection),
            Self::Redacted | Self::Unknown(_) => None,
        }
    }

    /// Whether the host is known to be the machine that ran `matrix`.
    #[must_use]
    pub const fn is_this_machine(&self) -> bool {
        matches!(self, Self::Known(Connection::Local))
    }
}

impl Serialize for RecordedConnection {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Known(connection) => connection.serialize(serializer),
            Self::Redacted => serializer.serialize_unit(),
            Self::Unknown(written) => written.serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for RecordedConnection {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let written = Value::deserialize(deserializer)?;
        if written.is_null() {
            return Ok(Self::Redacted);
        }
        Ok(Connection::deserialize(&written).map_or(Self::Unknown(written), Self::Known))
    }
}

#[cfg(test)]
mod tests {
    use rstest::rstest;
    use serde_json::json;

    use super::*;

    #[test]
    fn a_manifest_has_no_more_hosts_than_a_matrix_file() {
        let recorded = include_str!("../../../../tests/fixtures/recorded/manifest.json");
        let mut manifest: Manifest = serde_json::from_str(recorded).unwrap();
        manifest.hosts = vec![manifest.hosts[0].clone(); Manifest::MOST_HOSTS];
        assert_eq!(manifest.check(), Ok(()));
        manifest.hosts.push(manifest.hosts[0].clone());
        assert!(manifest.check().is_err());
    }

    #[rstest]
    #[case::this_machine(json!("local"), true, true)]
    #[case::ssh(json!({"ssh": "me@lab:22", "identity": null, "jump": null, "known_hosts": null}), true, false)]
    #[case::redacted(Value::Null, false, false)]
    #[case::of_a_later_version(json!({"serial": "/dev/ttyS0", "baud": 9600}), false, false)]
    #[case::of_a_later_ssh(json!({"ssh": "me@lab", "compression": true}), false, false)]
    fn a_connection_is_written_as_it_was_read_whether_it_is_known_or_not(
        #[case] written: Value,
        #[case] is_known: bool,
        #[case] is_this_machine: bool,
    ) {
        let connection: RecordedConnection = serde_json::from_value(written.clone()).unwrap();
        assert_eq!(
            (connection.known().is_some(), connection.is_this_machine()),
            (is_known, is_this_machine)
        );
        assert_eq!(serde_json::to_value(&connection).unwrap(), written);
    }
}
