//! The exit codes of `matrix`, which scripts and nightly checks rely on. The type is [`Exit`].

use std::process::ExitCode;

/// How the command ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Exit {
    /// Everything that was asked for was done.
    Done,
    /// A scenario's workload said that the experiment went wrong.
    ScenarioFailed,
    /// The matrix file, the run directory or the call is wrong; nothing was done.
    Wrong,
    /// The infrastructure failed: a provider, a disk, a lease; or nothing can run here.
    Infrastructure,
    /// What is measured night after night has changed.
    Drift,
    /// The newest night was measured, and is worth nothing.
    InvalidMeasurement,
    /// The newest night was not measured, or those before it are too few.
    TooLittleData,
    /// What was measured is not what the matrix file expects.
    NotAsExpected,
    /// Asked to stop; `matrix resume` goes on.
    Interrupted,
}

impl Exit {
    /// The number that the shell sees.
    #[must_use]
    pub const fn code(self) -> u8 {
        match self {
            Self::Done => 0,
            Self::ScenarioFailed => 1,
            Self::Wrong => 2,
            Self::Infrastructure => 3,
            Self::Drift => 4,
            Self::InvalidMeasurement => 5,
            Self::TooLittleData => 6,
            Self::NotAsExpected => 7,
            // 128 + SIGINT, as a shell would report it.
            Self::Interrupted => 130,
        }
    }
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(exit.code())
    }
}
