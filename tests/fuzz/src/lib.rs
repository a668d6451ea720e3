//! Whatever reads what others wrote, and what is asked of it whatever it is given: an answer or an error, in bounded time and memory,
//! and no panic. The table of targets is [`TARGETS`].
//!
//! A target is given bytes, which a fuzzer makes of seeds: files of a recorded run, answers as hosts give them. Where bytes
//! would seldom get beyond a parser ([`mod@records`]), they say what is to be changed in a whole file instead.

mod archives;
mod files;
mod foreign;
mod recorded;
mod records;

use std::{fs, path::Path};

/// One reader and what it is given first.
pub struct Target {
    /// The name that `tests/fuzz/run` takes.
    pub name: &'static str,
    /// Reads the bytes.
    pub read: fn(&[u8]),
    /// What others really write.
    pub seeds: fn() -> Vec<Vec<u8>>,
}

/// All readers.
pub const TARGETS: [Target; 19] = [
    Target {
        name: "matrix_file",
        read: orchestrator::fuzzing::matrix_file,
        seeds: foreign::matrix_files,
    },
    Target {
        name: "drift_file",
        read: orchestrator::fuzzing::drift_file,
        seeds: foreign::drift_files,
    },
    Target {
        name: "progress",
        read: orchestrator::fuzzing::progress,
        seeds: foreign::progress,
    },
    Target {
        name: "answers",
        read: orchestrator::fuzzing::answers,
        seeds: foreign::answers,
    },
    Target {
        name: "host_archive",
        read: orchestrator::fuzzing::host_archive,
        seeds: archives::of_hosts,
    },
    Target {
        name: "engine_archive",
        read: orchestrator::fuzzing::engine_archive,
        seeds: archives::of_engines,
    },
    Target {
        name: "ssh_configuration",
        read: orchestrator::fuzzing::ssh_configuration,
        seeds: foreign::ssh_configurations,
    },
    Target {
        name: "vagrant",
        read: orchestrator::fuzzing::vagrant,
        seeds: foreign::vagrant,
    },
    Target {
        name: "slurm",
        read: orchestrator::fuzzing::slurm,
        seeds: foreign::slurm,
    },
    Target {
        name: "platform",
        read: files::platform,
        seeds: foreign::platforms,
    },
    Target {
        name: "xml_rpc",
        read: workload::ros::fuzzing::xml_rpc,
        seeds: foreign::xml_rpc,
    },
    Target {
        name: "http",
        read: workload::ros::fuzzing::http,
        seeds: foreign::http,
    },
    Target {
        name: "tcpros",
        read: workload::ros::fuzzing::tcpros,
        seeds: foreign::tcpros,
    },
    Target {
        name: "messages",
        read: files::messages,
        seeds: foreign::messages,
    },
    Target {
        name: "control_log",
        read: files::control_log,
        seeds: recorded::control_logs,
    },
    Target {
        name: "capture",
        read: files::capture,
        seeds: recorded::captures,
    },
    Target {
        name: "run_directory",
        read: files::run_directory,
        seeds: recorded::records,
    },
    Target {
        name: "report",
        read: recorded::report,
        seeds: recorded::files_by_number,
    },
    Target {
        name: "records",
        read: records::changed,
        seeds: records::changes,
    },
];

/// Writes what a target begins with into a folder, a file each.
pub fn write_seeds(target: &Target, folder: &Path) {
    for (number, seed) in (target.seeds)().into_iter().enumerate() {
        fs::write(folder.join(format!("seed-{number}")), seed).expect("the folder can be written");
    }
}
