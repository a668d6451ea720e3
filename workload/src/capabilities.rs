//! What of root's rights the experiment keeps once its network namespaces are there. The functions are [`drop_unneeded`] and
//! [`of_all_threads`].
//!
//! Capabilities belong to a thread, and threads and programs get those of the thread that starts them (capabilities(7)). So
//! each thread that was started before the namespaces were there is started by [`spawn_after_drop`], and the one that starts all
//! others calls it before it does. That none was forgotten is looked up in /proc, which is what `environment.json` says.

use std::{fs, io, sync::mpsc::channel, thread};

use record::platform::PrivilegeRecord;
use rustix::thread::{
    CapabilitySet, CapabilitySets, capabilities, clear_ambient_capability_set,
    remove_capability_from_bounding_set, set_capabilities, set_no_new_privs,
};

/// Each with what it is for. A container has fewer of them, and an ordinary user has them in a namespace of its own alone.
const KEPT: CapabilitySet = CapabilitySet::NET_ADMIN // `tc` in the network's namespaces, counters
    .union(CapabilitySet::NET_RAW) // packet sockets
    .union(CapabilitySet::SYS_NICE) // SCHED_FIFO
    .union(CapabilitySet::IPC_LOCK) // mlockall
    .union(CapabilitySet::SETGID) // tcpdump sets its groups and its user, be it to what they are
    .union(CapabilitySet::SETUID)
    .union(CapabilitySet::DAC_OVERRIDE); // a data folder of another user's, in which root measures

/// Takes from the calling thread, and from all that it will start, every capability but those that the experiment needs, and the
/// way to get them back by starting a program. What the kernel refuses stays, and [`of_all_threads`] tells of it: a
/// container's workload without SETPCAP keeps its bounding set, which gives nothing to programs that may not gain privileges.
pub fn drop_unneeded() {
    let _ = set_no_new_privs(true);
    let _ = clear_ambient_capability_set();
    for capability in KEPT.complement().iter().filter(is_one) {
        // Of those that this kernel does not know, it says so.
        let _ = remove_capability_from_bounding_set(capability);
    }
    if let Ok(has) = capabilities(None) {
        let _ = set_capabilities(
            None,
            CapabilitySets {
                effective: has.effective.intersection(KEPT),
                permitted: has.permitted.intersection(KEPT),
                inheritable: CapabilitySet::empty(),
            },
        );
    }
}

/// Starts a thread, and returns when the thread has dropped the capabilities that the experiment does not need: a survey of all threads
/// that follows finds it without them.
///
/// # Errors
/// When it cannot be started.
pub fn spawn_after_drop(name: &str, body: impl FnOnce() + Send + 'static) -> io::Result<()> {
    let (at_work, has_dropped) = channel::<()>();
    thread::Builder::new().name(name.to_owned()).spawn(move || {
        drop_unneeded();
        drop(at_work);
        body();
    })?;
    // It ends when the other side is gone.
    let _ = has_dropped.recv();
    Ok(())
}

/// Whether it has a name: the rest of the bits comes as one.
fn is_one(set: &CapabilitySet) -> bool {
    set.bits().count_ones() == 1
}

/// What this process may do: a right is there if one of its threads has it.
#[must_use]
pub fn of_all_threads() -> PrivilegeRecord {
    let tasks = fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
    // One that has ended meanwhile has no status.
    let statuses: Vec<String> = tasks
        .filter_map(|task| fs::read_to_string(task.path().join("status")).ok())
        .collect();
    summary(statuses.iter().map(String::as_str))
}

fn summary<'a>(statuses: impl Iterator<Item = &'a str>) -> PrivilegeRecord {
    let (mut permitted, mut bounding) = (CapabilitySet::empty(), CapabilitySet::empty());
    let mut record = PrivilegeRecord {
        no_new_privileges: true,
        seccomp_filter: true,
        ..PrivilegeRecord::default()
    };
    for status in statuses {
        permitted |= set(status, "CapPrm") | set(status, "CapInh") | set(status, "CapAmb");
        bounding |= set(status, "CapBnd");
        record.no_new_privileges &= field(status, "NoNewPrivs") == Some("1");
        record.seccomp_filter &= field(status, "Seccomp") == Some("2");
    }
    record.capabilities = names(permitted);
    record.bounding_capabilities = names(bounding);
    record
}

