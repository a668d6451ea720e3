//! A real sshd on a port of 127.0.0.1, with keys and files of its own. The main type is [`Sshd`]; [`Agent`] is a real
//! ssh-agent.

use std::{
    fs::{self, File},
    net::{Ipv4Addr, TcpListener},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use nix::{
    sys::signal::{Signal, kill},
    unistd::{Pid, Uid, User},
};
use tempfile::TempDir;

/// What has not happened by now never will.
const HOPELESS: Duration = Duration::from_secs(60);
/// Between two looks.
const LOOK: Duration = Duration::from_millis(20);
/// Another process can take the port between the moment it was found free and sshd's.
const PORTS_TO_TRY: usize = 5;

/// The server, until it is dropped, and its connections with it. It lets the user in who runs the test, by one key.
#[derive(Debug)]
pub struct Sshd {
    folder: TempDir,
    options: String,
    /// More of what a login there has: words of `SetEnv`.
    surroundings: String,
    port: u16,
    server: Option<Child>,
}

impl Sshd {
    /// Starts one.
    ///
    /// # Panics
    /// When it does not come up, with what it said or what to install.
    #[must_use]
    pub fn start() -> Self {
        Self::with("")
    }

    /// Starts one with more lines of sshd_config(5), which come first and so win.
    ///
    /// # Panics
    /// As [`Sshd::start`].
    #[must_use]
    pub fn with(options: &str) -> Self {
        Self::in_surroundings("", options)
    }

    /// Starts one whose logins have some more variables, as `SetEnv` takes them.
    ///
    /// # Panics
    /// As [`Sshd::start`].
    #[must_use]
    pub fn in_surroundings(variables: &str, options: &str) -> Self {
        let folder = TempDir::with_prefix("matrix-sshd-").expect("a folder for sshd");
        make_key(&folder.path().join("host_ed25519"), "ed25519", "");
        make_key(&folder.path().join("host_rsa"), "rsa", "");
        make_key(&folder.path().join("identity"), "ed25519", "");
        fs::copy(
            folder.path().join("identity.pub"),
            folder.path().join("authorized_keys"),
        )
        .expect("the folder can be written");
        let mut sshd = Self {
            folder,
            options: options.to_owned(),
            surroundings: variables.to_owned(),
            port: 0,
            server: None,
        };
        for _ in 0..PORTS_TO_TRY {
            sshd.port = TcpListener::bind((Ipv4Addr::LOCALHOST, 0))
                .and_then(|listener| listener.local_addr())
                .expect("a free port")
                .port();
            if sshd.try_serve() {
                let line = sshd.known_hosts_line("host_ed25519");
                fs::write(sshd.known_hosts(), line).expect("the folder can be written");
                return sshd;
            }
        }
        panic!("no port of 127.0.0.1 stays free for sshd, {PORTS_TO_TRY} were tried")
    }

    /// Its folder, for files of the test's own.
    #[must_use]
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Its port.
    #[must_use]
    pub fn port(&self) -> u16 {
        self.port
    }

    /// `user@127.0.0.1:port`.
    #[must_use]
    pub fn address(&self) -> String {
        format!("{}@127.0.0.1:{}", user(), self.port)
    }

    /// How a matrix file says the way to it.
    #[must_use]
    pub fn connect(&self) -> String {
        format!(
            "{{ssh: \"{}\", identity: {}, known_hosts: {}}}",
            self.address(),
            self.identity().display(),
            self.known_hosts().display()
        )
    }

    /// The private key that is let in.
    #[must_use]
    pub fn identity(&self) -> PathBuf {
        self.folder.path().join("identity")
    }

    /// A file that knows its ed25519 key, and nothing else.
    #[must_use]
    pub fn known_hosts(&self) -> PathBuf {
        self.folder.path().join("known_hosts")
    }

    /// Lets in who has another private key, too.
    ///
    /// # Panics
    /// When its public key is not beside it.
    pub fn authorize(&self, identity: &Path) {
        let file = self.folder.path().join("authorized_keys");
        let public = fs::read_to_string(identity.with_extension("pub")).expect("the key can be read");
        let known = fs::read_to_string(&file).expect("the file is there");
        fs::write(file, known + &public).expect("the folder can be written");
    }

    /// The line of such a file for one of its keys, `host_ed25519` or `host_rsa`.
    ///
    /// # Panics
    /// When there is no such key.
    #[must_use]
    pub fn known_hosts_line(&self, key: &str) -> String {
        let public = self.folder.path().join(key).with_extension("pub");
        let public = fs::read_to_string(public).expect("the key can be read");
        format!("[127.0.0.1]:{} {public}", self.port)
    }

    /// How often somebody has logged in since it was made.
    #[must_use]
    pub fn logins(&self) -> usize {
        self.said().matches("Accepted publickey").count()
    }

    /// What it has logged.
    #[must_use]
    pub fn said(&self) -> String {
        fs::read_to_string(self.log()).unwrap_or_default()
    }

    /// Ends its connections, as a crash of the host would. The server goes on.
    pub fn cut(&self) {
        self.signal_connections(Signal::SIGKILL);
    }

    /// Stops its connections: they stay and say nothing more, as behind a cable that was cut.
    pub fn freeze(&self) {
        self.signal_connections(Signal::SIGSTOP);
    }

    /// Starts the server anew on the same port.
    ///
    /// # Panics
    /// When it does not come up.
    pub fn restart(&mut self) {
        self.stop();
        assert!(self.try_serve(), "the port was taken:\n{}", self.said());
    }

    /// Ends the server and its connections, and starts it anew when so much time has passed.
    ///
    /// # Panics
    /// As [`Sshd::restart`].
    pub fn restart_after(&mut self, time: Duration) {
        self.stop();
        thread::sleep(time);
        self.restart();
    }

    /// Gives it another ed25519 host key, as setting the host up anew would.
    pub fn set_up_anew(&mut self) {
        self.stop();
        for name in ["host_ed25519", "host_ed25519.pub"] {
            fs::remove_file(self.folder.path().join(name)).expect("the key was there");
        }
        make_key(&self.folder.path().join("host_ed25519"), "ed25519", "");
        self.restart();
    }

    fn log(&self) -> PathBuf {
        self.folder.path().join("log")
    }

    /// Whether it serves; no when the port was taken.
    fn try_serve(&mut self) -> bool {
        let folder = self.folder.path();
        if Uid::effective().is_root() {
            // Of Debian's sshd, for its unprivileged part.
            fs::create_dir_all("/run/sshd").expect("root can make /run/sshd");
        }
        let file = |name: &str| folder.join(name).display().to_string();
        let configuration = format!(
            "{}\nListenAddress 127.0.0.1\nPort {}\nHostKey {}\nHostKey {}\nAuthorizedKeysFile {}\nPidFile none\n\
             UsePAM no\nStrictModes no\nPermitRootLogin prohibit-password\nPasswordAuthentication no\n\
             KbdInteractiveAuthentication no\nLogLevel VERBOSE\nMaxStartups 100\nSetEnv {} MATRIX_STATE_DIR={} \
             MATRIX_LEASE={}\n",
            self.options,
            self.port,
            file("host_ed25519"),
            file("host_rsa"),
            file("authorized_keys"),
            self.surroundings,
            file("state"),
            file("lease"),
        );
        fs::write(folder.join("sshd_config"), configuration).expect("the folder can be written");
        let before = self.said().len();
        let log = File::options()
            .create(true)
            .append(true)
            .open(self.log())
            .expect("the folder can be written");
        // sshd starts itself anew for each connection and wants to know where it is.
        let mut server = Command::new(program())
            .args(["-D", "-e", "-f"])
            .arg(folder.join("sshd_config"))
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(log)
            .spawn()
            .expect("sshd starts");
        wait_until("sshd serves", || {
            let said = self.said();
            let said = &said[before..];
            let ended = server.try_wait().expect("it can be waited for").is_some();
            assert!(!ended || said.contains("Address already in use"), "{said}");
            ended || said.contains("Server listening")
        });
        let serves = server.try_wait().expect("it can be waited for").is_none();
        self.server = Some(server);
        serves
    }

    /// Ends the server and its connections, as if the host were switched off.
    pub fn stop(&mut self) {
        self.cut();
        if let Some(mut server) = self.server.take() {
            // It may have ended already.
            let _ = server.kill();
            let _ = server.wait();
        }
    }

    fn signal_connections(&self, signal: Signal) {
        let Some(server) = &self.server else { return };
        for pid in descendants(server.id()) {
            // It may have ended already.
            let _ = kill(pid, signal);
        }
    }
}

impl Drop for Sshd {
    fn drop(&mut self) {
        self.stop();
    }
}

/// A real ssh-agent, until it is dropped.
#[derive(Debug)]
pub struct Agent {
    process: Child,
    folder: TempDir,
}

impl Agent {
    /// Starts one that has these keys.
    ///
    /// # Panics
    /// When it does not come up, or does not take a key.
    #[must_use]
    pub fn with(keys: &[&Path]) -> Self {
        let folder = TempDir::with_prefix("matrix-agent-").expect("a folder for the agent");
        let process = Command::new("ssh-agent")
            .arg("-D")
            .arg("-a")
            .arg(folder.path().join("socket"))
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .spawn()
            .expect("ssh-agent starts: apt-get install openssh-client");
        let agent = Self { process, folder };
        wait_until("the agent listens", || agent.socket().exists());
        for key in keys {
            let added = Command::new("ssh-add")
                .arg("-q")
                .arg(key)
                .env("SSH_AUTH_SOCK", agent.socket())
                .status()
                .expect("ssh-add starts");
            assert!(added.success(), "the agent takes {}", key.display());
        }
        agent
    }

    /// Its socket.
    #[must_use]
    pub fn socket(&self) -> PathBuf {
        self.folder.path().join("socket")
    }
}

impl Drop for Agent {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// Makes a private key and, beside it, its public one.
///
/// # Panics
/// When it cannot.
pub fn make_key(file: &Path, kind: &str, passphrase: &str) {
    let made = Command::new("ssh-keygen")
        .args(["-q", "-t", kind, "-N", passphrase, "-C", "test", "-f"])
        .arg(file)
        .stdin(Stdio::null())
        .status()
        .expect("ssh-keygen starts: apt-get install openssh-client");
    assert!(made.success(), "ssh-keygen makes {}", file.display());
}

/// Waits for something that will be so soon.
///
/// # Panics
/// When it never is.
pub fn wait_until(what: &str, mut is_so: impl FnMut() -> bool) {
    let deadline = Instant::now() + HOPELESS;
    while !is_so() {
        assert!(Instant::now() < deadline, "{what}: not within {HOPELESS:?}");
        thread::sleep(LOOK);
    }
}

/// The user who runs the test.
#[must_use]
pub fn user() -> String {
    User::from_uid(Uid::effective())
        .ok()
        .flatten()
        .expect("whoever runs the test is a user")
        .name
}

fn program() -> &'static Path {
    ["/usr/sbin/sshd", "/usr/bin/sshd", "/sbin/sshd"]
        .map(Path::new)
        .into_iter()
        .find(|path| path.is_file())
        .expect("the test needs sshd: apt-get install openssh-server")
}

/// The processes of sshd that are below one, the deepest first. What its users started is not among them.
fn descendants(of: u32) -> Vec<Pid> {
    let processes: Vec<(u32, u32, String)> = fs::read_dir("/proc")
        .expect("there is /proc")
        .filter_map(|entry| entry.ok()?.file_name().to_str()?.parse().ok())
        .filter_map(|pid: u32| {
            let stat = fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
            let (before, after) = stat.rsplit_once(')')?;
            let name = before.split_once('(')?.1.to_owned();
            let parent = after.split_whitespace().nth(1)?.parse().ok()?;
            Some((pid, parent, name))
        })
        .collect();
    let mut found = vec![of];
    let mut next = 0;
    while let Some(parent) = found.get(next).copied() {
        let children = processes
            .iter()
            .filter(|(_, of, name)| *of == parent && name.starts_with("sshd"));
        found.extend(children.map(|(pid, _, _)| *pid));
        next += 1;
    }
    found
        .into_iter()
        .skip(1)
        .rev()
        .filter_map(|pid| i32::try_from(pid).ok())
        .map(Pid::from_raw)
        .collect()
}
