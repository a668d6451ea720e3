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

use self::{
    judge::{FAULTS, Fault, Verdict},
    kills::{Caller, Victim},
    scene::Platform,
};
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
    /// Why CI's tenth leaves it out. The whole has it.
    left_out: Option<&'static str>,
    points: fn() -> Vec<Point>,
}

const fn campaign(name: &'static str, side_by_side: usize, points: fn() -> Vec<Point>) -> Campaign {
    Campaign {
        name,
        side_by_side,
        left_out: None,
        points,
    }
}

impl Campaign {
    const fn left_out(mut self, why: &'static str) -> Self {
        self.left_out = Some(why);
        self
    }
}

/// Fake windows keep a processor busy, measured ones wait for the next step.
const BUSY: usize = 2;
const WAITING: usize = 4;
const ALONE: usize = 1;

const CAMPAIGNS: &[Campaign] = &[
    campaign("fake: matrix killed after each journal line", BUSY, || {
        kills::after_each_line(Platform::Fake, Victim::Matrix)
    }),
    campaign("fake: run killed before each call", BUSY, || {
        kills::before_each_call_of_run(Platform::Fake, Caller::Matrix)
    }),
    campaign("fake: resume killed before each call", BUSY, || {
        kills::before_each_call_of_resume(Platform::Fake)
    }),
    campaign("fake: clean killed before each call", BUSY, || {
        kills::before_each_call_of_clean(Platform::Fake)
    }),
    campaign("native: matrix killed after each journal line", WAITING, || {
        kills::after_each_line(Platform::Native, Victim::Matrix)
    }),
    campaign(
        "native: its group killed after each journal line",
        WAITING,
        || kills::after_each_line(Platform::Native, Victim::Group),
    ),
    campaign("native: workload killed after each journal line", WAITING, || {
        kills::after_each_line(Platform::Native, Victim::Workload)
    }),
    campaign("native: all killed after each journal line", WAITING, || {
        kills::after_each_line(Platform::Native, Victim::Everything)
    }),
    campaign("native: run killed before each call", WAITING, || {
        kills::before_each_call_of_run(Platform::Native, Caller::Matrix)
    }),
    campaign("native: a program of it killed before each call", WAITING, || {
        kills::before_each_call_of_run(Platform::Native, Caller::Program)
    }),
    campaign("native: all killed at random", WAITING, || {
        kills::at_random(Platform::Native, Victim::Everything, 20, 1)
    }),
    campaign("native: run and resumes killed again and again", WAITING, || {
        kills::again_and_again(Platform::Native, 8, 2)
    }),
    campaign("native: resume killed after each journal line", WAITING, || {
        kills::after_each_line_of_resume(Platform::Native, Victim::Matrix)
    }),
    campaign("native: clean killed before each call", WAITING, || {
        kills::before_each_call_of_clean(Platform::Native)
    }),
    campaign("native: asked to stop after each journal line", WAITING, || {
        kills::asked_to_stop(Platform::Native, Signal::SIGTERM)
    }),
    campaign("fake: journal cut", BUSY, || files::journal_cut(Platform::Fake)),
    campaign("fake: files emptied, cut, flipped, gone", BUSY, || {
        files::damaged(Platform::Fake)
    }),
    campaign("native: files emptied, cut, flipped, gone", BUSY, || {
        files::damaged(Platform::Native)
    }),
    campaign("native: windows moved away", WAITING, || {
        files::windows_gone(Platform::Native)
    }),
    campaign("fake: power cut after each journal line", BUSY, || {
        disks::power_cuts(Platform::Fake)
    }),
    campaign("native: power cut after each journal line", WAITING, || {
        disks::power_cuts(Platform::Native)
    }),
    campaign("native: disk full after each journal line", WAITING, || {
        disks::full_after_each_line(Platform::Native, kills::lines(Platform::Native))
    }),
    campaign("native: disk too small", WAITING, || {
        disks::too_small(Platform::Native)
    }),
    campaign("native: limits of files, lengths, memory", WAITING, || {
        limits::below_limits(Platform::Native)
    }),
    campaign("native: workload stands still", WAITING, || {
        limits::workload_stands_still(Platform::Native)
    }),
    campaign("native: resumed with another state folder", WAITING, || {
        limits::another_state_folder(Platform::Native)
    }),
    campaign("docker: matrix killed after each journal line", ALONE, || {
        kills::after_each_line(Platform::Docker, Victim::Matrix)
    }),
    campaign("docker: workload killed after each journal line", ALONE, || {
        kills::after_each_line(Platform::Docker, Victim::Workload)
    }),
    campaign("docker: all killed at random", ALONE, || {
        kills::at_random(Platform::Docker, Victim::Everything, 10, 3)
    }),
    campaign("ssh: matrix killed after each journal line", WAITING, || {
        kills::after_each_line(Platform::Ssh, Victim::Matrix)
    }),
    campaign("ssh: all killed after each journal line", WAITING, || {
        kills::after_each_line(Platform::Ssh, Victim::Everything)
    }),
    campaign("vm: matrix killed after some events", ALONE, || {
        let events = &["environment-creating", "measuring", "window-collected"];
        kills::after_events(Platform::Machine, Victim::Matrix, events)
    })
    .left_out("each point takes minutes"),
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
