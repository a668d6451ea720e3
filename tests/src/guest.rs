//! Debian machines of their own kernel, for what the kernel of the machine under test may not have (netem, openvswitch),
//! and for other architectures. The main types are [`Guest`] and its [`Model`].
//!
//! A script makes the image, once for each recipe. QEMU emulates the processor in software, which needs no `/dev/kvm` and
//! makes everything some ten to thirty times slower: a time measured in the guest is coarse.

use std::{
    fmt::Write as _,
    fs::File,
    io::{ErrorKind, Read},
    net::{Ipv4Addr, TcpListener, TcpStream},
    path::{Path, PathBuf},
    process::{Child, ChildStdin, Command, Stdio},
    sync::OnceLock,
    thread,
    time::{Duration, Instant},
};

use tempfile::TempDir;

use crate::Ran;

/// A boot that has not answered by now never will: the slowest seen took 70 s, on two cores with a load of 12.
const BOOT: Duration = Duration::from_secs(300);
/// Between two looks for an answer.
const LOOK: Duration = Duration::from_millis(100);
/// Another process can take the port between the moment it was found free and QEMU's.
const PORTS_TO_TRY: usize = 5;
/// What the console of a machine that failed is cut to.
const TAIL_LINES: usize = 40;

/// A shell that ends the machine with itself, in both directions: when its input ends, because the [`Guest`] is dropped
/// or its process is killed, and when QEMU ends. All are one process group, so that nobody is left.
pub(crate) const KEEPER: &str = r#"{ "$@" </dev/null; kill -9 0; } & read -r end; kill -9 0"#;

/// What a machine is made of, and how QEMU starts it.
#[derive(Debug, Clone, Copy)]
pub struct Model {
    /// Makes the image and prints its folder: a script of this repository, with its arguments.
    recipe: &'static [&'static str],
    /// QEMU and what it is to emulate.
    qemu: &'static str,
    /// What the kernel is told.
    parameters: &'static str,
    /// A command that says `running` once the machine is all there; SSH answers before.
    ready: &'static [&'static str],
}

/// An x86_64 machine with systemd, Mininet, Open vSwitch, ROS and a Docker Engine, of which none runs yet. An emulated processor leaks nothing to protect, and has no
/// ATA and no KVM.
pub const DEBIAN_12: Model = Model {
    recipe: &["vagrant/box/machine"],
    qemu: "qemu-system-x86_64 -cpu max",
    parameters: "root=/dev/vda rw console=ttyS0 mitigations=off \
                 modprobe.blacklist=ata_piix,ata_generic,kvm_amd,kvm_intel",
    ready: &["systemctl", "is-system-running", "--wait"],
};

/// An aarch64 machine with an SSH server, a Docker Engine and little more.
pub const AARCH64: Model = Model {
    recipe: &["tests/hosts/build", "aarch64"],
    qemu: "qemu-system-aarch64 -M virt -cpu cortex-a57",
    parameters: "console=ttyAMA0 rdinit=/init",
    ready: &[
        "timeout",
        "240",
        "sh",
        "-c",
        "until docker version >/dev/null 2>&1; do sleep 0.2; done; echo running",
    ],
};

/// An i686 machine with an SSH server and little more.
pub const I686: Model = Model {
    recipe: &["tests/hosts/build", "i686"],
    qemu: "qemu-system-x86_64 -cpu qemu32,+sse2",
    parameters: "console=ttyS0 rdinit=/init",
    ready: &["echo", "running"],
};

/// A booted machine, until it is dropped. Every boot begins with the same disk: what it writes goes with it.
#[derive(Debug)]
pub struct Guest {
    keeper: Child,
    // Its end is the machine's.
    alive: Option<ChildStdin>,
    connection: Option<Child>,
    folder: TempDir,
    image: PathBuf,
    port: u16,
}

impl Guest {
    /// Boots a [`DEBIAN_12`].
    ///
    /// # Panics
    /// As [`Guest::of`].
    #[must_use]
    pub fn boot() -> Self {
        Self::of(DEBIAN_12)
    }

    /// Boots a machine and waits until it answers on SSH; makes the image first where there is none (minutes).
    ///
    /// # Panics
    /// When it does not come up, with the end of its console or with what to install.
    #[must_use]
    pub fn of(model: Model) -> Self {
        model.require_programs();
        let image = model.image();
        for _ in 0..PORTS_TO_TRY {
            if let Some(guest) = Self::try_boot(model, &image) {
                return guest;
            }
        }
        panic!("no port of 127.0.0.1 stays free for the guest's SSH, {PORTS_TO_TRY} were tried")
    }

