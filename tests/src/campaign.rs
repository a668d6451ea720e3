//! The crash campaign: what a kill, a loss of power, a disk or a limit may do to a run, done at many points, and what it may
//! not have done looked at after each. `docs/crashes.md` has what came of it. The main function is [`run`].
//!
//! ```text
//! campaign: its points, listed  ->  each point done in a scene of its own  ->  the judge's verdict  ->  a row of the table
//! ```

pub mod disks;
pub mod files;
pub mod judge;
pub mod kills;
pub mod limits;
pub mod scene;
pub mod windows;

use std::{
    collections::BTreeSet,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicUsize, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use nix::sys::signal::Signal;

use judge::{FAULTS, Fault, Verdict};
use kills::{Caller, Victim};
use scene::Platform;

use crate::matrix_binary;

/// One thing that is done to a run, and what is looked at afterwards.
pub struct Point {
    name: String,
    done: Box<dyn Fn(&mut Verdict) + Send + Sync>,
}

impl Point {
    /// A point of that name.
    pub fn new(name: impl Into<String>, done: impl Fn(&mut Verdict) + Send + Sync + 'static) -> Self {
        Self {
            name: name.into(),
            done: Box::new(done),
        }
    }
}

/// Points of one kind.
struct Campaign {
    name: &'static str,
    /// How many of its points are done side by side: one where they share something.
    side_by_side: usize,
    /// Why CI's tenth leaves it out: a defect of `matrix` that is known and not mended yet, or its time. The whole has it.
    left_out: Option<&'static str>,
    points: fn() -> Vec<Point>,
}

/// Fake windows keep a processor busy, measured ones wait for the next step.
const BUSY: usize = 2;
const WAITING: usize = 4;
const ALONE: usize = 1;

const CAMPAIGNS: &[Campaign] = &[
    Campaign {
        name: "fake: matrix killed after each journal line",
        side_by_side: BUSY,
        left_out: None,
        points: || kills::after_each_line(Platform::Fake, Victim::Matrix),
    },
    Campaign {
        name: "fake: run killed before each call",
        side_by_side: BUSY,
        left_out: None,
        points: || kills::before_each_call_of_run(Platform::Fake, Caller::Matrix),
    },
    Campaign {
        name: "fake: resume killed before each call",
        side_by_side: BUSY,
        left_out: None,
        points: || kills::before_each_call_of_resume(Platform::Fake),
    },
    Campaign {
        name: "fake: clean killed before each call",
        side_by_side: BUSY,
        left_out: None,
        points: || kills::before_each_call_of_clean(Platform::Fake),
    },
    Campaign {
        name: "native: matrix killed after each journal line",
        side_by_side: WAITING,
        left_out: None,
        points: || kills::after_each_line(Platform::Native, Victim::Matrix),
    },
    Campaign {
        name: "native: its group killed after each journal line",
        side_by_side: WAITING,
        left_out: None,
        points: || kills::after_each_line(Platform::Native, Victim::Group),
    },
    Campaign {
        name: "native: workload killed after each journal line",
        side_by_side: WAITING,
        left_out: None,
        points: || kills::after_each_line(Platform::Native, Victim::Workload),
    },
    Campaign {
        name: "native: all killed after each journal line",
        side_by_side: WAITING,
        left_out: None,
        points: || kills::after_each_line(Platform::Native, Victim::Everything),
    },
    Campaign {
        name: "native: run killed before each call",
        side_by_side: WAITING,
        left_out: None,
        points: || kills::before_each_call_of_run(Platform::Native, Caller::Matrix),
    },
    Campaign {
        name: "native: a program of it killed before each call",
        side_by_side: WAITING,
        left_out: None,
        points: || kills::before_each_call_of_run(Platform::Native, Caller::Program),
    },
    Campaign {
        name: "native: all killed at random",
        side_by_side: WAITING,
        left_out: None,
        points: || kills::at_random(Platform::Native, Victim::Everything, 20, 1),
    },
    Campaign {
        name: "native: run and resumes killed again and again",
        side_by_side: WAITING,
        left_out: None,
        points: || kills::again_and_again(Platform::Native, 8, 2),
    },
    Campaign {
        name: "native: resume killed after each journal line",
        side_by_side: WAITING,
        left_out: None,
        points: || kills::after_each_line_of_resume(Platform::Native, Victim::Matrix),
    },
    Campaign {
        name: "native: clean killed before each call",
        side_by_side: WAITING,
        left_out: None,
        points: || kills::before_each_call_of_clean(Platform::Native),
    },
    Campaign {
        name: "native: asked to stop after each journal line",
        side_by_side: WAITING,
        left_out: None,
        points: || kills::asked_to_stop(Platform::Native, Signal::SIGTERM),
    },
    Campaign {
        name: "fake: journal cut",
        side_by_side: BUSY,
        left_out: None,
        points: || files::journal_cut(Platform::Fake),
    },
    Campaign {
        name: "fake: files emptied, cut, flipped, gone",
        side_by_side: BUSY,
        left_out: None,
        points: || files::damaged(Platform::Fake),
    },
    Campaign {
        name: "native: files emptied, cut, flipped, gone",
        side_by_side: BUSY,
        left_out: None,
        points: || files::damaged(Platform::Native),
    },
    Campaign {
        name: "native: windows moved away",
        side_by_side: WAITING,
        left_out: None,
        points: || files::windows_gone(Platform::Native),
    },
    Campaign {
        name: "fake: power cut after each journal line",
        side_by_side: BUSY,
        left_out: Some(
            "the fake platform syncs nothing of its own, and takes what is half there for discarded",
        ),
        points: || disks::power_cuts(Platform::Fake),
    },
    Campaign {
        name: "native: power cut after each journal line",
        side_by_side: WAITING,
        left_out: None,
        points: || disks::power_cuts(Platform::Native),
    },
    Campaign {
        name: "native: disk full after each journal line",
        side_by_side: WAITING,
        left_out: None,
        points: || disks::full_after_each_line(Platform::Native, kills::lines(Platform::Native)),
    },
    Campaign {
        name: "native: disk too small",
        side_by_side: WAITING,
        left_out: None,
        points: || disks::too_small(Platform::Native),
    },
    Campaign {
        name: "native: limits of files, lengths, memory",
        side_by_side: WAITING,
        left_out: None,
        points: || limits::below_limits(Platform::Native),
    },
    Campaign {
        name: "native: workload stands still",
        side_by_side: WAITING,
        left_out: None,
        points: || limits::workload_stands_still(Platform::Native),
    },
    Campaign {
        name: "native: resumed with another state folder",
        side_by_side: WAITING,
        left_out: None,
        points: || limits::another_state_folder(Platform::Native),
    },
    Campaign {
        name: "docker: matrix killed after each journal line",
        side_by_side: ALONE,
        left_out: None,
        points: || kills::after_each_line(Platform::Docker, Victim::Matrix),
    },
    Campaign {
        name: "docker: workload killed after each journal line",
        side_by_side: ALONE,
        left_out: None,
        points: || kills::after_each_line(Platform::Docker, Victim::Workload),
    },
    Campaign {
        name: "docker: all killed at random",
        side_by_side: ALONE,
        left_out: None,
        points: || kills::at_random(Platform::Docker, Victim::Everything, 10, 3),
    },
    Campaign {
        name: "ssh: matrix killed after each journal line",
        side_by_side: WAITING,
        left_out: None,
        points: || kills::after_each_line(Platform::Ssh, Victim::Matrix),
    },
    Campaign {
        name: "ssh: all killed after each journal line",
        side_by_side: WAITING,
        left_out: None,
        points: || kills::after_each_line(Platform::Ssh, Victim::Everything),
    },
    Campaign {
        name: "vm: matrix killed after some events",
        side_by_side: ALONE,
        left_out: Some("each point takes minutes"),
        points: || {
            let events = &["environment-creating", "measuring", "window-collected"];
            kills::after_events(Platform::Machine, Victim::Matrix, events)
        },
    },
];

/// Which points are done.
#[derive(Debug, Clone, Default)]
pub struct Extent {
    /// Only every tenth of each campaign, always the same ones, of those that it does not leave out.
    pub tenth: bool,
    /// Only campaigns that have one of these in their names; all without any.
    pub only: Vec<String>,
}

/// A row of the table.
#[derive(Debug)]
pub struct Row {
    /// The campaign.
    pub name: &'static str,
    /// How many points were done.
    pub points: usize,
    /// What was found, with the point's name.
    pub faults: Vec<(String, Fault, String)>,
    /// How long it took.
    pub took: Duration,
}

/// The names of all campaigns.
pub fn names() -> impl Iterator<Item = &'static str> {
    CAMPAIGNS.iter().map(|campaign| campaign.name)
}

