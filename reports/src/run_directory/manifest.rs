//! `manifest.json`: what was asked. The main type is [`Manifest`].

use serde::{Deserialize, Serialize};

use crate::settings::ReportSettings;

/// What was asked of this run; written once, before anything else happens.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// [`super::FORMAT`] at the time of writing.
    pub format: u32,
    /// The run's name, which is its folder's name at first.
    pub run: String,
    /// When it was asked for, RFC 3339.
    pub created: String,
    /// Version of `matrix`.
    pub matrix_version: String,
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
    /// Seed of the scenarios' order.
    pub seed: u64,
    /// The providers' own settings, as the matrix file's `providers:` section gives them.
    pub providers: serde_json::Value,
    /// How the tables are to be made.
    pub report: ReportSettings,
}
