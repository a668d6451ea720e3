//! A workload that runs, and programs inside its virtual hosts. The main types are [`Stage`] and [`Tool`].

use std::{
    ffi::OsStr,
    io::{BufRead, BufReader, Read},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    sync::{
        Mutex, MutexGuard, PoisonError,
        mpsc::{Receiver, channel},
    },
    thread,
    time::{Duration, Instant},
};

use machine_workload::workload_program;
use nix::{
    sys::signal::{Signal, kill},
    unistd::Pid,
};
use record::progress::Progress;
use tempfile::TempDir;

pub const INSTALL: &str = "apt-get install --no-install-recommends python3-rosmaster python3-rospy python3-rostopic python3-std-msgs";
/// For whatever is waited for; only hopeless waits are ended by it.
pub const TIMEOUT: Duration = Duration::from_secs(90);
/// Short links, so that what is looked at is the conversation and not the control task's limits.
pub const SHORT_LINKS: &str = r#""network":{"delay":"1ms","jitter":"0ms","loss":"0%"}"#;

/// They measure times, and a rospy node takes its share of the machine: one after the other.
static MACHINE: Mutex<()> = Mutex::new(());

/// Debian's own Python, whatever another is called `python3` here: ROS is installed for that one.
pub const PYTHON: &str = "/usr/bin/python3";

pub fn machine() -> MutexGuard<'static, ()> {
    let taken = MACHINE.lock().unwrap_or_else(PoisonError::into_inner);
    let imports = Command::new(PYTHON)
        .args(["-c", "import rosmaster, rospy, rostopic, std_msgs.msg"])
        .output()
        .unwrap_or_else(|error| panic!("{PYTHON}: {error}; {INSTALL}"));
    assert!(
        imports.status.success() && Path::new("/usr/bin/rostopic").exists(),
        "Debian's ROS is not installed: {INSTALL}\n{}",
        String::from_utf8_lossy(&imports.stderr)
    );
    taken
}

pub fn script(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/debian_ros")
        .join(name)
}

/// The lines of a process as they come, and its end.
struct Lines(Receiver<String>);

impl Lines {
    fn of(stream: impl Read + Send + 'static) -> Self {
        let (sender, lines) = channel();
        thread::spawn(move || {
            for line in BufReader::new(stream).lines().map_while(Result::ok) {
                if sender.send(line).is_err() {
                    return;
                }
            }
        });
        Self(lines)
    }

    /// The next line; none at its end.
    fn next(&self, deadline: Instant) -> Option<String> {
        let left = deadline.saturating_duration_since(Instant::now());
        match self.0.recv_timeout(left) {
            Ok(line) => Some(line),
            Err(std::sync::mpsc::RecvTimeoutError::Disconnected) => None,
            Err(error) => panic!("{error}"),
        }
    }
}

/// A workload that has begun.
pub struct Stage {
    pub child: Child,
    lines: Lines,
    pub said: Vec<Progress>,
    /// For what ROS's tools write.
    home: TempDir,
}

impl Stage {
    /// `workload rehearse`, up to where its nodes run.
    pub fn rehearse(settings: &str, without: &[&str]) -> Self {
        let mut arguments = vec!["rehearse", "--settings", settings];
        for part in without {
            arguments.extend(["--without", part]);
        }
        let mut stage = Self::start(&arguments);
        stage.wait_for(|progress| matches!(progress, Progress::Rehearsing { .. }));
        stage
    }

    /// `workload run`, up to where it measures the first of the windows, which are listed as `1,2`.
    pub fn run(settings: &str, windows: &str, data: &Path) -> Self {
        let arguments = [
            OsStr::new("run"),
            "--environment".as_ref(),
            "test".as_ref(),
            "--settings".as_ref(),
            settings.as_ref(),
            "--windows".as_ref(),
            windows.as_ref(),
            "--data".as_ref(),
            data.as_ref(),
        ];
        let mut stage = Self::start(&arguments);
        stage.wait_for(|progress| matches!(progress, Progress::Measuring { .. }));
        stage
    }

