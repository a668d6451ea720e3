//! The surroundings of one point: a folder with a matrix file, and what is of others beside it. The main type is [`Scene`].

use std::{
    collections::BTreeMap,
    fs::{self, File},
    os::unix::process::CommandExt as _,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use nix::{
    sys::signal::{Signal, kill, killpg},
    unistd::Pid,
};
use serde_json::Value;
use tempfile::TempDir;

use crate::{Ran, There, Workplace, matrix_binary};

/// Between two looks at a journal: its lines are a write to the disk apart.
const LOOK: Duration = Duration::from_micros(200);
/// Each of these runs is of seconds.
const TIMEOUT: Duration = Duration::from_secs(60);
/// A folder that is nobody's of ours.
const FOREIGN: &str = "of-others";

/// Where the windows are measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Platform {
    /// Two scenarios that are measured in a blink.
    Fake,
    /// A process of this machine.
    Native,
    /// A container of the engine which all share.
    Docker,
    /// A process behind a real sshd.
    Ssh,
    /// A virtual machine, its processor emulated.
    Machine,
}

impl Platform {
    /// How many scenarios there are.
    #[must_use]
    pub fn scenarios(self) -> usize {
        if self == Self::Fake { 2 } else { 1 }
    }

    /// The windows of a scenario.
    #[must_use]
    pub fn windows(self) -> u32 {
        2
    }

    /// What a command has not done by now it never does.
    #[must_use]
    pub fn timeout(self) -> Duration {
        match self {
            // It boots, in software.
            Self::Machine => 10 * TIMEOUT,
            _ => TIMEOUT,
        }
    }

    /// Whether a window that the workload called complete is on the disk by then.
    #[must_use]
    pub fn syncs_its_windows(self) -> bool {
        self != Self::Fake
    }

    fn matrix_file(self, there: Option<&There>) -> String {
        // What becomes of windows is looked at, not what they are worth: however late a loop was, each counts.
        const MEASURED: &str = "  dynamics: robust\n  windows: 2\n  window: 2s\n  period: 500ms\n  reference: {amplitude_m: 0.05}\n  \
             validity: {missed_deadlines: {suspect: 0.1%, invalid: never}, gap_steps: {suspect: 5, invalid: never}, \
             release_lateness: {suspect: 1ms, invalid: never}}\n";
        match (self, there) {
            (Self::Ssh, Some(there)) => there.matrix(MEASURED),
            (Self::Fake, _) => "matrix:\n  virtualization: [fake]\n  labels: {place: [here, there]}\n\
                 workload:\n  windows: 2\n  window: 8s\n  period: 1s\n"
                .to_owned(),
            (Self::Machine, _) => format!(
                "matrix:\n  virtualization: [libvirt]\nworkload:\n{MEASURED}providers:\n  libvirt:\n    options: {{driver: qemu, \
                 cpu_mode: custom, cpu_model: qemu64, graphics_type: none, video_type: none}}\n"
            ),
            (Self::Docker, _) => format!("matrix:\n  virtualization: [docker]\nworkload:\n{MEASURED}"),
            _ => format!("matrix:\n  virtualization: [native]\nworkload:\n{MEASURED}"),
        }
    }
}

/// A command that did not end.
#[derive(Debug)]
pub struct Hung;

/// The surroundings.
pub struct Scene {
    /// Where the windows are measured.
    pub platform: Platform,
    // Before the folder that it may be mounted on, since fields are dropped in this order.
    disk: Option<Mounted>,
    /// The folder.
    pub workplace: Workplace,
    /// The other machine, if it is one.
    pub there: Option<There>,
    /// What is written down while a command runs: not on a disk that is full, or has lost power.
    aside: TempDir,
    bystander: Bystander,
}

impl Scene {
    /// A folder with the matrix file of a platform, and others' things.
    ///
    /// # Panics
    /// When this machine does not have what is needed.
    #[must_use]
    pub fn on(platform: Platform) -> Self {
        Self::with(platform, |_| None)
    }

