//! `ip`, `tc` and `ethtool`, run in a namespace, with what was run and what came of it. The main type is [`Transcript`].

use std::{
    ffi::OsStr,
    fmt::{self, Write as _},
    io::ErrorKind,
    path::Path,
    process::{Command, Output, Stdio},
};

use super::super::{
    error::NetworkError,
    namespace::{Namespace, errno},
};

/// Where administrators' programs are; an ordinary user's `PATH` may lack them, and that of a detached workload is empty.
const FOLDERS: [&str; 6] = [
    "/usr/local/sbin",
    "/usr/local/bin",
    "/usr/sbin",
    "/usr/bin",
    "/sbin",
    "/bin",
];

/// What was run, line by line as in a shell, each followed by what it printed.
#[derive(Debug, Default)]
pub struct Transcript(String);

impl Transcript {
    /// Runs a program in a namespace and writes it down.
    ///
    /// # Errors
    /// If it is not installed or fails.
    pub fn run(
        &mut self,
        namespace: &Namespace,
        program: &'static str,
        words: &[&str],
    ) -> Result<(), NetworkError> {
        let ran = run(namespace, program, words);
        // Writing to a string cannot fail.
        let _ = writeln!(self.0, "# {program} {}", words.join(" "));
        let said = match &ran {
            Ok(printed) => printed.clone(),
            Err(error) => format!("{error}\n"),
        };
        self.0.push_str(&said);
        ran.map(drop)
    }
}

impl fmt::Display for Transcript {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// Runs a program in a namespace to its end; what it printed.
///
/// # Errors
/// If it is not installed or fails.
pub fn run(namespace: &Namespace, program: &'static str, words: &[&str]) -> Result<String, NetworkError> {
    let words: Vec<String> = words.iter().map(ToString::to_string).collect();
    // A child begins in the namespace of the thread that started it.
    namespace.within(move || {
        let words: Vec<&str> = words.iter().map(String::as_str).collect();
        run_here(program, &words)
    })
}

/// Runs a program in the calling thread's namespace to its end; what it printed.
///
/// # Errors
/// If it is not installed or fails.
pub fn run_here(program: &'static str, words: &[&str]) -> Result<String, NetworkError> {
    let missing = || NetworkError::Tool { program };
    let path = find(program).ok_or_else(missing)?;
    let output = Command::new(path)
        .args(words)
        .env_clear()
        .stdin(Stdio::null())
        .output()
        .map_err(|error| match error.kind() {
            ErrorKind::NotFound => missing(),
            _ => NetworkError::Start {
                program,
                source: errno(&error),
            },
        })?;
    outcome(program, words, &output)
}

fn find(program: &str) -> Option<impl AsRef<OsStr>> {
    FOLDERS
        .iter()
        .map(|folder| Path::new(folder).join(program))
        .find(|path| path.is_file())
}

fn outcome(program: &'static str, words: &[&str], output: &Output) -> Result<String, NetworkError> {
    if output.status.success() {
        return Ok(String::from_utf8_lossy(&output.stdout).into_owned());
    }
    let said = String::from_utf8_lossy(&output.stderr);
    if let Some((part, module)) = missing_part(words, &said) {
        return Err(NetworkError::KernelLacks { part, module });
    }
    Err(NetworkError::Command {
        command: format!("{program} {}", words.join(" ")),
        said: said.split_whitespace().collect::<Vec<_>>().join(" "),
    })
}

/// What the kernel lacks, and the module that has it, if that is why the command failed. The words are those of
/// `net/sched/sch_api.c` and `net/core/rtnetlink.c`; older kernels only say that there is no such file.
fn missing_part(words: &[&str], said: &str) -> Option<(&'static str, &'static str)> {
    const PARTS: [(&str, &str); 4] = [
        ("netem", "sch_netem"),
        ("htb", "sch_htb"),
        ("veth", "veth"),
        ("bridge", "bridge"),
    ];
    [
        "qdisc kind is unknown",
        "Unknown device type",
        "No such file or directory",
        "Operation not supported",
    ]
    .iter()
    .any(|reason| said.contains(reason))
    .then(|| PARTS.into_iter().find(|(part, _)| words.contains(part)))?
}

#[cfg(test)]
mod tests {
    use super::*;

    #[rstest::rstest]
    #[case(
        "qdisc add dev x parent 5:1 netem delay 10ms",
        "Error: Specified qdisc kind is unknown.",
        Some("netem")
    )]
    #[case(
        "qdisc add dev x root htb default 1",
        "RTNETLINK answers: No such file or directory",
        Some("htb")
    )]
    #[case("link add s1 type bridge", "Error: Unknown device type.", Some("bridge"))]
    #[case(
        "link add h1 type veth peer name s1",
        "Error: Unknown device type.",
        Some("veth")
    )]
    #[case(
        "qdisc add dev x root htb default 1",
        "RTNETLINK answers: Operation not permitted",
        None
    )]
    #[case("link set x up", "Error: Specified qdisc kind is unknown.", None)]
    fn what_the_kernel_lacks_is_told_from_other_failures(
        #[case] words: &str,
        #[case] said: &str,
        #[case] part: Option<&str>,
    ) {
        let words: Vec<&str> = words.split(' ').collect();
        assert_eq!(missing_part(&words, said).map(|(part, _)| part), part);
    }

    #[test]
    fn a_tool_that_is_not_installed_is_found_out_before_it_is_started() {
        assert!(find("no-such-tool").is_none());
    }
}
