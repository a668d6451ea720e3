//! The system calls that programs in our containers have: `seccomp.json`, as an engine takes it, with those that a matrix file
//! asks for. The function is [`profile`].
//!
//! An engine's own profile gives a container with CAP_SYS_ADMIN all calls that only that capability allows, `mount` and `bpf`
//! among them, of which the workload needs two, and those for network namespaces alone. So ours is a list of what is
//! allowed, whatever the capabilities; all else is EPERM, as in an engine's own. Names that a machine has not got, and that an
//! older engine does not know, are passed over by it.

use serde_json::{Value, json};

use super::settings::SystemCalls;

const PROFILE: &str = include_str!("seccomp.json");
/// `linux/sched.h`.
const CLONE_NEWUSER: u64 = 0x1000_0000;

/// The profile as JSON, in one line.
#[must_use]
pub fn profile(asked_for: &[SystemCalls]) -> String {
    with(asked_for, None)
}

/// The same for a container without capabilities: an ordinary user makes a network namespace in a user namespace of his own. What that
/// allows beside it is not in the list either.
#[must_use]
pub fn profile_of_an_ordinary_user(asked_for: &[SystemCalls]) -> String {
    let own_namespace = json!({
        "comment": "User namespaces: CLONE_NEWUSER",
        "names": ["unshare"],
        "action": "SCMP_ACT_ALLOW",
        "args": [{"index": 0, "value": CLONE_NEWUSER, "op": "SCMP_CMP_EQ"}],
    });
    with(asked_for, Some(own_namespace))
}

fn with(asked_for: &[SystemCalls], rule: Option<Value>) -> String {
    // Read by a test, too.
    let mut profile: Value = serde_json::from_str(PROFILE).unwrap_or_default();
    if let Some(calls) = profile.get_mut("syscalls").and_then(Value::as_array_mut) {
        calls.extend(asked_for.iter().map(|asked| {
            json!({
                "comment": format!("asked for: providers.docker.system_calls: [{asked}]"),
                "names": asked.names(),
                "action": "SCMP_ACT_ALLOW",
            })
        }));
        calls.extend(rule);
    }
    profile.to_string()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;

    /// With them a container's root takes its host, or looks into it.
    const DANGEROUS: &str = "mount umount umount2 move_mount open_tree fsopen fsconfig fsmount fspick mount_setattr pivot_root chroot \
        swapon swapoff bpf perf_event_open userfaultfd keyctl add_key request_key name_to_handle_at open_by_handle_at kexec_load \
        kexec_file_load init_module finit_module delete_module ptrace process_vm_readv process_vm_writev pidfd_getfd kcmp reboot \
        syslog acct quotactl iopl ioperm settimeofday clock_settime stime sethostname setdomainname io_uring_setup \
        io_uring_enter io_uring_register fanotify_init lookup_dcookie vhangup nfsservctl uselib ustat sysfs _sysctl \
        create_module get_kernel_syms query_module vm86 vm86old modify_ldt move_pages migrate_pages mbind set_mempolicy";

    /// `linux/sched.h`.
    const CLONE_NEWNET: u64 = 0x4000_0000;

    fn rules(asked_for: &[SystemCalls]) -> BTreeMap<String, Vec<Value>> {
        let profile: Value = serde_json::from_str(&profile(asked_for)).unwrap();
        assert_eq!(profile["defaultAction"], "SCMP_ACT_ERRNO");
        let mut rules = BTreeMap::<String, Vec<Value>>::new();
        for rule in profile["syscalls"].as_array().unwrap() {
            for name in rule["names"].as_array().unwrap() {
                rules
                    .entry(name.as_str().unwrap().to_owned())
                    .or_default()
                    .push(rule.clone());
            }
        }
        rules
    }

    #[test]
    fn no_call_that_takes_the_host_is_allowed() {
        let rules = rules(&[]);
        for call in DANGEROUS.split_whitespace() {
            assert!(!rules.contains_key(call), "{call}");
        }
    }

    #[test]
    fn every_other_call_is_listed_once_and_namespaces_are_of_networks() {
        let rules = rules(&[]);
        for (call, rules) in &rules {
            assert_eq!(rules.len(), if call == "personality" { 3 } else { 1 }, "{call}");
        }
        for (call, index) in [("unshare", 0), ("setns", 1)] {
            let argument = &rules[call][0]["args"][0];
            assert_eq!(argument["index"], index, "{call}");
            assert_eq!(argument["value"], CLONE_NEWNET, "{call}");
            assert_eq!(argument["op"], "SCMP_CMP_EQ", "{call}");
        }
        assert!(!rules["clone"][0]["args"].is_null());
        assert_eq!(rules["clone3"][0]["action"], "SCMP_ACT_ERRNO");
    }

    #[test]
    fn an_ordinary_user_may_make_a_user_namespace_and_nothing_else_beside() {
        let read = |text: String| serde_json::from_str::<Value>(&text).unwrap()["syscalls"].take();
        let (all, own) = (read(profile(&[])), read(profile_of_an_ordinary_user(&[])));
        let (all, own) = (all.as_array().unwrap(), own.as_array().unwrap());
        assert_eq!(own[..all.len()], all[..]);
        let [added] = &own[all.len()..] else {
            panic!("{own:?}");
        };
        assert_eq!(added["names"], json!(["unshare"]));
        assert_eq!(added["args"][0]["value"], CLONE_NEWUSER);
        assert_eq!(added["args"][0]["op"], "SCMP_CMP_EQ");
    }

    #[test]
    fn mounting_comes_only_where_a_file_asks_for_it() {
        let asked = rules(&[SystemCalls::Mount]);
        assert_eq!(asked["mount"][0]["action"], "SCMP_ACT_ALLOW");
        for call in ["bpf", "keyctl", "move_mount", "pivot_root", "ptrace"] {
            assert!(!asked.contains_key(call), "{call}");
        }
    }
}