    /// The same, on a disk of its own that is mounted on the folder first.
    ///
    /// # Panics
    /// As [`Scene::on`].
    #[must_use]
    pub fn with(platform: Platform, disk: impl FnOnce(&Path) -> Option<Mounted>) -> Self {
        let workplace = match platform {
            // Others' workloads on the same engine would be taken for neighbours that still measure.
            Platform::Docker | Platform::Machine => Workplace::measuring(),
            _ => Workplace::new(),
        };
        let disk = disk(workplace.path());
        let there = (platform == Platform::Ssh).then(There::start);
        workplace.write("m.yaml", platform.matrix_file(there.as_ref()));
        let aside = TempDir::with_prefix("matrix-aside-").expect("a folder");
        let bystander = Bystander::beside(&workplace, platform);
        Self {
            platform,
            disk,
            workplace,
            there,
            aside,
            bystander,
        }
    }

    /// Unmounts its disk, if it has one, and mounts another.
    ///
    /// # Panics
    /// When it cannot be mounted.
    pub fn change_disk(&mut self, disk: impl FnOnce(&Path) -> Mounted) {
        self.disk = None;
        self.disk = Some(disk(self.workplace.path()));
    }

    /// A file beside the folder, for what is written down of a command.
    #[must_use]
    pub fn aside(&self, name: &str) -> PathBuf {
        self.aside.path().join(name)
    }

    /// Starts `matrix`, below another program if `below` names one.
    ///
    /// # Panics
    /// When it cannot be started.
    #[must_use]
    pub fn start(&self, below: &[String], arguments: &[&str]) -> Started {
        let matrix = self.workplace.matrix(arguments);
        let mut command = match below {
            [] => matrix,
            [program, options @ ..] => {
                let mut command = Command::new(program);
                command.args(options).arg(matrix_binary()).args(matrix.get_args());
                command.current_dir(self.workplace.path()).stdin(Stdio::null());
                for (name, value) in matrix.get_envs() {
                    match value {
                        Some(value) => command.env(name, value),
                        None => command.env_remove(name),
                    };
                }
                command
            }
        };
        let said = |name: &str| File::create(self.aside(name)).expect("the folder can be written");
        let child = command
            .stdout(said("out"))
            .stderr(said("err"))
            .process_group(0)
            .spawn()
            .expect("the program starts");
        Started {
            child,
            out: self.aside("out"),
            err: self.aside("err"),
            timeout: self.platform.timeout(),
        }
    }

    /// What the command that was started last has said so far.
    #[must_use]
    pub fn said(&self) -> Vec<u8> {
        fs::read(self.aside("err")).unwrap_or_default()
    }

    /// Runs `matrix` to its end.
    ///
    /// # Errors
    /// When it has not ended in time; it is killed then.
    pub fn run(&self, arguments: &[&str]) -> Result<Ran, Hung> {
        self.start(&[], arguments).end()
    }

    /// The run directory, once it is there.
    #[must_use]
    pub fn run_directory(&self) -> Option<PathBuf> {
        children(&self.workplace.path().join("runs")).into_iter().next()
    }

    /// The state folders that its environments may be in.
    #[must_use]
    pub fn state_folders(&self) -> Vec<PathBuf> {
        let there = self.there.iter().map(|there| there.sshd.folder().join("state"));
        std::iter::once(self.workplace.path().join("state"))
            .chain(there)
            .collect()
    }

    /// The journal as it is now; its last line may be half-written.
    #[must_use]
    pub fn journal(&self) -> Vec<Value> {
        let Some(run) = self.run_directory() else {
            return Vec::new();
        };
        let text = fs::read_to_string(run.join("events.jsonl")).unwrap_or_default();
        text.lines()
            .map_while(|line| serde_json::from_str(line).ok())
            .collect()
    }

    /// How many lines the journal has.
    #[must_use]
    pub fn journal_lines(&self) -> usize {
        let journal = self.run_directory().map(|run| run.join("events.jsonl"));
        let bytes = journal
            .and_then(|journal| fs::read(journal).ok())
            .unwrap_or_default();
        bytes.iter().filter(|byte| **byte == b'\n').count()
    }

