//! `window.json`: what one window is and what it is worth. It is written last, so that a window without it is a broken
//! one. The main type is [`WindowRecord`].

use serde::{Deserialize, Deserializer, Serialize, de::Error as _};

use super::name::name;
use crate::{reason, virtual_host::VirtualHost};

/// One window's record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WindowRecord {
    /// [`super::FORMAT`] at the time of writing.
    pub format: u32,
    /// The window's number, from 1.
    pub window: u32,
    /// The environment that measured it; windows of one environment are contiguous.
    #[serde(deserialize_with = "name")]
    pub environment: String,
    /// Whether it is the first window of its run of the loop, and so begins with the transient.
    pub starts_run: bool,
    /// Whether all its steps were done.
    pub complete: bool,
    /// Wall clock at its start, nanoseconds since 1970.
    pub started_unix_ns: i64,
    /// Wall clock at its end.
    pub ended_unix_ns: i64,
    /// Its start on the experiment's clock.
    pub started_ns: i64,
    /// Its end on the experiment's clock.
    pub ended_ns: i64,
    /// What its experiment alone has.
    #[serde(flatten)]
    pub of: OfExperiment,
    /// Wall clock against monotonic clock, end minus start: a step of NTP or of a person.
    pub clock_jump_ns: i64,
    /// What the workload's process used of the processor during the window, as a share of one core.
    pub cpu_share: f64,
    /// What else happened on the machine meanwhile.
    #[serde(default)]
    pub conditions: ConditionsRecord,
    /// One for each virtual host, if captures are on.
    pub captures: Vec<CaptureRecord>,
    /// What the network's losses and delays were drawn from since the run of the loop began; none if they cannot be drawn
    /// again.
    #[serde(default)]
    pub network_seed: Option<u64>,
    /// The links, in [`VirtualHost::OF_THE_BALL`]'s order.
    pub links: Vec<LinkRecord>,
    /// What happened between the ROS master and nodes and their peers.
    #[serde(default)]
    pub notices: NoticesRecord,
    /// How late packets were let go, over all links; none where that is the kernel's doing, or of an older version.
    #[serde(default)]
    pub releases: Option<ReleaseRecord>,
    /// The files beside this one.
    pub files: Vec<FileRecord>,
    /// What it is worth.
    pub verdict: Verdict,
    /// Why, if not valid.
    pub reasons: Vec<String>,
}

/// What a window of one experiment has and those of others have not.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub enum OfExperiment {
    /// The ball on the plate.
    Loops(LoopsRecord),
    /// A command of the user's, below a key of its own, by which it is known.
    Command {
        /// How it ended.
        command: CommandRecord,
    },
}

impl<'de> Deserialize<'de> for OfExperiment {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        struct Either {
            command: Option<CommandRecord>,
            #[serde(flatten)]
            others: serde_json::Map<String, serde_json::Value>,
        }
        let Either { command, others } = Either::deserialize(deserializer)?;
        match command {
            Some(command) => Ok(Self::Command { command }),
            None => serde_json::from_value(others.into())
                .map(Self::Loops)
                .map_err(D::Error::custom),
        }
    }
}

/// What the loops of the ball on the plate did.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct LoopsRecord {
    /// Control steps that the window should have.
    pub steps_expected: u64,
    /// Control steps in its log.
    pub steps_done: u64,
    /// The controller's loop.
    pub controller: LoopRecord,
    /// The plant's loop.
    pub plant: LoopRecord,
    /// Control steps that had no newer state than the step before.
    pub stale_steps: u64,
    /// Longest time between two control steps.
    pub longest_gap_ns: i64,
    /// Rows that the log's queue had no room for.
    pub log_dropped: u64,
}

/// How a command ended, and what it took: of nodes, all of them together.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct CommandRecord {
    /// Its exit code; none if it was ended.
    pub exit_code: Option<i32>,
    /// Processors' time of the command and all that it started and waited for, in user and in system mode.
    pub cpu_ns: u64,
    /// The most memory that one of these processes had at once, in bytes.
    pub peak_memory_bytes: u64,
    /// What it printed on standard output, of which the file has the beginning and the end.
    pub stdout_bytes: u64,
    /// The same of standard error.
    pub stderr_bytes: u64,
    /// Processes that it left behind and that were ended.
    pub left_behind: u64,
    /// The nodes, where the experiment has some, in the order in which they were started.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub nodes: Vec<NodeRecord>,
}