/// Does the campaigns, one after another, and hands over each one's row as soon as it is there.
pub fn run(extent: &Extent, mut tell: impl FnMut(&Row)) -> Vec<Row> {
    let wanted = |campaign: &&Campaign| {
        if extent.tenth && campaign.left_out.is_some() {
            return false;
        }
        extent.only.is_empty()
            || extent
                .only
                .iter()
                .any(|words| campaign.name.contains(words.as_str()))
    };
    // No point is to wait while it is built.
    matrix_binary();
    let mut rows = Vec::new();
    for campaign in CAMPAIGNS.iter().filter(wanted) {
        let row = row(campaign, extent.tenth);
        tell(&row);
        rows.push(row);
    }
    rows
}

fn row(campaign: &Campaign, tenth: bool) -> Row {
    let begun = Instant::now();
    let mut points = (campaign.points)();
    if tenth {
        // Not the first ones, at which next to nothing has happened yet.
        let first = points.len().saturating_sub(1) % 10 / 2 + points.len().min(10) / 4;
        points = points.into_iter().skip(first).step_by(10).collect();
    }
    let next = AtomicUsize::new(0);
    let faults = Mutex::new(Vec::new());
    thread::scope(|scope| {
        for _ in 0..campaign.side_by_side {
            scope.spawn(|| {
                while let Some(point) = points.get(next.fetch_add(1, Ordering::Relaxed)) {
                    let found = verdict_on(point);
                    let mut faults = faults.lock().unwrap_or_else(PoisonError::into_inner);
                    faults.extend(
                        found
                            .into_iter()
                            .map(|(fault, what)| (point.name.clone(), fault, what)),
                    );
                }
            });
        }
    });
    Row {
        name: campaign.name,
        points: points.len(),
        faults: faults.into_inner().unwrap_or_else(PoisonError::into_inner),
        took: begun.elapsed(),
    }
}

