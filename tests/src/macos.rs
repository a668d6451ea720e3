//! A host that answers as macOS does, as far as a Linux machine can. The main type is [`MacOs`].
//!
//! Its logins have the programs in `PATH` that macOS has and that `matrix` may ask for, and no other; those that say what
//! the system is say what a Mac said.

use std::{os::unix::fs::symlink, path::Path};

use tempfile::TempDir;

use crate::{program, sshd::Sshd};

/// What every macOS has in `/bin` and `/usr/bin`. There is no sha256sum, no flock, no setsid and no `/proc`.
const PROGRAMS: [&str; 16] = [
    "cat", "chmod", "date", "df", "env", "id", "ls", "mkdir", "mv", "perl", "printf", "rm", "sh", "shasum",
    "tar", "tr",
];

/// Recorded on a Mac mini with an M2.
const UNAME: &str = r#"#!/bin/sh
case $1 in
    -s) echo Darwin ;;
    -m) echo arm64 ;;
    -n) echo mini.local ;;
    -r) echo 24.1.0 ;;
    -v) echo "Darwin Kernel Version 24.1.0: Thu Oct 10 21:02:45 PDT 2024; root:xnu-11215.41.3~2/RELEASE_ARM64_T8112" ;;
    *) echo "uname: $*" >&2; exit 64 ;;
esac
"#;
const SW_VERS: &str = "#!/bin/sh\n[ \"$*\" = -productVersion ] && echo 15.1\n";
const SYSCTL: &str = r#"#!/bin/sh
case $* in
    "-n machdep.cpu.brand_string") echo "Apple M2" ;;
    "-n hw.ncpu") echo 8 ;;
    "-n hw.memsize") echo 17179869184 ;;
    *) echo "sysctl: $*" >&2; exit 1 ;;
esac
"#;

/// Such a host, until it is dropped.
#[derive(Debug)]
pub struct MacOs {
    /// Its sshd.
    pub sshd: Sshd,
    programs: TempDir,
}

impl MacOs {
    /// Starts one.
    ///
    /// # Panics
    /// As [`Sshd::start`].
    #[must_use]
    pub fn start() -> Self {
        let programs = TempDir::with_prefix("matrix-macos-").expect("a folder for programs");
        for name in PROGRAMS {
            let there = ["/usr/bin", "/bin"].map(|folder| Path::new(folder).join(name));
            let there = there
                .iter()
                .find(|path| path.exists())
                .expect("this machine has it, too");
            symlink(there, programs.path().join(name)).expect("the folder can be written");
        }
        for (name, script) in [("uname", UNAME), ("sw_vers", SW_VERS), ("sysctl", SYSCTL)] {
            program::write(programs.path(), name, script);
        }
        // bash reads a file of the user's before a command of sshd's, and that may add to PATH.
        let surroundings = format!("PATH={}", programs.path().display());
        Self {
            sshd: Sshd::in_surroundings(&surroundings, ""),
            programs,
        }
    }

    /// Installs a program, as Homebrew does, that is a shell script.
    ///
    /// # Panics
    /// When it cannot be written.
    pub fn install(&self, name: &str, script: &str) {
        program::write(self.programs.path(), name, script);
    }
}
