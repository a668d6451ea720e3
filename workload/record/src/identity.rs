//! What a host is said to be, against what it is. The main type is [`HostIdentity`].

use crate::axis::{HARDWARE, OS};

/// What is said of a host. Values are names that a user chooses, such as `intel-i7`, so that only what is certainly another
/// machine's or system's name is false.
#[derive(Debug, Clone, Copy)]
pub struct HostIdentity<'a> {
    /// The host's name in the matrix file.
    pub host: &'a str,
    /// Its hardware, if that is said.
    pub hardware: Option<&'a str>,
    /// Its operating system, if that is said.
    pub os: Option<&'a str>,
}

/// A claim that is false.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct IdentityMismatch {
    /// What it is about: `hardware` or `os`.
    pub axis: &'static str,
    /// What was said and what is.
    pub reason: String,
    /// What to write instead.
    pub fix: String,
}

impl HostIdentity<'_> {
    /// What is wrong with it, of a host that is this.
    #[must_use]
    pub fn contradiction(&self, hardware: &str, os: &str) -> Option<IdentityMismatch> {
        let differs = |axis, said: Option<&str>, found: &str, is_other: fn(&str, &str) -> bool| {
            let said = said?;
            (!found.is_empty() && is_other(said, found)).then(|| IdentityMismatch {
                axis,
                reason: format!(
                    "the file says `{axis}: {said}` of host `{}`, which is `{found}`",
                    self.host
                ),
                fix: format!("write `{axis}: {found}`, leave it out, or connect to the host that was meant"),
            })
        };
        differs(HARDWARE, self.hardware, hardware, is_other_machine)
            .or_else(|| differs(OS, self.os, os, is_other_system))
    }
}

/// Machines that are no other's, each by all its names.
const MACHINES: [&[&str]; 6] = [
    &["x86_64", "amd64", "x64"],
    &["i686", "i586", "i386", "x86"],
    &["aarch64", "arm64"],
    &["armv7l", "armhf"],
    &["riscv64"],
    &["ppc64le"],
];

fn is_other_machine(said: &str, found: &str) -> bool {
    let machine = |name: &str| MACHINES.iter().position(|names| names.contains(&name));
    matches!((machine(said), machine(found)), (Some(said), Some(found)) if said != found)
}

/// By `ID` and `VERSION_ID` of os-release: another system's name, or the same with another number.
fn is_other_system(said: &str, found: &str) -> bool {
    let parts = |name: &str| {
        let (id, version) = name.split_once('-').unwrap_or((name, ""));
        let version = version
            .starts_with(|c: char| c.is_ascii_digit())
            .then(|| version.to_owned());
        let id = if MACOS.contains(&id) { "macos" } else { id };
        (id.to_owned(), version)
    };
    let ((said_id, said_version), (found_id, found_version)) = (parts(said), parts(found));
    match said_id == found_id {
        true => matches!((said_version, found_version), (Some(said), Some(found)) if said != found),
        false => SYSTEMS.contains(&said_id.as_str()),
    }
}

/// The names that one system has had.
const MACOS: [&str; 4] = ["macos", "osx", "macosx", "darwin"];

/// Names of systems that are no other's.
const SYSTEMS: [&str; 11] = [
    "alpine", "arch", "centos", "debian", "fedora", "macos", "opensuse", "rhel", "rocky", "ubuntu", "windows",
];
