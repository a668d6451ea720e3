//! VirtualBox and Vagrant in a root of their own, where they work without VirtualBox's kernel module: real machines, their
//! processors interpreted. The main type is [`VirtualBox`].

use std::{
    ffi::OsString,
    path::{Path, PathBuf},
    process::Command,
};

use crate::program;

/// The box of `tests/virtualbox`, and how VirtualBox runs its machines without a kernel module. Their clock goes at a fifth
/// of the speed, so that a second of theirs has five times the instructions. VirtualBox's additions to the guest are for
/// shared folders, which nobody uses.
pub const PROVIDER: &str = "  virtualbox:
    box: matrix/virtualbox
    memory: 256MiB
    cpus: 1
    guest: linux
    insert_key: false
    boot_timeout: 10min
    options:
      check_guest_additions: false
      customize:
        - [modifyvm, ':id', --vm-execution-engine, recompiler]
        - [setextradata, ':id', VBoxInternal/TM/WarpDrivePercentage, '20']
";

/// A VirtualBox of one test, with the `vagrant` and `VBoxManage` that reach it.
pub struct VirtualBox {
    programs: PathBuf,
}

/// Two Vagrants as one: that of the machine, and the one beside VirtualBox for its machines. Both have boxes.
const VAGRANT: &str = r#"#!/bin/sh
beside() { HOME="$home" "$enter" "$folder" vagrant "$@"; }
own=$(PATH=${PATH#"$programs":} command -v vagrant)
case $* in
    *"box list"*)
        beside "$@"
        [ -z "$own" ] || "$own" "$@"
        exit ;;
esac
if [ -z "$own" ] || grep -q '"provider": *"virtualbox"' "$VAGRANT_CWD/machine.json" 2>/dev/null; then
    beside "$@"
else
    exec "$own" "$@"
fi
"#;
const VBOXMANAGE: &str = r#"#!/bin/sh
HOME="$home" exec "$enter" "$folder" VBoxManage "$@"
"#;

impl VirtualBox {
    /// Its machines and settings are below a folder, where `matrix` must have its state, too. `tests/prepare` has made the
    /// root; where it has not, this does.
    ///
    /// # Panics
    /// When the root cannot be made.
    #[must_use]
    pub fn below(home: &Path) -> Self {
        let scripts = Path::new(env!("CARGO_MANIFEST_DIR")).join("virtualbox");
        let built = Command::new(scripts.join("build"))
            .output()
            .expect("tests/virtualbox/build starts");
        assert!(
            built.status.success(),
            "{}",
            String::from_utf8_lossy(&built.stderr)
        );
        let folder = String::from_utf8_lossy(&built.stdout).trim().to_owned();
        let programs = home.join("programs");
        std::fs::create_dir(&programs).expect("the folder can be written");
        let places = format!(
            "home='{}' enter='{}' folder='{folder}' programs='{}'\n",
            home.display(),
            scripts.join("enter").display(),
            programs.display(),
        );
        for (name, script) in [("vagrant", VAGRANT), ("VBoxManage", VBOXMANAGE)] {
            let script = script.replacen('\n', &format!("\n{places}"), 1);
            program::write(&programs, name, &script);
        }
        Self { programs }
    }

    /// The same command on a machine that has this VirtualBox and its Vagrant.
    pub fn on(&self, mut command: Command) -> Command {
        let mut path = OsString::from(&self.programs);
        path.push(":");
        path.push(std::env::var_os("PATH").unwrap_or_default());
        command.env("PATH", path);
        command
    }

    /// The machines that VirtualBox knows, as it lists them.
    ///
    /// # Panics
    /// When it does not answer.
    #[must_use]
    pub fn machines(&self) -> String {
        let listed = self
            .on(Command::new(self.programs.join("VBoxManage")))
            .args(["list", "vms"])
            .output()
            .expect("VBoxManage starts");
        assert!(listed.status.success(), "{listed:?}");
        String::from_utf8_lossy(&listed.stdout).into_owned()
    }
}
