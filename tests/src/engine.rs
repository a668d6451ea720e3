//! A Docker Engine of a test's own, which may be stopped and restarted while the one that all share goes on. The main type
//! is [`Engine`].

use std::{
    fs::{self, File},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
};

use nix::{
    sys::signal::{Signal, kill},
    unistd::Pid,
};
use tempfile::TempDir;

use crate::{Ran, Workplace, sshd::wait_until};

/// The containers, then the volumes, of the one run that the engine which all share has.
///
/// # Panics
/// When it does not answer.
#[must_use]
pub fn on_the_engine(workplace: &Workplace) -> Vec<String> {
    let run_directory = workplace.run_directory();
    let filter = format!("label=matrix.run-directory={}", run_directory.display());
    let kinds: [&[&str]; 2] = [&["ps", "--all"], &["volume", "ls"]];
    let mut found = Vec::new();
    for kind in kinds {
        let listed = Command::new("docker")
            .args(kind)
            .args(["--quiet", "--filter", &filter])
            .output()
            .expect("docker starts");
        assert!(listed.status.success(), "{listed:?}");
        found.extend(String::from_utf8_lossy(&listed.stdout).lines().map(str::to_owned));
    }
    found
}

/// The image of `dockerfiles/mininet` on the engine that all share, made if need be: its name.
///
/// # Panics
/// When it cannot be made; the recipe has said why.
#[must_use]
pub fn mininet_image() -> String {
    made_by("mininet", &[])
}

/// An image of Debian 12 with these packages, made if need be: its name.
///
/// # Panics
/// When it cannot be made; the recipe has said why.
#[must_use]
pub fn debian_image(name: &str, packages: &[&str]) -> String {
    made_by("debian", &[&[name], packages].concat())
}

fn made_by(recipe: &str, arguments: &[&str]) -> String {
    let recipes = Path::new(env!("CARGO_MANIFEST_DIR")).join("../dockerfiles");
    let made = Command::new(recipes.join(recipe).join("build"))
        .args(arguments)
        .stdin(Stdio::null())
        .stderr(Stdio::inherit())
        .output()
        .expect("the recipe starts");
    assert!(made.status.success(), "the image could not be made");
    String::from_utf8_lossy(&made.stdout).trim().to_owned()
}

/// The engine, until it is dropped, and its containers with it.
#[derive(Debug)]
pub struct Engine {
    folder: TempDir,
    live_restore: bool,
    daemon: Option<Child>,
}

impl Engine {
    /// Starts one. With `live_restore`, what its containers do outlives its daemon.
    ///
    /// # Panics
    /// When it does not come up, with what it said.
    #[must_use]
    pub fn start(live_restore: bool) -> Self {
        let mut engine = Self {
            folder: TempDir::with_prefix("matrix-engine-").expect("a folder for the engine"),
            live_restore,
            daemon: None,
        };
        engine.serve();
        engine
    }

    /// As `DOCKER_HOST` names it.
    #[must_use]
    pub fn address(&self) -> String {
        format!("unix://{}", self.file("docker.sock").display())
    }

    /// Asks it to end, waits until it has, and starts it anew.
    ///
    /// # Panics
    /// As [`Engine::start`].
    pub fn restart(&mut self) {
        self.end(Signal::SIGTERM);
        self.serve();
    }

    /// Kills it, and starts it anew.
    ///
    /// # Panics
    /// As [`Engine::start`].
    pub fn crash(&mut self) {
        self.end(Signal::SIGKILL);
        // Its containerd dies with it, a moment later; a new daemon would take it for alive and wait for it.
        let containerd = fs::read_to_string(self.file("run/containerd/containerd.pid")).unwrap_or_default();
        wait_until("its containerd has ended", || {
            // Who has ended has no command line, also while nobody has asked how.
            let command = fs::read(format!("/proc/{}/cmdline", containerd.trim()));
            !command.is_ok_and(|command| command.starts_with(b"containerd"))
        });
        // And so would it while nobody has asked how it ended.
        let _ = fs::remove_file(self.file("run/containerd/containerd.pid"));
        self.serve();
    }

    /// Runs `docker` against it.
    ///
    /// # Panics
    /// When `docker` cannot be started.
    #[must_use]
    pub fn docker(&self, arguments: &[&str]) -> Ran {
        let output = Command::new("docker")
            .args(["--host", &self.address()])
            .args(arguments)
            .stdin(Stdio::null())
            .output()
            .expect("docker starts: apt-get install docker.io");
        Ran::of(output)
    }

    fn file(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn serve(&mut self) {
        let settings = format!(
            // No network but `none` is needed, and a kernel may have no overlay.
            r#"{{"live-restore": {}, "bridge": "none", "iptables": false, "storage-driver": "vfs"}}"#,
            self.live_restore
        );
        fs::write(self.file("daemon.json"), settings).expect("the folder can be written");
        // Of a daemon that was killed.
        let _ = fs::remove_file(self.file("pid"));
        let log = File::options()
            .create(true)
            .append(true)
            .open(self.file("log"))
            .expect("the folder can be written");
        let mut daemon = Command::new("setpriv");
        daemon
            // It ends with the test, however that ends.
            .args(["--pdeathsig", "TERM", "dockerd"])
            .args(["--host", &self.address()])
            // containerd may be the system's.
            .args(["--containerd-namespace", &self.name()])
            .args([
                "--containerd-plugins-namespace",
                &format!("{}-plugins", self.name()),
            ]);
        for (option, name) in [
            ("--config-file", "daemon.json"),
            ("--data-root", "data"),
            ("--exec-root", "run"),
            ("--pidfile", "pid"),
        ] {
            daemon.arg(option).arg(self.file(name));
        }
        let daemon = daemon
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(log)
            .spawn()
            .expect("dockerd starts: apt-get install docker.io util-linux");
        self.daemon = Some(daemon);
        wait_until("the engine answers", || {
            let ended = self.daemon.as_mut().map(Child::try_wait);
            assert!(
                matches!(ended, Some(Ok(None))),
                "dockerd has ended:\n{}",
                self.said()
            );
            self.docker(&["version"]).code == Some(0)
        });
    }

    fn said(&self) -> String {
        fs::read_to_string(self.file("log")).unwrap_or_default()
    }

    fn name(&self) -> String {
        let name = self.folder.path().file_name().unwrap_or_default();
        name.to_string_lossy().into_owned()
    }

    fn end(&mut self, signal: Signal) {
        if let Some(mut daemon) = self.daemon.take() {
            let pid = i32::try_from(daemon.id()).expect("a process number");
            // It may have ended already.
            let _ = kill(Pid::from_raw(pid), signal);
            let _ = daemon.wait();
        }
    }
}

impl Drop for Engine {
    fn drop(&mut self) {
        // With live-restore they would stay.
        let there = self.docker(&["ps", "--all", "--quiet"]).out;
        let there: Vec<&str> = there.split_whitespace().collect();
        if !there.is_empty() {
            let _ = self.docker(&[["rm", "--force", "--volumes"].as_slice(), &there].concat());
        }
        self.end(Signal::SIGTERM);
    }
}