/// A program on a virtual host: how it ended, and what it took.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NodeRecord {
    /// As the matrix file names it.
    pub name: VirtualHost,
    /// Where it ran.
    pub host: VirtualHost,
    /// Its exit code; none if a signal ended it, such as that which ends a node in the background.
    pub exit_code: Option<i32>,
    /// That signal.
    pub signal: Option<i32>,
    /// From the beginning of the window until it was ready; none if it never was.
    pub ready_after_ns: Option<u64>,
    /// Processors' time of it and all that it started and waited for, in user and in system mode.
    pub cpu_ns: u64,
    /// The most memory that one of these processes had at once, in bytes.
    pub peak_memory_bytes: u64,
    /// What it printed on standard output, of which the file has the beginning and the end.
    pub stdout_bytes: u64,
    /// The same of standard error.
    pub stderr_bytes: u64,
}

/// A record says what no run can have.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{field}` is {value}, which no run has")]
pub struct Impossible {
    /// The field.
    pub field: &'static str,
    /// What it says.
    pub value: String,
}

impl Impossible {
    /// There are too many of something.
    #[must_use]
    pub fn count(field: &'static str, many: usize) -> Self {
        Self {
            field,
            value: format!("{many} in all"),
        }
    }
}

impl LoopsRecord {
    fn counts(&self) -> [(&'static str, u64); 12] {
        let (controller, plant) = (&self.controller, &self.plant);
        [
            ("steps_expected", self.steps_expected),
            ("steps_done", self.steps_done),
            ("stale_steps", self.stale_steps),
            ("log_dropped", self.log_dropped),
            ("controller.steps", controller.steps),
            ("controller.lost_ticks", controller.lost_ticks),
            ("controller.missed_deadlines", controller.missed_deadlines),
            ("controller.late_steps", controller.late_steps),
            ("plant.steps", plant.steps),
            ("plant.lost_ticks", plant.lost_ticks),
            ("plant.missed_deadlines", plant.missed_deadlines),
            ("plant.late_steps", plant.late_steps),
        ]
    }
}

impl CommandRecord {
    fn counts(&self) -> [(&'static str, u64); 4] {
        [
            ("command.peak_memory_bytes", self.peak_memory_bytes >> 20),
            ("command.stdout_bytes", self.stdout_bytes >> 20),
            ("command.stderr_bytes", self.stderr_bytes >> 20),
            ("command.left_behind", self.left_behind),
        ]
    }
}

/// A window's reasons as one line. Those of the loops are sentences with a full stop, those of a command are
/// phrases without one; both can stand together.
#[must_use]
pub fn reasons_in_one_line(reasons: &[String]) -> String {
    let mut line = String::new();
    for reason in reasons {
        line.push_str(match line.chars().next_back() {
            None => "",
            Some('.' | '!' | '?') => " ",
            Some(_) => "; ",
        });
        line.push_str(reason);
    }
    line
}

impl WindowRecord {
    /// What the loops did; none of a command.
    #[must_use]
    pub const fn loops(&self) -> Option<&LoopsRecord> {
        match &self.of {
            OfExperiment::Loops(loops) => Some(loops),
            OfExperiment::Command { .. } => None,
        }
    }

    /// Brings its reasons to what a reader reads: the beginning of each, and the first of them. A window has some, of a hundred
    /// letters each; ten nodes that failed at once, with their last words, have half of what is kept.
    pub fn shorten_reasons(&mut self) {
        let mut bytes = 0;
        let shortened = self.reasons.iter().map(|it| reason::shortened(it));
        let kept: Vec<String> = shortened
            .take_while(|reason| {
                bytes += reason.len();
                bytes <= Self::KEPT_REASONS
            })
            .collect();
        let beside = self.reasons.len() - kept.len();
        self.reasons = kept;
        if beside > 0 {
            self.reasons
                .push(format!("and {beside} more, which window.json has"));
        }
    }