    pub fn start(arguments: &[impl AsRef<OsStr>]) -> Self {
        let mut child = Command::new(workload_program())
            .args(arguments)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        Self {
            lines: Lines::of(child.stdout.take().unwrap()),
            child,
            said: Vec::new(),
            home: TempDir::new().unwrap(),
        }
    }

    /// Waits until it says something of the kind, if it has not yet, since the last one that was waited for.
    pub fn wait_for(&mut self, wanted: impl Fn(&Progress) -> bool) -> Progress {
        let deadline = Instant::now() + TIMEOUT;
        while let Some(line) = self.lines.next(deadline) {
            let progress: Progress = serde_json::from_str(&line).unwrap();
            self.said.push(progress.clone());
            if wanted(&progress) {
                return progress;
            }
        }
        panic!("it ended first: {:#?}", self.said);
    }

    /// Waits for a notice with these words.
    pub fn wait_for_notice(&mut self, words: &str) -> String {
        let progress = self
            .wait_for(|progress| matches!(progress, Progress::Notice { text, .. } if text.contains(words)));
        match progress {
            Progress::Notice { text, .. } => text,
            other => panic!("{other:?}"),
        }
    }

    pub fn pid(&self) -> String {
        self.child.id().to_string()
    }

    /// A program inside one of its hosts.
    pub fn tool(&self, host: &str, program: &str, arguments: &[impl AsRef<OsStr>]) -> Tool {
        let mut child = Command::new(workload_program())
            .args(["enter", &self.pid(), host, program])
            .args(arguments)
            .env("ROS_HOME", self.home.path())
            .env("ROS_LOG_DIR", self.home.path())
            .env("PYTHONUNBUFFERED", "1")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        Tool {
            lines: Lines::of(child.stdout.take().unwrap()),
            child,
        }
    }

    /// A node written in rospy.
    pub fn node(&self, host: &str, name: &str, arguments: &[&str]) -> Tool {
        let script = script(name);
        let mut all = vec![script.as_os_str()];
        all.extend(arguments.iter().map(OsStr::new));
        self.tool(host, PYTHON, &all)
    }

    /// What a tool prints that ends by itself.
    pub fn output(&self, host: &str, program: &str, arguments: &[&str]) -> String {
        self.tool(host, program, arguments).output()
    }

    /// Ends it in order, and gives all it said.
    pub fn end(mut self) -> Vec<Progress> {
        kill(pid(&self.child), Signal::SIGTERM).unwrap();
        let deadline = Instant::now() + TIMEOUT;
        while let Some(line) = self.lines.next(deadline) {
            self.said.push(serde_json::from_str(&line).unwrap());
        }
        assert!(self.child.wait().unwrap().success(), "{:#?}", self.said);
        std::mem::take(&mut self.said)
    }
}

impl Drop for Stage {
    fn drop(&mut self) {
        // Has ended already, unless a test failed.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A program inside a virtual host. Ends when it is dropped.
pub struct Tool {
    child: Child,
    lines: Lines,
}

impl Tool {
    /// Waits for a line with these words.
    pub fn wait_for(&self, words: &str) -> String {
        let deadline = Instant::now() + TIMEOUT;
        let mut said = Vec::new();
        while let Some(line) = self.lines.next(deadline) {
            if line.contains(words) {
                return line;
            }
            said.push(line);
        }
        panic!("it ended without a word of {words:?}: {said:#?}");
    }

    /// All its lines, when it ends by itself.
    pub fn output(mut self) -> String {
        let deadline = Instant::now() + TIMEOUT;
        let mut all = String::new();
        while let Some(line) = self.lines.next(deadline) {
            all.push_str(&line);
            all.push('\n');
        }
        assert!(self.child.wait().unwrap().success(), "{all}");
        all
    }

    /// What it has said by now and nobody has waited for.
    pub fn said(&self) -> Vec<String> {
        self.lines.0.try_iter().collect()
    }

    /// As `kill -9`.
    pub fn kill(mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }
}

impl Drop for Tool {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

pub fn pid(child: &Child) -> Pid {
    Pid::from_raw(i32::try_from(child.id()).unwrap())
}
