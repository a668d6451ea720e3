//! What is installed and running that the experiment may use or feel: packages, daemons that steer the clock. The main
//! functions are [`packages`] and [`time_daemons`].
//!
//! dpkg's own file is read and no program started: that takes a millisecond or two and disturbs nobody. Sources:
//! dpkg(1), deb-control(5), proc_pid_comm(5).

use std::{collections::BTreeMap, fs};

/// Their versions are part of what a platform was.
const PACKAGES: [&str; 9] = [
    "libc6",
    "mininet",
    "openvswitch-common",
    "openvswitch-switch",
    "openvswitch-testcontroller",
    "python3-rosmaster",
    "python3-rospy",
    "ros-core",
    "tcpdump",
];

/// Packages of ROS's own repository, such as `ros-noetic-rospy`.
const ROS_PARTS: [&str; 3] = ["-rosmaster", "-rospy", "-ros-core"];

/// As the kernel shows their names, which is up to 15 characters.
const TIME_DAEMONS: [&str; 7] = [
    "chronyd",
    "ntpd",
    "ntpd-rs",
    "openntpd",
    "phc2sys",
    "ptp4l",
    "systemd-timesyn",
];

/// Versions of the packages that matter and are installed; empty where dpkg is not used.
pub fn packages() -> BTreeMap<String, String> {
    fs::read_to_string("/var/lib/dpkg/status").map_or_else(|_| BTreeMap::new(), |status| installed(&status))
}

/// The daemons that run and steer the clock, as far as they can be seen: in a container only its own.
pub fn time_daemons() -> Vec<String> {
    let processes = fs::read_dir("/proc").into_iter().flatten().flatten();
    let names = processes
        .filter(|entry| {
            entry
                .file_name()
                .as_encoded_bytes()
                .iter()
                .all(u8::is_ascii_digit)
        })
        .filter_map(|entry| fs::read_to_string(entry.path().join("comm")).ok());
    let mut daemons: Vec<String> = names
        .map(|name| name.trim().to_owned())
        .filter(|name| TIME_DAEMONS.contains(&name.as_str()))
        .collect();
    daemons.sort();
    daemons.dedup();
    daemons
}

fn installed(status: &str) -> BTreeMap<String, String> {
    let entries = status.split("\n\n").filter_map(|entry| {
        let value = |key: &str| {
            let mut lines = entry.lines();
            lines.find_map(|line| line.strip_prefix(key)?.strip_prefix(": "))
        };
        let name = value("Package")?;
        let wanted = PACKAGES.contains(&name)
            || name.starts_with("ros-") && ROS_PARTS.iter().any(|part| name.ends_with(part));
        let is_installed = wanted && value("Status")?.ends_with(" installed");
        is_installed
            .then(|| Some((name.to_owned(), value("Version")?.to_owned())))
            .flatten()
    });
    entries.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_packages_that_matter_and_are_installed_count() {
        let status = "Package: mininet\nStatus: install ok installed\nArchitecture: amd64\nVersion: 2.3.0-1.1\n\n\
            Package: openvswitch-switch\nStatus: deinstall ok config-files\nVersion: 3.1.0-2\n\n\
            Package: ros-noetic-rospy\nStatus: install ok installed\nVersion: 1.16.0\n\n\
            Package: bash\nStatus: install ok installed\nVersion: 5.2\n";
        let found: Vec<(String, String)> = installed(status).into_iter().collect();
        let wanted = [("mininet", "2.3.0-1.1"), ("ros-noetic-rospy", "1.16.0")];
        assert_eq!(
            found,
            wanted.map(|(name, version)| (name.to_owned(), version.to_owned()))
        );
    }
}