fn field<'a>(status: &'a str, name: &str) -> Option<&'a str> {
    let value = status
        .lines()
        .find_map(|line| line.strip_prefix(name)?.strip_prefix(':'));
    value.map(str::trim)
}

fn set(status: &str, name: &str) -> CapabilitySet {
    let bits = field(status, name).and_then(|hex| u64::from_str_radix(hex, 16).ok());
    CapabilitySet::from_bits_retain(bits.unwrap_or(0))
}

/// As capabilities(7) names them, without `CAP_`.
fn names(set: CapabilitySet) -> Vec<String> {
    set.iter_names().map(|(name, _)| name.to_owned()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROOT: &str = "Name:\tworkload\nCapInh:\t0000000000000000\nCapPrm:\t000001ffffffffff\nCapEff:\t000001ffffffffff\n\
                        CapBnd:\t000001ffffffffff\nCapAmb:\t0000000000000000\nNoNewPrivs:\t0\nSeccomp:\t0\n";
    const CONTAINED: &str = "CapInh:\t0000000000000000\nCapPrm:\t0000000000001000\nCapEff:\t0000000000001000\n\
                             CapBnd:\t0000000000003000\nCapAmb:\t0000000000000000\nNoNewPrivs:\t1\nSeccomp:\t2\n";

    // Until version 0.1 such a thread was seen with all of root's rights, if the survey came before it was at work: a change of the
    // platform that was none.
    #[test]
    fn a_thread_has_dropped_its_rights_when_it_is_said_to_be_started() {
        for round in 0..50 {
            let name = format!("dropped-{round}");
            let (done, is_done) = channel::<()>();
            spawn_after_drop(&name, move || {
                let _ = is_done.recv();
            })
            .unwrap();
            // A listing leaves out threads where others, of other tests, end meanwhile.
            let listed = || {
                let tasks = fs::read_dir("/proc/self/task").unwrap().flatten();
                let mut statuses =
                    tasks.filter_map(|task| fs::read_to_string(task.path().join("status")).ok());
                statuses.find(|status| field(status, "Name") == Some(&name))
            };
            let status = (0..100).find_map(|_| listed()).expect("it is there");
            assert_eq!(field(&status, "NoNewPrivs"), Some("1"), "{status}");
            drop(done);
        }
    }

    #[test]
    fn what_one_thread_still_may_the_process_may() {
        let all_dropped = summary([CONTAINED, CONTAINED].into_iter());
        assert_eq!(all_dropped.capabilities, ["NET_ADMIN"]);
        assert_eq!(all_dropped.bounding_capabilities, ["NET_ADMIN", "NET_RAW"]);
        assert!(all_dropped.no_new_privileges && all_dropped.seccomp_filter);
        let one_forgotten = summary([CONTAINED, ROOT].into_iter());
        assert!(one_forgotten.capabilities.iter().any(|name| name == "SYS_ADMIN"));
        assert!(!one_forgotten.no_new_privileges && !one_forgotten.seccomp_filter);
    }

    #[test]
    fn a_thread_that_gives_up_its_rights_starts_others_without_them() {
        let status = |path: &str| fs::read_to_string(path).unwrap();
        let inside = thread::spawn(move || {
            drop_unneeded();
            thread::spawn(move || status("/proc/thread-self/status"))
                .join()
                .unwrap()
        });
        let inside = inside.join().unwrap();
        let has = set(&inside, "CapPrm") | set(&inside, "CapEff") | set(&inside, "CapAmb");
        assert!(KEPT.contains(has), "{inside}");
        assert_eq!(field(&inside, "NoNewPrivs"), Some("1"));
        // Only who may is able to: root is.
        let could = set(&status("/proc/thread-self/status"), "CapEff");
        if could.contains(CapabilitySet::SETPCAP) {
            assert!(KEPT.contains(set(&inside, "CapBnd")), "{inside}");
        }
    }

    #[test]
    fn a_program_gets_none_of_them_back() {
        let said = thread::spawn(|| {
            drop_unneeded();
            let cat = std::process::Command::new("cat")
                .arg("/proc/self/status")
                .output()
                .unwrap();
            String::from_utf8(cat.stdout).unwrap()
        });
        let said = said.join().unwrap();
        assert!(
            KEPT.contains(set(&said, "CapEff") | set(&said, "CapPrm")),
            "{said}"
        );
    }
}
