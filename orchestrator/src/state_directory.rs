//! Where `matrix` keeps what must outlive it on this machine and belongs to no run directory: the deployed binary, the
//! environments of the native provider, the leases of hosts. The main type is [`StateDirectory`].
//!
//! After the XDG Base Directory Specification 0.8: `$XDG_STATE_HOME/matrix`, `~/.local/state/matrix` when that is not
//! set, `/var/lib/matrix` for a user without a home. `MATRIX_STATE_DIR` overrides it.

use std::{
    env,
    ffi::OsString,
    path::{Path, PathBuf},
};

/// What to do where it cannot be written.
pub const CHOOSE: &str = "set `MATRIX_STATE_DIR` to a folder that you may write to";

/// The directory. It only knows names; nothing is created.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StateDirectory(PathBuf);

impl StateDirectory {
    /// The directory at `path`.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self(path.into())
    }

    /// The directory that this process's surroundings ask for.
    #[must_use]
    pub fn of_this_user() -> Self {
        Self(locate(|name| env::var_os(name)))
    }

    /// The directory itself.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// Where deployed binaries are.
    #[must_use]
    pub fn binaries(&self) -> PathBuf {
        self.0.join("bin")
    }

    /// Where images of containers are noted whose workload was looked at.
    #[must_use]
    pub fn images(&self) -> PathBuf {
        self.0.join("images")
    }

    /// Where runs with hosts elsewhere are written down.
    #[must_use]
    pub fn runs(&self) -> PathBuf {
        self.0.join("runs")
    }

    /// Where environments without a platform of their own are, each in a folder with its name.
    #[must_use]
    pub fn environments(&self) -> PathBuf {
        self.0.join("environments")
    }
}

/// The first of the places that is given. A relative path is no answer: the specification says to ignore it, and what
/// must outlive us cannot depend on the directory we were started in.
fn locate(variable: impl Fn(&str) -> Option<OsString>) -> PathBuf {
    let absolute = |name: &str| {
        variable(name)
            .map(PathBuf::from)
            .filter(|path| path.is_absolute())
    };
    absolute("MATRIX_STATE_DIR")
        .or_else(|| absolute("XDG_STATE_HOME").map(|path| path.join("matrix")))
        .or_else(|| absolute("HOME").map(|path| path.join(".local/state/matrix")))
        .unwrap_or_else(|| PathBuf::from("/var/lib/matrix"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[rstest::rstest]
    #[case::asked_for(&[("MATRIX_STATE_DIR", "/m"), ("XDG_STATE_HOME", "/x"), ("HOME", "/h")], "/m")]
    #[case::specification(&[("XDG_STATE_HOME", "/x"), ("HOME", "/h")], "/x/matrix")]
    #[case::default(&[("HOME", "/h")], "/h/.local/state/matrix")]
    #[case::no_home(&[], "/var/lib/matrix")]
    #[case::relative_paths_are_ignored(&[("MATRIX_STATE_DIR", "m"), ("XDG_STATE_HOME", ""), ("HOME", "/h")], "/h/.local/state/matrix")]
    fn the_place_follows_the_specification(#[case] variables: &[(&str, &str)], #[case] place: &str) {
        let variable = |name: &str| {
            variables
                .iter()
                .find(|(known, _)| *known == name)
                .map(|(_, value)| OsString::from(value))
        };
        assert_eq!(locate(variable), Path::new(place));
    }
}
