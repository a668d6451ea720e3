//! Builds the static `workload` binary that `matrix` carries and deploys, and hands its path to `include_bytes!`. Hands over
//! the git revision of the sources too, for `manifest.json`.
//!
//! It is a build of its own, in a profile, a target directory and with flags of its own: the outer build may be a debug
//! build, a `clippy` run or have features on that the deployed binary must not have.

use std::{
    env,
    error::Error,
    ffi::OsString,
    path::{Path, PathBuf},
    process::{Command, ExitCode, Output},
};

/// What the outer cargo sets for its own build and the inner one must not inherit.
const NOT_INHERITED: [&str; 14] = [
    "CARGO_BUILD_BUILD_DIR",
    "CARGO_BUILD_RUSTFLAGS",
    "CARGO_BUILD_TARGET",
    "CARGO_BUILD_TARGET_DIR",
    "CARGO_ENCODED_RUSTFLAGS",
    "CARGO_TARGET_DIR",
    "CLIPPY_ARGS",
    "HOST",
    "OUT_DIR",
    "PROFILE",
    "RUSTC_WORKSPACE_WRAPPER",
    "RUSTDOC",
    "RUSTDOCFLAGS",
    "TARGET",
];

/// The same, by how the names begin.
const NOT_INHERITED_PREFIXES: [&str; 5] = [
    "CARGO_CFG_",
    "CARGO_FEATURE_",
    "CARGO_MANIFEST_",
    "CARGO_PKG_",
    "DEP_",
];

/// All that `matrix` is built of: a change here builds it again, and makes the tree dirty.
const SOURCES: [&str; 20] = [
    "Cargo.lock",
    "Cargo.toml",
    "dockerfiles",
    "orchestrator/Cargo.toml",
    "orchestrator/build.rs",
    "orchestrator/src",
    "reports/Cargo.toml",
    "reports/captures/Cargo.toml",
    "reports/captures/src",
    "reports/src",
    "reports/statistics/Cargo.toml",
    "reports/statistics/src",
    "rust-toolchain.toml",
    "vagrant/Vagrantfile",
    "workload/Cargo.toml",
    "workload/record/Cargo.toml",
    "workload/record/src",
    "workload/simulation/Cargo.toml",
    "workload/simulation/src",
    "workload/src",
];

fn main() -> ExitCode {
    match build() {
        Ok(binary) => {
            println!("cargo::rustc-env=WORKLOAD_BINARY={}", binary.display());
            ExitCode::SUCCESS
        }
        Err(error) => {
            for line in error.to_string().lines() {
                println!("cargo::error={line}");
            }
            ExitCode::FAILURE
        }
    }
}

/// Names a workload that is there already, in place of a build of its own: `cargo check` and editors need none.
const GIVEN: &str = "MATRIX_WORKLOAD_BINARY";

fn build() -> Result<PathBuf, Box<dyn Error>> {
    let manifest_directory = PathBuf::from(variable("CARGO_MANIFEST_DIR")?);
    let workspace = manifest_directory
        .parent()
        .ok_or("the crate is not in a workspace")?;
    for source in SOURCES {
        rerun_if_changed(&workspace.join(source));
    }
    let (commit, dirty) = revision(workspace).unwrap_or_default();
    println!("cargo::rustc-env=MATRIX_SOURCE_COMMIT={commit}");
    println!("cargo::rustc-env=MATRIX_SOURCE_DIRTY={dirty}");

    println!("cargo::rerun-if-env-changed={GIVEN}");
    if let Some(given) = env::var_os(GIVEN) {
        let given = workspace.join(given);
        if !given.is_file() {
            return Err(format!("{GIVEN}: {} is no file", given.display()).into());
        }
        rerun_if_changed(&given);
        return Ok(given);
    }
    let target = variable("TARGET")?
        .into_string()
        .map_err(|_| "TARGET is not text")?;
    if !target.contains("linux") {
        return Err(
            format!("matrix carries a Linux workload and is built on Linux, not for {target}").into(),
        );
    }
    let target_directory = target_directory(Path::new(&variable("OUT_DIR")?)).join("workload-static");
    let output = inner_cargo(workspace, &target, &target_directory)?.output()?;
    if !output.status.success() {
        return Err(explain(&target, &output).into());
    }
    Ok(target_directory.join(&target).join("deploy").join("workload"))
}

/// cargo takes what is not there for changed, each time.
fn rerun_if_changed(path: &Path) {
    if path.exists() {
        println!("cargo::rerun-if-changed={}", path.display());
    }
}

