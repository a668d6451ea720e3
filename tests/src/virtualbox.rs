//! VirtualBox and Vagrant in a root of their own, where they work without VirtualBox's kernel module: real machines, their
//! processors interpreted. The main type is [`VirtualBox`].

use std::{
    ffi::OsString,
    os::unix::fs::PermissionsExt as _,
    path::{Path, PathBuf},
    process::Command,
};

use crate::Workplace;

/// The box of `tests/virtualbox`, and how VirtualBox runs its machines without a kernel module. Their clock goes at a fifth
/// of the speed, so that a second of theirs has five times the instructions. VirtualBox's additions to the guest are for
/// shared folders, which nobody uses.
pub const PROVIDER: &str = "\
providers:
  virtualbox:
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
    home: PathBuf,
    programs: PathBuf,
}

impl VirtualBox {
    /// Its machines and settings are in the workplace. `tests/prepare` has made the root; where it has not, this does.
    ///
    /// # Panics
    /// When the root cannot be made.
    #[must_use]
    pub fn in_workplace(workplace: &Workplace) -> Self {
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
        let home = workplace.path().to_owned();
        let programs = home.join("programs");
        std::fs::create_dir(&programs).expect("the workplace can be written");
        for program in ["vagrant", "VBoxManage"] {
            let file = programs.join(program);
            let enter = scripts.join("enter");
            let script = format!(
                "#!/bin/sh\nexec '{}' '{folder}' {program} \"$@\"\n",
                enter.display()
            );
            std::fs::write(&file, script).expect("the workplace can be written");
            std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o755))
                .expect("the workplace can be written");
        }
        Self { home, programs }
    }

    /// The same command on a machine that has this VirtualBox and its Vagrant.
    pub fn on(&self, mut command: Command) -> Command {
        let mut path = OsString::from(&self.programs);
        path.push(":");
        path.push(std::env::var_os("PATH").unwrap_or_default());
        command.env("PATH", path).env("HOME", &self.home);
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