    /// The one machine that the tests of a test binary share; it ends with their process.
    ///
    /// # Panics
    /// As [`Guest::boot`].
    pub fn shared() -> &'static Self {
        static GUEST: OnceLock<Guest> = OnceLock::new();
        GUEST.get_or_init(Self::boot)
    }

    /// `None` when the port was taken by another process.
    fn try_boot(model: Model, image: &Path) -> Option<Self> {
        let folder = TempDir::with_prefix("matrix-guest-").expect("a folder for the guest");
        let port = TcpListener::bind((Ipv4Addr::LOCALHOST, 0))
            .and_then(|listener| listener.local_addr())
            .expect("a free port")
            .port();
        let said = File::create(folder.path().join("qemu")).expect("the folder can be written");
        let mut keeper = Command::new("sh");
        keeper
            .args(["-c", KEEPER, "keeper"])
            .args(model.command(
                image,
                &[
                    // Two processors, since the workload keeps its loops apart.
                    "-accel tcg,thread=multi -smp 2",
                    &format!("-netdev user,id=net,hostfwd=tcp:127.0.0.1:{port}-:22"),
                    "-device virtio-net-pci,netdev=net,romfile=",
                    "-object rng-random,filename=/dev/urandom,id=random -device virtio-rng-pci,rng=random",
                    &format!("-serial file:{}", folder.path().join("console").display()),
                ],
                "",
            ))
            .env("TMPDIR", std::env::temp_dir())
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(said);
        std::os::unix::process::CommandExt::process_group(&mut keeper, 0);
        let mut keeper = keeper.spawn().expect("a shell starts");
        let alive = keeper.stdin.take();
        let mut guest = Self {
            keeper,
            alive,
            connection: None,
            folder,
            image: image.to_owned(),
            port,
        };
        let deadline = Instant::now() + BOOT;
        while !guest.answers() {
            if guest.has_ended() {
                if guest.said().contains("host forwarding rule") {
                    return None;
                }
                panic!("the guest ended while it booted{}", guest.state());
            }
            assert!(
                Instant::now() < deadline,
                "the guest did not answer on SSH in {BOOT:?}{}",
                guest.state()
            );
            thread::sleep(LOOK);
        }
        let ran = guest.run(model.ready);
        assert_eq!(
            ran.out.trim(),
            "running",
            "{}{}{}",
            ran.err,
            guest.run(&["systemctl", "--failed"]).out,
            guest.state()
        );
        // Later commands go through this connection and need no handshake; without it they make their own.
        guest.connection = guest
            .ssh("ssh")
            .args(["-N", "-o", "ControlMaster=yes", "guest"])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .ok();
        Some(guest)
    }

    /// Runs a program to its end; the arguments arrive as they are. Code 255 with an error of `ssh` in [`Ran::err`]
    /// means that there was no way to the machine.
    ///
    /// # Panics
    /// When `ssh` cannot be started.
    #[must_use]
    pub fn run(&self, command: &[&str]) -> Ran {
        Ran::of(
            self.command(command)
                .stdin(Stdio::null())
                .output()
                .expect("ssh starts"),
        )
    }

    /// Runs a program that has to succeed; its standard output.
    ///
    /// # Panics
    /// When it fails, with what it said.
    pub fn expect(&self, command: &[&str]) -> String {
        let ran = self.run(command);
        assert_eq!(
            ran.code,
            Some(0),
            "{command:?} failed in the guest\n{}{}{}",
            ran.out,
            ran.err,
            self.state()
        );
        ran.out
    }

    /// A program in the guest as a command of this machine, to be started by the caller. It gets no terminal and, when
    /// the command is killed here, it goes on there.
    #[must_use]
    pub fn command(&self, command: &[&str]) -> Command {
        let mut ssh = self.ssh("ssh");
        ssh.arg("guest").arg(
            command
                .iter()
                .map(|word| quoted(word))
                .collect::<Vec<_>>()
                .join(" "),
        );
        ssh
    }

    /// A shell in the guest at the terminal of this process.
    #[must_use]
    pub fn shell(&self) -> Command {
        let mut ssh = self.ssh("ssh");
        ssh.args(["-t", "guest"]);
        ssh
    }

    /// Boots it anew with the disk as it is, and waits until it answers again. Nobody in it is asked to end.
    ///
    /// # Panics
    /// When it does not come back.
    pub fn reboot(&mut self) {
        let boot = |guest: &Self| guest.run(&["cat", "/proc/sys/kernel/random/boot_id"]).out;
        let before = boot(self);
        // It would wait for what nobody answers any more.
        if let Some(mut connection) = self.connection.take() {
            let _ = connection.kill();
            let _ = connection.wait();
        }
        let mut reboot = self.command(&["reboot", "--force"]);
        let mut reboot = reboot.stdin(Stdio::null()).spawn().expect("ssh starts");
        let deadline = Instant::now() + BOOT;
        while !self.answers() || [before.as_str(), ""].contains(&boot(self).as_str()) {
            assert!(
                Instant::now() < deadline,
                "the guest did not come back{}",
                self.state()
            );
            thread::sleep(LOOK);
        }
        let _ = reboot.kill();
        let _ = reboot.wait();
    }

    /// Copies a file or folder of this machine into the guest, modes included.
    ///
    /// # Panics
    /// When it cannot.
    pub fn put(&self, from: &Path, to: &str) {
        self.copy(from.as_os_str(), format!("guest:{to}").as_ref());
    }

    /// Copies a file or folder of the guest to this machine.
    ///
    /// # Panics
    /// When it cannot.
    pub fn get(&self, from: &str, to: &Path) {
        self.copy(format!("guest:{from}").as_ref(), to.as_os_str());
    }

    /// The port of 127.0.0.1 that leads to the guest's SSH.
    #[must_use]
    pub fn ssh_port(&self) -> u16 {
        self.port
    }

    /// The private key that root is let in with. The host's key stands in `known_hosts` beside it, as `matrix-guest`.
    #[must_use]
    pub fn ssh_key(&self) -> PathBuf {
        self.image.join("id_ed25519")
    }

    /// How a matrix file says the way to it, as root.
    ///
    /// # Panics
    /// When the file with its host's key cannot be written.
    #[must_use]
    pub fn connect(&self) -> String {
        let keys = std::fs::read_to_string(self.image.join("known_hosts")).expect("the image has its key");
        let known_hosts = self.folder.path().join("known_hosts");
        let place = format!("[127.0.0.1]:{}", self.port);
        std::fs::write(&known_hosts, keys.replace("matrix-guest", &place))
            .expect("the folder can be written");
        format!(
            "{{ssh: \"root@127.0.0.1:{}\", identity: {}, known_hosts: {}}}",
            self.port,
            self.ssh_key().display(),
            known_hosts.display()
        )
    }

    fn copy(&self, from: &std::ffi::OsStr, to: &std::ffi::OsStr) {
        let output = self
            .ssh("scp")
            .args(["-q", "-r", "-p"])
            .args([from, to])
            .stdin(Stdio::null())
            .output()
            .expect("scp starts");
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(
            output.status.success(),
            "copying {} to {} failed\n{said}{}",
            from.display(),
            to.display(),
            self.state()
        );
    }

    /// `ssh` or `scp` with all that leads to this machine and nothing of the user's own configuration.
    fn ssh(&self, program: &str) -> Command {
        let mut command = Command::new(program);
        command.args(["-F", "/dev/null", "-i"]).arg(self.ssh_key());
        for option in [
            "BatchMode=yes".to_owned(),
            "Compression=no".to_owned(),
            "ConnectTimeout=60".to_owned(),
            format!("ControlPath={}", self.folder.path().join("ssh").display()),
            "HostKeyAlias=matrix-guest".to_owned(),
            "HostName=127.0.0.1".to_owned(),
            "IdentitiesOnly=yes".to_owned(),
            "LogLevel=ERROR".to_owned(),
            format!("Port={}", self.port),
            "ServerAliveInterval=15".to_owned(),
            "ServerAliveCountMax=8".to_owned(),
            "StrictHostKeyChecking=yes".to_owned(),
            "User=root".to_owned(),
            format!("UserKnownHostsFile={}", self.image.join("known_hosts").display()),
        ] {
            command.arg("-o").arg(option);
        }
        command
    }

    /// Whether an SSH server greets. QEMU takes the connection even before there is one.
    fn answers(&self) -> bool {
        let Ok(mut stream) = TcpStream::connect((Ipv4Addr::LOCALHOST, self.port)) else {
            return false;
        };
        let mut greeting = [0; 8];
        stream.set_read_timeout(Some(Duration::from_secs(2))).is_ok()
            && stream.read_exact(&mut greeting).is_ok()
            && &greeting == b"SSH-2.0-"
    }

    fn has_ended(&mut self) -> bool {
        !matches!(self.keeper.try_wait(), Ok(None))
    }

    fn said(&self) -> String {
        std::fs::read_to_string(self.folder.path().join("qemu")).unwrap_or_default()
    }

    /// What QEMU said and the end of the console, for a message.
    fn state(&self) -> String {
        let console = std::fs::read(self.folder.path().join("console")).unwrap_or_default();
        let console = String::from_utf8_lossy(&console);
        let mut text = String::new();
        let _ = write!(
            text,
            "\nQEMU said:\n{}\nthe end of the console:\n{}",
            self.said(),
            tail(&console)
        );
        text
    }
}

