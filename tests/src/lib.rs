//! End-to-end tests of the `matrix` command as a user has it: the real binary in a folder of its own.
//!
//! The hermetic tests are in `tests/tests`, the others in `tests/machine` and `tests/engines`. This is what they share. The
//! main type is [`Workplace`]; [`Guest`] is a machine with a kernel of its own.

pub mod browser;
pub mod campaign;
pub mod cluster;
pub mod difference;
pub mod documents;
pub mod engine;
mod fleet;
mod guest;
pub mod killed;
mod macos;
mod program;
pub mod sshd;
mod there;
pub mod virtual_time;
pub mod virtualbox;
mod workload;

use std::{
    ffi::OsStr,
    fs::File,
    io::{BufRead, BufReader, Read as _},
    os::unix::fs::chown,
    path::{Path, PathBuf},
    process::{Child, Command, Output, Stdio},
    sync::{Arc, OnceLock},
};

use nix::{
    sys::signal::{Signal, kill},
    unistd::{Pid, User},
};
use serde_json::Value;
use tempfile::TempDir;

pub use crate::{
    fleet::Fleet,
    guest::{AARCH64, DEBIAN_12, Guest, I686, Model},
    macos::MacOs,
    there::There,
    workload::{workload_binary, workload_example, workloads_for},
};

/// Two fake scenarios of four windows: the whole pipeline in a blink.
pub const FAKE: &str = "\
matrix:
  virtualization: [fake]
  labels: {place: [here, there]}
workload:
  windows: 4
  window: 8s
  period: 1s
";

/// Where the `matrix` binary is; built first if need be, by the same cargo that runs the tests, in the profile
/// that the README's command uses, for benchmarks too.
pub fn matrix_binary() -> &'static Path {
    static BINARY: OnceLock<PathBuf> = OnceLock::new();
    BINARY.get_or_init(|| {
        escargot::CargoBuild::new()
            .package("orchestrator")
            .bin("matrix")
            .manifest_path(Path::new(env!("CARGO_MANIFEST_DIR")).join("../Cargo.toml"))
            .run()
            .expect("`cargo build -p orchestrator` works")
            .path()
            .to_owned()
    })
}

/// Where the program of `orchestrator/examples/provider_from_outside.rs` is; built first if need be, as [`matrix_binary`].
pub fn program_with_another_provider() -> &'static Path {
    static BINARY: OnceLock<PathBuf> = OnceLock::new();
    BINARY.get_or_init(|| {
        escargot::CargoBuild::new()
            .package("orchestrator")
            .example("provider_from_outside")
            .manifest_path(Path::new(env!("CARGO_MANIFEST_DIR")).join("../Cargo.toml"))
            .run()
            .expect("`cargo build -p orchestrator --example provider_from_outside` works")
            .path()
            .to_owned()
    })
}

/// A line below `workload:` for tests of what becomes of windows, not of what they are worth: however much of the machine
/// others take, every whole window counts. That a disturbed one does not is tested where the rules are.
pub const WHOLE_WINDOWS_COUNT: &str = "validity: {\
    missed_deadlines: {suspect: 0.1%, invalid: never}, \
    gap_steps: {suspect: 5, invalid: never}, \
    release_lateness: {suspect: 1ms, invalid: never}}";

/// A folder to work in, with a state folder and, unless it measures for real, a lease of its own.
pub struct Workplace {
    folder: TempDir,
    turn: Option<Turn>,
    variables: Vec<(String, String)>,
    user: Option<AsUser>,
}

/// Whoever calls `matrix`, where it is not who runs the tests.
#[derive(Clone)]
struct AsUser {
    name: String,
    home: PathBuf,
    matrix: PathBuf,
}

