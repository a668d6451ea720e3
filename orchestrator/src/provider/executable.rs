//! Programs of this machine, as a shell would find them. The main type is [`Executable`].

use std::{
    env,
    ffi::OsStr,
    path::{Path, PathBuf},
};

use rustix::fs::{Access, access};

/// A program that can be run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Executable(PathBuf);

impl Executable {
    /// The first program of that name in `PATH`.
    #[must_use]
    pub fn find(name: &str) -> Option<Self> {
        Self::find_in(&env::var_os("PATH")?, name)
    }

    fn find_in(path: &OsStr, name: &str) -> Option<Self> {
        env::split_paths(path)
            .map(|directory| directory.join(name))
            .find(|file| file.is_file() && access(file, Access::EXEC_OK).is_ok())
            .map(Self)
    }

    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.0
    }
}

#[cfg(test)]
mod tests {
    use std::{fs, os::unix::fs::PermissionsExt as _};

    use super::*;

    #[test]
    fn the_first_file_that_can_be_run_is_the_program() {
        let [plain, folder, right] = [(); 3].map(|()| tempfile::tempdir().unwrap());
        fs::write(plain.path().join("tool"), "").unwrap();
        fs::set_permissions(plain.path().join("tool"), fs::Permissions::from_mode(0o644)).unwrap();
        fs::create_dir(folder.path().join("tool")).unwrap();
        fs::write(right.path().join("tool"), "").unwrap();
        fs::set_permissions(right.path().join("tool"), fs::Permissions::from_mode(0o755)).unwrap();
        let path = env::join_paths([plain.path(), folder.path(), right.path()]).unwrap();
        let found = Executable::find_in(&path, "tool").unwrap();
        assert_eq!(found.path(), right.path().join("tool"));
        assert_eq!(Executable::find_in(&path, "other"), None);
    }
}