impl Drop for Guest {
    fn drop(&mut self) {
        drop(self.alive.take());
        let _ = self.keeper.wait();
        if let Some(connection) = &mut self.connection {
            let _ = connection.kill();
            let _ = connection.wait();
        }
    }
}

impl Model {
    /// Fails with what to install.
    pub(crate) fn require_programs(self) {
        let qemu = self.qemu.split(' ').next().unwrap_or_default();
        for (program, package) in [
            (
                qemu,
                "qemu-system-x86 qemu-system-arm (where they conflict with an installed qemu-utils: \
                 apt-get install -t bookworm-backports …, with bookworm-backports among the sources)",
            ),
            ("ssh", "openssh-client"),
            ("scp", "openssh-client"),
        ] {
            assert!(
                is_installed(program),
                "the guest needs {program}: apt-get install {package}"
            );
        }
    }

    /// QEMU and its arguments: those that every machine has, `more`, and `parameters` for the kernel beside its own. The disk
    /// is a temporary overlay that QEMU unlinks at once.
    pub(crate) fn command(self, image: &Path, more: &[&str], parameters: &str) -> Vec<String> {
        let image = image.display().to_string();
        let common = [
            self.qemu,
            "-nodefaults -no-user-config -display none -m 1024",
            &format!("-kernel {image}/vmlinuz -initrd {image}/initrd"),
            &format!("-drive file={image}/root.ext4,format=raw,if=virtio,snapshot=on,cache=unsafe"),
        ];
        common
            .iter()
            .chain(more)
            .flat_map(|words| words.split(' '))
            .map(str::to_owned)
            .chain([
                "-append".to_owned(),
                format!("net.ifnames=0 quiet {} {parameters}", self.parameters),
            ])
            .collect()
    }

