//! A real Slurm cluster on this machine (`tests/slurm/cluster`), and its user. The main type is [`Cluster`].

use std::{
    fs,
    os::unix::fs::{PermissionsExt as _, chown},
    path::{Path, PathBuf},
    process::{Command, Stdio},
    sync::OnceLock,
    thread,
    time::{Duration, Instant},
};

use nix::unistd::User;

use crate::{Ran, Workplace, matrix_binary, workloads_for};

/// What has not happened by now never will.
const HOPELESS: Duration = Duration::from_secs(120);
/// Between two looks.
const LOOK: Duration = Duration::from_millis(200);
/// Whose the jobs are.
const USER: &str = "researcher";

/// The cluster, with a folder of its user's on the file system that its nodes share. It is whole again when this is dropped.
pub struct Cluster {
    /// Where its user works.
    pub workplace: Workplace,
}

impl Cluster {
    /// Has it started, with no job of its user's. A test that uses it measures, so that it waits for its turn.
    ///
    /// # Panics
    /// When it does not come up.
    #[must_use]
    pub fn start() -> Self {
        let turn = Workplace::measuring();
        script("cluster", &["start"]);
        let workplace = turn.of_user(USER, &binary());
        Self { workplace }
    }

    /// Does something to a node, as `tests/slurm/node` has it.
    ///
    /// # Panics
    /// When that fails.
    pub fn node(&self, what: &str, node: &str) {
        script("node", &[what, node]);
    }

    /// The workload for a machine, in a folder that its user can read, as `MATRIX_WORKLOADS` names it. Root's own folders need not be
    /// readable to others.
    ///
    /// # Panics
    /// When it cannot be built or copied.
    #[must_use]
    pub fn workload_for(&self, machine: &str) -> PathBuf {
        let built = workloads_for(&[machine]);
        let folder = self.workplace.path().join("workloads");
        fs::create_dir_all(folder.join(machine)).expect("the user's folder can be written");
        for file in ["SHA256SUMS", &format!("{machine}/workload")] {
            fs::copy(built.join(file), folder.join(file)).expect("the builder made it");
        }
        folder
    }

    /// Ends the cluster's controller, or begins it again.
    ///
    /// # Panics
    /// When that fails.
    pub fn controller(&self, runs: bool) {
        script("cluster", &[if runs { "controller" } else { "no-controller" }]);
    }

    /// Lets its user use the Docker Engine that all nodes have. A cluster that has just started does not.
    ///
    /// # Panics
    /// When there is none.
    pub fn share_the_engine(&self) {
        script("cluster", &["engine"]);
    }

    /// The jobs of its user that have not ended: number, state, node and name of each.
    ///
    /// # Panics
    /// When the cluster does not answer.
    #[must_use]
    pub fn jobs(&self) -> Vec<[String; 4]> {
        let said = self.slurm(&["squeue", "--noheader", "--me", "--format=%i|%T|%N|%j"]);
        said.lines()
            .map(|line| {
                let fields: Vec<String> = line.split('|').map(str::to_owned).collect();
                fields.try_into().expect("four fields")
            })
            .collect()
    }

    /// What a tool of Slurm's prints, called by its user.
    ///
    /// # Panics
    /// When it fails.
    #[must_use]
    pub fn slurm(&self, command: &[&str]) -> String {
        let ran = self.as_user(command);
        assert_eq!(ran.code, Some(0), "{command:?}: {ran:?}");
        ran.out
    }

    /// A command of its user's, in the folder.
    ///
    /// # Panics
    /// When it cannot be started.
    #[must_use]
    pub fn as_user(&self, command: &[&str]) -> Ran {
        let (program, arguments) = command.split_first().expect("a command has a program");
        let mut called = self.workplace.program(program);
        Ran::of(called.args(arguments).output().expect("the command starts"))
    }

    /// Waits until that is so.
    ///
    /// # Panics
    /// When it never is.
    pub fn until(&self, what: &str, is_so: impl Fn() -> bool) {
        let begun = Instant::now();
        while !is_so() {
            assert!(begun.elapsed() < HOPELESS, "never: {what}; {:?}", self.jobs());
            thread::sleep(LOOK);
        }
    }

    /// The node on which the one running job of its user's runs.
    ///
    /// # Panics
    /// When none runs.
    #[must_use]
    pub fn running_on(&self) -> String {
        let jobs = self.jobs();
        let running = jobs.iter().find(|[_, state, ..]| state == "RUNNING");
        running.unwrap_or_else(|| panic!("none runs: {jobs:?}"))[2].clone()
    }
}

impl Drop for Cluster {
    /// Nodes that a test has broken are not to be the next one's.
    fn drop(&mut self) {
        if !thread::panicking() {
            script("cluster", &["start"]);
        }
    }
}

/// `matrix` where its user and the nodes see it.
fn binary() -> PathBuf {
    static COPIED: OnceLock<PathBuf> = OnceLock::new();
    COPIED
        .get_or_init(|| {
            let user = user();
            let copy = user.dir.join("matrix");
            // Others may run the copy that is there.
            let new = user.dir.join(format!("matrix.{}", std::process::id()));
            fs::copy(matrix_binary(), &new).expect("the user's home can be written");
            fs::set_permissions(&new, fs::Permissions::from_mode(0o755)).expect("it is ours");
            fs::rename(&new, &copy).expect("the user's home can be written");
            copy
        })
        .clone()
}

pub(crate) fn user() -> User {
    User::from_name(USER)
        .ok()
        .flatten()
        .expect("tests/slurm/cluster makes the user")
}

/// Gives a file to the cluster's user.
///
/// # Panics
/// When it is not there.
pub fn give(path: &Path) {
    let user = user();
    chown(path, Some(user.uid.as_raw()), Some(user.gid.as_raw())).expect("the tests run as root");
}

fn script(name: &str, arguments: &[&str]) {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("slurm").join(name);
    let output = Command::new(&script)
        .args(arguments)
        .stdin(Stdio::null())
        .output()
        .expect("the script starts");
    assert!(
        output.status.success(),
        "{name} {arguments:?}: {}",
        String::from_utf8_lossy(&output.stderr)
    );
}
