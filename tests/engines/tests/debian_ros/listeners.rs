//! Where the workload listens: inside its virtual hosts, and nowhere else.

use std::{collections::BTreeSet, fs};

use rstest::rstest;

use crate::{
    settings,
    stage::{Stage, machine},
};

/// Of a table as /proc/net/tcp has it: address and port of each listening socket, and its inode.
fn listening(table: &str) -> Vec<(String, u64)> {
    const LISTEN: &str = "0A";
    let rows = table
        .lines()
        .skip(1)
        .map(|line| line.split_whitespace().collect::<Vec<_>>());
    rows.filter(|row| row[3] == LISTEN)
        .map(|row| (row[1].to_owned(), row[9].parse().unwrap()))
        .collect()
}

/// The sockets that a process has open.
fn sockets(pid: &str) -> BTreeSet<u64> {
    let files = fs::read_dir(format!("/proc/{pid}/fd")).unwrap();
    files
        .filter_map(|file| {
            let target = fs::read_link(file.ok()?.path()).ok()?;
            let inode = target.to_str()?.strip_prefix("socket:[")?.strip_suffix(']')?;
            inode.parse().ok()
        })
        .collect()
}

/// With their children.
fn family(pid: &str) -> Vec<String> {
    let tasks = fs::read_dir(format!("/proc/{pid}/task")).unwrap();
    let children = tasks.map(|task| fs::read_to_string(task.unwrap().path().join("children")).unwrap());
    let children: String = children.collect();
    let mut all = vec![pid.to_owned()];
    all.extend(children.split_whitespace().map(str::to_owned));
    all
}

#[rstest]
#[case::embedded("embedded", "0100000A:2C2F")]
// It binds all addresses of the host it is in.
#[case::rosmaster("rosmaster", "00000000:2C2F")]
fn nothing_listens_outside_the_virtual_hosts(#[case] master: &str, #[case] master_address: &str) {
    let _machine = machine();
    let stage = Stage::rehearse(&settings(master), &[]);
    let ours: BTreeSet<u64> = family(&stage.pid()).iter().flat_map(|pid| sockets(pid)).collect();
    let mut inside = 0;
    for (host, address) in [("h1", "0100000A"), ("sta1", "0200000A"), ("sta2", "0300000A")] {
        for (local, inode) in listening(&stage.output(host, "/bin/cat", &["/proc/self/net/tcp"])) {
            assert!(ours.contains(&inode), "{local} on {host}");
            assert!(
                local.starts_with(address) || local == master_address,
                "{local} on {host}"
            );
            inside += 1;
        }
        let table = stage.output(host, "/bin/cat", &["/proc/self/net/tcp6"]);
        assert_eq!(listening(&table), []);
    }
    // The master's, and of each node that for calls and that for subscribers.
    assert_eq!(inside, 5);
    for table in ["/proc/self/net/tcp", "/proc/self/net/tcp6"] {
        let outside = listening(&fs::read_to_string(table).unwrap());
        let of_ours = outside.iter().filter(|(_, inode)| ours.contains(inode));
        assert_eq!(of_ours.count(), 0, "{outside:?}");
    }
    stage.end();
}