    /// Why it is invalid, if it is: all its reasons in one line.
    #[must_use]
    pub fn invalid_for(&self) -> Option<String> {
        (self.verdict == Verdict::Invalid).then(|| reasons_in_one_line(&self.reasons))
    }

    /// The same, to be changed.
    pub const fn loops_mut(&mut self) -> Option<&mut LoopsRecord> {
        match &mut self.of {
            OfExperiment::Loops(loops) => Some(loops),
            OfExperiment::Command { .. } => None,
        }
    }

    /// The file is no longer: it is some kilobytes.
    pub const MOST_BYTES: u64 = 1 << 20;
    /// Whatever is counted in a window, steps and packets too, stays far below.
    pub const MOST: u64 = 1 << 40;
    /// Whatever the two clocks say: in the year 2116.
    const LATEST_NS: i64 = 1 << 62;
    /// No window takes longer: 18 years.
    const LONGEST_NS: i64 = 1 << 59;
    /// There are some twenty rules of validity, and each gives a reason at most for a host or a loop.
    const MOST_REASONS: usize = 100;
    /// All that is said in words: of a window with every reason and notice some kilobytes.
    const MOST_TEXT: usize = 64 << 10;
    /// Bytes of the reasons that are kept of a window, of which a run has some thousands.
    const KEPT_REASONS: usize = 8 << 10;
    /// Three virtual hosts, two logs, with room for more.
    const MOST_FILES: usize = 64;
    /// No file of a window is longer. One of 6000 s has some hundred megabytes; a day of the paper's network at full rate stays below.
    pub const LONGEST_FILE: u64 = 256 << 30;
    /// Captures are compressed to a quarter or a fifth; what shrinks to less than a thousandth is none.
    const MOST_COMPRESSION: u64 = 1000;

