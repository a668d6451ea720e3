//! What else happened on the machine while a window was measured: the kernel's counters at its two ends. The main type
//! is [`Counters`].
//!
//! Sources: proc_stat(5), proc_vmstat(5), Documentation/accounting/psi.rst, Documentation/admin-guide/cgroup-v2.rst
//! (`cpu.stat`), arch/x86/kernel/cpu/mce/therm_throt.c. Whatever a kernel or a container does not show is none, never 0.

use std::{fs, path::Path};

use nix::{
    sys::{
        resource::{Usage, UsageWho, getrusage},
        time::TimeValLike,
    },
    time::{ClockId, clock_gettime},
    unistd::{Pid, SysconfVar, sysconf},
};
use record::window::ConditionsRecord;

use crate::{cgroup::Groups, survey::cpus_allowed};

/// Makes [`Counters`] of the rows, with its reading and the difference of two readings. A row is a counter: what it is at the
/// moment of a reading, and the fields of [`ConditionsRecord`] that follow from it.
macro_rules! counters {
    (
        read(|$here:ident|), since(|$now:ident, $before:ident, $span:ident|):
        $(
            $(#[$comment:meta])*
            $counter:ident: $kind:ty {
                read: $read:expr,
                $($field:ident: $since:expr,)*
            }
        )+
    ) => {
        /// Counters at one moment.
        #[derive(Debug, Clone, Default, PartialEq)]
        pub struct Counters {
            $($(#[$comment])* pub $counter: $kind,)+
        }

        impl Counters {
            /// Now. `others` are the workload's processes beside this one; one that has ended counts no longer.
            #[must_use]
            pub fn read(others: &[Pid]) -> Self {
                let $here = Here::look(others);
                Self { $($counter: $read,)+ }
            }

            /// What happened since `earlier`, which is so long ago. Shares are of all processors that the process may use.
            #[must_use]
            pub fn since(&self, earlier: &Self, elapsed_ns: i64) -> ConditionsRecord {
                let ($now, $before, $span) = (self, earlier, Span::of(elapsed_ns));
                ConditionsRecord { $($($field: $since,)*)+ }
            }
        }
    };
}

counters! {
    read(|here|), since(|now, before, span|):

    /// Processor time that the workload's processes have used.
    own_cpu_ns: i64 {
        read: here.usage.map_or(0, |usage| (usage.user_time() + usage.system_time()).num_nanoseconds())
            + here.others.iter().map(|pid| cpu_ns(*pid)).sum::<i64>(),
    }

    /// Page faults of the workload's processes that had to wait for a disk.
    major_faults: u64 {
        read: here.usage.map_or(0, |usage| u64::try_from(usage.major_page_faults()).unwrap_or(0))
            + here.others.iter().map(|pid| major_faults(*pid)).sum::<u64>(),
        major_faults: now.major_faults.saturating_sub(before.major_faults),
    }

    /// Of the processors that the process may use, together.
    processors: Option<ProcessorTimes> {
        read: text("/proc/stat").and_then(|stat| ProcessorTimes::of(&stat, &here.cpus)),
        steal_share: both(now.processors, before.processors)
            .filter(|_| span.is_long_enough())
            .map(|(now, before)| ticks_ns(now.stolen.saturating_sub(before.stolen)) / span.processors_ns),
        // Ticks are coarse: on a quiet machine the rest may come out a little below nothing.
        other_load_share: both(now.processors, before.processors).filter(|_| span.is_long_enough()).map(|(later, earlier)| {
            let own_ns = (now.own_cpu_ns - before.own_cpu_ns) as f64;
            ((ticks_ns(later.busy.saturating_sub(earlier.busy)) - own_ns) / span.processors_ns).max(0.0)
        }),
    }

    /// Of the process's control groups.
    throttling: Option<Throttling> {
        read: Groups::of("cpu").and_then(|groups| Throttling::of(&groups)),
        throttled_share: both(now.throttling, before.throttling)
            .map(|(now, before)| now.total_ns.saturating_sub(before.total_ns) as f64 / span.ns),
        throttled_periods: both(now.throttling, before.throttling)
            .map(|(now, before)| now.periods.saturating_sub(before.periods)),
    }

    /// How often the processors slowed down since they were too hot.
    thermal_throttles: Option<u64> {
        read: thermal_throttles(&here.cpus),
        thermal_throttles: more(now.thermal_throttles, before.thermal_throttles),
    }

    /// For how long something on the machine waited for memory.
    memory_waited_ns: Option<u64> {
        read: text("/proc/pressure/memory").and_then(|pressure| waited_ns(&pressure)),
        memory_pressure_share: more(now.memory_waited_ns, before.memory_waited_ns)
            .map(|waited_ns| waited_ns as f64 / span.ns),
    }

    /// Pages swapped in and out by the machine.
    swapped_pages: Option<u64> {
        read: text("/proc/vmstat").and_then(|vmstat| swapped_pages(&vmstat)),
        swapped_bytes: more(now.swapped_pages, before.swapped_pages)
            .map(|pages| pages.saturating_mul(page_bytes())),
    }
}

/// What several counters are read from.
struct Here<'a> {
    usage: nix::Result<Usage>,
    cpus: Vec<usize>,
    others: &'a [Pid],
}

impl<'a> Here<'a> {
    fn look(others: &'a [Pid]) -> Self {
        Self {
            usage: getrusage(UsageWho::RUSAGE_SELF),
            cpus: cpus_allowed(),
            others,
        }
    }
}

/// The time between two readings.
struct Span {
    ns: f64,
    /// Of all processors that the process may use.
    processors_ns: f64,
}

impl Span {
    fn of(elapsed_ns: i64) -> Self {
        let ns = elapsed_ns.max(1) as f64;
        Self {
            ns,
            processors_ns: ns * cpus_allowed().len().max(1) as f64,
        }
    }

    /// Whether ticks, of which there are a hundred a second, say anything of it.
    fn is_long_enough(&self) -> bool {
        self.ns >= 1e9
    }
}

/// Time of processors in ticks of the clock that /proc/stat counts with.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ProcessorTimes {
    /// Doing something, for whomever, this machine's guests included.
    busy: u64,
    /// Given by a hypervisor to others.
    stolen: u64,
}

/// How a quota held the process up.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Throttling {
    /// In how many of the quota's periods.
    periods: u64,
    /// For how long, summed over the processors.
    total_ns: u64,
}

