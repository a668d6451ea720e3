//! An ordinary user with unprivileged user namespaces measures natively; what takes more rights is infeasible and says
//! so. Needs root, to become somebody else.

use std::{
    os::unix::fs::{PermissionsExt, chown},
    process::{Command, Stdio},
};

use tests::{WHOLE_WINDOWS_COUNT, Workplace, matrix_binary};

/// `nobody` on Debian; it owns nothing.
const NOBODY: u32 = 65_534;

/// Gives up all rights, after giving `/dev/net/tun` the mode that udev gives it (0666), here and for nobody else: some
/// machines keep it for root.
const AS_NOBODY: &str = "mount -t tmpfs tmpfs /dev/net && mknod -m 666 /dev/net/tun c 10 200 && \
    exec setpriv --reuid=65534 --regid=65534 --clear-groups --no-new-privs \"$@\"";

#[test]
fn nobody_measures_natively_and_is_told_why_docker_is_out_of_reach() {
    let workplace = Workplace::measuring();
    workplace.write(
        "m.yaml",
        format!(
            "matrix:\n  virtualization: [native, docker]\n\
             workload:\n  windows: 2\n  window: 2s\n  period: 1s\n  reference: {{amplitude_m: 0.05}}\n  \
             {WHOLE_WINDOWS_COUNT}\n"
        ),
    );
    // The build folder may be where nobody may not look.
    let binary = workplace.path().join("matrix");
    std::fs::copy(matrix_binary(), &binary).unwrap();
    std::fs::set_permissions(&binary, std::fs::Permissions::from_mode(0o755)).unwrap();
    chown(workplace.path(), Some(NOBODY), Some(NOBODY)).unwrap();

    let output = Command::new("unshare")
        .args(["--mount", "sh", "-c", AS_NOBODY, "sh"])
        .arg(&binary)
        .args(["run", "m.yaml", "--json", "--quiet"])
        .current_dir(workplace.path())
        .env("MATRIX_STATE_DIR", workplace.path().join("state"))
        .stdin(Stdio::null())
        .output()
        .unwrap();
    let err = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{err}");
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["within"][0]["pairs"], 1, "{report:#}");
    // The times on record give the errors on record again, to the last bit.
    let run = workplace.run_directory();
    let replayed = workplace.run(&["replay", run.to_str().unwrap()]);
    assert!(
        replayed.code == Some(0) && replayed.out.contains("differ by at most 0.0000 µm"),
        "{replayed:?}"
    );
    let docker = &report["scenarios"][1];
    assert_eq!(docker["outcome"], "infeasible", "{report:#}");
    assert!(
        docker["reason"].as_str().unwrap().contains("ermission"),
        "{docker:#}"
    );
}