/// A test that measures has the machine and its engine for itself: `matrix clean` of one would remove what another
/// one killed on purpose.
#[derive(Clone)]
struct Turn(#[allow(dead_code, reason = "held, not used")] Arc<File>);

/// Whether the folder of a window has all that was measured in it.
#[must_use]
pub fn is_whole(window: &Path) -> bool {
    let Ok(record) = std::fs::read(window.join("window.json")) else {
        return false;
    };
    let record: Value = serde_json::from_slice(&record).expect("a record is JSON");
    record["complete"] == true && window.join("control.csv").exists()
}

/// Brings a run directory to what an earlier version, or whoever changes one with care, would have written.
///
/// # Panics
/// When it has no journal that can be read and written.
pub fn without_checksums(directory: &Path) {
    let journal = directory.join("events.jsonl");
    let text = std::fs::read_to_string(&journal).expect("there is a journal");
    let mut lines = String::new();
    for line in text.lines() {
        let mut entry: Value = serde_json::from_str(line).expect("a journal's lines are JSON");
        if let Some(fields) = entry.as_object_mut() {
            for field in ["sum", "sha256", "manifest_sha256", "plan_sha256"] {
                fields.remove(field);
            }
        }
        if entry["event"] != "environment-recorded" {
            lines.push_str(&format!("{entry}\n"));
        }
    }
    std::fs::write(journal, lines).expect("the journal can be written");
}

/// A copy of a worked example of `examples/`, to measure in.
///
/// # Panics
/// When there is no such example.
#[must_use]
pub fn example(name: &str) -> Workplace {
    let workplace = Workplace::measuring();
    let example = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../examples")
        .join(name);
    for entry in std::fs::read_dir(example).expect("the example is there") {
        let from = entry.expect("the folder can be read").path();
        if from.is_file() {
            let to = workplace.path().join(from.file_name().unwrap_or_default());
            std::fs::copy(from, to).expect("the folder can be written");
        }
    }
    workplace
}

/// What a command printed and how it ended.
#[derive(Debug)]
pub struct Ran {
    /// Exit code; `None` when a signal ended it.
    pub code: Option<i32>,
    /// Standard output.
    pub out: String,
    /// Standard error.
    pub err: String,
}

impl Workplace {
    /// For tests with fakes: nothing is shared with other tests.
    #[must_use]
    pub fn new() -> Self {
        Self {
            folder: TempDir::with_prefix("matrix-test-").expect("a folder to work in"),
            turn: None,
            variables: Vec::new(),
            user: None,
        }
    }

    /// For tests that measure: they take turns, those of other processes too. `tests/run` gives the tests of emulated machines
    /// two turns (`MATRIX_TESTS_TURN`), since what they measure is not this machine.
    #[must_use]
    pub fn measuring() -> Self {
        // Nobody is to wait while it is built.
        matrix_binary();
        let turn = std::env::var_os("MATRIX_TESTS_TURN")
            .map_or_else(|| std::env::temp_dir().join("matrix-tests.turn"), PathBuf::from);
        let file = File::create(turn).expect("a file to take turns by");
        file.lock().expect("turns can be taken");
        Self {
            turn: Some(Turn(Arc::new(file))),
            ..Self::new()
        }
    }

    /// Another folder for the same test, which has its turn already.
    #[must_use]
    pub fn beside(&self) -> Self {
        let turn = Self {
            turn: self.turn.clone(),
            ..Self::new()
        };
        match &self.user {
            Some(user) => turn.of_user(&user.name, &user.matrix),
            None => turn,
        }
    }

    /// The same for another user, in a folder below that user's home, with `matrix` from where that user can read it.
    ///
    /// # Panics
    /// When there is no such user, or this is not root.
    #[must_use]
    pub fn of_user(self, name: &str, matrix: &Path) -> Self {
        let user = User::from_name(name)
            .ok()
            .flatten()
            .expect("there is such a user");
        let folder = TempDir::with_prefix_in("matrix-test-", &user.dir).expect("the home can be written");
        chown(folder.path(), Some(user.uid.as_raw()), Some(user.gid.as_raw())).expect("this is root");
        Self {
            folder,
            user: Some(AsUser {
                name: name.to_owned(),
                home: user.dir,
                matrix: matrix.to_owned(),
            }),
            ..self
        }
    }

    /// Has `matrix` see a variable of the environment.
    pub fn set(&mut self, name: &str, value: &str) {
        self.variables.push((name.to_owned(), value.to_owned()));
    }

    /// The folder.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.folder.path()
    }

    /// Writes a file.
    pub fn write(&self, name: &str, text: impl AsRef<[u8]>) {
        std::fs::write(self.path().join(name), text).expect("the folder can be written");
    }

    /// The `matrix` command in this folder.
    pub fn matrix(&self, arguments: impl IntoIterator<Item = impl AsRef<OsStr>>) -> Command {
        let matrix = self.user.as_ref().map(|user| user.matrix.as_path());
        let mut command = self.program(matrix.unwrap_or_else(|| matrix_binary()));
        command.args(arguments);
        command.env("MATRIX_STATE_DIR", self.path().join("state"));
        command.env_remove("RUST_BACKTRACE");
        command.envs(self.variables.iter().cloned());
        if self.turn.is_none() {
            command.env("MATRIX_LEASE", self.path().join("lease"));
        }
        command
    }

    /// A program in this folder, called by whoever calls `matrix`.
    pub fn program(&self, program: impl AsRef<OsStr>) -> Command {
        let mut command = match &self.user {
            None => Command::new(program),
            Some(user) => {
                let mut command = Command::new("setpriv");
                command
                    .args(["--reuid", &user.name, "--regid", &user.name, "--init-groups"])
                    .arg(program)
                    .env("HOME", &user.home);
                command
            }
        };
        command.current_dir(self.path()).stdin(Stdio::null());
        command
    }

    /// Runs `matrix` to its end.
    pub fn run(&self, arguments: &[&str]) -> Ran {
        Ran::of(self.matrix(arguments).output().expect("matrix starts"))
    }

    /// Runs `matrix … --json` and reads what it prints.
    pub fn json(&self, arguments: &[&str]) -> Value {
        let ran = self.run(&[arguments, &["--json"]].concat());
        serde_json::from_str(&ran.out)
            .unwrap_or_else(|error| panic!("{arguments:?} prints JSON: {error}\n{ran:?}"))
    }

    /// Starts `matrix` and follows its plain lines.
    pub fn start(&self, arguments: &[&str]) -> Running {
        Running::of(&mut self.matrix(arguments))
    }

    /// The one run directory under `runs/`.
    #[must_use]
    pub fn run_directory(&self) -> PathBuf {
        let mut runs: Vec<PathBuf> = std::fs::read_dir(self.path().join("runs"))
            .expect("there are runs")
            .map(|entry| entry.expect("the folder can be read").path())
            .collect();
        assert_eq!(runs.len(), 1, "one run: {runs:?}");
        runs.remove(0)
    }

    /// Fails when a line of the workload is in the journal of the one run more than once. Those that say how it is resemble
    /// each other, and are never there.
    pub fn assert_lines_came_once(&self) {
        let journal =
            std::fs::read_to_string(self.run_directory().join("events.jsonl")).expect("there is a journal");
        let events = journal
            .lines()
            .map(|line| serde_json::from_str::<Value>(line).expect("a journal's lines are JSON"));
        let mut seen = Vec::new();
        for event in events.filter(|event| event["event"] == "workload") {
            let said = event["progress"].clone();
            assert!(!seen.contains(&said), "{said} is there twice:\n{journal}");
            seen.push(said);
        }
        assert!(!seen.is_empty(), "the workload says what it does:\n{journal}");
    }

    /// The folder of the one scenario that the one run has data of.
    #[must_use]
    pub fn scenario_directory(&self) -> PathBuf {
        let scenarios =
            std::fs::read_dir(self.run_directory().join("scenarios")).expect("there are scenarios");
        let mut scenarios: Vec<PathBuf> = scenarios
            .map(|entry| entry.expect("the folder can be read").path())
            .collect();
        assert_eq!(scenarios.len(), 1, "one scenario: {scenarios:?}");
        scenarios.remove(0)
    }
}

