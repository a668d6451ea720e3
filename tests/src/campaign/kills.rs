//! Kills: of `matrix`, its group, the workload or all, after each line of the journal, before each call that changes a file,
//! at random; of `resume`, of `clean`.

use std::{
    collections::BTreeMap,
    fs,
    sync::{Mutex, PoisonError},
    thread,
    time::{Duration, Instant},
};

use nix::sys::signal::Signal;
use sha2::{Digest as _, Sha256};

use super::{
    Point,
    judge::{Fault, Verdict},
    scene::{Platform, Scene, Started},
    windows::Windows,
};

/// Who is killed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Victim {
    /// `matrix` alone.
    Matrix,
    /// `matrix` and what is in its process group.
    Group,
    /// The workload; `matrix` sees it.
    Workload,
    /// All of them at once.
    Everything,
}

impl Victim {
    fn kill(self, scene: &Scene, started: Started, verdict: &mut Verdict) {
        match self {
            Self::Matrix => started.kill(),
            Self::Group => started.kill_group(),
            Self::Workload => {
                scene.kill_workload();
                verdict.ended("run", started.end());
            }
            Self::Everything => {
                started.kill_group();
                scene.kill_workload();
            }
        }
    }
}

/// How many lines the journal has of a run that nothing happens to. It is run once for all campaigns.
#[must_use]
pub fn lines(platform: Platform) -> usize {
    static KNOWN: Mutex<Vec<(Platform, usize)>> = Mutex::new(Vec::new());
    let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((_, lines)) = known.iter().find(|(of, _)| *of == platform) {
        return *lines;
    }
    let scene = Scene::on(platform);
    let ran = scene.run(&["run", "m.yaml"]).expect("a run ends");
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let lines = scene.journal_lines();
    known.push((platform, lines));
    lines
}

/// A point after each line of the journal.
pub fn after_each_line(platform: Platform, victim: Victim) -> Vec<Point> {
    let point = |line| {
        Point::new(format!("line {line}"), move |verdict| {
            let mut scene = Scene::on(platform);
            let mut started = scene.start(&[], &["run", "m.yaml"]);
            scene.wait_for_line(&mut started, line);
            victim.kill(&scene, started, verdict);
            let before = Windows::anywhere(&scene);
            verdict.go_on_whole(&mut scene, &before);
        })
    };
    (1..=lines(platform)).map(point).collect()
}

/// A point as soon as each of these events is in the journal, the workload's own among them.
pub fn after_events(platform: Platform, victim: Victim, events: &'static [&'static str]) -> Vec<Point> {
    let point = |event: &&'static str| {
        let event = *event;
        Point::new(format!("after {event}"), move |verdict| {
            let mut scene = Scene::on(platform);
            let mut started = scene.start(&[], &["run", "m.yaml"]);
            scene.wait_for_event(&mut started, event);
            victim.kill(&scene, started, verdict);
            let before = Windows::anywhere(&scene);
            verdict.go_on_whole(&mut scene, &before);
        })
    };
    events.iter().map(point).collect()
}

/// A point after each line of the journal at which the run is asked to stop.
pub fn asked_to_stop(platform: Platform, signal: Signal) -> Vec<Point> {
    let point = |line| {
        Point::new(format!("line {line}"), move |verdict| {
            let mut scene = Scene::on(platform);
            let mut started = scene.start(&[], &["run", "m.yaml"]);
            scene.wait_for_line(&mut started, line);
            started.signal(signal);
            let before = Windows::anywhere(&scene);
            if let Some(ran) = verdict.ended("run", started.end()) {
                let finished = scene
                    .journal()
                    .last()
                    .is_some_and(|last| last["event"] == "run-finished");
                let told = if finished { Some(0) } else { Some(130) };
                if scene
                    .run_directory()
                    .is_some_and(|run| run.join("manifest.json").exists())
                    && ran.code != told
                {
                    verdict.note(
                        Fault::WrongWord,
                        format!("finished is {finished}, and run ended with {:?}", ran.code),
                    );
                }
            }
            verdict.go_on_whole(&mut scene, &before);
        })
    };
    // Before the first, nobody listens yet.
    (2..=lines(platform)).map(point).collect()
}

/// So many moments of a run, drawn once and for ever.
pub fn at_random(platform: Platform, victim: Victim, moments: u32, seed: u64) -> Vec<Point> {
    let scene = Scene::on(platform);
    let begun = Instant::now();
    scene.run(&["run", "m.yaml"]).expect("a run ends");
    let takes = begun.elapsed();
    let point = |number| {
        let share = drawn(seed, number);
        Point::new(
            format!("{number} of seed {seed}, at {share:.3} of a run"),
            move |verdict| {
                let mut scene = Scene::on(platform);
                let started = scene.start(&[], &["run", "m.yaml"]);
                thread::sleep(takes.mul_f64(share));
                victim.kill(&scene, started, verdict);
                let before = Windows::anywhere(&scene);
                verdict.go_on_whole(&mut scene, &before);
            },
        )
    };
    (0..moments).map(point).collect()
}

