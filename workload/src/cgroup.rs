//! The control groups that the process is in, version 1 or 2: where the kernel says what they may use and how often they
//! were held up. The main type is [`Groups`].
//!
//! Sources: cgroups(7), proc_pid_mountinfo(5), Documentation/admin-guide/cgroup-v2.rst. In a container only the groups
//! from its own on are visible; what limits those above it cannot be seen.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

/// The visible groups of one controller.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Groups {
    /// Their folders, the process's own first.
    folders: Vec<PathBuf>,
}

impl Groups {
    /// The groups that limit the process's use of a controller such as `cpu`; none where they are not mounted.
    #[must_use]
    pub fn of(controller: &str) -> Option<Self> {
        let mounts = fs::read_to_string("/proc/self/mountinfo").ok()?;
        let memberships = fs::read_to_string("/proc/self/cgroup").ok()?;
        let found = locate(&mounts, &memberships, controller)?;
        let own = found.mounted_at.join(&found.below);
        let folders = own
            .ancestors()
            .take_while(|folder| folder.starts_with(&found.mounted_at))
            .map(Path::to_owned)
            .filter(|folder| folder.is_dir())
            .collect();
        Some(Self { folders })
    }

    /// A file of the innermost group that has it, without surrounding white space.
    #[must_use]
    pub fn innermost(&self, file: &str) -> Option<String> {
        self.each(file).next()
    }

    /// A file in each of the groups that has it, the own first.
    pub fn each<'a>(&'a self, file: &'a str) -> impl Iterator<Item = String> + 'a {
        let texts = self
            .folders
            .iter()
            .map(move |folder| fs::read_to_string(folder.join(file)));
        texts.filter_map(|text| text.ok().map(|text| text.trim().to_owned()))
    }
}

/// The files of both versions that say what a group may use, with their controllers.
const LIMITS: [(&str, &[&str]); 4] = [
    (
        "cpu",
        &[
            "cpu.max",
            "cpu.weight",
            "cpu.cfs_quota_us",
            "cpu.cfs_period_us",
            "cpu.shares",
            "cpu.rt_runtime_us",
        ],
    ),
    ("cpuset", &["cpuset.cpus.effective", "cpuset.effective_cpus"]),
    ("pids", &["pids.max"]),
    (
        "memory",
        &[
            "memory.max",
            "memory.high",
            "memory.swap.max",
            "memory.limit_in_bytes",
            "memory.memsw.limit_in_bytes",
        ],
    ),
];

/// What the process's innermost groups may use, in the kernel's spelling, by the names of the kernel's files.
#[must_use]
pub fn limits() -> BTreeMap<String, String> {
    let found = LIMITS.iter().flat_map(|(controller, files)| {
        let groups = Groups::of(controller);
        let limit = move |file: &&str| Some(((*file).to_owned(), groups.as_ref()?.innermost(file)?));
        files.iter().filter_map(limit).collect::<Vec<_>>()
    });
    found.collect()
}

/// Where a controller's hierarchy is mounted and the process's place in it.
#[derive(Debug, PartialEq, Eq)]
struct Located {
    mounted_at: PathBuf,
    below: PathBuf,
}

/// Version 1 if the controller is in it, else version 2.
fn locate(mounts: &str, memberships: &str, controller: &str) -> Option<Located> {
    let of_version_1 = memberships.lines().find_map(|line| {
        let (_, rest) = line.split_once(':')?;
        let (controllers, path) = rest.split_once(':')?;
        controllers
            .split(',')
            .any(|name| name == controller)
            .then_some(path)
    });
    let unified = of_version_1.is_none();
    let path = of_version_1.or_else(|| memberships.lines().find_map(|line| line.strip_prefix("0::")))?;
    let (root, mounted_at) = mounts.lines().find_map(|line| {
        let (place, about) = line.split_once(" - ")?;
        let mut about = about.split(' ');
        let (kind, options) = (about.next()?, about.nth(1).unwrap_or_default());
        let wanted = match unified {
            true => kind == "cgroup2",
            false => kind == "cgroup" && options.split(',').any(|option| option == controller),
        };
        let mut place = place.split(' ').skip(3);
        wanted.then(|| Some((place.next()?, place.next()?))).flatten()
    })?;
    // A path that is not below what is mounted is one of outside the container.
    let below = Path::new(path).strip_prefix(root).unwrap_or(Path::new(""));
    let below = below.strip_prefix("/").unwrap_or(below);
    Some(Located {
        mounted_at: PathBuf::from(mounted_at),
        below: below.to_owned(),
    })
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    const VERSION_2: &str =
        "30 23 0:26 / /sys/fs/cgroup rw,nosuid shared:4 - cgroup2 cgroup2 rw,nsdelegate\n";
    const VERSION_1: &str = "31 23 0:27 / /sys/fs/cgroup/cpu,cpuacct rw shared:9 - cgroup cgroup rw,cpu,cpuacct\n\
        32 23 0:28 / /sys/fs/cgroup/memory rw shared:10 - cgroup cgroup rw,memory\n\
        33 23 0:29 / /sys/fs/cgroup/unified rw shared:11 - cgroup2 cgroup2 rw\n";
    const CONTAINER: &str = "31 23 0:27 /docker/ab /sys/fs/cgroup/cpu ro - cgroup cpu rw,cpu\n";

    #[rstest]
    #[case::of_version_2(
        VERSION_2,
        "0::/user.slice/a.service\n",
        "/sys/fs/cgroup",
        "user.slice/a.service"
    )]
    #[case::at_the_root(VERSION_2, "0::/\n", "/sys/fs/cgroup", "")]
    #[case::of_version_1(
        VERSION_1,
        "4:memory:/elsewhere\n2:cpu,cpuacct:/a/b\n0::/\n",
        "/sys/fs/cgroup/cpu,cpuacct",
        "a/b"
    )]
    #[case::in_a_container(CONTAINER, "2:cpu:/docker/ab\n0::/\n", "/sys/fs/cgroup/cpu", "")]
    #[case::in_a_container_seen_from_outside(CONTAINER, "2:cpu:/slurm/job\n", "/sys/fs/cgroup/cpu", "")]
    fn the_own_group_is_found(
        #[case] mounts: &str,
        #[case] memberships: &str,
        #[case] mounted_at: &str,
        #[case] below: &str,
    ) {
        let located = Located {
            mounted_at: mounted_at.into(),
            below: below.into(),
        };
        assert_eq!(locate(mounts, memberships, "cpu"), Some(located));
    }

    #[test]
    fn a_controller_that_is_not_mounted_has_no_groups() {
        assert_eq!(locate(VERSION_1, "2:cpuset:/\n", "cpuset"), None);
        assert_eq!(locate("", "0::/\n", "cpu"), None);
    }
}