impl Default for Workplace {
    fn default() -> Self {
        Self::new()
    }
}

impl Ran {
    /// Of a command that has ended.
    pub fn of(output: Output) -> Self {
        Self {
            code: output.status.code(),
            out: String::from_utf8_lossy(&output.stdout).into_owned(),
            err: String::from_utf8_lossy(&output.stderr).into_owned(),
        }
    }
}

/// A `matrix` that is at work; killed when it is dropped, so that a test that fails leaves nobody who holds the machine.
pub struct Running {
    child: Child,
    lines: BufReader<std::process::ChildStderr>,
}

impl Drop for Running {
    fn drop(&mut self) {
        // It has ended, mostly.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Running {
    /// Starts such a command.
    pub fn of(matrix: &mut Command) -> Self {
        let mut child = matrix
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("matrix starts");
        let lines = BufReader::new(child.stderr.take().expect("standard error is a pipe"));
        Self { child, lines }
    }

    /// The next line on standard error; `None` at its end.
    pub fn next_line(&mut self) -> Option<String> {
        let mut line = String::new();
        let read = self.lines.read_line(&mut line).expect("the pipe can be read");
        (read > 0).then(|| line.trim_end().to_owned())
    }

    /// Reads until a line has `text` in it; all lines up to that one.
    pub fn wait_for(&mut self, text: &str) -> String {
        let mut seen = String::new();
        while let Some(line) = self.next_line() {
            seen.push_str(&line);
            seen.push('\n');
            if line.contains(text) {
                return seen;
            }
        }
        panic!("no line has {text:?}:\n{seen}");
    }

    /// The most memory it had resident so far, in KiB, as the kernel counts it.
    pub fn peak_memory_kib(&self) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).expect("it runs");
        let line = status
            .lines()
            .find(|line| line.starts_with("VmHWM:"))
            .expect("the kernel counts it");
        line.split_whitespace()
            .nth(1)
            .and_then(|number| number.parse().ok())
            .expect("a number of KiB")
    }

    /// Kills it as the kernel's out-of-memory killer would.
    pub fn kill(mut self) {
        self.child.kill().expect("it can be killed");
        self.child.wait().expect("it can be waited for");
    }

    /// Presses Ctrl-C and waits for the end.
    pub fn interrupt(self) -> Ran {
        let pid = i32::try_from(self.child.id()).expect("a process number");
        kill(Pid::from_raw(pid), Signal::SIGINT).expect("it can be signalled");
        self.end()
    }

    /// Waits for the end.
    pub fn end(mut self) -> Ran {
        let mut err = String::new();
        while let Some(line) = self.next_line() {
            err.push_str(&line);
            err.push('\n');
        }
        let mut out = String::new();
        if let Some(mut output) = self.child.stdout.take() {
            output.read_to_string(&mut out).expect("the pipe can be read");
        }
        let status = self.child.wait().expect("it can be waited for");
        Ran {
            code: status.code(),
            out,
            err,
        }
    }
}
