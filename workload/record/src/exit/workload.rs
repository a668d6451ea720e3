//! The exit codes of the `workload` program. The type is [`Exit`].

use std::process::ExitCode;

/// How a call of the workload ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Exit {
    /// All windows are on disk, it was asked to stop and did so in order, or the check was made whatever it found.
    Done,
    /// The run failed, by the experiment or by the platform: the last line of progress says which and why.
    Failed,
    /// The call or the settings are wrong.
    WrongCall,
}

impl Exit {
    const ALL: [Self; 3] = [Self::Done, Self::Failed, Self::WrongCall];

    /// The number.
    #[must_use]
    pub const fn code(self) -> u8 {
        match self {
            Self::Done => 0,
            Self::Failed => 1,
            Self::WrongCall => 2,
        }
    }

    /// What a number means; none if the workload never ends with it.
    #[must_use]
    pub fn of(code: i64) -> Option<Self> {
        Self::ALL.into_iter().find(|exit| i64::from(exit.code()) == code)
    }
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(exit.code())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_code_means_what_it_was_made_of() {
        for exit in Exit::ALL {
            assert_eq!(Exit::of(exit.code().into()), Some(exit));
        }
        assert_eq!(Exit::of(3), None);
        assert_eq!(Exit::of(137), None);
    }
}
