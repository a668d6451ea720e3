//! `manifest.json`: what was asked. The main type is [`Manifest`].

use std::{fmt, path::PathBuf};

use serde::{Deserialize, Serialize};

use crate::{name::name, report_settings::ReportSettings};

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
    /// The providers' own settings, as the matrix file's `providers:` section gives them.
    pub providers: serde_json::Value,
    /// The hosts that the matrix file names; none in runs of earlier versions, which were on one machine.
    #[serde(default)]
    pub hosts: Vec<HostRecord>,
    /// Where this machine keeps what is of the run and not in its directory, such as the environments of `native`; none in
    /// runs of earlier versions and in redacted copies.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub state_directory: Option<PathBuf>,
    /// How the tables are to be made.
    pub report: ReportSettings,
    /// Whether this is a copy from which names were taken (`reports::redaction`): it can be reported, and not resumed.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub redacted: bool,
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
    /// How it is reached, as the matrix file says it.
    pub connect: serde_json::Value,
    /// What it is, as `uname -m` says it; empty where it could not be asked.
    pub hardware: String,
    /// `ID` and `VERSION_ID` of its os-release.
    pub os: String,
    /// Its kernel, as `uname -r` says it.
    pub kernel: String,
}
