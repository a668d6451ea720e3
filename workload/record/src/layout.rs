//! Names of the files and folders that the workload writes and others read.

use crate::virtual_host::VirtualHost;

/// What the platform was: a [`crate::platform::SurveyRecord`]; in a run directory what the orchestrator makes of it.
pub const ENVIRONMENT: &str = "environment.json";
/// How the network was made, as text.
pub const NETWORK: &str = "network.txt";
/// The lines that the workload printed ([`crate::progress`]).
pub const PROGRESS: &str = "progress.jsonl";
/// A window's record: a [`crate::window::WindowRecord`], written last.
pub const WINDOW: &str = "window.json";
/// A window's control steps ([`crate::control_log`]).
pub const CONTROL_LOG: &str = "control.csv";
/// A window's plant steps ([`crate::plant_log`]).
pub const PLANT_LOG: &str = "plant.csv";
/// What a command printed on standard output: of a window, or before the windows.
pub const STDOUT: &str = "stdout.txt";
/// What it printed on standard error.
pub const STDERR: &str = "stderr.txt";
/// What the command before the windows printed, a folder.
pub const PREPARE: &str = "prepare";
/// What the command after the windows printed, a folder.
pub const RESTORE: &str = "restore";
/// Where an environment has an experiment's files, below its folder for the command's work.
pub const FILES: &str = "files";
/// Where a command writes, below the same.
pub const OUTPUT: &str = "output";
/// The variable by which what a command starts is found again if its workload was killed: the folder for the command's work.
pub const WORK_VARIABLE: &str = "MATRIX_WORK";
/// The lines of a detached workload, where it is kept.
pub const LINES: &str = "lines.jsonl";
/// Whose a detached workload is ([`crate::detached::Owner`]).
pub const OWNER: &str = "owner.json";

/// What the batch system writes of a job that an environment's workload runs in.
pub const JOB_OUTPUT: &str = "job.txt";

/// What a node printed in a window, on standard output and on standard error.
#[must_use]
pub fn printed_by(node: &VirtualHost) -> [String; 2] {
    [STDOUT, STDERR].map(|file| format!("{node}.{file}"))
}

/// Whether a file of a window is what a command or a node printed.
#[must_use]
pub fn is_printed(file: &str) -> bool {
    [STDOUT, STDERR].iter().any(|printed| {
        let before = file.strip_suffix(printed);
        before.is_some_and(|before| before.is_empty() || before.ends_with('.'))
    })
}

/// The capture of a virtual host in a window.
#[must_use]
pub fn capture(host: &VirtualHost) -> String {
    format!("{host}.pcap")
}

const WINDOW_FOLDER: &str = "window-";

/// The folder of a window; windows count from 1.
#[must_use]
pub fn window_folder(window: u32) -> String {
    format!("{WINDOW_FOLDER}{window}")
}

/// The window whose folder has that name, which is written in one way only.
#[must_use]
pub fn window_of(folder: &str) -> Option<u32> {
    let number = folder.strip_prefix(WINDOW_FOLDER)?;
    let window: u32 = number.parse().ok()?;
    (window > 0 && window.to_string() == number).then_some(window)
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    #[rstest]
    #[case("stdout.txt", true)]
    #[case("robot.stderr.txt", true)]
    #[case("my-stdout.txt", false)]
    #[case("stdout.txt.csv", false)]
    fn what_was_printed_is_known_by_its_name(#[case] file: &str, #[case] is_one: bool) {
        assert_eq!(is_printed(file), is_one);
    }

    #[rstest]
    #[case("window-1", Some(1))]
    #[case("window-4294967295", Some(u32::MAX))]
    #[case("window-0", None)]
    #[case("window-01", None)]
    #[case("window-+1", None)]
    #[case("window-4294967296", None)]
    #[case("window-", None)]
    #[case("windows-1", None)]
    fn a_windows_folder_has_one_name(#[case] folder: &str, #[case] window: Option<u32>) {
        assert_eq!(window_of(folder), window);
        assert!(window.is_none_or(|window| window_folder(window) == folder));
    }
}