/// Processor time that another process has used; 0 if it has ended.
fn cpu_ns(pid: Pid) -> i64 {
    ClockId::pid_cpu_clock_id(pid)
        .and_then(clock_gettime)
        .map_or(0, |time| time.num_nanoseconds())
}

/// Page faults of another process that had to wait for a disk; 0 if it has ended.
fn major_faults(pid: Pid) -> u64 {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).unwrap_or_default();
    // The name, in parentheses, may hold anything; `majflt` is the tenth field behind it.
    let fields = stat.rsplit_once(')').map_or("", |(_, fields)| fields);
    fields
        .split_whitespace()
        .nth(9)
        .and_then(|field| field.parse().ok())
        .unwrap_or(0)
}

impl ProcessorTimes {
    /// Those of some processors, from the text of /proc/stat; none if one of them is missing.
    fn of(stat: &str, cpus: &[usize]) -> Option<Self> {
        let mut sum = Self::default();
        for cpu in cpus {
            let name = format!("cpu{cpu} ");
            let line = stat.lines().find_map(|line| line.strip_prefix(&name))?;
            let ticks: Vec<u64> = line
                .split_whitespace()
                .map_while(|field| field.parse().ok())
                .collect();
            // user nice system idle iowait irq softirq steal; guests are in user and nice already.
            let [user, nice, system, _, _, irq, softirq, steal] = *ticks.get(..8)? else {
                return None;
            };
            sum.busy += user + nice + system + irq + softirq;
            sum.stolen += steal;
        }
        (!cpus.is_empty()).then_some(sum)
    }
}

impl Throttling {
    /// Summed over the own group and those above it: each of them can hold the process up.
    fn of(groups: &Groups) -> Option<Self> {
        groups
            .each("cpu.stat")
            .filter_map(|stat| Self::read(&stat))
            .reduce(|one, other| Self {
                periods: one.periods + other.periods,
                total_ns: one.total_ns + other.total_ns,
            })
    }

    /// From the text of `cpu.stat`; none if the group cannot have a quota.
    fn read(stat: &str) -> Option<Self> {
        let total_ns =
            number(stat, "throttled_time").or_else(|| number(stat, "throttled_usec").map(|us| us * 1000));
        Some(Self {
            periods: number(stat, "nr_throttled")?,
            total_ns: total_ns?,
        })
    }
}

/// The sum of all counters of the processors, of each core and of its package; none where there are no such counters.
fn thermal_throttles(cpus: &[usize]) -> Option<u64> {
    let counters = cpus.iter().flat_map(|cpu| {
        let folder = format!("/sys/devices/system/cpu/cpu{cpu}/thermal_throttle");
        ["core_throttle_count", "package_throttle_count"].map(|name| Path::new(&folder).join(name))
    });
    let counts = counters.filter_map(|path| fs::read_to_string(path).ok()?.trim().parse::<u64>().ok());
    counts.reduce(|one, other| one + other)
}

/// `total` of the line `some` of /proc/pressure/memory, which is in microseconds.
fn waited_ns(pressure: &str) -> Option<u64> {
    let some = pressure.lines().find_map(|line| line.strip_prefix("some "))?;
    let total = some.split(' ').find_map(|field| field.strip_prefix("total="))?;
    total.parse::<u64>().ok()?.checked_mul(1000)
}

