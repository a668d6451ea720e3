//! The machines that a workload is built for, and where `matrix` finds the binaries of those that are not its own. The
//! main type is [`Machine`].
//!
//! `workload/builder/build` makes them. They are looked for in the folder that `MATRIX_WORKLOADS` names, then in
//! `workloads` beside the program, and in both as `<machine>/workload`. Their checksums are beside them, in `SHA256SUMS`: what was
//! cut short, mixed up or replaced alone is found out. Who can write both can write what he likes.

use std::{
    borrow::Cow,
    env, fmt, fs, io,
    path::{Path, PathBuf},
    str::FromStr,
};

use record::platform::MACHINE;

use super::{bytes, hash_of};

/// A kind of machine that runs Linux programs of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Machine {
    /// AMD64, Intel 64.
    X86_64,
    /// 32-bit x86 with SSE2.
    I686,
    /// ARM64.
    Aarch64,
}

impl Machine {
    /// As `uname -m` says it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::X86_64 => "x86_64",
            Self::I686 => "i686",
            Self::Aarch64 => "aarch64",
        }
    }

    /// `e_ident[EI_CLASS]`, which is the width of its words, and `e_machine` in its programs (elf(5), `linux/elf-em.h`).
    const fn in_elf(self) -> (u8, u16) {
        match self {
            Self::X86_64 => (2, 62),
            Self::I686 => (1, 3),
            Self::Aarch64 => (2, 183),
        }
    }

    /// Whether that is a program for it.
    fn runs(self, program: &[u8]) -> bool {
        let (class, machine) = self.in_elf();
        let [low, high] = machine.to_le_bytes();
        program.starts_with(b"\x7fELF")
            && program.get(4) == Some(&class)
            && program.get(18..20) == Some(&[low, high])
    }

    /// The workload for it: the one that this `matrix` carries, or else what the builder made.
    ///
    /// # Errors
    /// When there is none, or what is there is not a program for this machine.
    pub fn workload(self) -> Result<Cow<'static, [u8]>, NoWorkload> {
        // The carried binary is built for the same machine as this program.
        if self.name() == MACHINE {
            return Ok(Cow::Borrowed(bytes()));
        }
        self.workload_in(&folders()).map(Cow::Owned)
    }

    fn workload_in(self, folders: &[PathBuf]) -> Result<Vec<u8>, NoWorkload> {
        for folder in folders {
            let path = folder.join(self.name()).join("workload");
            match fs::read(&path) {
                Ok(program) if self.runs(&program) => {
                    self.verify(folder, &path, &program)?;
                    return Ok(program);
                }
                Ok(_) => {
                    return Err(NoWorkload::AnotherMachines { machine: self, path });
                }
                Err(error) if error.kind() == io::ErrorKind::NotFound => {}
                Err(source) => {
                    return Err(NoWorkload::Unreadable {
                        machine: self,
                        path,
                        source,
                    });
                }
            }
        }
        Err(NoWorkload::NotBuilt {
            machine: self,
            folders: folders.to_vec(),
        })
    }

    /// Whether it is what the builder made, by its checksum (`sha256sum`'s format).
    fn verify(self, folder: &Path, path: &Path, program: &[u8]) -> Result<(), NoWorkload> {
        let sums = folder.join(SUMS);
        let text = fs::read_to_string(&sums).map_err(|source| NoWorkload::Unreadable {
            machine: self,
            path: sums.clone(),
            source,
        })?;
        let name = format!("{self}/workload");
        let listed = text.lines().find_map(|line| {
            let (sum, file) = line.split_once(' ')?;
            (file.trim_start_matches([' ', '*']) == name).then_some(sum)
        });
        if listed.is_some_and(|sum| sum.eq_ignore_ascii_case(&hash_of(program))) {
            return Ok(());
        }
        Err(NoWorkload::Altered {
            machine: self,
            path: path.to_owned(),
            sums,
        })
    }
}

/// What the builder writes beside them.
const SUMS: &str = "SHA256SUMS";