    /// Looks whether its numbers are such that they can be added up: the record comes from another machine.
    ///
    /// # Errors
    /// The first that is not.
    pub fn check(&self) -> Result<(), Impossible> {
        let wrong = |field, value: String| Err(Impossible { field, value });
        let dropped = |capture: &CaptureRecord| capture.dropped.max(capture.packets);
        let passed = |pass: &PassRecord| {
            let counts = [
                pass.offered,
                pass.lost,
                pass.delivered,
                pass.overflowed.unwrap_or(0),
            ];
            counts.into_iter().max().unwrap_or(0)
        };
        let links = self.links.iter().flat_map(|link| [&link.up, &link.down]);
        let of_experiment = match &self.of {
            OfExperiment::Loops(loops) => loops.counts().to_vec(),
            OfExperiment::Command { command } => command.counts().to_vec(),
        };
        let counts = [
            ("notices.count", self.notices.count),
            ("captures", self.captures.iter().map(dropped).max().unwrap_or(0)),
            ("links", links.map(passed).max().unwrap_or(0)),
            ("releases.released", self.releases.map_or(0, |it| it.released)),
        ];
        let mut counts = of_experiment.into_iter().chain(counts);
        if let Some((field, count)) = counts.find(|(_, count)| *count > Self::MOST) {
            return wrong(field, count.to_string());
        }
        let times = [
            ("started_unix_ns", self.started_unix_ns),
            ("ended_unix_ns", self.ended_unix_ns),
            ("started_ns", self.started_ns),
            ("ended_ns", self.ended_ns),
        ];
        let is_time = |ns: i64| (0..Self::LATEST_NS).contains(&ns);
        if let Some((field, ns)) = times.into_iter().find(|(_, ns)| !is_time(*ns)) {
            return wrong(field, ns.to_string());
        }
        // The wall clock may be set meanwhile, by half a century where a machine has none of its own.
        let took_ns = self.ended_ns - self.started_ns;
        if !(0..Self::LONGEST_NS).contains(&took_ns) {
            return wrong("ended_ns", format!("{took_ns} ns after started_ns"));
        }
        if self.window == 0 {
            return wrong("window", "0".to_owned());
        }
        for (field, found, most) in [
            ("files", self.files.len(), Self::MOST_FILES),
            ("captures", self.captures.len(), Self::MOST_FILES),
            ("links", self.links.len(), Self::MOST_FILES),
            ("reasons", self.reasons.len(), Self::MOST_REASONS),
            ("notices.first", self.notices.first.len(), NoticesRecord::MOST),
        ] {
            if found > most {
                return wrong(field, format!("a list of {found}"));
            }
        }
        let said = self.reasons.iter().chain(&self.notices.first);
        let said = said.chain(self.captures.iter().map(|capture| &capture.tool));
        let sums = self.files.iter().map(|file| &file.sha256);
        let text: usize = said.chain(sums).map(String::len).sum();
        if text > Self::MOST_TEXT {
            return wrong(
                "reasons",
                format!("{text} bytes of text, with notices and checksums"),
            );
        }
        if let Some(file) = self.files.iter().find(|file| file.bytes > Self::LONGEST_FILE) {
            return wrong("files", format!("{} bytes of {}", file.bytes, file.name));
        }
        let is_bomb = |file: &&FileRecord| {
            let measured = file.measured.as_ref().map_or(0, |it| it.bytes);
            measured > file.bytes.saturating_mul(Self::MOST_COMPRESSION)
        };
        if let Some(file) = self.files.iter().find(is_bomb) {
            return wrong(
                "files",
                format!(
                    "{} in {} bytes of {}",
                    file.as_measured().bytes,
                    file.bytes,
                    file.name
                ),
            );
        }
        Ok(())
    }
}

/// Peers of the ROS master and nodes that came, went or were refused during a window. The experiment's own are
/// connected before; whatever is here came from elsewhere, or broke.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct NoticesRecord {
    /// How many.
    pub count: u64,
    /// The first of them, as `host: words`.
    pub first: Vec<String>,
}

impl NoticesRecord {
    /// How many are kept in words.
    pub const MOST: usize = 20;
}

/// What happened on the machine during one window, as far as the platform shows it: what is hidden is none. Shares are
/// from 0 to 1, those of processors' time of all processors that the workload may use.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct ConditionsRecord {
    /// Processors' time that a hypervisor gave to others.
    pub steal_share: Option<f64>,
    /// Processors' time that others on the machine used.
    pub other_load_share: Option<f64>,
    /// Part of the window in which a quota of the control group held the workload up, summed over processors.
    pub throttled_share: Option<f64>,
    /// In how many of the quota's periods that was.
    pub throttled_periods: Option<u64>,
    /// How often a processor or its package slowed down since it was too hot.
    pub thermal_throttles: Option<u64>,
    /// Part of the window in which something on the machine waited for memory.
    pub memory_pressure_share: Option<f64>,
    /// Pages of the workload that had to be read from a disk.
    pub major_faults: u64,
    /// What the machine swapped, in and out.
    pub swapped_bytes: Option<u64>,
}

/// What a window is worth, from the best to the worst.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// Counted.
    Valid,
    /// Counted, with a remark in the report.
    Suspect,
    /// Kept, never counted.
    Invalid,
}

impl Verdict {
    /// Its name, as `window.json` has it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Valid => "valid",
            Self::Suspect => "suspect",
            Self::Invalid => "invalid",
        }
    }
}

/// How well one of the two loops held its schedule.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct LoopRecord {
    /// Steps done.
    pub steps: u64,
    /// Ticks that were lost, since others before them had not ended; none where late ticks are caught up.
    #[serde(default)]
    pub lost_ticks: u64,
    /// Steps that began a whole step or more after they were due.
    pub missed_deadlines: u64,
    /// Steps that began more than a tenth of a step late.
    pub late_steps: u64,
    /// Mean time from due to begun.
    pub lateness_mean_ns: f64,
    /// Half of the steps began no later than this.
    pub lateness_p50_ns: i64,
    /// 99 % of them.
    pub lateness_p99_ns: i64,
    /// 99.9 % of them.
    pub lateness_p999_ns: i64,
    /// All of them.
    pub lateness_max_ns: i64,
}

/// One virtual host's capture.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct CaptureRecord {
    /// Where.
    pub host: VirtualHost,
    /// Packets in the file.
    pub packets: u64,
    /// Packets that the kernel dropped before they could be read.
    pub dropped: u64,
    /// What captured: `builtin`, or the first line of `tcpdump --version`.
    #[serde(default = "builtin")]
    pub tool: String,
}

/// What captured before it was on record.
fn builtin() -> String {
    "builtin".to_owned()
}