fn swapped_pages(vmstat: &str) -> Option<u64> {
    Some(number(vmstat, "pswpin")? + number(vmstat, "pswpout")?)
}

/// The number after a name at the start of a line.
fn number(text: &str, name: &str) -> Option<u64> {
    let mut lines = text.lines().filter_map(|line| line.split_once(' '));
    lines.find(|(key, _)| *key == name)?.1.trim().parse().ok()
}

fn text(path: &str) -> Option<String> {
    fs::read_to_string(path).ok()
}

fn both<T>(now: Option<T>, before: Option<T>) -> Option<(T, T)> {
    now.zip(before)
}

/// By how much a counter has grown.
fn more(now: Option<u64>, before: Option<u64>) -> Option<u64> {
    both(now, before).map(|(now, before)| now.saturating_sub(before))
}

fn ticks_ns(ticks: u64) -> f64 {
    // 100 on every Linux there is.
    let per_second = sysconf(SysconfVar::CLK_TCK).ok().flatten().unwrap_or(100);
    ticks as f64 * 1e9 / per_second as f64
}

fn page_bytes() -> u64 {
    let bytes = sysconf(SysconfVar::PAGE_SIZE).ok().flatten().unwrap_or(4096);
    u64::try_from(bytes).unwrap_or(4096)
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    use super::*;

    const STAT: &str = "cpu  111 0 0 0 0 0 0 0 0 0\n\
        cpu0 10 1 20 1000 50 2 3 7 4 0\n\
        cpu1 100 0 0 0 0 0 0 0 0 0\n\
        cpu10 1000 0 0 0 0 0 0 5 0 0\n\
        intr 5\n";

    #[rstest]
    #[case(&[0], Some((36, 7)))]
    #[case(&[0, 10], Some((1036, 12)))]
    #[case(&[2], None)]
    #[case(&[], None)]
    fn waiting_is_not_being_busy_and_only_own_processors_count(
        #[case] cpus: &[usize],
        #[case] wanted: Option<(u64, u64)>,
    ) {
        let found = ProcessorTimes::of(STAT, cpus).map(|times| (times.busy, times.stolen));
        assert_eq!(found, wanted);
    }

    #[rstest]
    #[case::version_1("nr_periods 9\nnr_throttled 3\nthrottled_time 4000\nnr_bursts 0", Some((3, 4000)))]
    #[case::version_2("usage_usec 5\nnr_periods 9\nnr_throttled 3\nthrottled_usec 4", Some((3, 4000)))]
    #[case::root_of_version_2("usage_usec 5\nuser_usec 5\nsystem_usec 0", None)]
    fn both_versions_of_control_groups_say_how_long_they_held_up(
        #[case] stat: &str,
        #[case] wanted: Option<(u64, u64)>,
    ) {
        let found = Throttling::read(stat).map(|found| (found.periods, found.total_ns));
        assert_eq!(found, wanted);
    }

    #[test]
    fn pressure_is_the_time_in_which_something_waited() {
        let pressure = "some avg10=0.00 avg60=0.00 avg300=0.00 total=1200\nfull avg10=0.00 total=7\n";
        assert_eq!(waited_ns(pressure), Some(1_200_000));
        assert_eq!(waited_ns(""), None);
    }

    #[test]
    fn swapping_is_in_and_out() {
        assert_eq!(swapped_pages("pgpgin 9\npswpin 3\npswpout 4\n"), Some(7));
    }

    #[test]
    fn a_window_has_what_happened_since_it_began() {
        let before = Counters {
            processors: Some(ProcessorTimes {
                busy: 100,
                stolen: 10,
            }),
            memory_waited_ns: Some(1_000_000),
            swapped_pages: None,
            ..Counters::default()
        };
        let cpus = cpus_allowed().len() as u64;
        let now = Counters {
            own_cpu_ns: 1_000_000_000 * cpus as i64,
            major_faults: 2,
            processors: Some(ProcessorTimes {
                busy: 100 + 300 * cpus,
                stolen: 10 + 100 * cpus,
            }),
            memory_waited_ns: Some(501_000_000),
            swapped_pages: Some(3),
            ..Counters::default()
        };
        // Ten seconds; a tick is 10 ms.
        let found = now.since(&before, 10_000_000_000);
        assert_eq!(
            found,
            ConditionsRecord {
                steal_share: Some(0.1),
                other_load_share: Some(0.2),
                memory_pressure_share: Some(0.05),
                major_faults: 2,
                ..ConditionsRecord::default()
            }
        );
    }

    #[test]
    fn the_kernel_counts_this_machines_processors() {
        let counters = Counters::read(&[]);
        assert!(counters.processors.unwrap().busy > 0);
        assert!(counters.swapped_pages.is_some());
    }
}
