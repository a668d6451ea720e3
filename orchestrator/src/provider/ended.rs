//! How a workload's process ended, in words. The main type is [`Ended`].

use std::{os::unix::process::ExitStatusExt as _, process::ExitStatus};

use record::{exit::workload::Exit, progress::Progress};

/// How a workload's process ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Ended {
    /// Whether it ended in order: with all its windows measured, or since it was asked to.
    pub success: bool,
    /// In words.
    pub how: String,
    /// Whether its node failed or was taken away: another may do.
    pub lost_its_node: bool,
}

/// A shell, and so an engine, reports a death by signal N as this plus N.
const SIGNAL_BASE: i64 = 128;

impl Ended {
    /// It did not succeed.
    #[must_use]
    pub fn failed(how: &str) -> Self {
        Self {
            success: false,
            how: how.to_owned(),
            lost_its_node: false,
        }
    }

    /// As an engine reports it: an exit code, above 128 for a signal.
    #[must_use]
    pub fn by_exit_code(code: i64) -> Self {
        if code > SIGNAL_BASE && code <= SIGNAL_BASE + 64 {
            Self::by_signal(code - SIGNAL_BASE)
        } else {
            Self {
                success: code == 0,
                how: format!("exit code {code}{}", meaning(code)),
                lost_its_node: false,
            }
        }
    }

    /// Killed by the signal of this number.
    #[must_use]
    pub fn by_signal(number: i64) -> Self {
        let name = match number {
            1 => " (SIGHUP)",
            2 => " (SIGINT)",
            4 => " (SIGILL)",
            6 => " (SIGABRT)",
            7 => " (SIGBUS)",
            8 => " (SIGFPE)",
            9 => " (SIGKILL)",
            11 => " (SIGSEGV)",
            15 => " (SIGTERM)",
            31 => " (SIGSYS)",
            _ => "",
        };
        Self::failed(&format!("killed by signal {number}{name}"))
    }

    /// As the kernel reports it to a parent.
    #[must_use]
    pub fn by_status(status: ExitStatus) -> Self {
        match (status.code(), status.signal()) {
            (Some(code), _) => Self::by_exit_code(code.into()),
            (None, Some(signal)) => Self::by_signal(signal.into()),
            (None, None) => Self::by_last_line(None),
        }
    }

    /// As far as the workload's own last line tells, when nobody was there to be told by the kernel.
    #[must_use]
    pub fn by_last_line(line: Option<&Progress>) -> Self {
        let (success, how) = match line {
            Some(Progress::Finished) => (true, "it said that it had finished"),
            Some(Progress::Stopped { .. }) => (true, "it said that it stopped when asked to"),
            Some(Progress::Failed { .. }) => (false, "it said that it had failed"),
            _ => (
                false,
                "it ended without saying how: killed, or the machine was restarted",
            ),
        };
        Self {
            success,
            how: how.to_owned(),
            lost_its_node: false,
        }
    }

    /// With the last thing it wrote to its standard error, where it did not succeed and wrote something.
    #[must_use]
    pub fn with_last_words(mut self, standard_error: &str) -> Self {
        let last = standard_error.lines().rev().find(|line| !line.trim().is_empty());
        if let (false, Some(last)) = (self.success, last) {
            self.how.push_str("; its last words were: ");
            self.how.extend(last.trim().chars().take(500));
        }
        self
    }
}

/// What the workload means by an exit code.
fn meaning(code: i64) -> &'static str {
    match Exit::of(code) {
        Some(Exit::Failed) => " (the run failed)",
        Some(Exit::WrongCall) => " (its call or its settings were wrong)",
        Some(Exit::Done) | None => "",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[rstest::rstest]
    #[case(0, true, "exit code 0")]
    #[case(1, false, "exit code 1 (the run failed)")]
    #[case(137, false, "killed by signal 9 (SIGKILL)")]
    #[case(255, false, "exit code 255")]
    fn an_exit_code_is_put_into_words(#[case] code: i64, #[case] success: bool, #[case] how: &str) {
        let ended = Ended::by_exit_code(code);
        assert_eq!((ended.success, ended.how.as_str()), (success, how));
    }

    #[test]
    fn what_ended_unseen_is_judged_by_its_last_line() {
        assert!(Ended::by_last_line(Some(&Progress::Finished)).success);
        assert!(Ended::by_last_line(Some(&Progress::Stopped { window: 1 })).success);
        assert!(!Ended::by_last_line(Some(&Progress::NetworkUp)).success);
        assert!(!Ended::by_last_line(None).success);
    }

    #[test]
    fn last_words_are_told_of_what_failed_only() {
        let words = "one\nno space left\n\n";
        assert_eq!(Ended::by_exit_code(0).with_last_words(words).how, "exit code 0");
        assert_eq!(
            Ended::by_exit_code(101).with_last_words(words).how,
            "exit code 101; its last words were: no space left"
        );
        assert_eq!(Ended::by_exit_code(101).with_last_words("").how, "exit code 101");
    }
}
