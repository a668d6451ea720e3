//! Debian's rosmaster as a process of its own, for those who want the real one. The main type is [`Rosmaster`].
//!
//! It runs in the network namespace of the thread that starts it, is ready when it answers XML-RPC, is started again when
//! it dies, and ends with its handle. It also ends when this process is killed ([`child_process`]), which is why the
//! thread that made it stays.
//!
//! It keeps no log: that would be files on the disk of the machine that is being measured.
//!
//! Source: `rosmaster/main.py` and `rosgraph/roslogging.py` of Debian's python3-rosmaster 1.15.15.

use std::{
    env,
    ffi::OsString,
    fs, io,
    io::Read,
    net::Ipv4Addr,
    os::fd::{AsFd, OwnedFd},
    path::PathBuf,
    process::{Child, Command, Stdio},
    sync::mpsc::{Receiver, Sender, channel},
    time::{Duration, Instant},
};

use nix::{
    fcntl::OFlag,
    poll::PollFlags,
    sys::signal::{Signal, kill},
};

use super::{
    Notice, Notices, RosError,
    stop::{Stop, WaitError},
    thread_group::ThreadGroup,
    xml_rpc::Client,
};
use crate::child_process;

/// Its program, as Debian and ROS's own packages name it.
const PROGRAM: &str = "rosmaster";
/// Where programs are, for who has no PATH.
const USUAL_PATH: &str = "/usr/local/bin:/usr/bin:/bin";
/// What to do where it is missing.
pub const INSTALL: &str =
    "install it: `apt-get install --no-install-recommends python3-rosmaster`; or use `ros.master: embedded`";

/// From its start to its first answer: Python on a slow, emulated processor.
const READY_TIMEOUT: Duration = Duration::from_secs(60);
/// For one attempt at an answer.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(5);
/// Between two attempts, and before it is started again.
const PAUSE: Duration = Duration::from_millis(100);
/// For its thread to see it end.
const END_TIMEOUT: Duration = Duration::from_secs(5);
/// How much is kept of what it says.
const MOST_WORDS: usize = 4096;

/// A running rosmaster.
#[derive(Debug)]
pub struct Rosmaster {
    uri: String,
    crew: ThreadGroup,
}

impl Rosmaster {
    /// Starts it in the calling thread's network namespace and waits until it answers.
    ///
    /// # Errors
    /// [`RosError`] if it is not installed, cannot be started, ends at once or does not answer.
    pub fn start(address: Ipv4Addr, port: u16, notices: Notices) -> Result<Self, RosError> {
        let program = find()?;
        let failed = |error| RosError::system("start rosmaster", error);
        let crew = ThreadGroup::new().map_err(failed)?;
        let uri = format!("http://{address}:{port}/");
        let keeper = Keeper {
            program,
            address,
            port,
            notices,
            stop: crew.stop().clone(),
        };
        let (ends, ended) = channel();
        crew.spawn("rosmaster", move || keeper.keep(&ends))
            .map_err(failed)?;
        let master = Self { uri, crew };
        master.wait_until_ready(&ended)?;
        Ok(master)
    }

    /// Its address, such as `http://10.0.0.1:11311/`.
    #[must_use]
    pub fn uri(&self) -> &str {
        &self.uri
    }

    /// Ends it and waits until it has ended.
    pub fn stop(self) {
        self.crew.dismiss(END_TIMEOUT);
    }

    fn wait_until_ready(&self, ended: &Receiver<String>) -> Result<(), RosError> {
        let client = Client::new(&self.uri, self.crew.stop().clone())?;
        let begun = Instant::now();
        loop {
            let error =
                match client.call_ros("getPid", &["/workload".into()], Instant::now() + ANSWER_TIMEOUT) {
                    Ok(_) => return Ok(()),
                    Err(error) => error,
                };
            if let Ok(words) = ended.try_recv() {
                return Err(RosError::RosmasterEnded { words });
            }
            if begun.elapsed() > READY_TIMEOUT || self.crew.stop().rest(PAUSE).is_err() {
                return Err(RosError::MasterUnreachable {
                    master: client.address().socket.into(),
                    waited: begun.elapsed(),
                    reason: error.to_string(),
                });
            }
        }
    }
}

impl Drop for Rosmaster {
    /// For whoever leaves by an error: tells it to end, without waiting.
    fn drop(&mut self) {
        self.crew.stop().raise();
    }
}

/// Whether it is installed and can be run.
///
/// # Errors
/// [`RosError::NoRosmaster`] with the reason.
pub fn survey() -> Result<(), RosError> {
    let program = find()?;
    let unusable = |reason: String| RosError::NoRosmaster { reason };
    // It imports all its parts and does nothing.
    let tried = Command::new(&program)
        .arg("--help")
        .env("PATH", path())
        .stdin(Stdio::null())
        .output()
        .map_err(|error| unusable(format!("{} cannot be run: {error}", program.display())))?;
    if tried.status.success() {
        return Ok(());
    }
    let words = String::from_utf8_lossy(&tried.stderr);
    let last = words.lines().last().unwrap_or("it said nothing").trim();
    Err(unusable(format!("{} does not work: {last}", program.display())))
}

/// Its version, from the `package.xml` that ROS installs beside it.
#[must_use]
pub fn version() -> Option<String> {
    let program = find().ok()?;
    let prefix = program.parent()?.parent()?;
    let manifest = fs::read_to_string(prefix.join("share/rosmaster/package.xml")).ok()?;
    version_of(&manifest)
}