    /// Waits until the journal has so many lines; no when the command ended, or hung, before.
    pub fn wait_for_line(&self, started: &mut Started, line: usize) -> bool {
        let begun = Instant::now();
        loop {
            if self.journal_lines() >= line {
                return true;
            }
            if started.has_ended() || begun.elapsed() > started.timeout {
                return false;
            }
            thread::sleep(LOOK);
        }
    }

    /// Waits until the journal has an event, `workload`'s own by their names; no when the command ended, or hung, before.
    pub fn wait_for_event(&self, started: &mut Started, event: &str) -> bool {
        let is_it = |entry: &Value| entry["event"] == event || entry["progress"]["event"] == event;
        let mut line = 1;
        while self.wait_for_line(started, line) {
            if self.journal().iter().any(is_it) {
                return true;
            }
            line = self.journal_lines() + 1;
        }
        false
    }

    /// The processes of ours: those whose program, folder or words are below this scene's folders.
    #[must_use]
    pub fn processes(&self) -> Vec<(i32, String)> {
        let ours = self.state_folders();
        let begins = |path: &Path| {
            path.starts_with(self.workplace.path()) || ours.iter().any(|it| path.starts_with(it))
        };
        let mut found = Vec::new();
        for process in children(Path::new("/proc")) {
            let pid = process.file_name().and_then(|name| name.to_str()?.parse().ok());
            let Some(pid) = pid else { continue };
            let links = ["exe", "cwd"].map(|name| fs::read_link(process.join(name)).unwrap_or_default());
            let words = fs::read(process.join("cmdline")).unwrap_or_default();
            let words = String::from_utf8_lossy(&words).replace('\0', " ");
            let names = ours.iter().any(|it| words.contains(&*it.to_string_lossy()));
            // sshd is of the other machine.
            if (links.iter().any(|link| begins(link)) || names) && !words.starts_with("sshd") {
                found.push((pid, words));
            }
        }
        found
    }

    /// The containers and volumes of the run on the engine which all share.
    #[must_use]
    pub fn on_the_engine(&self) -> Vec<String> {
        match (self.platform, self.run_directory()) {
            (Platform::Docker, Some(_)) => crate::engine::on_the_engine(&self.workplace),
            _ => Vec::new(),
        }
    }

    /// Kills the workload: its processes, or its containers.
    pub fn kill_workload(&self) {
        for (pid, words) in self.processes() {
            if words.contains("/bin/workload-") {
                // It may have ended already.
                let _ = kill(Pid::from_raw(pid), Signal::SIGKILL);
            }
        }
        for id in self.on_the_engine() {
            // A volume is none, and a container may have ended.
            let _ = Command::new("docker").args(["kill", &id]).output();
        }
    }

    /// What of others was touched.
    #[must_use]
    pub fn touched(&mut self) -> Vec<String> {
        self.bystander.touched()
    }
}

impl Drop for Scene {
    fn drop(&mut self) {
        // What a point left is told by the judge; nothing of it is to disturb the next one.
        for (pid, _) in self.processes() {
            let _ = kill(Pid::from_raw(pid), Signal::SIGKILL);
        }
        if self.platform == Platform::Machine {
            let _ = self.run(&["clean"]);
        }
        for id in self.on_the_engine() {
            for kind in ["container", "volume"] {
                let _ = Command::new("docker").args([kind, "rm", "--force", &id]).output();
            }
        }
    }
}

/// What is in a folder, in order; nothing if it is none.
#[must_use]
pub fn children(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten();
    let mut children: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    children.sort();
    children
}

/// A `matrix` that is at work, in a process group of its own.
pub struct Started {
    child: Child,
    out: PathBuf,
    err: PathBuf,
    timeout: Duration,
}

impl Started {
    fn pid(&self) -> Pid {
        Pid::from_raw(i32::try_from(self.child.id()).expect("a process number"))
    }