/// A point that cannot be looked at is no good word either.
fn verdict_on(point: &Point) -> Vec<(Fault, String)> {
    let mut verdict = Verdict::default();
    let done = catch_unwind(AssertUnwindSafe(|| (point.done)(&mut verdict)));
    if done.is_err() {
        verdict.note(
            Fault::WrongWord,
            "the point could not be looked at: see what was said above",
        );
    }
    verdict.faults
}

impl Row {
    /// How many windows were lost or measured twice; of all else, at how many points it was so.
    #[must_use]
    pub fn count(&self, fault: Fault) -> usize {
        let of_a_kind = self.faults.iter().filter(|(_, found, _)| *found == fault);
        match fault {
            Fault::Lost | Fault::MeasuredTwice => of_a_kind.count(),
            Fault::Leak | Fault::WrongWord | Fault::Hang => of_a_kind
                .map(|(point, _, _)| point)
                .collect::<BTreeSet<_>>()
                .len(),
        }
    }
}

/// The table, in Markdown.
#[must_use]
pub fn table(rows: &[Row]) -> String {
    let heads: String = FAULTS.iter().map(|(_, head)| format!(" {head} |")).collect();
    let mut text = format!(
        "| campaign | points |{heads}\n|---|--:|{}\n",
        "--:|".repeat(FAULTS.len())
    );
    let mut line = |name: &str, points: usize, rows: &[&Row]| {
        let counts: String = FAULTS
            .iter()
            .map(|(fault, _)| format!(" {} |", rows.iter().map(|row| row.count(*fault)).sum::<usize>()))
            .collect();
        text.push_str(&format!("| {name} | {points} |{counts}\n"));
    };
    for row in rows {
        line(row.name, row.points, &[row]);
    }
    line(
        "all",
        rows.iter().map(|row| row.points).sum(),
        &rows.iter().collect::<Vec<_>>(),
    );
    text
}
