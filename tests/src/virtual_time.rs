//! The guest in virtual time: its clock counts instructions, one a nanosecond, and not what the machine under it takes
//! for them. The main functions are [`run`] and [`follow`].
//!
//! The emulated processor is never interrupted and never waits for its turn, so that times measured in it are those of
//! its kernel and programs alone, the same on a busy machine and on an idle one (QEMU, `docs/devel/tcg-icount.rst`).
//! When it has nothing to do its clock jumps to the next timer: nobody outside can talk with it meanwhile, and a script
//! is all that runs.

use std::{
    fs::{self, File},
    os::unix::process::CommandExt as _,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use crate::guest::{self, DEBIAN_12};

/// Real time that a script may take. Half a minute of the guest's takes about a minute on an idle machine.
const TIMEOUT: Duration = Duration::from_secs(1800);
const LOOK: Duration = Duration::from_millis(100);

/// Boots the image, runs a shell script as root in a folder with the files, and gives what it wrote to `$RESULT`.
///
/// There is no systemd and no network device: `/proc`, `/sys`, `/dev` and the folder are all there is. Modules are
/// loaded with `modprobe`.
///
/// # Panics
/// When it cannot be booted, or the script fails or does not end, with the end of the console.
#[must_use]
pub fn run(files: &[&Path], script: &str) -> String {
    follow(files, script, &mut |_| {})
}

/// The same, and hands on each line of the console, where the script's other output goes, as it comes.
///
/// # Panics
/// As [`run`].
#[must_use]
pub fn follow(files: &[&Path], script: &str, line: &mut dyn FnMut(&str)) -> String {
    DEBIAN_12.require_programs();
    let image = DEBIAN_12.image();
    let folder = tempfile::tempdir().expect("a folder for the guest");
    let place = |name: &str| folder.path().join(name);
    let read = |name: &str| String::from_utf8_lossy(&fs::read(place(name)).unwrap_or_default()).into_owned();
    pack(files, script, folder.path());
    let said = File::create(place("qemu")).expect("the folder can be written");
    let mut keeper = Command::new("sh");
    keeper
        .args(["-c", guest::KEEPER, "keeper"])
        .args(machine(&image, folder.path()))
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(said)
        .process_group(0);
    let mut keeper = keeper.spawn().expect("a shell starts");
    // While this is open, so is the machine.
    let alive = keeper.stdin.take();
    let deadline = Instant::now() + TIMEOUT;
    let mut followed = 0;
    loop {
        let ended = !matches!(keeper.try_wait(), Ok(None));
        let console = read("console");
        let lines = || {
            console
                .split_inclusive('\n')
                .take_while(|line| line.ends_with('\n'))
        };
        lines().skip(followed).for_each(|text| line(text.trim_end()));
        followed = lines().count();
        if ended || Instant::now() > deadline {
            break;
        }
        thread::sleep(LOOK);
    }
    drop(alive);
    let _ = keeper.wait();
    let console = read("console");
    assert!(
        console.contains("the script ended with 0"),
        "the script did not come to its end\nQEMU said:\n{}\nthe end of the console:\n{}",
        read("qemu"),
        guest::tail(&console)
    );
    // A serial line ends lines with both.
    read("result").replace("\r\n", "\n")
}

/// The files and the script as an archive, which the guest sees as a disk.
fn pack(files: &[&Path], script: &str, folder: &Path) {
    fs::write(
        folder.join("script"),
        format!("set -e\ncd /media\nRESULT=/dev/ttyS1\nexport RESULT\n{script}\n"),
    )
    .expect("the folder can be written");
    let mut tar = Command::new("tar");
    tar.arg("-cf").arg(folder.join("disk"));
    tar.arg("-C").arg(folder).arg("script");
    for file in files {
        let (parent, name) = (file.parent().expect("a file has a folder"), file.file_name());
        tar.arg("-C").arg(parent).arg(name.expect("a file has a name"));
    }
    let status = tar.status().expect("tar starts");
    assert!(status.success(), "tar ended with {status}");
}

fn machine(image: &Path, folder: &Path) -> Vec<String> {
    let place = |name: &str| -> PathBuf { folder.join(name) };
    let init = "init=/bin/sh -- -c \"mount -t proc p /proc; mount -t sysfs s /sys; mount -t devtmpfs d /dev; \
                mount -t tmpfs t /media; mount -t tmpfs t /run; mount -t tmpfs t /tmp; tar xf /dev/vdb -C /media; \
                stty -F /dev/ttyS1 raw; sh /media/script; echo the script ended with $?; echo o > /proc/sysrq-trigger; \
                sleep 1000\"";
    DEBIAN_12.command(
        image,
        &[
            "-no-reboot -accel tcg,thread=single -icount shift=0,sleep=off,align=off -smp 1",
            &format!(
                "-drive file={},format=raw,if=virtio,readonly=on",
                place("disk").display()
            ),
            &format!("-serial file:{}", place("console").display()),
            &format!("-serial file:{}", place("result").display()),
        ],
        &format!("panic=-1 {init}"),
    )
}