/// One link's two directions, counted where packets enter and leave its ends.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LinkRecord {
    /// Whose link.
    pub host: VirtualHost,
    /// From the host to the switch.
    pub up: PassRecord,
    /// From the switch to the host.
    pub down: PassRecord,
}

/// One pass through a link's end.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct PassRecord {
    /// Packets offered.
    pub offered: u64,
    /// Packets lost as the settings ask, and those that found the queue full where `overflowed` is none.
    pub lost: u64,
    /// Packets dropped since the queue was full; none where they cannot be told from `lost` (netem).
    pub overflowed: Option<u64>,
    /// Packets delivered.
    pub delivered: u64,
    /// Mean time from when a packet was due to when it was delivered; none where nobody can say (the kernel).
    pub lateness_mean_ns: Option<f64>,
    /// The largest such time since the run began, not only in this window; none where nobody can say.
    #[serde(alias = "lateness_max_ns")]
    pub lateness_max_of_run_ns: Option<u64>,
}

/// How late the emulator let packets go, in one window, over all passes through its links.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ReleaseRecord {
    /// Packets let go; one that crosses the network makes two passes.
    pub released: u64,
    /// Mean time from when a packet was due to when it was let go.
    pub lateness_mean_ns: f64,
    /// 99 % of them were no later than this, to 1/64.
    pub lateness_p99_ns: u64,
    /// 99.9 % of them, to 1/64.
    pub lateness_p999_ns: u64,
    /// All of them, to 1/64.
    pub lateness_max_ns: u64,
}

/// A file beside the record.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileRecord {
    /// Its name, without a folder.
    #[serde(deserialize_with = "name")]
    pub name: String,
    /// Its length.
    pub bytes: u64,
    /// Its SHA-256, in hexadecimal.
    pub sha256: String,
    /// What was measured, if the file is that one compressed with zstd, `.zst` behind its name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured: Option<MeasuredFile>,
}

/// A file as it was before it was compressed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct MeasuredFile {
    /// Its length.
    pub bytes: u64,
    /// Its SHA-256, in hexadecimal.
    pub sha256: String,
}

impl FileRecord {
    /// The file as it was measured.
    #[must_use]
    pub fn as_measured(&self) -> Self {
        match &self.measured {
            Some(measured) => Self {
                name: self.name.trim_end_matches(".zst").to_owned(),
                bytes: measured.bytes,
                sha256: measured.sha256.clone(),
                measured: None,
            },
            None => self.clone(),
        }
    }
}

#[cfg(test)]
mod tests {
    use rstest::rstest;

    #[test]
    fn of_a_window_with_more_words_than_any_says_the_first_are_kept() {
        let recorded = concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/../../tests/fixtures/recorded/scenarios/"
        );
        let path = format!("{recorded}x86-64-debian-12-docker/window-1/window.json");
        let mut record: super::WindowRecord = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
        // As a command with ten nodes that failed, with their last words.
        let ours: Vec<String> = (0..20)
            .map(|it| format!("{it}: {}", "said ".repeat(60)))
            .collect();
        record.reasons.clone_from(&ours);
        record.shorten_reasons();
        assert_eq!(record.reasons, ours);
        record.reasons = vec!["x".repeat(600); 100];
        record.shorten_reasons();
        assert_eq!(record.reasons.len(), 14);
        assert_eq!(record.reasons[13], "and 87 more, which window.json has");
    }

    #[rstest]
    #[case::none(&[], "")]
    #[case::sentences(&["12 steps late.", "Too few."], "12 steps late. Too few.")]
    #[case::phrases(&["no `a.csv`", "no `b.txt`"], "no `a.csv`; no `b.txt`")]
    #[case::both(&["exit code 3", "Time went back.", "no `b.txt`"], "exit code 3; Time went back. no `b.txt`")]
    #[case::an_empty_one(&["", "no `b.txt`"], "no `b.txt`")]
    fn the_reasons_of_a_window_can_be_told_apart_in_one_line(#[case] reasons: &[&str], #[case] line: &str) {
        let reasons: Vec<String> = reasons.iter().map(|&it| it.to_owned()).collect();
        assert_eq!(super::reasons_in_one_line(&reasons), line);
    }
}