/// Where they are looked for, best first.
fn folders() -> Vec<PathBuf> {
    let asked_for = env::var_os("MATRIX_WORKLOADS").filter(|folder| !folder.is_empty());
    let program = env::current_exe().ok();
    let beside = program
        .as_deref()
        .and_then(Path::parent)
        .map(|folder| folder.join("workloads"));
    asked_for.map(PathBuf::from).into_iter().chain(beside).collect()
}

impl fmt::Display for Machine {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.name())
    }
}

impl FromStr for Machine {
    type Err = UnknownMachine;

    /// What `uname -m` says, or another name of the same.
    fn from_str(text: &str) -> Result<Self, UnknownMachine> {
        match text {
            "x86_64" | "amd64" => Ok(Self::X86_64),
            "i686" | "i586" | "i386" | "386" => Ok(Self::I686),
            "aarch64" | "arm64" => Ok(Self::Aarch64),
            _ => Err(UnknownMachine(text.to_owned())),
        }
    }
}

/// A kind of machine that no workload is built for.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("there is no workload for {0}: it is built for x86_64, i686 and aarch64")]
pub struct UnknownMachine(pub String);

/// There is no workload to deploy to a machine.
#[derive(Debug, thiserror::Error)]
pub enum NoWorkload {
    /// It is in none of the folders.
    #[error("there is no workload for {machine} in {}", list(.folders))]
    NotBuilt {
        /// Whose it would be.
        machine: Machine,
        /// Where it was looked for.
        folders: Vec<PathBuf>,
    },
    /// It is a program for another machine, or none.
    #[error("{} is not a program for {machine}", .path.display())]
    AnotherMachines {
        /// Whose it should be.
        machine: Machine,
        /// What was found.
        path: PathBuf,
    },
    /// It is not the program that was built.
    #[error("{} is not the workload for {machine} that {} lists", .path.display(), .sums.display())]
    Altered {
        /// Whose it should be.
        machine: Machine,
        /// What was found.
        path: PathBuf,
        /// The list of checksums.
        sums: PathBuf,
    },
    /// It is there and cannot be read, or its checksum cannot.
    #[error("cannot read the workload for {machine}, {}", .path.display())]
    Unreadable {
        /// Whose it is.
        machine: Machine,
        /// What was found.
        path: PathBuf,
        /// The cause.
        source: io::Error,
    },
}

impl NoWorkload {
    /// What to do about it.
    #[must_use]
    pub fn hint(&self) -> String {
        let (Self::NotBuilt { machine, .. }
        | Self::AnotherMachines { machine, .. }
        | Self::Altered { machine, .. }
        | Self::Unreadable { machine, .. }) = self;
        format!(
            "in a checkout of matrix, `workload/builder/build {machine}` makes it with its checksum; then set \
             MATRIX_WORKLOADS=target/workloads, or move that folder beside the program `matrix`"
        )
    }
}

