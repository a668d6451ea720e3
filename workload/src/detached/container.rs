//! The container that a job's workload runs in. The node's engine is asked by its client, `docker`, as a person would ask it; the main
//! type is [`Engine`].
//!
//! ```text
//! supervisor ──stdin, kept open──> docker run ──> engine ──> workload run --ends-with-input
//!     └── its folder is also the container's, at the same path: lines, windows and their end are where a process would leave them
//! ```
//!
//! A container is the engine's and not the job's. It has the number and the rights of the job's user and no capability, and it ends with
//! the client that started it: when the batch system kills the job, the workload's standard input ends, and so does the workload.

use std::{
    env,
    ffi::{OsStr, OsString},
    fs,
    io::{self, Write as _},
    path::Path,
    process::{Command, Output, Stdio},
};

use nix::unistd::{getgid, getuid};
use record::{
    call::Run,
    detached::{EngineRecord, JobContainer, JobImage},
    settings::Settings,
};
use serde::Deserialize;

use super::{DetachedError, EnvironmentFolder, supervise::arguments};

/// Where the workload is in a container, whatever image that is of.
const WORKLOAD: &str = "/workload";
/// How many seconds an engine may take to answer.
const ANSWER_S: &str = "60";
/// What `timeout` of coreutils ends with when that was too long.
const TOO_LONG: i32 = 124;
/// An archive without a file: two blocks of zeros (POSIX, pax).
const EMPTY_ARCHIVE: [u8; 1024] = [0; 1024];

/// The engine of this node, which has what a container is made of.
#[derive(Debug)]
pub struct Engine<'a> {
    container: &'a JobContainer,
    /// The options by which a container's user is the job's.
    user: Vec<String>,
    record: EngineRecord,
}

/// What `docker info` says.
#[derive(Deserialize)]
struct Info {
    version: String,
    security: Option<Vec<String>>,
}

impl<'a> Engine<'a> {
    /// Asks it, and makes the image if that is the one without a file.
    ///
    /// # Errors
    /// When there is no engine, the job's user may not use it, or it does not have the image.
    pub fn look(container: &'a JobContainer) -> Result<Self, DetachedError> {
        let action = "ask the node's engine";
        let format = r#"{"version":{{json .ServerVersion}},"security":{{json .SecurityOptions}}}"#;
        let said = docker(action, ["info", "--format", format], &[])?;
        let info: Info = serde_json::from_slice(&said).map_err(|_| DetachedError::Engine {
            action,
            words: String::from_utf8_lossy(&said).trim().to_owned(),
        })?;
        let image_id = match &container.image {
            JobImage::Named(name) => id_of(name)?,
            JobImage::Empty { name, labels } => match id_of(name) {
                Ok(id) => id,
                Err(_) => {
                    let labels = labels.iter().map(|(key, value)| format!("LABEL {key}={value}"));
                    let changes = labels.flat_map(|label| ["--change".to_owned(), label]);
                    let arguments = ["import".to_owned()]
                        .into_iter()
                        .chain(changes)
                        .chain(["-".to_owned(), name.clone()]);
                    docker("make the image without a file", arguments, &EMPTY_ARCHIVE)?;
                    id_of(name)?
                }
            },
        };
        Ok(Self {
            container,
            user: user(&info.security.unwrap_or_default()),
            record: EngineRecord {
                version: info.version,
                image_id,
            },
        })
    }

    /// What it is, for whoever reads the results.
    #[must_use]
    pub const fn record(&self) -> &EngineRecord {
        &self.record
    }

    /// What runs the workload of the environment in a container and ends with it.
    ///
    /// # Errors
    /// When the folder does not take the profile of system calls, or nobody knows where the workload is.
    pub fn command(&self, folder: &EnvironmentFolder, settings: &Settings) -> Result<Command, DetachedError> {
        let profile = folder.path().join("seccomp.json");
        fs::write(&profile, &self.container.seccomp).map_err(DetachedError::file("write", &profile))?;
        let workload = env::current_exe().map_err(DetachedError::system("find the workload"))?;
        let memory = self.container.memory.or_else(three_quarters_of_the_node);
        let mut command = Command::new("docker");
        command
            .args([
                "run",
                "--rm",
                "--interactive",
                "--pull",
                "never",
                "--name",
                folder.environment(),
            ])
            .args(&self.user)
            .args(&self.container.options)
            .args(
                memory
                    .iter()
                    .flat_map(|bytes| [format!("--memory={bytes}"), format!("--memory-swap={bytes}")]),
            )
            .arg(joined("--security-opt=seccomp=", &profile))
            .arg(mount(&folder.path(), &folder.path(), ""))
            .arg(mount(&workload, Path::new(WORKLOAD), ",readonly"));
        // The program that becomes the workload, or that itself.
        let mut words = self
            .container
            .entrypoint
            .iter()
            .map(String::as_str)
            .chain([WORKLOAD]);
        let run = Run {
            ends_with_input: true,
            ..arguments(folder, settings)
        };
        command
            .arg("--entrypoint")
            .arg(words.next().unwrap_or(WORKLOAD))
            .arg(&self.record.image_id)
            .args(words)
            .args(run.arguments())
            .stdin(Stdio::piped());
        Ok(command)
    }