/// The commit that is checked out, and whether the sources are not those of it. None outside of git, without the program
/// `git`, and where the sources lie in a repository of somebody else's.
fn revision(workspace: &Path) -> Option<(String, bool)> {
    let git = |arguments: &[&str]| {
        let mut git = Command::new("git");
        // A hook of another repository may have set them.
        for name in ["GIT_DIR", "GIT_INDEX_FILE", "GIT_WORK_TREE"] {
            git.env_remove(name);
        }
        let output = git.current_dir(workspace).args(arguments).output().ok()?;
        let printed = String::from_utf8(output.stdout).ok()?;
        output.status.success().then(|| printed.trim_end().to_owned())
    };
    let top = git(&["rev-parse", "--show-toplevel"])?;
    if Path::new(&top).canonicalize().ok()? != workspace.canonicalize().ok()? {
        return None;
    }
    // Each commit and each checkout adds a line to the log of HEAD; HEAD itself changes with the branch only.
    for file in ["HEAD", "logs/HEAD"] {
        rerun_if_changed(&workspace.join(git(&["rev-parse", "--git-path", file])?));
    }
    let commit = git(&["rev-parse", "--verify", "HEAD"])?;
    let changed = git(&[
        &["--no-optional-locks", "status", "--porcelain", "--"],
        &SOURCES[..],
    ]
    .concat())?;
    Some((commit, !changed.is_empty()))
}

/// The outer build's target directory, so that the inner one is cached beside it: cargo tags it. The inner build needs
/// a folder of its own, since the outer cargo holds the lock of its.
fn target_directory(out_directory: &Path) -> PathBuf {
    out_directory
        .ancestors()
        .find(|directory| directory.join("CACHEDIR.TAG").is_file())
        .unwrap_or(out_directory)
        .to_owned()
}

fn inner_cargo(workspace: &Path, target: &str, target_directory: &Path) -> Result<Command, Box<dyn Error>> {
    let mut cargo = Command::new(variable("CARGO")?);
    for (name, _) in env::vars_os() {
        let text = name.to_string_lossy();
        let per_target_flags = text.starts_with("CARGO_TARGET_") && text.ends_with("_RUSTFLAGS");
        if per_target_flags
            || NOT_INHERITED.contains(&&*text)
            || NOT_INHERITED_PREFIXES
                .iter()
                .any(|prefix| text.starts_with(prefix))
        {
            cargo.env_remove(&name);
        }
    }
    cargo
        .current_dir(workspace)
        .env("CARGO_ENCODED_RUSTFLAGS", flags(target_directory)?)
        // The outer build has fetched all that is needed: tests/tests/inner_build.rs sees to it.
        .args(["build", "--offline", "--locked", "--color", "never"])
        .args(["--package", "workload", "--bin", "workload"])
        .args(["--profile", "deploy", "--target", target, "--target-dir"])
        .arg(target_directory);
    Ok(cargo)
}

/// The flags of the inner compiler, as `CARGO_ENCODED_RUSTFLAGS` wants them, so that a folder's name may have spaces.
///
/// Folders of this machine get the names that they have in `workload/builder`: a binary that is deployed everywhere
/// knows nothing of where it was built. cargo names our own sources from the workspace on, so that this needs no name,
/// and another checkout can use what is built.
fn flags(target_directory: &Path) -> Result<OsString, Box<dyn Error>> {
    let cargo_home = match env::var_os("CARGO_HOME") {
        Some(folder) => PathBuf::from(folder),
        None => Path::new(&variable("HOME")?).join(".cargo"),
    };
    let mut flags = OsString::from("-Ctarget-feature=+crt-static");
    for (folder, name) in [
        (cargo_home, "/cargo"),
        (compiler_root()?, "/rust"),
        (target_directory.to_owned(), "/target"),
    ] {
        flags.push("\u{1f}--remap-path-prefix=");
        flags.push(folder);
        flags.push("=");
        flags.push(name);
    }
    Ok(flags)
}

/// Where the compiler is. If the sources of its library are there as well (rustup's `rust-src`), their paths get into
/// what it compiles.
fn compiler_root() -> Result<PathBuf, Box<dyn Error>> {
    let output = Command::new(variable("RUSTC")?)
        .args(["--print", "sysroot"])
        .output()?;
    if !output.status.success() {
        return Err("`rustc --print sysroot` failed".into());
    }
    Ok(PathBuf::from(String::from_utf8(output.stdout)?.trim_end()))
}

/// What a person has to do when the inner build failed.
fn explain(target: &str, output: &Output) -> String {
    let said = String::from_utf8_lossy(&output.stderr);
    let mut message =
        format!("the static workload binary for {target} could not be built; the build said:\n{said}");
    if [
        "cannot find -lc",
        "unable to find library -lc",
        "crt1.o",
        "libc.a",
    ]
    .iter()
    .any(|sign| said.contains(sign))
    {
        message.push_str(
            "\nhint: linking statically needs the C library's static form and a linker: on Fedora `dnf install \
             glibc-static gcc`, on Debian and Ubuntu `apt-get install libc6-dev gcc`, on Arch `pacman -S glibc gcc`",
        );
    }
    message
}

fn variable(name: &str) -> Result<OsString, Box<dyn Error>> {
    env::var_os(name).ok_or_else(|| format!("{name} is not set: this is run by cargo").into())
}