/// Between 0 and 1, from a seed and a number.
fn drawn(seed: u64, number: u32) -> f64 {
    let bytes = Sha256::new()
        .chain_update(seed.to_le_bytes())
        .chain_update(number.to_le_bytes())
        .finalize();
    let drawn = bytes
        .iter()
        .take(4)
        .fold(0, |drawn, byte| drawn << 8 | u32::from(*byte));
    f64::from(drawn) / f64::from(u32::MAX)
}

/// A soak: run and resumes are killed again and again, each a little later than the one before.
pub fn again_and_again(platform: Platform, soaks: u32, seed: u64) -> Vec<Point> {
    const KILLS: u32 = 8;
    let point = |soak| {
        Point::new(
            format!("soak {soak} of seed {seed}, {KILLS} kills"),
            move |verdict| {
                let mut scene = Scene::on(platform);
                let mut before = Windows::default();
                for kill in 0..KILLS {
                    let run = scene
                        .run_directory()
                        .map(|run| run.to_string_lossy().into_owned());
                    let started = match &run {
                        None => scene.start(&[], &["run", "m.yaml"]),
                        Some(run) => scene.start(&[], &["resume", run]),
                    };
                    thread::sleep(Duration::from_secs(3).mul_f64(drawn(seed, soak * KILLS + kill)));
                    Victim::Everything.kill(&scene, started, verdict);
                    // What was whole once stays the one.
                    before.add(Windows::anywhere(&scene));
                }
                verdict.go_on_whole(&mut scene, &before);
            },
        )
    };
    (0..soaks).map(point).collect()
}

/// The system calls by which `matrix` changes files, talks to an engine and starts programs.
const CALLS: [&str; 23] = [
    "write",
    "pwrite64",
    "writev",
    "rename",
    "renameat",
    "renameat2",
    "mkdir",
    "mkdirat",
    "unlink",
    "unlinkat",
    "rmdir",
    "fsync",
    "fdatasync",
    "ftruncate",
    "chmod",
    "fchmod",
    "fchmodat",
    "flock",
    "connect",
    "sendto",
    "sendmsg",
    "vfork",
    "clone3",
];
/// A call that is made more often is taken so many times, evenly.
const OF_ONE_CALL: usize = 40;

/// Whose calls are counted: one of them is killed before its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Caller {
    /// `matrix`. The programs that it starts go on by themselves.
    Matrix,
    /// Any of the programs: `matrix`, those that it starts, and the workload.
    Program,
}

/// The words before a command that have strace kill a caller before a thread's `number`th call of that name; without a number
/// it only writes them down.
fn strace(scene: &Scene, caller: Caller, kill: Option<(&str, usize)>) -> Vec<String> {
    // What another architecture does not have is left out.
    let calls = CALLS.map(|call| format!("?{call}")).join(",");
    let log = scene.aside("calls").to_string_lossy().into_owned();
    let words = ["strace", "-f", "-qq", "-o", &log, "-e", &format!("trace={calls}")];
    let mut words: Vec<String> = words.map(str::to_owned).to_vec();
    words.extend(match caller {
        Caller::Matrix => ["-b", "execve"].map(str::to_owned).to_vec(),
        // Who measures is not stopped at the calls that are not counted.
        Caller::Program => vec!["--seccomp-bpf".to_owned()],
    });
    if let Some((call, number)) = kill {
        words.extend([
            "-e".to_owned(),
            format!("inject={call}:signal=KILL:when={number}"),
        ]);
    }
    words
}

/// The calls of a command, each with how often the thread made it that made it most.
fn calls_of(scene: &Scene, caller: Caller, arguments: &[&str]) -> Vec<(String, usize)> {
    let ended = scene
        .start(&strace(scene, caller, None), arguments)
        .end()
        .expect("it ends");
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let log = fs::read_to_string(scene.aside("calls")).expect("strace wrote it");
    let mut made: BTreeMap<(&str, &str), usize> = BTreeMap::new();
    for line in log.lines() {
        let call = line
            .split_once(' ')
            .and_then(|(thread, rest)| Some((thread, rest.trim_start().split_once('(')?.0)));
        if let Some((thread, call)) = call.filter(|(_, call)| CALLS.contains(call)) {
            *made.entry((call, thread)).or_default() += 1;
        }
    }
    let mut most: BTreeMap<String, usize> = BTreeMap::new();
    for ((call, _), times) in made {
        let most = most.entry(call.to_owned()).or_default();
        *most = times.max(*most);
    }
    most.into_iter().collect()
}