    /// Sees to it that nothing of the container goes on whose client has ended, however that came about.
    ///
    /// # Errors
    /// When the engine does not answer.
    pub fn end(folder: &EnvironmentFolder) -> Result<(), DetachedError> {
        let name = folder.environment();
        // One that has removed itself is what is wished for.
        let ended = call(["rm", "--force", name], &[])?;
        let words = String::from_utf8_lossy(&ended.stderr);
        match ended.status.success() || words.contains("No such container") {
            true => Ok(()),
            false => Err(refused("end the container", &ended)),
        }
    }
}

/// The options by which the files that a container writes are the job's user's.
fn user(security: &[String]) -> Vec<String> {
    let has = |option: &str| security.iter().any(|it| it.split(',').any(|part| part == option));
    match has("name=rootless") {
        // Its root is the user whose engine it is.
        true => Vec::new(),
        false => {
            let own = format!("--user={}:{}", getuid(), getgid());
            let mapped = has("name=userns").then(|| "--userns=host".to_owned());
            [own].into_iter().chain(mapped).collect()
        }
    }
}

/// Three quarters of the node's memory, in bytes: what a container has of other engines, too.
fn three_quarters_of_the_node() -> Option<u64> {
    let text = fs::read_to_string("/proc/meminfo").ok()?;
    let total = text.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
    let kilobytes: u64 = total.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kilobytes.saturating_mul(1024) / 4 * 3)
}

/// A folder or file of the node in a container. A path with a comma or a quotation mark would be other options.
fn mount(source: &Path, target: &Path, options: &str) -> OsString {
    let mut words = OsString::from("--mount=type=bind,\"source=");
    words.push(source);
    words.push("\",\"target=");
    words.push(target);
    words.push("\"");
    words.push(options);
    words
}

fn joined(option: &str, path: &Path) -> OsString {
    let mut words = OsString::from(option);
    words.push(path);
    words
}

/// The digest of an image that the engine has.
fn id_of(name: &str) -> Result<String, DetachedError> {
    let id = docker(
        "find the image",
        ["image", "inspect", "--format", "{{.Id}}", name],
        &[],
    )?;
    Ok(String::from_utf8_lossy(&id).trim().to_owned())
}

/// What the client prints.
fn docker(
    action: &'static str,
    arguments: impl IntoIterator<Item = impl AsRef<OsStr>>,
    input: &[u8],
) -> Result<Vec<u8>, DetachedError> {
    let output = call(arguments, input)?;
    match output.status.success() {
        true => Ok(output.stdout),
        false => Err(refused(action, &output)),
    }
}

fn refused(action: &'static str, output: &Output) -> DetachedError {
    let words = String::from_utf8_lossy(&output.stderr);
    let words = match output.status.code() {
        Some(TOO_LONG) => format!("it has not answered within {ANSWER_S} s"),
        _ => words.trim().to_owned(),
    };
    DetachedError::Engine { action, words }
}

fn call(
    arguments: impl IntoIterator<Item = impl AsRef<OsStr>>,
    input: &[u8],
) -> Result<Output, DetachedError> {
    let asked = || {
        let mut client = Command::new("timeout")
            .args([ANSWER_S, "docker"])
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()?;
        if let Some(mut stdin) = client.stdin.take() {
            match stdin.write_all(input) {
                // It says itself why it reads no more.
                Err(error) if error.kind() == io::ErrorKind::BrokenPipe => {}
                written => written?,
            }
        }
        client.wait_with_output()
    };
    asked().map_err(DetachedError::system("start `docker`"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn options(security: &[&str]) -> Vec<String> {
        user(&security.iter().map(ToString::to_string).collect::<Vec<_>>())
    }

    #[test]
    fn what_a_container_writes_is_the_jobs_users_whatever_the_engine_makes_of_users() {
        let own = format!("--user={}:{}", getuid(), getgid());
        assert_eq!(
            options(&["name=seccomp,profile=default"]),
            std::slice::from_ref(&own)
        );
        assert_eq!(
            options(&["name=seccomp,profile=default", "name=rootless"]),
            [""; 0]
        );
        assert_eq!(options(&["name=userns"]), [own, "--userns=host".to_owned()]);
    }

    #[test]
    fn a_path_is_no_option_whatever_is_in_it() {
        let words = mount(Path::new("/a,readonly"), Path::new("/w"), ",readonly");
        assert_eq!(
            words,
            r#"--mount=type=bind,"source=/a,readonly","target=/w",readonly"#
        );
    }

    #[test]
    fn a_container_leaves_its_node_a_quarter_of_the_memory() {
        let bytes = three_quarters_of_the_node().unwrap();
        assert!((1 << 20..1 << 50).contains(&bytes), "{bytes}");
    }
}
