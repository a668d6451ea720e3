//! Whose a bridge is: the process that made it, named so that no later one can be mistaken for it. The main type is
//! [`Owner`].

use std::{fs, str::FromStr};

/// A process: its number, when it was started and in which boot, since OVSDB outlives them all.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Owner {
    boot: String,
    /// The PID namespace, as the link `/proc/self/ns/pid` names it: other namespaces have other numbers.
    pid_namespace: String,
    pid: u32,
    /// Clock ticks since the boot (proc(5), the 22nd field of `stat`).
    started: u64,
}

impl Owner {
    /// Whether the process has ended. One that cannot be seen from here is taken to live.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        let Some(boot) = read("/proc/sys/kernel/random/boot_id") else {
            return false;
        };
        if self.boot != boot {
            return true;
        }
        let ours = fs::read_link("/proc/self/ns/pid").ok();
        if ours.is_none_or(|ours| ours.as_os_str() != self.pid_namespace.as_str()) {
            return false;
        }
        let stat = read(format!("/proc/{}/stat", self.pid));
        stat.and_then(|stat| started(&stat)) != Some(self.started)
    }
}

/// `boot/PID namespace/process/start`.
impl FromStr for Owner {
    type Err = ();

    fn from_str(text: &str) -> Result<Self, ()> {
        let parts: Vec<&str> = text.split('/').collect();
        let [boot, pid_namespace, pid, started] = parts[..] else {
            return Err(());
        };
        Ok(Self {
            boot: boot.to_owned(),
            pid_namespace: pid_namespace.to_owned(),
            pid: pid.parse().map_err(drop)?,
            started: started.parse().map_err(drop)?,
        })
    }
}

/// When a process started, out of its `stat`. The name before it may contain anything, also parentheses. A process that
/// nobody has waited for yet has ended, too.
fn started(stat: &str) -> Option<u64> {
    let mut fields = stat.rsplit_once(')')?.1.split_whitespace();
    let state = fields.next()?;
    (state != "Z").then(|| fields.nth(18)?.parse().ok())?
}

fn read(path: impl AsRef<std::path::Path>) -> Option<String> {
    Some(fs::read_to_string(path).ok()?.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// This process.
    fn us() -> Owner {
        Owner {
            boot: read("/proc/sys/kernel/random/boot_id").unwrap(),
            pid_namespace: fs::read_link("/proc/self/ns/pid")
                .unwrap()
                .to_str()
                .unwrap()
                .to_owned(),
            pid: std::process::id(),
            started: started(&read("/proc/self/stat").unwrap()).unwrap(),
        }
    }

    #[test]
    fn a_process_that_runs_has_not_ended() {
        assert!(!us().has_ended());
    }

    #[test]
    fn another_process_of_the_same_number_is_not_the_owner() {
        let earlier = Owner {
            started: us().started - 1,
            ..us()
        };
        assert!(earlier.has_ended());
    }

    #[test]
    fn what_an_earlier_boot_left_has_no_owner_any_more() {
        let earlier = Owner {
            boot: "an earlier one".into(),
            ..us()
        };
        assert!(earlier.has_ended());
    }

    #[test]
    fn a_process_of_another_pid_namespace_is_not_ours_to_judge() {
        let other = Owner {
            pid_namespace: "pid:[1]".into(),
            pid: u32::MAX,
            ..us()
        };
        assert!(!other.has_ended());
    }

    #[test]
    fn a_process_that_has_ended_and_was_not_waited_for_has_ended() {
        let mut child = std::process::Command::new("true").spawn().unwrap();
        let zombie = || read(format!("/proc/{}/stat", child.id())).is_some_and(|stat| stat.contains(") Z "));
        while !zombie() {
            std::thread::yield_now();
        }
        assert!(
            Owner {
                pid: child.id(),
                ..us()
            }
            .has_ended()
        );
        child.wait().unwrap();
    }

    #[rstest::rstest]
    #[case(
        "7 (python3) S 1 7 7 0 -1 4194560 1 2 3 4 5 6 7 8 20 0 1 0 24181 99 1",
        Some(24181)
    )]
    #[case(
        "7 (a) b) (c) S 1 7 7 0 -1 4194560 1 2 3 4 5 6 7 8 20 0 1 0 24181 99 1",
        Some(24181)
    )]
    #[case("7 (python3) Z 1 7 7 0 -1 4194560 1 2 3 4 5 6 7 8 20 0 1 0 24181 99 1", None)]
    #[case("nonsense", None)]
    fn the_start_is_the_22nd_field(#[case] stat: &str, #[case] ticks: Option<u64>) {
        assert_eq!(started(stat), ticks);
    }

    #[rstest::rstest]
    #[case("bc3281b4-4c5b/pid:[4026531836]/641/24181", true)]
    #[case("bc3281b4-4c5b/pid:[4026531836]/641", false)]
    #[case("bc3281b4-4c5b/pid:[4026531836]/six/24181", false)]
    #[case("", false)]
    fn an_owner_is_read_as_the_program_writes_it(#[case] text: &str, #[case] is_one: bool) {
        assert_eq!(text.parse::<Owner>().is_ok(), is_one);
    }
}