/// A point before each of these calls.
fn before_each_call(
    calls: Vec<(String, usize)>,
    done: impl Fn(&str, usize, &mut Verdict) + Clone + Send + Sync + 'static,
) -> Vec<Point> {
    let numbers = |(call, times): (String, usize)| {
        let step = times.div_ceil(OF_ONE_CALL);
        (1..=times)
            .step_by(step)
            .map(move |number| (call.clone(), number))
    };
    let point = |(call, number): (String, usize)| {
        let done = done.clone();
        Point::new(format!("{call} {number}"), move |verdict| {
            done(&call, number, verdict)
        })
    };
    calls.into_iter().flat_map(numbers).map(point).collect()
}

/// A point before each call of a run, of `matrix` or of any of its programs.
pub fn before_each_call_of_run(platform: Platform, caller: Caller) -> Vec<Point> {
    let calls = calls_of(&Scene::on(platform), caller, &["run", "m.yaml"]);
    before_each_call(calls, move |call, number, verdict| {
        let mut scene = Scene::on(platform);
        let killed = scene.start(&strace(&scene, caller, Some((call, number))), &["run", "m.yaml"]);
        has_ended(verdict, "run", killed);
        let before = Windows::anywhere(&scene);
        verdict.go_on_whole(&mut scene, &before);
    })
}

/// That strace, and with it what it has killed, has ended.
fn has_ended(verdict: &mut Verdict, what: &str, killed: Started) {
    if killed.end().is_err() {
        verdict.note(Fault::Hang, format!("{what} under strace did not end"));
    }
}

/// A run that was killed with all that belongs to it when its journal had half its lines.
fn half_done(platform: Platform, half: usize, verdict: &mut Verdict) -> Scene {
    let scene = Scene::on(platform);
    let mut started = scene.start(&[], &["run", "m.yaml"]);
    scene.wait_for_line(&mut started, half);
    Victim::Everything.kill(&scene, started, verdict);
    scene
}

fn run_path(scene: &Scene) -> String {
    scene
        .run_directory()
        .map(|run| run.to_string_lossy().into_owned())
        .unwrap_or_default()
}

/// A point before each call of a resume of a run that was killed half-way.
pub fn before_each_call_of_resume(platform: Platform) -> Vec<Point> {
    let half = lines(platform) / 2;
    let reference = half_done(platform, half, &mut Verdict::default());
    let calls = calls_of(&reference, Caller::Matrix, &["resume", &run_path(&reference)]);
    before_each_call(calls, move |call, number, verdict| {
        let mut scene = half_done(platform, half, verdict);
        let mut before = Windows::anywhere(&scene);
        let killed = scene.start(
            &strace(&scene, Caller::Matrix, Some((call, number))),
            &["resume", &run_path(&scene)],
        );
        has_ended(verdict, "resume", killed);
        before.add(Windows::anywhere(&scene));
        verdict.go_on_whole(&mut scene, &before);
    })
}

/// A point after each line that a resume of a run that was killed half-way adds to the journal.
pub fn after_each_line_of_resume(platform: Platform, victim: Victim) -> Vec<Point> {
    let all = lines(platform);
    let half = all / 2;
    let point = |more| {
        Point::new(format!("line {half} and {more} more"), move |verdict| {
            let mut scene = half_done(platform, half, verdict);
            let mut before = Windows::anywhere(&scene);
            let line = scene.journal_lines() + more;
            let mut resumed = scene.start(&[], &["resume", &run_path(&scene)]);
            scene.wait_for_line(&mut resumed, line);
            victim.kill(&scene, resumed, verdict);
            before.add(Windows::anywhere(&scene));
            verdict.go_on_whole(&mut scene, &before);
        })
    };
    (1..=all - half).map(point).collect()
}

/// A point before each call of a clean after a run that was killed half-way. Only what is in the run directory is kept then.
pub fn before_each_call_of_clean(platform: Platform) -> Vec<Point> {
    let half = lines(platform) / 2;
    let reference = half_done(platform, half, &mut Verdict::default());
    let calls = calls_of(&reference, Caller::Matrix, &["clean"]);
    before_each_call(calls, move |call, number, verdict| {
        let mut scene = half_done(platform, half, verdict);
        let before = Windows::in_place(&scene);
        let killed = scene.start(&strace(&scene, Caller::Matrix, Some((call, number))), &["clean"]);
        has_ended(verdict, "clean", killed);
        verdict.succeeds(&scene, &["clean"]);
        // A copy that was being collected is the run's, and goes with its resume.
        verdict.nothing_is_left_outside(&mut scene);
        verdict.go_on_whole(&mut scene, &before);
    })
}