fn list(folders: &[PathBuf]) -> String {
    let folders: Vec<_> = folders
        .iter()
        .map(|folder| folder.display().to_string())
        .collect();
    folders.join(" or ")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The beginning of a program.
    fn program(class: u8, machine: u8) -> Vec<u8> {
        let mut header = vec![0; 64];
        header[..5].copy_from_slice(&[0x7f, b'E', b'L', b'F', class]);
        header[18] = machine;
        header
    }

    /// As the builder leaves it.
    fn put(folder: &Path, machine: Machine, program: &[u8]) {
        fs::create_dir_all(folder.join(machine.name())).unwrap();
        fs::write(folder.join(machine.name()).join("workload"), program).unwrap();
        let others = "0".repeat(64);
        let sum = hash_of(program);
        fs::write(
            folder.join(SUMS),
            format!("{others}  other/workload\n{sum}  {machine}/workload\n"),
        )
        .unwrap();
    }

    #[test]
    fn a_workload_that_is_not_the_one_that_was_built_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let folders = [folder.path().to_owned()];
        let built = program(2, 183);
        put(folder.path(), Machine::Aarch64, &built);
        let replaced = [built.as_slice(), b"another"].concat();
        fs::write(folder.path().join("aarch64/workload"), replaced).unwrap();
        let error = Machine::Aarch64.workload_in(&folders).unwrap_err();
        assert!(matches!(error, NoWorkload::Altered { .. }), "{error}");

        // Listed is another machine's alone.
        put(folder.path(), Machine::I686, &program(1, 3));
        fs::write(folder.path().join("aarch64/workload"), &built).unwrap();
        let error = Machine::Aarch64.workload_in(&folders).unwrap_err();
        assert!(matches!(error, NoWorkload::Altered { .. }), "{error}");

        fs::remove_file(folder.path().join(SUMS)).unwrap();
        let error = Machine::I686.workload_in(&folders).unwrap_err();
        assert!(matches!(error, NoWorkload::Unreadable { .. }), "{error}");
        assert!(error.to_string().contains(SUMS), "{error}");
    }

    #[rstest::rstest]
    #[case("x86_64", Machine::X86_64)]
    #[case("amd64", Machine::X86_64)]
    #[case("i686", Machine::I686)]
    #[case("i386", Machine::I686)]
    #[case("386", Machine::I686)]
    #[case("aarch64", Machine::Aarch64)]
    #[case("arm64", Machine::Aarch64)]
    fn a_machine_is_known_by_the_names_that_systems_give_it(#[case] name: &str, #[case] machine: Machine) {
        assert_eq!(name.parse(), Ok(machine));
        assert_eq!(machine.name().parse(), Ok(machine));
    }

    #[test]
    fn a_machine_without_a_workload_is_refused_with_those_that_have_one() {
        let error = "riscv64".parse::<Machine>().unwrap_err();
        insta::assert_snapshot!(error, @"there is no workload for riscv64: it is built for x86_64, i686 and aarch64");
    }

    #[test]
    fn this_machines_workload_is_the_one_that_is_carried() {
        let machine: Machine = MACHINE.parse().unwrap();
        assert_eq!(&*machine.workload().unwrap(), bytes());
        assert!(machine.runs(bytes()));
    }

    #[test]
    fn the_first_folder_that_has_it_is_taken() {
        let (first, second) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        let folders = [first.path().to_owned(), second.path().to_owned()];
        let arm = program(2, 183);
        put(second.path(), Machine::Aarch64, &arm);
        assert_eq!(Machine::Aarch64.workload_in(&folders).unwrap(), arm);
        let newer = [arm.as_slice(), b"newer"].concat();
        put(first.path(), Machine::Aarch64, &newer);
        assert_eq!(Machine::Aarch64.workload_in(&folders).unwrap(), newer);
    }

    #[rstest::rstest]
    #[case::of_64_bit_x86(program(2, 62))]
    #[case::of_64_bit_arm(program(2, 183))]
    #[case::x32_is_neither(program(1, 62))]
    #[case::cut_short(program(1, 3)[..19].to_vec())]
    #[case::a_script(b"#!/bin/sh\nexec workload".to_vec())]
    fn a_program_of_another_machine_is_refused(#[case] program: Vec<u8>) {
        let folder = tempfile::tempdir().unwrap();
        put(folder.path(), Machine::I686, &program);
        let error = Machine::I686
            .workload_in(&[folder.path().to_owned()])
            .unwrap_err();
        assert!(matches!(error, NoWorkload::AnotherMachines { .. }), "{error}");
    }

    #[test]
    fn a_workload_that_is_not_built_is_said_with_where_and_how() {
        let folders = ["/a", "/b/workloads"].map(PathBuf::from);
        let error = Machine::Aarch64.workload_in(&folders).unwrap_err();
        insta::assert_snapshot!(error, @"there is no workload for aarch64 in /a or /b/workloads");
        assert!(error.hint().contains("workload/builder/build aarch64"));
    }
}