    /// The folder with the image, made if need be.
    pub(crate) fn image(self) -> PathBuf {
        let [script, arguments @ ..] = self.recipe else {
            panic!("a model has a recipe");
        };
        let output = Command::new(Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(script))
            .args(arguments)
            .stdin(Stdio::null())
            .stderr(Stdio::inherit())
            .output()
            .expect("the recipe starts");
        let said = String::from_utf8_lossy(&output.stdout);
        assert!(
            output.status.success(),
            "the guest's image could not be made; {script} said above what is missing"
        );
        PathBuf::from(said.trim_end())
    }
}

/// The last lines of a console.
pub(crate) fn tail(console: &str) -> String {
    let lines: Vec<&str> = console.lines().collect();
    lines[lines.len().saturating_sub(TAIL_LINES)..].join("\n")
}

fn is_installed(program: &str) -> bool {
    match Command::new(program)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .arg("-version")
        .status()
    {
        Ok(_) => true,
        Err(error) => error.kind() != ErrorKind::NotFound,
    }
}

/// A word as it stands, for the shell that `ssh` hands its line to.
fn quoted(word: &str) -> String {
    format!("'{}'", word.replace('\'', r"'\''"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[rstest::rstest]
    #[case("plain", "'plain'")]
    #[case("two words", "'two words'")]
    #[case("$HOME `id` \"x\"", "'$HOME `id` \"x\"'")]
    #[case("it's", r"'it'\''s'")]
    #[case("", "''")]
    fn a_word_is_not_read_by_the_shell(#[case] word: &str, #[case] expected: &str) {
        assert_eq!(quoted(word), expected);
    }
}