fn version_of(manifest: &str) -> Option<String> {
    let (_, rest) = manifest.split_once("<version>")?;
    let (version, _) = rest.split_once("</version>")?;
    Some(version.trim().to_owned())
}

fn path() -> OsString {
    env::var_os("PATH").unwrap_or_else(|| USUAL_PATH.into())
}

fn find() -> Result<PathBuf, RosError> {
    env::split_paths(&path())
        .map(|folder| folder.join(PROGRAM))
        .find(|program| program.is_absolute() && program.is_file())
        .ok_or_else(|| RosError::NoRosmaster {
            reason: format!("no program `{PROGRAM}` is installed here"),
        })
}

/// The thread that the process belongs to.
struct Keeper {
    program: PathBuf,
    address: Ipv4Addr,
    port: u16,
    notices: Notices,
    stop: Stop,
}

impl Keeper {
    /// Keeps it running until the stop is raised, and tells how each of its lives ended.
    fn keep(&self, ends: &Sender<String>) {
        while !self.stop.is_raised() {
            let ended = match Process::start(self.command()) {
                Ok(process) => process.attend(&self.stop),
                Err(error) => Some(format!("it could not be started: {error}")),
            };
            if let Some(words) = ended {
                self.notices.send(Notice::MasterEnded { words: words.clone() });
                // Listened to while it has not answered yet.
                let _ = ends.send(words);
            }
            if self.stop.rest(PAUSE).is_err() {
                return;
            }
        }
    }

    fn command(&self) -> Command {
        let mut command = Command::new(&self.program);
        command
            .args(["--core", "--port", &self.port.to_string(), "__log:=/dev/null"])
            .env("PATH", path())
            .env("ROS_IP", self.address.to_string())
            .env(
                "ROS_MASTER_URI",
                format!("http://{}:{}/", self.address, self.port),
            )
            // A folder that is there, so that none is made.
            .env("ROS_LOG_DIR", "/tmp")
            .env("PYTHONDONTWRITEBYTECODE", "1")
            .env_remove("ROS_HOSTNAME")
            .env_remove("ROS_IPV6");
        command
    }
}

/// One life of it.
struct Process {
    child: Child,
    /// What it says; at its end when it has ended.
    words: OwnedFd,
}

impl Process {
    /// Starts the command, which is to end with this thread.
    fn start(mut command: Command) -> io::Result<Self> {
        let (words, said) = nix::unistd::pipe2(OFlag::O_CLOEXEC)?;
        command
            .current_dir("/")
            .stdin(Stdio::null())
            .stdout(said.try_clone()?)
            .stderr(said);
        let child = child_process::spawn(&mut command)?;
        // With it this process's copies of the pipe's other end are closed.
        drop(command);
        Ok(Self { child, words })
    }

    /// Waits until it ends and gives its last words; ends it when the stop is raised, without a word.
    fn attend(mut self, stop: &Stop) -> Option<String> {
        let mut kept = Vec::new();
        let mut words = fs::File::from(self.words);
        let mut buffer = [0; 1024];
        let ended = loop {
            match stop.wait(&[(words.as_fd(), PollFlags::POLLIN)], None) {
                Ok(()) => {}
                Err(WaitError::Stopped) => break false,
                Err(_) => break true,
            }
            match words.read(&mut buffer) {
                Ok(0) => break true,
                Ok(count) => {
                    kept.extend_from_slice(buffer.get(..count).unwrap_or_default());
                    let surplus = kept.len().saturating_sub(MOST_WORDS);
                    kept.drain(..surplus);
                }
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(_) => break true,
            }
        };
        if !ended {
            // Nothing of it is worth an orderly end: it has no files and its nodes end, too.
            let _ = kill(child_process::pid(&self.child), Signal::SIGKILL);
        }
        let status = self.child.wait();
        ended.then(|| {
            let status = status.map_or_else(|error| error.to_string(), |status| status.to_string());
            let words = String::from_utf8_lossy(&kept);
            let last = words.lines().rev().find(|line| !line.trim().is_empty());
            last.map_or(status.clone(), |last| {
                format!("{status}; it last said: {}", last.trim())
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[rstest::rstest]
    #[case("<package>\n  <version>1.15.15</version>\n</package>", Some("1.15.15"))]
    #[case("<package/>", None)]
    fn the_version_is_that_of_its_manifest(#[case] manifest: &str, #[case] version: Option<&str>) {
        assert_eq!(version_of(manifest).as_deref(), version);
    }

    fn shell(script: &str) -> Process {
        let mut command = Command::new("/bin/sh");
        command.args(["-c", script]);
        Process::start(command).unwrap()
    }

    #[test]
    fn how_one_ended_and_its_last_words_are_told() {
        let words = shell("echo Traceback; echo 'port 11311 is in use' >&2; echo; exit 3")
            .attend(&Stop::new().unwrap());
        assert_eq!(
            words.unwrap(),
            "exit status: 3; it last said: port 11311 is in use"
        );
    }

    #[test]
    fn one_that_talks_without_end_is_heard_to_its_last_word() {
        let words = shell("seq 100000").attend(&Stop::new().unwrap());
        assert_eq!(words.unwrap(), "exit status: 0; it last said: 100000");
    }

    #[test]
    fn it_has_ended_when_it_was_told_to() {
        let stop = Stop::new().unwrap();
        let process = shell("exec sleep 1000");
        let pid = child_process::pid(&process.child);
        stop.raise();
        assert_eq!(process.attend(&stop), None);
        assert_eq!(kill(pid, None), Err(nix::errno::Errno::ESRCH));
    }
}