    /// Whether it has ended.
    pub fn has_ended(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(Some(_)))
    }

    /// Sends it a signal.
    pub fn signal(&self, signal: Signal) {
        // It may have ended already.
        let _ = kill(self.pid(), signal);
    }

    /// Kills it, as the kernel's out-of-memory killer would.
    pub fn kill(mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }

    /// Kills its process group.
    pub fn kill_group(mut self) {
        let _ = killpg(self.pid(), Signal::SIGKILL);
        let _ = self.child.wait();
    }

    /// Waits for its end.
    ///
    /// # Errors
    /// When it has not ended in time; it is killed then.
    pub fn end(self) -> Result<Ran, Hung> {
        let timeout = self.timeout;
        self.end_within(timeout)
    }

    /// Waits for its end for so long.
    ///
    /// # Errors
    /// As [`Started::end`].
    pub fn end_within(mut self, timeout: Duration) -> Result<Ran, Hung> {
        let begun = Instant::now();
        let status = loop {
            if let Ok(Some(status)) = self.child.try_wait() {
                break status;
            }
            if begun.elapsed() > timeout {
                self.kill_group();
                return Err(Hung);
            }
            thread::sleep(Duration::from_millis(2));
        };
        let read = |path: &Path| String::from_utf8_lossy(&fs::read(path).unwrap_or_default()).into_owned();
        Ok(Ran {
            code: status.code(),
            out: read(&self.out),
            err: read(&self.err),
        })
    }
}

/// A disk that is mounted, until it is dropped.
pub struct Mounted(PathBuf);

impl Mounted {
    /// Mounts something, as mount(8) takes it.
    ///
    /// # Panics
    /// When it cannot be mounted.
    #[must_use]
    pub fn new(arguments: &[&str], on: &Path) -> Self {
        let mounted = Command::new("mount")
            .args(arguments)
            .arg(on)
            .output()
            .expect("mount starts");
        assert!(mounted.status.success(), "only root can mount: {mounted:?}");
        Self(on.to_owned())
    }
}

impl Drop for Mounted {
    fn drop(&mut self) {
        // Somebody may have a file on it still.
        let _ = Command::new("umount").arg("--lazy").arg(&self.0).output();
    }
}

/// What is of others: files beside ours and in our state folder, a process, a container.
struct Bystander {
    files: BTreeMap<PathBuf, String>,
    process: Child,
    container: Option<String>,
}

impl Bystander {
    fn beside(workplace: &Workplace, platform: Platform) -> Self {
        let mut files = BTreeMap::new();
        for place in ["", "state", "state/bin"] {
            let folder = workplace.path().join(place).join(FOREIGN);
            fs::create_dir_all(&folder).expect("the folder can be written");
            let text = format!("of somebody else, in {place:?}\n");
            fs::write(folder.join("notes"), &text).expect("the folder can be written");
            files.insert(folder.join("notes"), text);
        }
        let process = Command::new("sleep")
            .arg("infinity")
            .spawn()
            .expect("sleep starts");
        let container = (platform == Platform::Docker).then(|| {
            let images = Command::new("docker")
                .args(["images", "--quiet"])
                .output()
                .expect("docker starts");
            let images = String::from_utf8_lossy(&images.stdout).into_owned();
            let image = images.lines().next().expect("the engine has an image").to_owned();
            let made = Command::new("docker")
                .args(["create", "--label", "of=others", &image, "/bin/true"])
                .output()
                .expect("docker starts");
            assert!(made.status.success(), "{made:?}");
            String::from_utf8_lossy(&made.stdout).trim().to_owned()
        });
        Self {
            files,
            process,
            container,
        }
    }

    fn touched(&mut self) -> Vec<String> {
        let mut touched: Vec<String> = self
            .files
            .iter()
            .filter(|(path, text)| fs::read_to_string(path).ok().as_ref() != Some(text))
            .map(|(path, _)| format!("{} of others was touched", path.display()))
            .collect();
        if !matches!(self.process.try_wait(), Ok(None)) {
            touched.push("a process of others was ended".to_owned());
        }
        if let Some(container) = &self.container {
            let there = Command::new("docker")
                .args(["container", "inspect", container])
                .output();
            if !there.is_ok_and(|there| there.status.success()) {
                touched.push("a container of others was removed".to_owned());
            }
        }
        touched
    }
}

impl Drop for Bystander {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
        if let Some(container) = &self.container {
            let _ = Command::new("docker").args(["rm", "--force", container]).output();
        }
    }
}
